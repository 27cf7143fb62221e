//! The names that a host has given out: ports, and devices with their holders.

use super::Deployment;
use serde::{Deserialize, Serialize};

/// The answer to [`super::Request::Names`].
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Names {
    /// The ports of programs on this host that are connected by wires.
    pub ports: Vec<PortName>,
    /// The devices of this host that have a holder.
    pub devices: Vec<DeviceName>,
}

/// A port of a program.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct PortName {
    /// The deployment of the program.
    pub deployment: Deployment,
    /// Absolute path of the process.
    pub path: String,
    /// The port.
    pub port: String,
    /// Whether it is an output.
    pub is_output: bool,
    /// The type of its values, if the program's interface declares it.
    pub kind: Option<String>,
}

/// A device of a host, and its holder.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct DeviceName {
    /// The device.
    pub device: String,
    /// The deployment of the holder.
    pub deployment: Deployment,
    /// Absolute path of the holder. If there are several readers, the type of one reader.
    pub path: String,
    /// Whether the device is held exclusively.
    pub is_exclusive: bool,
}
