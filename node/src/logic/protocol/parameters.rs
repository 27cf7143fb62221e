//! Messages about the parameters of programs.

use super::Deployment;
use language::plan::{Constant, Parameter};
use serde::{Deserialize, Serialize};

/// The parameters of a running program.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct InstanceParameters {
    /// Its deployment.
    pub deployment: Deployment,
    /// Absolute path.
    pub path: String,
    /// The type of the program.
    pub module: String,
    /// Its parameters; nothing if no program of the host declares the parameters of this type.
    pub parameters: Option<Vec<ParameterStatus>>,
    /// If the program is a ROS 2 node, the name of the node. Such a node keeps its parameters itself.
    pub ros_node: Option<String>,
}

/// A parameter of a running program.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ParameterStatus {
    /// The name of the parameter, and the values that it accepts.
    pub parameter: Parameter,
    /// The value in the plan, if the plan gives one.
    pub given: Option<Constant>,
}
