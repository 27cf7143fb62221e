//! What a node says of the parameters of its programs.

use super::Deployment;
use language::plan::{Constant, Parameter};
use serde::{Deserialize, Serialize};

/// What may be told to a program while it runs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct InstanceParameters {
    /// Its deployment.
    pub deployment: Deployment,
    /// Absolute path.
    pub path: String,
    /// Its type.
    pub module: String,
    /// None if no program of the host says what parameters that type has.
    pub parameters: Option<Vec<ParameterStatus>>,
}

/// A parameter of a running program.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ParameterStatus {
    /// What it is called and takes.
    pub parameter: Parameter,
    /// What the plan gives it, if anything.
    pub given: Option<Constant>,
}
