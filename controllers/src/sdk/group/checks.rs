//! The form of a group after the check that its members and wires fit.

use super::{GroupError, InProcessGroup, MEMBERS_MAX, Make, Member, MemberPort};
use crate::sdk::arguments::Arguments;
use crate::sdk::controller::{About, Outcome, Schedule, StartValue};
use crate::sdk::interface::{Binding, Direction, InnerOutput, Interface, PortInterface};
use crate::sdk::module::Module;
use std::collections::BTreeMap;

/// A group whose wires fit.
pub(super) struct Layout {
    pub(super) interface: Interface,
    pub(super) members: Vec<Place>,
    /// By the name of an input of the group, the inputs of members that get its values.
    pub(super) inputs: BTreeMap<&'static str, Vec<(usize, &'static str)>>,
    /// The index of the member of each export, and below of each call.
    pub(super) exports: BTreeMap<&'static str, usize>,
    pub(super) calls: BTreeMap<&'static str, usize>,
}

/// One member in the order of turns.
pub(super) struct Place {
    pub(super) name: String,
    pub(super) schedule: Schedule,
    pub(super) is_service: bool,
    make: Box<Make>,
    /// The destinations of its outputs.
    pub(super) outputs: BTreeMap<&'static str, Outlet>,
}

/// The destinations of the values of an output.
pub(super) struct Outlet {
    pub(super) targets: Vec<Target>,
    /// The index of this output among the outputs that lead to other members. None if this output leads to no member.
    pub(super) inner: Option<usize>,
}

/// One destination of an output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Target {
    /// The input of a member.
    Member(usize, &'static str),
    /// An output of the group.
    Outside(&'static str),
}

impl Layout {
    pub(super) fn of(group: InProcessGroup) -> Result<Self, GroupError> {
        let InProcessGroup { type_name, doc, parameters, members, wires, exposed } = group;
        if !(1..=MEMBERS_MAX).contains(&members.len()) {
            return Err(GroupError::Count { group: type_name, count: members.len() });
        }
        let names = members.iter().map(|member| &*member.name);
        unique(type_name, names)?;
        let mut joints = Joints::new(type_name, &members);
        wires.iter().try_for_each(|(from, to)| joints.wire(from, to))?;
        exposed.iter().try_for_each(|(end, name)| joints.expose(end, name))?;
        joints.devices()?;
        joints.check_inputs()?;
        let Joints { ports, inputs, outputs, .. } = joints;
        let (inner, outlets) = inner(&members, outputs);
        let about = About { parameters, ..about(type_name, doc, &members)? };
        let exports = members.iter().flat_map(|member| &member.interface.exports).cloned().collect::<Vec<_>>();
        let calls = members.iter().flat_map(|member| &member.interface.calls).cloned().collect::<Vec<_>>();
        unique(type_name, exports.iter().map(|export| export.name))?;
        unique(type_name, calls.iter().map(|call| call.name))?;
        let of = |names: fn(&Interface) -> Vec<&'static str>| {
            let all = members.iter().enumerate();
            all.flat_map(|(at, member)| names(&member.interface).into_iter().map(move |name| (name, at))).collect()
        };
        Ok(Self {
            exports: of(|interface| interface.exports.iter().map(|export| export.name).collect()),
            calls: of(|interface| interface.calls.iter().map(|call| call.name).collect()),
            interface: Interface { type_name, about, ports, exports, calls, inner },
            inputs,
            members: members.into_iter().zip(outlets).map(|(member, outputs)| Place::new(member, outputs)).collect(),
        })
    }

    /// Makes the members; they are not active yet.
    ///
    /// # Errors
    /// Names the member that refuses its arguments, and the reason.
    pub(super) fn make(&self, arguments: &Arguments) -> Result<Vec<Box<dyn Module>>, String> {
        let make = |place: &Place| (place.make)(arguments).map_err(|why| format!("`{}`: {why}", place.name));
        self.members.iter().map(make).collect()
    }
}

impl Place {
    fn new(Member { name, interface, make }: Member, outputs: BTreeMap<&'static str, Outlet>) -> Self {
        let About { schedule, service: is_service, .. } = interface.about;
        Self { name, schedule, is_service, make, outputs }
    }
}

