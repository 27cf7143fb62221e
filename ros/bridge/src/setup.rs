//! Parts that the bridge and actions share: they get the network of ROS 2 and the node name from the arguments of a program, the schemas of
//! types, and names and signals for interfaces.

use crate::logic::network::Network;
use comms::logic::signals::Signal;
use controllers::sdk::{Arguments, Kind, Parameter};
use ros::logic::library;
use ros::logic::name::TypeName;
use ros::logic::schema::Schema;

/// The domain. If it is empty, the variable of ROS 2 is used.
pub(crate) const DOMAIN: Parameter = Parameter::new("domain", Kind::Text(&[])).or("");
/// The settings of the session. If they are empty, the variable of ROS 2 is used.
pub(crate) const SETTINGS: Parameter = Parameter::new("settings", Kind::Text(&[])).or("");
/// The distribution of ROS 2. If it is empty, the variable of ROS 2 is used.
pub(crate) const DISTRIBUTION: Parameter = Parameter::new("distribution", Kind::Text(&[])).or("");
/// The longest name of a node. ROS 2 allows 255 characters for the name with its namespace.
const NODE_NAME_MAX: usize = 200;

/// Returns the network that the arguments and the environment declare.
///
/// # Errors
/// The error is a sentence for a person.
pub(crate) fn network(arguments: &Arguments) -> Result<Network, String> {
    network_of(arguments, |variable| std::env::var(variable).ok())
}

/// Returns the network that the arguments and this environment declare.
///
/// # Errors
/// The error is a sentence for a person.
pub(crate) fn network_of(
    arguments: &Arguments,
    environment: impl Fn(&str) -> Option<String>,
) -> Result<Network, String> {
    let given = |argument: &str, variable: &str| match arguments.text(argument) {
        "" => environment(variable).unwrap_or_default(),
        text => text.to_owned(),
    };
    let (domain, settings) = (given("domain", "ROS_DOMAIN_ID"), given("settings", "ZENOH_CONFIG_OVERRIDE"));
    Network::read(&domain, &settings, &given("distribution", "ROS_DISTRO"))
}

/// Returns the name of the node in ROS 2. Each process of each deployment has its own name.
pub(crate) fn node_name(arguments: &Arguments) -> String {
    let name = format!("dca_{}_{}", arguments.deployment(), arguments.instance());
    let word = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
    name.chars().map(word).take(NODE_NAME_MAX).collect()
}

/// Returns the schema of a standard type.
///
/// # Errors
/// The error is a sentence for a person.
pub(crate) fn schema(of: &TypeName) -> Result<Schema, String> {
    library::schema(of).map_err(|error| format!("`{of}`: {error}"))
}

/// Returns a text that lives as long as the process, like the names in interfaces. An interface is made once.
pub(crate) fn for_ever(text: String) -> &'static str {
    Box::leak(text.into_boxed_str())
}

/// Returns a signal for a count.
#[expect(clippy::cast_precision_loss, reason = "a count for people")]
pub(crate) fn signal(name: String, count: u64) -> Signal {
    Signal { name, unit: String::new(), value: count as f64, headline: false }
}
