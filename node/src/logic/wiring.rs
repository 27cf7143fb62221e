//! Determines which program dials which other program. The links of a program follow from the plan and from the reports of all programs.
//!
//! The consumer of a wire dials the producer. A program that needs a device dials the program that owns the device's
//! keys. Programs on the same machine use Unix sockets. Others use the addresses on which the producer listens.

use crate::logic::protocol::{Deployment, LeafFacts};
use comms::logic::control::{CallRoute, Device, Dial, Incoming, Location, Order, Outgoing, Partner, Shape};
use comms::logic::direct::Place;
use comms::logic::key;
use language::plan::{Plan, Quality, Retention, Transfer, Wire};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// The facts of a deployment after every program has reported.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Registrations {
    /// The facts by leaf.
    pub facts: BTreeMap<u32, LeafFacts>,
    /// The machine of each host, in the plan's order.
    pub machines: Vec<String>,
}

/// Returns the order that tells `leaf` each of its links, for the wires that are `live`.
///
/// # Errors
/// Sentences for a user: a producer has no data session or cannot be reached, or a device has no owner or several owners.
pub fn links(
    plan: &Plan,
    deployment: &Deployment,
    registrations: &Registrations,
    leaf: u32,
    live: &BTreeSet<u32>,
) -> Result<Order, Vec<String>> {
    let (mut incoming, mut outgoing, mut devices, mut problems) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let is_data = |(number, wire): &(u32, &Wire)| live.contains(number) && wire.transfer != Transfer::Call;
    for (number, wire) in (0_u32..).zip(&plan.wires).filter(is_data) {
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
        let owner = owner(plan, registrations, leaf, device);
        match owner.and_then(|owner| Ok((owner, dial(plan, registrations, leaf, owner)?))) {
            Ok((leaf, owner)) => {
                let external = plan.external(leaf).map(|external| &external.deployment);
                let deployment = external.unwrap_or(&deployment.name).clone();
                devices.push(Device { device: device.clone(), owner, deployment });
            }
            Err(why) => problems.push(why),
        }
    }
    if problems.is_empty() {
        Ok(Order::Connect { robot: deployment.name.clone(), incoming, outgoing, devices })
    } else {
        Err(problems)
    }
}

/// Returns the order that tells `leaf` its callees, for the wires that are `live`; nothing if `leaf` calls no program.
///
/// # Errors
/// Sentences for a person: a program has no data session, or cannot be reached.
pub fn calls(
    plan: &Plan,
    deployment: &Deployment,
    registrations: &Registrations,
    leaf: u32,
    live: &BTreeSet<u32>,
) -> Result<Option<Order>, Vec<String>> {
    let is_call = |wire: &Wire| wire.transfer == Transfer::Call && wire.from.leaf == leaf;
    let wires = (0_u32..).zip(&plan.wires).filter(|(number, wire)| live.contains(number) && is_call(wire));
    let (mut calls, mut problems) = (Vec::new(), Vec::new());
    for (wire, Wire { from, to, .. }) in wires {
        match dial(plan, registrations, leaf, to.leaf) {
            Ok(server) => {
                let (external, seal) = (plan.external(to.leaf), seal(plan, deployment, wire));
                let path = external.map_or_else(|| path(plan, to.leaf), |external| &external.path).to_owned();
                let of = external.map_or(&deployment.name, |external| &external.deployment).clone();
                let (call, name) = (from.port.clone(), to.port.clone());
                calls.push(CallRoute { wire, call, server, path, name, deployment: of, seal });
            }
            Err(why) => problems.push(why),
        }
    }
    if !problems.is_empty() {
        return Err(problems);
    }
    Ok(plan.wires.iter().any(is_call).then_some(Order::Calls { calls }))
}

/// Returns the order that tells `leaf` how data moves on its wires; nothing if the spec does not say this for any wire.
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

/// Returns the number that both ends of a wire use for its seals. A program that serves other deployments also has
/// wires of its own. So the wires of an external call get a number of the upper half, which depends on the calling
/// deployment.
fn seal(plan: &Plan, Deployment { name, epoch }: &Deployment, wire: u32) -> u32 {
    if plan.wires.get(wire as usize).is_none_or(|wire| plan.external(wire.to.leaf).is_none()) {
        return wire;
    }
    // FNV-1a. If two numbers are equal, the only effect is that one of the two calls is refused.
    let bytes = name.bytes().chain(epoch.to_le_bytes()).chain(wire.to_le_bytes());
    let hash = bytes.fold(0x811c_9dc5_u32, |hash, byte| (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193));
    (1 << 31) | (hash & (u32::MAX >> 2))
}

