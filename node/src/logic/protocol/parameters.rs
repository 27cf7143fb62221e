//! Messages about the parameters of programs.

use super::Deployment;
use language::plan::{Constant, Parameter};
use serde::{Deserialize, Serialize};

/// The parameters of a program that runs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct InstanceParameters {
    /// Its deployment.
    pub deployment: Deployment,
    /// Absolute path.
    pub path: String,
    /// Its type.
    pub module: String,
    /// None if no program of the host declares the parameters of that type.
    pub parameters: Option<Vec<ParameterStatus>>,
    /// The name of the node of ROS 2 that its program is. Such a node has its parameters itself.
    pub ros_node: Option<String>,
}

/// A parameter of a running program.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ParameterStatus {
    /// Its name and the values that it takes.
    pub parameter: Parameter,
    /// The value of the plan, if it gives one.
    pub given: Option<Constant>,
}
