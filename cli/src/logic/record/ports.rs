//! Chooses the wires whose values are recorded.

use super::message::Messages;
use super::missing::WireName;
use crate::logic::mission::short;
use crate::logic::tap::{self, Wanted};
use comms::logic::key;
use comms::logic::layout::Message;
use comms::logic::tap::{OutputType, Outputs};
use language::plan::{LeafPort, Plan, Transfer, Wire};
use node::logic::protocol::Deployment;
use std::sync::Arc;

/// The most outputs that a message lists.
const CHOICES_MAX: usize = 8;

/// A wire that is recorded.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Port {
    /// Path of the producer.
    pub producer: String,
    /// The ends of the wire.
    pub name: WireName,
    /// The type of the values, if the plan or the interface of the producer declares it.
    pub message: Option<Arc<Message>>,
    /// Index into `Plan::wires`.
    wire: u32,
}

impl Port {
    /// Returns a wire without a known type.
    #[cfg(test)]
    pub(crate) fn of(name: WireName) -> Self {
        Self { producer: "main".to_owned(), name, message: None, wire: 0 }
    }

    /// Returns the key under which the values of the wire are sent.
    pub fn key(&self, deployment: &Deployment) -> String {
        key::wire(&deployment.name, deployment.epoch, self.wire)
    }
}

/// Returns the outputs that can be named, as a sentence continues.
fn choices(plan: &Plan) -> String {
    let mut outputs: Vec<String> = Vec::new();
    for wire in plan.wires.iter().filter(|wire| wire.transfer == Transfer::Push) {
        let path = plan.leaves.get(wire.from.leaf as usize).map_or("", |leaf| &leaf.path);
        let output = format!("`{}.{}`", short(path), wire.from.port);
        if !outputs.contains(&output) {
            outputs.push(output);
        }
    }
    let more = outputs.len().saturating_sub(CHOICES_MAX);
    outputs.truncate(CHOICES_MAX);
    match (outputs.is_empty(), more) {
        (true, _) => "no process sends values to another one".to_owned(),
        (false, 0) => format!("connected are {}; `all` records all of them", outputs.join(", ")),
        (false, _) => format!("connected are {} and {more} more; `all` records all of them", outputs.join(", ")),
    }
}

/// Returns the named wires: `all`, or outputs such as `Out`, `force.Out` or `hit/force.Out`. `messages` contains the
/// known types of outputs.
///
/// # Errors
/// A sentence for a person: some name fits no wire that can be recorded.
pub fn ports(plan: &Plan, wanted: &[String], messages: &Messages) -> Result<Vec<Port>, String> {
    let named = |port: &LeafPort| {
        let path = plan.leaves.get(port.leaf as usize).map_or("", |leaf| &leaf.path);
        (path.to_owned(), format!("{path}/{}", port.port))
    };
    let mut found = Vec::new();
    for what in wanted {
        let output = Wanted::parse(what)?;
        let deployment = Deployment { name: plan.name.clone(), epoch: 0 };
        let process = output.process().of_any_run();
        let is_meant =
            |from: &LeafPort| process.is_process(&deployment, &named(from).0) && output.is_output(&from.port);
        let meant = |wire: &Wire| what == "all" || is_meant(&wire.from);
        let wires = || (0_u32..).zip(&plan.wires).filter(|(_, wire)| meant(wire));
        if wires().next().is_none() && what != "all" {
            return Err(format!("no output `{what}` is connected; {}", choices(plan)));
        }
        // If the consumer of a wire fetches the values, they are not sent, so they cannot be received.
        let pushed: Vec<_> = wires().filter(|(_, wire)| wire.transfer == Transfer::Push).collect();
        if pushed.is_empty() && what != "all" {
            return Err(format!("`{what}` cannot be recorded: its consumers fetch its values"));
        }
        for (wire, route) in pushed {
            let ((producer, from), (_, to)) = (named(&route.from), named(&route.to));
            let message = output_message(plan, messages, &route.from).map(Arc::new);
            let port = Port { producer, name: WireName { from, to }, message, wire };
            if !found.contains(&port) {
                found.push(port);
            }
        }
    }
    Ok(found)
}