/// Returns the programs at the other ends of the wires of `leaf`, with their keys; nothing if `leaf` has no keys.
pub fn partners(
    plan: &Plan,
    deployment: &Deployment,
    registrations: &Registrations,
    leaf: u32,
) -> Option<Vec<Partner>> {
    let location = |leaf: u32| registrations.facts.get(&leaf)?.location.as_ref();
    location(leaf).filter(|own| !own.keys.is_empty())?;
    let mut shared: BTreeMap<u32, (Vec<u32>, Vec<String>)> = BTreeMap::new();
    for (number, wire) in (0_u32..).zip(&plan.wires) {
        let other = match (wire.from.leaf == leaf, wire.to.leaf == leaf) {
            (true, _) => wire.to.leaf,
            (false, true) => wire.from.leaf,
            (false, false) => continue,
        };
        shared.entry(other).or_default().0.push(seal(plan, deployment, number));
    }
    for (other, device) in sharing(registrations, leaf) {
        shared.entry(other).or_default().1.push(device.clone());
    }
    let partner = |(other, (wires, devices)): (u32, (Vec<u32>, Vec<String>))| {
        let at = location(other)?;
        let is_near = machine(plan, registrations, leaf) == machine(plan, registrations, other);
        Some(Partner { session: at.session.clone(), keys: at.keys.clone(), is_near, wires, devices })
    };
    Some(shared.into_iter().filter_map(partner).collect())
}

/// Returns each device that `leaf` owns and another program needs, or that `leaf` needs and another program owns. Each
/// is returned with the other program.
fn sharing(registrations: &Registrations, leaf: u32) -> Vec<(u32, &String)> {
    let Some(own) = registrations.facts.get(&leaf) else { return Vec::new() };
    let others = registrations.facts.values().filter(|facts| facts.leaf != leaf);
    let shared = others.flat_map(|facts| {
        let needed = own.owns.iter().filter(|device| facts.needs.contains(device));
        let owned = own.needs.iter().filter(|device| facts.owns.contains(device));
        needed.chain(owned).map(|device| (facts.leaf, device))
    });
    shared.collect()
}

/// Returns the programs that have a wire to or from `leaf`, or share a device with it.
pub fn partnered(plan: &Plan, registrations: &Registrations, leaf: u32) -> BTreeSet<u32> {
    let ends = plan.wires.iter().map(|wire| (wire.from.leaf, wire.to.leaf));
    let others = ends.filter_map(|(from, to)| match (from == leaf, to == leaf) {
        (true, _) => Some(to),
        (false, true) => Some(from),
        (false, false) => None,
    });
    let sharing = sharing(registrations, leaf).into_iter().map(|(other, _)| other);
    others.chain(sharing).filter(|other| *other != leaf).collect()
}

/// Returns the programs that dial `leaf`: consumers of its outputs, its callers, and programs that need one of its devices.
pub fn dialers(plan: &Plan, registrations: &Registrations, leaf: u32) -> BTreeSet<u32> {
    let dialled = |wire: &&Wire| {
        let (dialled, dialler) =
            if wire.transfer == Transfer::Call { (&wire.to, &wire.from) } else { (&wire.from, &wire.to) };
        (dialled.leaf == leaf).then_some(dialler.leaf)
    };
    let consumers = plan.wires.iter().filter_map(|wire| dialled(&wire));
    let owned = registrations.facts.get(&leaf).map_or(&[][..], |facts| &facts.owns);
    let needs = |facts: &&LeafFacts| facts.needs.iter().any(|device| owned.contains(device));
    let users = registrations.facts.values().filter(needs).map(|facts| facts.leaf);
    consumers.chain(users).filter(|dialer| *dialer != leaf).collect()
}

/// Returns the order that tells `dialer` the new address of `moved`. `moved` was started again, and had the session
/// `lost` before. Nothing if `dialer` cannot reach `moved`, which was so before as well.
pub fn relink(plan: &Plan, registrations: &Registrations, dialer: u32, moved: u32, lost: &str) -> Option<Order> {
    let found = dial(plan, registrations, dialer, moved).ok()?;
    Some(Order::Relink { lost: lost.to_owned(), found })
}

