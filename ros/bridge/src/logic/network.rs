//! The network of ROS 2 in which a bridge takes part, from the variables that ROS 2 itself reads.

use ros::logic::hash::rihs01;
use ros::logic::schema::Schema;

/// The router that ROS 2 uses by default.
const ROUTER: &str = r#"["tcp/localhost:7447"]"#;
/// The setting that names the router.
const ENDPOINTS: &str = "connect/endpoints";
/// The setting that the bridge chooses itself: routers do not forward messages between peers.
const MODE: &str = "mode";
/// The largest domain, as the ports of other middlewares limit it.
const DOMAIN_MAX: u32 = 232;

/// The distribution whose keys do not contain the hash of a type.
const HUMBLE: &str = "humble";
/// The word that its keys contain in place of a hash.
const NO_HASH: &str = "TypeHashNotSupported";

/// The network, and the settings of a session in it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Network {
    /// The first part of the keys of all topics.
    pub(crate) domain: u32,
    /// Settings of Zenoh: key and value in JSON5.
    pub(crate) settings: Vec<(String, String)>,
    /// Whether the nodes belong to the distribution Humble.
    is_humble: bool,
}

impl Network {
    /// Reads `ROS_DOMAIN_ID`, `ZENOH_CONFIG_OVERRIDE` and `ROS_DISTRO`. Source: `rmw_zenoh`, `docs/design.md` and `zenoh_config.cpp`.
    ///
    /// # Errors
    /// The error is a sentence for a person.
    pub(crate) fn read(domain: &str, overrides: &str, distribution: &str) -> Result<Self, String> {
        let number = if domain.is_empty() { Some(0) } else { domain.parse().ok() };
        let domain = number
            .filter(|domain| *domain <= DOMAIN_MAX)
            .ok_or_else(|| format!("`ROS_DOMAIN_ID` is `{domain}`, and not a number up to {DOMAIN_MAX}"))?;
        let mut settings = vec![(ENDPOINTS.to_owned(), ROUTER.to_owned())];
        for one in overrides.split(';').map(str::trim).filter(|one| !one.is_empty()) {
            let (key, value) = one
                .split_once('=')
                .ok_or_else(|| format!("`ZENOH_CONFIG_OVERRIDE` has `{one}`, and not `KEY=VALUE`"))?;
            let (key, value) = (key.trim(), value.trim());
            if key != MODE {
                settings.push((key.to_owned(), value.to_owned()));
            }
        }
        let network = Self { domain, settings, is_humble: distribution == HUMBLE };
        let has_router = network.router().chars().any(|character| !matches!(character, '[' | ']' | '"' | ' '));
        if !has_router {
            return Err(format!("`ZENOH_CONFIG_OVERRIDE` sets `{ENDPOINTS}` to an empty list: it needs the router"));
        }
        Ok(network)
    }

    /// Returns the hash of a type, as in keys.
    pub(crate) fn hash(&self, of: &Schema) -> String {
        if self.is_humble { NO_HASH.to_owned() } else { rihs01(of) }
    }

    /// Returns the addresses of the router, for people.
    pub(crate) fn router(&self) -> &str {
        let last = self.settings.iter().rev().find(|(key, _)| key == ENDPOINTS);
        last.map_or(ROUTER, |(_, value)| value)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_variables_of_ros_are_read() {
        let plain = Network::read("", "", "").unwrap();
        assert_eq!((plain.domain, plain.router()), (0, r#"["tcp/localhost:7447"]"#));
        let text = r#"mode="peer"; connect/endpoints=["tcp/10.0.0.3:7448"] ;"#;
        let other = Network::read("42", text, "jazzy").unwrap();
        assert_eq!((other.domain, other.router()), (42, r#"["tcp/10.0.0.3:7448"]"#));
        assert!(other.settings.iter().all(|(key, _)| key != "mode"));
    }

    #[test]
    fn humble_has_no_hashes() {
        let schema = ros::logic::library::schema(&ros::logic::name::TypeName::parse("std_msgs/Bool").unwrap()).unwrap();
        let hash = |distribution: &str| Network::read("", "", distribution).unwrap().hash(&schema);
        assert_eq!((hash("humble"), hash("jazzy")), (NO_HASH.to_owned(), rihs01(&schema)));
    }

    #[test]
    fn mistakes_in_them_are_told() {
        for (domain, overrides) in
            [("x", ""), ("-1", ""), ("233", ""), ("0", "connect"), ("0", "connect/endpoints=[ ]")]
        {
            assert!(Network::read(domain, overrides, "").is_err(), "{domain} {overrides}");
        }
    }
}
