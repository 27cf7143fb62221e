//! Who dials whom: the links of one program, worked out from the plan and from what every program told about itself.
//!
//! A wire is dialled from the consumer to the producer, a device from the program that needs it to the one that owns its
//! keys. Programs that share a machine use Unix sockets; others use the addresses that the producer listens on.

use crate::logic::protocol::{Deployment, LeafFacts};
use comms::logic::control::{Device, Dial, Incoming, Location, Order, Outgoing, Shape};
use comms::logic::key;
use language::plan::{Plan, Quality, Retention, Transfer, Wire};
use std::collections::BTreeMap;

/// What is known of a deployment once every program has reported.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Registrations {
    /// By leaf.
    pub facts: BTreeMap<u32, LeafFacts>,
    /// The machine of each host, in the plan's order.
    pub machines: Vec<String>,
}

/// Returns the order that tells `leaf` every link it takes part in.
///
/// # Errors
/// Sentences for a person: a producer without a data session or out of reach, a device that nobody or several own.
pub fn links(
    plan: &Plan,
    deployment: &Deployment,
    registrations: &Registrations,
    leaf: u32,
) -> Result<Order, Vec<String>> {
    let (mut incoming, mut outgoing, mut devices, mut problems) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for (number, wire) in (0_u32..).zip(&plan.wires) {
        let pull = wire.transfer == Transfer::Pull;
        let key = || key::wire(&deployment.name, deployment.epoch, number);
        if wire.from.leaf == leaf {
            outgoing.push(Outgoing { wire: number, port: wire.from.port.clone(), key: key(), pull });
        }
        if wire.to.leaf == leaf {
            match dial(plan, registrations, leaf, wire.from.leaf) {
                Ok(producer) => {
                    let port = wire.to.port.clone();
                    incoming.push(Incoming { wire: number, port, key: key(), producer, pull });
                }
                Err(why) => problems.push(why),
            }
        }
    }
    for device in registrations.facts.get(&leaf).map_or(&[][..], |facts| &facts.needs) {
        match owner(plan, registrations, leaf, device).and_then(|owner| dial(plan, registrations, leaf, owner)) {
            Ok(owner) => devices.push(Device { device: device.clone(), owner }),
            Err(why) => problems.push(why),
        }
    }
    if problems.is_empty() {
        Ok(Order::Connect { robot: deployment.name.clone(), incoming, outgoing, devices })
    } else {
        Err(problems)
    }
}

/// Returns the order that tells `leaf` how data moves on its wires, if the spec says so of any.
pub fn shapes(plan: &Plan, leaf: u32) -> Option<Order> {
    let wires = (0_u32..).zip(&plan.wires).filter(|(_, wire)| wire.from.leaf == leaf || wire.to.leaf == leaf);
    let shaped = wires.filter(|(_, wire)| wire.quality != Quality::default());
    let shapes = shaped.map(|(wire, Wire { quality, .. })| Shape {
        wire,
        latch: quality.retention == Retention::Latch,
        queue: quality.queue,
        period_min: quality.period_min,
    });
    let wires: Vec<Shape> = shapes.collect();
    (!wires.is_empty()).then_some(Order::Shape { wires })
}

/// Returns how to reach a program that publishes signals. Nobody knows where its observer is: it tries every way in turn.
pub fn observe(registrations: &Registrations, leaf: u32) -> Option<Dial> {
    let location = registrations.facts.get(&leaf)?.location.as_ref()?;
    let locators = location.local.iter().chain(&location.remote).cloned().collect();
    Some(Dial { session: location.session.clone(), locators })
}

fn owner(plan: &Plan, registrations: &Registrations, leaf: u32, device: &str) -> Result<u32, String> {
    let owns = |facts: &&LeafFacts| facts.owns.iter().any(|owned| owned == device);
    let owners: Vec<u32> = registrations.facts.values().filter(owns).map(|facts| facts.leaf).collect();
    match owners[..] {
        [owner] => Ok(owner),
        [] => Err(format!("`{}` needs the device `{device}`, which no process of this spec owns", path(plan, leaf))),
        [first, second, ..] => {
            let (first, second) = (path(plan, first), path(plan, second));
            Err(format!("both `{first}` and `{second}` own the device `{device}`; it can have one owner"))
        }
    }
}

fn dial(plan: &Plan, registrations: &Registrations, from: u32, to: u32) -> Result<Dial, String> {
    let location = registrations.facts.get(&to).and_then(|facts| facts.location.as_ref());
    let Some(location) = location else {
        return Err(format!("`{}` has no data session, so `{}` cannot reach it", path(plan, to), path(plan, from)));
    };
    let machine = |leaf: u32| {
        let host = plan.leaves.get(leaf as usize)?.host;
        registrations.machines.get(host as usize)
    };
    reach(location, machine(from) == machine(to)).ok_or_else(|| {
        let host = plan.leaves.get(to as usize).and_then(|leaf| plan.hosts.get(leaf.host as usize));
        let host = host.map_or("?", String::as_str);
        format!("host `{host}` is not open to the network; start its node with `--lan`")
    })
}

fn reach(location: &Location, same_machine: bool) -> Option<Dial> {
    let locators = if same_machine { &location.local } else { &location.remote };
    (!locators.is_empty()).then(|| Dial { session: location.session.clone(), locators: locators.clone() })
}

fn path(plan: &Plan, leaf: u32) -> &str {
    plan.leaves.get(leaf as usize).map_or("?", |leaf| &leaf.path)
}
