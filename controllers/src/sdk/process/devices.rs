//! The links of a program to devices and to people. They are always open, and do not belong to the wires of a spec.

use super::inbox::{Hold, Inbox};
use super::keyring::Keyring;
use super::links::LinkOrders;
use super::objects::Serving;
use super::taps::Taps;
use super::wire::{put, subscribe};
use crate::sdk::interface::{Binding, Direction, Interface, PortInterface};
use comms::io::data::{DataSession, Payload, Priority, Publisher, Subscription, Voucher};
use comms::logic::codec::{self, Enveloped};
use comms::logic::key::{self, Channel};
use std::sync::Arc;

/// The links of a program to devices and to people; they exist after its first links were made.
#[derive(Debug, Default)]
pub(super) struct Devices {
    outputs: Vec<DeviceOutput>,
    inputs: Vec<Subscription>,
    signals: Option<Publisher>,
    pub(super) taps: Taps,
    /// Kept as long as calls are to arrive.
    serving: Serving,
}

/// An output to a device of another program, or an output of a device that this program owns.
#[derive(Debug)]
struct DeviceOutput {
    port: &'static str,
    publisher: Publisher,
    /// The voucher for its samples, in a team.
    voucher: Option<Arc<Voucher>>,
}

impl DeviceOutput {
    fn put(&self, payload: Payload) {
        match &self.voucher {
            None => put(&self.publisher, payload),
            Some(voucher) => {
                if let Err(error) = self.publisher.put_vouched(payload, voucher) {
                    tracing::debug!(%error, "a sample was not sent");
                }
            }
        }
    }
}

impl Devices {
    /// Sends a value of an output to its devices.
    pub(super) fn send(&self, port: &str, payload: &Payload) {
        for device in self.outputs.iter().filter(|device| device.port == port) {
            device.put(payload.clone());
        }
    }

    /// Publishes signals, or their peaks between two samples.
    pub(super) fn show(&self, signals: &impl Enveloped) {
        if let (Some(publisher), Ok(bytes)) = (&self.signals, codec::encode(signals)) {
            put(publisher, bytes.into());
        }
    }

    /// Returns whether a device or a person receives this output.
    pub(super) fn hears(&self, port: &str) -> bool {
        self.outputs.iter().any(|device| device.port == port) || self.taps.is_heard(port)
    }

    pub(super) fn make(
        session: &Arc<DataSession>,
        keyring: Option<&Keyring>,
        interface: &Interface,
        orders: &LinkOrders,
        inbox: &Arc<Inbox>,
    ) -> Result<Self, String> {
        let mut devices = Self::default();
        for port in interface.ports.iter().filter(|port| port.binding != Binding::Wire) {
            devices.port(session, keyring, orders, port, inbox)?;
        }
        let key = key::signals(&orders.robot, &orders.instance);
        devices.signals = Some(session.publisher(&key, Priority::Background).map_err(|error| error.to_string())?);
        let taps = Taps::make(session, interface, &orders.robot, &orders.instance);
        devices.taps = taps.map_err(|error| error.to_string())?;
        let serving = Serving::make(session, keyring, interface, &orders.robot, &orders.instance, inbox);
        devices.serving = serving.map_err(|error| error.to_string())?;
        Ok(devices)
    }

    fn port(
        &mut self,
        session: &DataSession,
        keyring: Option<&Keyring>,
        orders: &LinkOrders,
        port: &PortInterface,
        inbox: &Arc<Inbox>,
    ) -> Result<(), String> {
        let device = port.device_key().ok_or_else(|| format!("`{}` is not a device key", port.name))?;
        let channel = if device.channel == "state" { Channel::State } else { Channel::Command };
        // A device of another deployment has the keys of that deployment.
        let owner = orders.devices.iter().find(|other| other.device == device.name);
        let robot = owner.map_or(&orders.robot, |owner| &owner.deployment);
        let key = key::hardware(robot, device.name, channel);
        match port.direction {
            Direction::In => {
                let gate = keyring.map(|keyring| keyring.device_gate(device.name, &key));
                self.inputs.push(subscribe(session, gate, &key, port.name, Hold::default(), inbox)?);
            }
            Direction::Out => {
                let publisher = session.publisher(&key, Priority::Device).map_err(|error| error.to_string())?;
                let voucher = keyring.map(|keyring| keyring.voucher(device.name, &key));
                self.outputs.push(DeviceOutput { port: port.name, publisher, voucher });
            }
        }
        Ok(())
    }
}