/// Returns how a program that publishes signals can be reached. The location of its observer is unknown. So the
/// observer tries all ways in turn.
pub fn observe(registrations: &Registrations, leaf: u32) -> Option<Dial> {
    let location = registrations.facts.get(&leaf)?.location.as_ref()?;
    // An observer has no wire. So it does not get the direct path.
    let locators = location.local.iter().chain(&location.remote).filter(|locator| !Place::is_meant(locator));
    let locators = locators.cloned().collect();
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
    let is_near = machine(plan, registrations, from) == machine(plan, registrations, to);
    reach(location, is_near).ok_or_else(|| {
        let host = plan.leaves.get(to as usize).and_then(|leaf| plan.hosts.get(leaf.host as usize));
        let host = host.map_or("?", String::as_str);
        format!(
            "no other host can reach the programs of `{host}`: take its node into a team, or start it with `--insecure-lan`; if that is \
             done, give the host an IPv4 address, or an IPv6 address that is not link-local"
        )
    })
}

fn machine<'a>(plan: &Plan, registrations: &'a Registrations, leaf: u32) -> Option<&'a String> {
    let host = plan.leaves.get(leaf as usize)?.host;
    registrations.machines.get(host as usize)
}

fn reach(location: &Location, same_machine: bool) -> Option<Dial> {
    let locators = if same_machine { &location.local } else { &location.remote };
    (!locators.is_empty()).then(|| Dial { session: location.session.clone(), locators: locators.clone() })
}

fn path(plan: &Plan, leaf: u32) -> &str {
    plan.leaves.get(leaf as usize).map_or("?", |leaf| &leaf.path)
}

#[cfg(test)]
mod tests {
    use super::*;
    use language::{Options, Source, compile};
    use std::time::Duration;

    const SPEC: &str = r#"
module Source(host) { out Out: Number; out Other: Number; service; }
module Sink(host) { in In: Number; in Other: Number; done; }
process main() {
    host { "c1" }
    instantiated_processes { a instof Source("c1"); b instof Sink("c1"); c instof Sink("c2"); }
    internal_connections(a, lbl1) {
        a, Out -> b, In queue 4;
        a, Out -> c, In latch rate 10 Hz;
        a, Other -> c, Other;
    }
    internal_event_actions { a[lbl1], (b ; c) }
}
"#;

    fn plan() -> Plan {
        plan_of(SPEC)
    }

    fn plan_of(text: &str) -> Plan {
        let compiled = compile(&Source::new("wires", text), &[], &Options::named("wires"));
        compiled.plan.unwrap_or_else(|| panic!("{:#?}", compiled.diagnostics))
    }

    /// Returns the number of the leaf with this path.
    fn leaf_of(plan: &Plan, path: &str) -> u32 {
        (0_u32..).zip(&plan.leaves).find(|(_, leaf)| leaf.path == path).unwrap().0
    }

    fn facts(leaf: u32, session: &str) -> LeafFacts {
        let location =
            Location { session: session.into(), local: vec!["unix".into()], remote: vec!["tcp".into()], keys: vec![] };
        LeafFacts { location: Some(location), ..LeafFacts::plain(leaf) }
    }

    #[test]
    fn both_ends_are_told_how_data_moves_and_nobody_of_what_moves_as_ever() {
        let plan = plan();
        let queue = Shape { wire: 0, queue: Some(4), ..Shape::default() };
        let period_min = Some(Duration::from_millis(100));
        let latch = Shape { wire: 1, latch: true, period_min, ..Shape::default() };
        let order = |wires: &[Shape]| Some(Order::Shape { wires: wires.to_vec() });
        assert_eq!(shapes(&plan, 0), order(&[queue, latch]));
        assert_eq!(shapes(&plan, 1), order(&[queue]));
        assert_eq!(shapes(&plan, 2), order(&[latch]));
        assert_eq!(shapes(&plan, 3), None);
    }

