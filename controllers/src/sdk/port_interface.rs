//! The interface of one port: its direction, its message type, and its binding.

/// One port.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PortInterface {
    /// The name: `In1`, or the device key `arm/state`.
    pub name: &'static str,
    /// The direction in which data flows.
    pub direction: Direction,
    /// The message type; both ends of a wire have the same type.
    pub type_name: &'static str,
    /// The fields of the message, as in a record; empty if the message type does not name them.
    pub fields: &'static str,
    /// The doc line of the port.
    pub doc: &'static str,
    /// Whether the controller cannot work if the port is not connected.
    pub required: bool,
    /// The binding of the port.
    pub binding: Binding,
}

/// The direction in which data flows through a port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// Into the controller.
    In,
    /// Out of the controller.
    Out,
}

/// The binding of a port: the wires of a spec, or a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Binding {
    /// The wires that a spec connects with the port.
    Wire,
    /// A device that another program owns. The port receives its `state` or sends to its `cmd`, and is always open.
    Client,
    /// A device that this program owns. The port sends its `state` or receives its `cmd`, and is always open.
    Owner,
}

/// One side of a device: `arm` and `state`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Device {
    /// `arm`, `base`, `ft`, `gripper`, `laser`, `camera`.
    pub name: &'static str,
    /// `state` or `cmd`.
    pub channel: &'static str,
}

impl PortInterface {
    /// Returns a port that a spec has to connect.
    pub fn wire(name: &'static str, direction: Direction, type_name: &'static str) -> Self {
        Self { name, direction, type_name, fields: "", doc: "", required: true, binding: Binding::Wire }
    }

    /// Returns a port that a spec may connect.
    pub fn optional(name: &'static str, direction: Direction, type_name: &'static str) -> Self {
        Self { required: false, ..Self::wire(name, direction, type_name) }
    }

    /// Returns a client's port of the device key `name`, such as `arm/state`.
    pub fn device(name: &'static str, direction: Direction, type_name: &'static str) -> Self {
        Self { binding: Binding::Client, ..Self::wire(name, direction, type_name) }
    }

    /// Returns the owner's port of the device key `name`.
    pub fn owner(name: &'static str, direction: Direction, type_name: &'static str) -> Self {
        Self { binding: Binding::Owner, ..Self::wire(name, direction, type_name) }
    }

    /// Returns the port with the fields of its message.
    #[must_use]
    pub fn carrying(self, fields: &'static str) -> Self {
        Self { fields, ..self }
    }

    /// Returns the port with its doc line.
    #[must_use]
    pub fn documented(self, doc: &'static str) -> Self {
        Self { doc, ..self }
    }

    /// Returns the device that the port is bound to, if it is.
    pub fn device_key(&self) -> Option<Device> {
        match self.binding {
            Binding::Wire => None,
            Binding::Client | Binding::Owner => {
                self.name.split_once('/').map(|(name, channel)| Device { name, channel })
            }
        }
    }
}
