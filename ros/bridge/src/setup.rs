//! The network of ROS 2 and the name in it, from the arguments of a program.

use crate::logic::network::Network;
use controllers::sdk::{Arguments, Kind, Parameter};

/// The domain; without it the variable of ROS 2 counts.
pub(crate) const DOMAIN: Parameter = Parameter::new("domain", Kind::Text(&[])).or("");
/// Settings of the session; without them the variable of ROS 2 counts.
pub(crate) const SETTINGS: Parameter = Parameter::new("settings", Kind::Text(&[])).or("");
/// The distribution of ROS 2; without it the variable of ROS 2 counts.
pub(crate) const DISTRIBUTION: Parameter = Parameter::new("distribution", Kind::Text(&[])).or("");
/// The longest name of a node. ROS 2 allows 255 with its namespace.
const NODE_NAME_MAX: usize = 200;

/// Returns the network that is meant.
///
/// # Errors
/// A sentence for a person.
pub(crate) fn network(arguments: &Arguments) -> Result<Network, String> {
    let given = |argument: &str, variable: &str| match arguments.text(argument) {
        "" => std::env::var(variable).unwrap_or_default(),
        text => text.to_owned(),
    };
    let (domain, settings) = (given("domain", "ROS_DOMAIN_ID"), given("settings", "ZENOH_CONFIG_OVERRIDE"));
    Network::read(&domain, &settings, &given("distribution", "ROS_DISTRO"))
}

/// Returns the name of the node that ROS 2 sees: one for each process of each deployment.
pub(crate) fn node_name(arguments: &Arguments) -> String {
    let name = format!("dca_{}_{}", arguments.deployment(), arguments.instance());
    let word = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
    name.chars().map(word).take(NODE_NAME_MAX).collect()
}