    #[test]
    fn who_dials_a_program_is_told_where_it_is_now() {
        let plan = plan();
        let mut registrations = Registrations {
            facts: [facts(0, "new"), facts(1, "b"), facts(2, "c")].map(|facts| (facts.leaf, facts)).into(),
            machines: vec!["one".into(), "other".into()],
        };
        assert_eq!(dialers(&plan, &registrations, 0), BTreeSet::from([1, 2]));
        assert_eq!(dialers(&plan, &registrations, 1), BTreeSet::new());
        // A program that needs a device dials its owner even without a wire.
        registrations.facts.entry(1).and_modify(|facts| facts.owns = vec!["arm".into()]);
        registrations.facts.entry(0).and_modify(|facts| facts.needs = vec!["arm".into()]);
        assert_eq!(dialers(&plan, &registrations, 1), BTreeSet::from([0]));
        let relink = |dialer| relink(&plan, &registrations, dialer, 0, "old");
        let order = |locator: &str| {
            let found = Dial { session: "new".into(), locators: vec![locator.into()] };
            Some(Order::Relink { lost: "old".into(), found })
        };
        assert_eq!((relink(1), relink(2)), (order("unix"), order("tcp")));
    }

    /// The server of another deployment has its devices under that deployment's name.
    #[test]
    fn a_device_is_of_the_deployment_whose_program_owns_it() {
        let mut plan = plan();
        let mut registrations = Registrations {
            facts: [facts(0, "a"), facts(1, "b")].map(|facts| (facts.leaf, facts)).into(),
            machines: vec!["one".into(), "other".into()],
        };
        registrations.facts.entry(1).and_modify(|facts| facts.owns = vec!["arm".into()]);
        registrations.facts.entry(0).and_modify(|facts| facts.needs = vec!["arm".into()]);
        let mission = Deployment { name: "mission".into(), epoch: 1 };
        for (external, deployment) in [(None, "mission"), (Some("hardware"), "hardware")] {
            let path = "main/robot".to_owned();
            plan.leaves[1].external =
                external.map(|name| language::plan::External { deployment: name.to_owned(), path });
            let owner = Dial { session: "b".into(), locators: vec!["unix".into()] };
            let expected = Device { device: "arm".into(), owner, deployment: deployment.into() };
            let order = links(&plan, &mission, &registrations, 0, &BTreeSet::new());
            let Ok(Order::Connect { devices, robot, .. }) = order else { panic!("{order:?}") };
            assert_eq!((devices, robot), (vec![expected], "mission".to_owned()));
        }
    }

    /// In a team, the two ends of a wire know the present keys of each other.
    #[test]
    fn both_ends_know_the_keys_of_each_other() {
        let plan = plan();
        let keyed = |leaf: u32, session: &str, keys: &[u8]| {
            let mut facts = facts(leaf, session);
            facts.location.iter_mut().for_each(|location| location.keys = keys.to_vec());
            (leaf, facts)
        };
        let registrations = Registrations {
            facts: [keyed(0, "a", &[1]), keyed(1, "b", &[2]), keyed(2, "c", &[3])].into(),
            machines: vec!["one".into(), "other".into()],
        };
        let partner = |session: &str, keys: &[u8], is_near, wires: &[u32]| Partner {
            session: session.into(),
            keys: keys.to_vec(),
            is_near,
            wires: wires.to_vec(),
            devices: vec![],
        };
        let order = |partners: &[Partner]| Some(partners.to_vec());
        let deployment = Deployment { name: "d".into(), epoch: 1 };
        let partners = |registrations: &Registrations, leaf| partners(&plan, &deployment, registrations, leaf);
        let both = [partner("b", &[2], true, &[0]), partner("c", &[3], false, &[1, 2])];
        assert_eq!(partners(&registrations, 0), order(&both));
        assert_eq!(partners(&registrations, 1), order(&[partner("a", &[1], true, &[0])]));
        assert_eq!(partners(&registrations, 2), order(&[partner("a", &[1], false, &[1, 2])]));
        let partnered = |leaf| partnered(&plan, &registrations, leaf);
        assert_eq!((partnered(0), partnered(2)), (BTreeSet::from([1, 2]), BTreeSet::from([0])));
        // Programs that share a device know each other.
        let mut sharing = registrations.clone();
        sharing.facts.entry(1).and_modify(|facts| facts.owns = vec!["arm".into(), "ft".into()]);
        sharing.facts.entry(2).and_modify(|facts| facts.needs = vec!["arm".into()]);
        let arm =
            |session: &str, keys: &[u8]| Partner { devices: vec!["arm".into()], ..partner(session, keys, false, &[]) };
        let of_b = [partner("a", &[1], true, &[0]), arm("c", &[3])];
        assert_eq!(partners(&sharing, 1), order(&of_b));
        let of_c = [partner("a", &[1], false, &[1, 2]), arm("b", &[2])];
        assert_eq!(partners(&sharing, 2), order(&of_c));
        let open = Registrations { facts: [(0, facts(0, "a")), keyed(1, "b", &[2])].into(), ..registrations };
        assert_eq!(partners(&open, 0), None, "who has no keys is in no team");
    }