/// Returns the outputs that lead to other members, and the destinations of all outputs of each member.
fn inner(
    members: &[Member],
    outputs: Vec<BTreeMap<&'static str, Vec<Target>>>,
) -> (Vec<InnerOutput>, Vec<BTreeMap<&'static str, Outlet>>) {
    let mut all = Vec::new();
    let mut outlet = |member: &Member, port: &'static str, targets: Vec<Target>| {
        let inputs = targets.iter().filter_map(|target| match target {
            Target::Member(to, input) => members.get(*to).map(|to| format!("{}.{input}", to.name)),
            Target::Outside(_) => None,
        });
        let (inputs, declared) = (inputs.collect::<Vec<_>>(), member.interface.port(port));
        let inner = declared.filter(|_| !inputs.is_empty()).map(|declared| {
            let (name, type_name, fields) = (format!("{}.{port}", member.name), declared.type_name, declared.fields);
            all.push(InnerOutput { name, type_name, fields, inputs });
            all.len() - 1
        });
        (port, Outlet { targets, inner })
    };
    let of_member = |(member, outputs): (&Member, BTreeMap<&'static str, Vec<Target>>)| {
        outputs.into_iter().map(|(port, targets)| outlet(member, port, targets)).collect()
    };
    let outlets = members.iter().zip(outputs).map(of_member).collect();
    (all, outlets)
}

/// Returns the description of the group: its period is the shortest period of its members, and it is a task if one of
/// them is a task.
fn about(group: &'static str, doc: &'static str, members: &[Member]) -> Result<About, GroupError> {
    let all = || members.iter().map(|member| &member.interface.about);
    let tasks: Vec<&Member> = members.iter().filter(|member| !member.interface.about.service).collect();
    let outcomes: &'static [Outcome] = match &tasks[..] {
        [only] => only.interface.about.outcomes,
        several => match several.iter().find(|member| !member.interface.about.outcomes.is_empty()) {
            Some(member) => return Err(GroupError::Outcomes { group, member: member.name.clone() }),
            None => &[],
        },
    };
    let about = if tasks.is_empty() { About::service(doc) } else { About::task(doc) };
    Ok(About {
        remembers: all().any(|about| about.remembers),
        schedule: Schedule {
            period: all().map(|about| about.schedule.period).min().unwrap_or(about.schedule.period),
            trigger: None,
        },
        stop_within: all().map(|about| about.stop_within).max().unwrap_or(about.stop_within),
        signals_every: all().filter_map(|about| about.signals_every).min(),
        outcomes,
        start: same(all().filter_map(|about| about.start)),
        ..about
    })
}

/// Returns the start value of all members that declare one. These members get the same bytes, so there is none if
/// their types differ.
fn same(mut starts: impl Iterator<Item = StartValue>) -> Option<StartValue> {
    let first = starts.next()?;
    starts.all(|other| other == first).then_some(first)
}

fn unique<'a>(group: &'static str, names: impl Iterator<Item = &'a str>) -> Result<(), GroupError> {
    let mut all: Vec<&str> = names.collect();
    all.sort_unstable();
    match all.windows(2).find(|pair| pair[0] == pair[1]) {
        Some(pair) => Err(GroupError::Twice { group, name: pair[0].to_owned() }),
        None => Ok(()),
    }
}

/// The wires of a group, while they are made.
struct Joints<'a> {
    group: &'static str,
    members: &'a [Member],
    ports: Vec<PortInterface>,
    inputs: BTreeMap<&'static str, Vec<(usize, &'static str)>>,
    /// For each member, its outputs and their destinations.
    outputs: Vec<BTreeMap<&'static str, Vec<Target>>>,
}

impl<'a> Joints<'a> {
    fn new(group: &'static str, members: &'a [Member]) -> Self {
        let outputs = members.iter().map(|_| BTreeMap::new()).collect();
        Self { group, members, ports: Vec::new(), inputs: BTreeMap::new(), outputs }
    }