/// Returns the type of the values of an output. The plan has the types of the bridge to ROS 2, and `messages` has the
/// types that interfaces declare.
pub(crate) fn output_message(plan: &Plan, messages: &Messages, output: &LeafPort) -> Option<Message> {
    if let Some(type_name) = plan.ros_type(output) {
        let output = OutputType { name: output.port.clone(), type_name, fields: String::new() };
        return tap::message(&output, &Outputs::default());
    }
    let module = &plan.leaves.get(output.leaf as usize)?.module;
    messages.get(module)?.get(&output.port).cloned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::mission::tests::door;
    use crate::logic::record::messages;
    use language::{Options, Source, compile};

    /// The plan has the types of the bridge to ROS 2, and interfaces have the types of other outputs.
    #[test]
    fn the_type_of_each_output_is_known() {
        let source = Source::new(
            "a.dca",
            "module Avoid(host: Host) { in Scan: ros.sensor.LaserScan; out Cmd: ros.geometry.Twist; }
            module Log(host: Host) { in Cmd: ros.geometry.Twist; }
            process main() { host { c1 }
                instantiated_processes { avoid instof Avoid(c1); log instof Log(c1); }
                internal_connections {
                    topic(\"/front/scan\", qos = sensor) -> avoid.Scan;
                    avoid.Cmd -> topic(\"/cmd\", qos = reliable(10)); avoid.Cmd -> log.Cmd;
                }
                internal_event_actions { avoid, log }
            }",
        );
        let compiled = compile(&source, &[], &Options::named("a"));
        let plan = compiled.plan.unwrap_or_else(|| panic!("{:?}", compiled.diagnostics));
        let found = ports(&plan, &["all".to_owned()], &messages(&[source])).unwrap();
        let mut types: Vec<(&str, &str)> = found
            .iter()
            .map(|port| (port.name.from.as_str(), port.message.as_ref().map_or("", |of| &of.name)))
            .collect();
        types.sort_unstable();
        let (scan, twist) = ("ros.sensor.LaserScan", "ros.geometry.Twist");
        let expected = [("main/avoid/Cmd", twist), ("main/avoid/Cmd", twist), ("main/ros/front.scan", scan)];
        assert_eq!(types, expected);
    }

    #[test]
    fn ports_are_meant_by_their_names() {
        let mut plan = door();
        let port = |leaf, port: &str| LeafPort { leaf, port: port.to_owned() };
        let wire = |from, to, transfer| Wire { from, to, transfer, quality: Default::default() };
        plan.wires.push(wire(port(1, "Out"), port(0, "In"), Transfer::Push));
        plan.wires.push(wire(port(2, "Out"), port(0, "Near"), Transfer::Push));
        plan.wires.push(wire(port(0, "State"), port(1, "In"), Transfer::Pull));
        let check = |what: &[&str], expected: Result<&[&str], &str>| {
            let what: Vec<String> = what.iter().map(|what| (*what).to_owned()).collect();
            let found = ports(&plan, &what, &Messages::new());
            let found =
                found.as_ref().map(|ports| ports.iter().map(|port| port.name.from.as_str()).collect::<Vec<_>>());
            assert_eq!(found.as_deref().map_err(|why| why.as_str()), expected, "{what:?}");
        };
        check(&["all"], Ok(&["main/sys/servo/Out", "main/sys/near/Out"]));
        check(&["Out"], Ok(&["main/sys/servo/Out", "main/sys/near/Out"]));
        check(&["near.Out", "sys/near.Out"], Ok(&["main/sys/near/Out"]));
        let connected = "connected are `sys/servo.Out`, `sys/near.Out`; `all` records all of them";
        check(&["near.In"], Err(&format!("no output `near.In` is connected; {connected}")));
        check(&["State"], Err("`State` cannot be recorded: its consumers fetch its values"));
    }
}
