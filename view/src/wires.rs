//! The wires of a deployment, with rates and losses.

use crate::deployment::Look;
use crate::input::Measured;
use crate::text::is_name;
use comms::logic::time::Time;
use language::plan::{Plan, Transfer};
use node::logic::protocol::DeploymentStatus;
use std::collections::{BTreeMap, BTreeSet};

/// The most wires of a deployment.
const WIRES_MAX: usize = 5000;

/// How often values leave an output.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rate {
    /// Values a second (Hz).
    pub hertz: f64,
    /// When this was measured.
    pub at: Time,
}

/// A port of a process.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WireEnd {
    /// The absolute path of the process.
    pub path: String,
    /// The port.
    pub port: String,
}

/// A wire from an output to an input.
#[derive(Clone, Debug)]
pub struct Wire {
    /// Both ends, as a plan writes them: `main/a, Out -> main/b, In`.
    pub name: String,
    /// The output.
    pub from: WireEnd,
    /// The input.
    pub to: WireEnd,
    /// Values that were sent and have not come, since the program at the end of the wire began.
    pub lost: u64,
    /// How many were lost a second, between the last two reports.
    pub lost_a_second: f64,
    /// Values that the input has refused.
    pub refused: u64,
    /// Values that were sent while the consumer was not connected, and that it does not count as lost yet.
    pub undelivered: u64,
    /// The rate of its output, if it was measured.
    pub rate: Option<Rate>,
    counted: Option<Time>,
    pub(crate) changed: u64,
}

/// All wires of a deployment.
#[derive(Clone, Debug, Default)]
pub(crate) struct Wires {
    pub(crate) all: BTreeMap<String, Wire>,
    /// Whether the present plan is known.
    pub(crate) is_planned: bool,
}

impl Wire {
    fn new(name: &str, number: u64) -> Option<Self> {
        let (from, to) = name.split_once(" -> ").filter(|_| is_name(name))?;
        let end = |text: &str| {
            let (path, port) = text.rsplit_once(", ")?;
            Some(WireEnd { path: path.to_owned(), port: port.to_owned() })
        };
        let (lost, lost_a_second, refused, undelivered) = (0, 0.0, 0, 0);
        let (from, to) = (end(from)?, end(to)?);
        let name = name.to_owned();
        let (rate, counted, changed) = (None, None, number);
        Some(Self { name, from, to, lost, lost_a_second, refused, undelivered, rate, counted, changed })
    }

    /// Returns how many values were sent and have not come.
    pub fn missing(&self) -> u64 {
        self.lost + self.undelivered
    }

    fn take_lost(&mut self, look: Look<'_>, count: u64) {
        // A program that was started again counts from zero.
        let new = count.checked_sub(self.lost).unwrap_or(count);
        let over = self.counted.map_or(0.0, |counted| look.now.since(counted).as_secs_f64());
        #[expect(clippy::cast_precision_loss, reason = "a count for people")]
        let a_second = if over > 0.0 { new as f64 / over } else { 0.0 };
        if count != self.lost || a_second.total_cmp(&self.lost_a_second).is_ne() {
            self.changed = look.number;
        }
        (self.lost, self.lost_a_second, self.counted) = (count, a_second, Some(look.now));
    }

    fn take_undelivered(&mut self, look: Look<'_>, count: u64) {
        if count != self.undelivered {
            (self.undelivered, self.changed) = (count, look.number);
        }
    }
}

impl Wires {
    /// Takes in the report of a host. Returns how many wires found no room.
    pub(crate) fn take(&mut self, look: Look<'_>, part: &DeploymentStatus) -> u64 {
        let mut omitted = 0;
        for lost in &part.lost {
            match self.wire(&lost.wire, look.number) {
                Some(wire) => wire.take_lost(look, lost.count),
                None => omitted += 1,
            }
        }
        // The host of an output reports no count for a wire whose consumer is connected again.
        let is_of_part = |wire: &Wire| part.processes.iter().any(|process| process.path == wire.from.path);
        for wire in self.all.values_mut().filter(|wire| wire.undelivered > 0 && is_of_part(wire)) {
            wire.take_undelivered(look, 0);
        }
        for undelivered in &part.undelivered {
            match self.wire(&undelivered.wire, look.number) {
                Some(wire) => wire.take_undelivered(look, undelivered.count),
                None => omitted += 1,
            }
        }
        for refused in &part.refused {
            let wires = self.all.values_mut().filter(|wire| {
                refused.input.rsplit_once(", ").is_some_and(|(path, port)| wire.to.path == path && wire.to.port == port)
            });
            for wire in wires.filter(|wire| wire.refused != refused.count) {
                (wire.refused, wire.changed) = (refused.count, look.number);
            }
        }
        omitted
    }

    /// Takes the wires of a plan in; returns the names of those that are gone, and how many found no room.
    pub(crate) fn plan(&mut self, plan: &Plan, number: u64) -> (Vec<String>, u64) {
        let data = plan.wires.iter().filter(|wire| wire.transfer != Transfer::Call);
        let names: BTreeSet<String> = data.map(|wire| plan.ends(wire)).collect();
        let gone: Vec<String> = self.all.keys().filter(|name| !names.contains(*name)).cloned().collect();
        gone.iter().for_each(|name| drop(self.all.remove(name)));
        let omitted = names.iter().filter(|name| self.wire(name, number).is_none()).fold(0, |count, _| count + 1);
        self.is_planned = true;
        (gone, omitted)
    }

    pub(crate) fn measured(&mut self, now: Time, number: u64, measured: &Measured) {
        let is_meant = |wire: &&mut Wire| wire.from.path == measured.path && wire.from.port == measured.port;
        for wire in self.all.values_mut().filter(is_meant) {
            (wire.rate, wire.changed) = (Some(Rate { hertz: measured.hertz, at: now }), number);
        }
    }

    fn wire(&mut self, name: &str, number: u64) -> Option<&mut Wire> {
        if !self.all.contains_key(name) {
            let wire = Wire::new(name, number).filter(|_| self.all.len() < WIRES_MAX)?;
            self.all.insert(name.to_owned(), wire);
        }
        self.all.get_mut(name)
    }
}