    fn wire(&mut self, from: &MemberPort, to: &MemberPort) -> Result<(), GroupError> {
        let (from_at, output) = self.port(from, Some(Direction::Out))?;
        let (to_at, input) = self.port(to, Some(Direction::In))?;
        if !fit(output, input) {
            return Err(GroupError::Types { group: self.group, from: from.to_string(), to: to.to_string() });
        }
        let (target, targets) = (Target::Member(to_at, input.name), self.outputs_of(from_at, output.name));
        if targets.contains(&target) {
            return Err(GroupError::Twice { group: self.group, name: format!("{from} -> {to}") });
        }
        targets.push(target);
        Ok(())
    }

    fn expose(&mut self, end: &MemberPort, name: &'static str) -> Result<(), GroupError> {
        let (at, port) = self.port(end, None)?;
        match self.ports.iter().find(|other| other.name == name) {
            None => self.ports.push(PortInterface { name, ..port.clone() }),
            Some(other) if port.direction == Direction::Out || other.direction == Direction::Out => {
                return Err(GroupError::Twice { group: self.group, name: name.to_owned() });
            }
            Some(other) if !fit(other, port) => {
                let (from, to) = (name.to_owned(), end.to_string());
                return Err(GroupError::Types { group: self.group, from, to });
            }
            Some(_) => {}
        }
        match port.direction {
            Direction::In => self.inputs.entry(name).or_default().push((at, port.name)),
            Direction::Out => self.outputs_of(at, port.name).push(Target::Outside(name)),
        }
        Ok(())
    }

    /// Adds the ports of devices to the group, under their own names.
    fn devices(&mut self) -> Result<(), GroupError> {
        for (at, member) in self.members.iter().enumerate() {
            for port in member.interface.ports.iter().filter(|port| port.binding != Binding::Wire) {
                let key = port.name;
                match self.ports.iter().find(|other| other.name == key) {
                    None => self.ports.push(port.clone()),
                    Some(other) if *other == *port && port.direction == Direction::In => {}
                    Some(_) => return Err(GroupError::Device { group: self.group, key }),
                }
                match port.direction {
                    Direction::In => self.inputs.entry(key).or_default().push((at, key)),
                    Direction::Out => self.outputs_of(at, key).push(Target::Outside(key)),
                }
            }
        }
        self.ports.sort_by_key(|port| port.direction == Direction::Out);
        Ok(())
    }

    fn check_inputs(&self) -> Result<(), GroupError> {
        let wired = |at, port| {
            self.outputs.iter().flat_map(BTreeMap::values).flatten().any(|to| *to == Target::Member(at, port))
        };
        let exposed = |at, port| self.inputs.values().flatten().any(|to| *to == (at, port));
        for (at, member) in self.members.iter().enumerate() {
            let needed = member.interface.ports.iter().filter(|port| port.direction == Direction::In && port.required);
            let mut needed = needed.map(|port| port.name);
            if let Some(port) = needed.find(|port| !wired(at, port) && !exposed(at, port)) {
                return Err(GroupError::Unconnected { group: self.group, member: member.name.clone(), port });
            }
        }
        Ok(())
    }

    fn port(&self, end: &MemberPort, direction: Option<Direction>) -> Result<(usize, &'a PortInterface), GroupError> {
        let MemberPort { member: name, port } = end;
        let member = self.members.iter().enumerate().find(|(_, member)| member.name == *name);
        let found = member.and_then(|(at, member)| Some((at, member.interface.port(port)?)));
        let fits = |port: &PortInterface| {
            port.binding == Binding::Wire && direction.is_none_or(|direction| port.direction == direction)
        };
        found.filter(|(_, port)| fits(port)).ok_or_else(|| GroupError::NoPort {
            group: self.group,
            direction: match direction {
                None => "port",
                Some(Direction::In) => "input",
                Some(Direction::Out) => "output",
            },
            member: name.clone(),
            port: port.clone(),
        })
    }

    fn outputs_of(&mut self, at: usize, port: &'static str) -> &mut Vec<Target> {
        // There is one entry for each member, and `at` is the index of a member.
        let outputs = &mut self.outputs[at];
        outputs.entry(port).or_default()
    }
}

/// Returns whether values of one type fit the other: the names are equal, and also the fields if both types declare
/// them.
fn fit(one: &PortInterface, other: &PortInterface) -> bool {
    let both_say = !one.fields.is_empty() && !other.fields.is_empty();
    one.type_name == other.type_name && (!both_say || one.fields == other.fields)
}
