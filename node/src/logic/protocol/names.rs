//! The names that a host has given out: ports, and devices with their holders.

use super::Deployment;
use serde::{Deserialize, Serialize};

/// The answer to [`super::Request::Names`].
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Names {
    /// The ports of the programs of this host that are wired.
    pub ports: Vec<PortName>,
    /// The devices of this host that are held.
    pub devices: Vec<DeviceName>,
}

/// A port of a program.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct PortName {
    /// Of which deployment.
    pub deployment: Deployment,
    /// Absolute path of the process.
    pub path: String,
    /// The port.
    pub port: String,
    /// Whether values leave the program there.
    pub is_output: bool,
    /// The type of its values, as far as the program's interface says it.
    pub kind: Option<String>,
}

/// A device of a host, and its holder.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct DeviceName {
    /// The device.
    pub device: String,
    /// Of which deployment its holder is.
    pub deployment: Deployment,
    /// Absolute path of the holder, or of one of several readers.
    pub path: String,
    /// Whether the device is held exclusively.
    pub is_exclusive: bool,
}