    /// A caller dials its callee, and the call is not an input of the callee. A program that calls no other gets no `Calls`.
    #[test]
    fn who_calls_is_told_what_and_where() {
        let text = r#"
module Server(host) { proc Grip(Number) -> Number; service; }
module Client(host) { calls Push(Number) -> Number; done; }
process main() {
    host { "c1" }
    instantiated_processes { a instof Client("c1"); b instof Server("c2"); }
    internal_connections { a, Push -> b, Grip; }
    internal_event_actions { b, a }
}
"#;
        let plan = plan_of(text);
        let (a, b) = (leaf_of(&plan, "main/a"), leaf_of(&plan, "main/b"));
        let registrations = Registrations {
            facts: [facts(a, "a"), facts(b, "b")].map(|facts| (facts.leaf, facts)).into(),
            machines: vec!["one".into(), "other".into()],
        };
        let server = Dial { session: "b".into(), locators: vec!["tcp".into()] };
        let (path, name, seal) = ("main/b".into(), "Grip".into(), 0);
        let route = CallRoute { wire: 0, call: "Push".into(), server, path, name, deployment: "d".into(), seal };
        let deployment = Deployment { name: "d".into(), epoch: 1 };
        let calls = |leaf, live: &BTreeSet<u32>| calls(&plan, &deployment, &registrations, leaf, live);
        let live = BTreeSet::from([0]);
        assert_eq!(calls(a, &live), Ok(Some(Order::Calls { calls: vec![route] })));
        assert_eq!(calls(a, &BTreeSet::new()), Ok(Some(Order::Calls { calls: vec![] })));
        assert_eq!(calls(b, &live), Ok(None));
        assert_eq!(dialers(&plan, &registrations, b), BTreeSet::from([a]));
        assert_eq!(dialers(&plan, &registrations, a), BTreeSet::new());
        for leaf in [a, b] {
            let Ok(Order::Connect { incoming, outgoing, .. }) = links(&plan, &deployment, &registrations, leaf, &live)
            else {
                panic!("it has no links")
            };
            assert!(incoming.is_empty() && outgoing.is_empty());
        }
    }

    /// A call of a process of another deployment goes to that deployment, under a number that none of its wires has.
    #[test]
    fn a_call_of_another_deployment_goes_to_its_process() {
        let text = r#"
module Server(host) { proc Grip(Number) -> Number; service; }
module Client(host) { calls Push(Number) -> Number; done; }
process main() {
    host { "c1" }
    instantiated_processes { a instof Client("c1"); b instof Server("c2"){ runs_in hardware "main/arm/hand"; } }
    internal_connections { a, Push -> b, Grip; }
    internal_event_actions { b, a }
}
"#;
        let plan = plan_of(text);
        let (a, b) = (leaf_of(&plan, "main/a"), leaf_of(&plan, "main/b"));
        let keyed = |leaf, session: &str| {
            let mut facts = facts(leaf, session);
            facts.location.iter_mut().for_each(|location| location.keys = vec![1]);
            facts
        };
        let registrations = Registrations {
            facts: [keyed(a, "a"), keyed(b, "b")].map(|facts| (facts.leaf, facts)).into(),
            machines: vec!["one".into(), "other".into()],
        };
        let deployment = Deployment { name: "d".into(), epoch: 1 };
        let Ok(Some(Order::Calls { calls })) = calls(&plan, &deployment, &registrations, a, &BTreeSet::from([0]))
        else {
            panic!("it calls nothing")
        };
        let [route] = &calls[..] else { panic!("{calls:?}") };
        assert_eq!((route.wire, route.path.as_str(), route.deployment.as_str()), (0, "main/arm/hand", "hardware"));
        assert!(route.seal >= 1 << 31 && route.seal < u32::MAX - 1);
        for leaf in [a, b] {
            let partners = partners(&plan, &deployment, &registrations, leaf).unwrap();
            assert_eq!(partners.iter().flat_map(|partner| partner.wires.clone()).collect::<Vec<_>>(), [route.seal]);
        }
        let later = Deployment { epoch: 2, ..deployment };
        assert_ne!(seal(&plan, &later, 0), route.seal, "each epoch has its own");
    }
}
