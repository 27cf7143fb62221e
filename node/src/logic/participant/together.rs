//! A start at one moment: what is activated on this host before it waits for it.
//!
//! From the first question for the clock on nothing is activated, since a supervisor elsewhere may have heard of GO before. From GO on
//! supervisors go ahead, so that wires are open and other hosts have their orders when the moment comes; programs wait for it. What is
//! stopped before has never begun. What is activated later begins at once, as ever. What is activated while its node checks in with the home
//! waits in the same place.

use super::Participant;
use crate::logic::effect::Out;
use crate::logic::protocol::{Ending, Target, ToCoordinator};
use comms::logic::time::Time;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// By how much GO may be late before people are told.
const LATE_MIN: Duration = Duration::from_millis(1);
/// By how much this node may wake up late for the moment before they are: on a busy machine it waits for a core, as programs do.
pub(super) const WOKEN_LATE_MIN: Duration = Duration::from_millis(20);

/// What begins with others.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Together {
    start: Start,
    /// Whether the moment was over when this host looked at its clock last.
    is_over: bool,
    /// Activations that wait: what, its number, and its value.
    waiting: Vec<(Target, u32, Vec<u8>)>,
}

/// When programs begin that are activated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
enum Start {
    /// At once.
    #[default]
    AtOnce,
    /// At a moment that is not known yet.
    Unknown,
    /// Not before a moment.
    At(Time),
}

impl Together {
    /// Returns the moment, if one is known.
    pub(super) fn start(&self) -> Time {
        if let Start::At(start) = self.start { start } else { Time::ZERO }
    }
}

impl Participant {
    /// Says what the clock of this host shows, and from now on waits for the moment.
    pub(super) fn read_clock(&mut self, asked: Time, out: &mut Out<'_>) {
        if self.go_at.is_none() {
            self.together.start = Start::Unknown;
        }
        let read = ToCoordinator::ClockRead { asked, shown: out.now };
        out.send(&self.home, self.deployment.to_coordinator(read));
    }

    /// Takes the moment; none if programs begin as soon as they can.
    pub(super) fn start_at(&mut self, start: Option<Time>, out: &mut Out<'_>) {
        self.together.start = start.map_or(Start::AtOnce, Start::At);
        self.begin_together(LATE_MIN, out);
        self.activate_waiting(out);
    }

    /// Returns when the programs of the first step begin, until then.
    pub fn starts_at(&self) -> Option<Time> {
        let Start::At(start) = self.together.start else { return None };
        (!self.together.is_over && self.check_in.is_none()).then_some(start)
    }

    /// Returns whether something is to begin later.
    pub(super) fn is_early(&self, target: Target, now: Time) -> bool {
        if self.check_in.is_some() {
            return true;
        }
        match self.together.start {
            Start::AtOnce => false,
            Start::Unknown => true,
            Start::At(start) => now < start && matches!(target, Target::Leaf(_)),
        }
    }

    pub(super) fn begin_later(&mut self, target: Target, activation: u32, value: Vec<u8>) {
        let is_known = self.together.waiting.iter().any(|(other, number, _)| (*other, *number) == (target, activation));
        if !is_known {
            self.together.waiting.push((target, activation, value));
        }
    }

    /// Takes something away that waits, and is stopped; says whether it did wait.
    pub(super) fn never_begins(&mut self, target: Target, activation: u32) -> bool {
        let count = self.together.waiting.len();
        self.together.waiting.retain(|(other, number, _)| (*other, *number) != (target, activation));
        self.together.waiting.len() < count
    }

    /// Activates what has waited, if the moment has come. This node may have been suspended, or killed and started again, when it came: if it
    /// comes too late, its home is told.
    pub(super) fn begin_together(&mut self, late_min: Duration, out: &mut Out<'_>) {
        let Some(start) = self.starts_at().filter(|start| *start <= out.now) else { return };
        self.together.is_over = true;
        let by = out.now.since(start);
        if by >= late_min {
            let late_ms = by.as_secs_f64() * 1000.0;
            tracing::warn!(deployment = %self.deployment, late_ms, "this host begins late at an aligned start");
            out.send(&self.home, self.deployment.to_coordinator(ToCoordinator::BeganLate { by }));
        }
        self.activate_waiting(out);
    }

    /// Ends what has waited: this part of the deployment comes to its end.
    pub(super) fn begin_never(&mut self, out: &mut Out<'_>) {
        for (target, activation, _) in std::mem::take(&mut self.together.waiting) {
            self.tell_supervisor(target, activation, Ending::Stopped, out);
        }
    }

    /// Activates what waits, unless it has to wait on.
    pub(super) fn activate_waiting(&mut self, out: &mut Out<'_>) {
        for (target, activation, value) in std::mem::take(&mut self.together.waiting) {
            self.activate(target, activation, value, out);
        }
    }
}
