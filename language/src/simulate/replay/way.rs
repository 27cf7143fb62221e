//! Finds the events inside a group when a story has only the end of the group.

use crate::automaton::Failure;
use crate::simulate::{GroupEnd, Simulation, TraceEvent, Transition};
use std::collections::{BTreeSet, VecDeque};

/// The largest number of ways that are tried to bring a group to its end.
const WAYS_MAX: usize = 2000;

impl Simulation<'_> {
    /// Brings a group to an end by events of its programs and timers. First tries only events that usually lead to this
    /// end. Otherwise finds the shortest way.
    pub(super) fn bring(&mut self, path: &str, goal: &Goal) -> Result<(), &'static str> {
        let group = self.group(path).ok_or("it is not a group")?;
        self.seats.contains_key(&group).then_some(()).ok_or("it does not run")?;
        // Only an end after this point is accepted, even if the group restarts at once.
        self.record.ends.remove(&group);
        let is_stopped = self.pending().ordered.contains(&group);
        if matches!(goal, Goal::Stopped) && is_stopped {
            self.reached(path)?;
        }
        let found = [true, false].into_iter().find_map(|is_straight| self.way(path, group, goal, is_straight));
        *self = found.ok_or("it does not come to that")?;
        Ok(())
    }

    /// Finds a way to the end of a group. Returns the simulation after it.
    fn way(&self, path: &str, group: usize, goal: &Goal, is_straight: bool) -> Option<Self> {
        let mut ways = VecDeque::from([self.clone()]);
        for _ in 0..WAYS_MAX {
            let way = ways.pop_front()?;
            if way.has_come(group, goal) {
                return Some(way);
            }
            if !way.seats.contains_key(&group) {
                continue;
            }
            let mut events = way.possible(path);
            if is_straight {
                events.retain(|event| goal.is_led_to_by(event));
                // With the reversed order, the first event is tried first.
                events.reverse();
            }
            for event in events {
                let mut next = way.clone();
                if next.happens(&event).is_err() || ways.len() >= WAYS_MAX {
                    continue;
                }
                if is_straight { ways.push_front(next) } else { ways.push_back(next) }
            }
        }
        None
    }

    fn has_come(&self, group: usize, goal: &Goal) -> bool {
        let Some(GroupEnd { transition, tag, failure }) = self.record.ends.get(&group) else { return false };
        match (transition, goal) {
            (Transition::Done, Goal::Done(wanted)) => wanted.is_none() || tag == wanted,
            (Transition::Aborted(_), Goal::Failed(wanted)) => wanted.is_none() || failure == wanted,
            (Transition::Stopped, Goal::Stopped) => true,
            // The order to stop came too late, because the group had already ended.
            (Transition::Done, Goal::Stopped) => self.pending.is_some(),
            (_, _) => false,
        }
    }

    /// Returns the possible events below a group. Answers come first, then ends, failures, timers, and deaths beyond
    /// the limit of a group.
    fn possible(&self, path: &str) -> Vec<TraceEvent> {
        let prefix = format!("{path}/");
        let is_below = |other: &&str| other.starts_with(&prefix);
        let own = |group: usize| self.plan.groups[group].path.as_str();
        let mut events = Vec::new();
        let ordered = self.pending.iter().flat_map(|pending| &pending.ordered).map(|group| own(*group));
        events.extend(ordered.filter(is_below).map(|path| TraceEvent::Reached(path.to_owned())));
        events.extend(self.stopping().into_iter().filter(is_below).map(|path| TraceEvent::Stopped(path.to_owned())));
        let running: Vec<&str> = self.running().into_iter().filter(is_below).collect();
        for path in &running {
            let Some(leaf) = self.leaf(path).filter(|leaf| !self.is_service(*leaf)) else { continue };
            let tags = &self.plan.leaves[leaf as usize].outcomes;
            events.extend(tags.iter().map(|tag| TraceEvent::Done((*path).to_owned(), Some(tag.clone()))));
            if tags.is_empty() {
                events.push(TraceEvent::Done((*path).to_owned(), None));
            }
        }
        let asked = self.plan.groups.iter().flat_map(|group| group.expression.failures());
        let asked: BTreeSet<&Failure> =
            asked.filter(|failure| [Failure::Crash, Failure::HostLost].contains(failure)).collect();
        for reason in std::iter::once(None).chain(asked.into_iter().map(Some)) {
            events.extend(running.iter().map(|path| TraceEvent::Fails((*path).to_owned(), reason.cloned())));
        }
        let is_own = |group: usize| own(group) == path || own(group).starts_with(&prefix);
        let timers = self.clock.timers.values().filter(|timer| is_own(timer.group));
        events.extend(timers.map(|timer| TraceEvent::Elapsed(own(timer.group).to_owned(), timer.timer + 1)));
        let bears = |group: &usize| self.plan.groups[*group].supervision.intensity.is_some();
        let below = self.seats.keys().copied().filter(|group| is_own(*group) && bears(group));
        events.extend(below.map(|group| TraceEvent::TooMany(own(group).to_owned())));
        events
    }

    fn is_service(&self, leaf: u32) -> bool {
        let seat = self.leaves.get(&leaf);
        seat.is_some_and(|seat| self.plan.groups[seat.group].members[seat.member as usize].service)
    }
}

/// The end that a group must reach.
#[derive(Clone, Debug)]
pub(super) enum Goal {
    Done(Option<String>),
    /// A failure. If there is a reason, it must be this one.
    Failed(Option<Failure>),
    Stopped,
}

impl Goal {
    /// Returns whether an event inside a group usually leads to this end.
    fn is_led_to_by(&self, event: &TraceEvent) -> bool {
        let is_answer = matches!(event, TraceEvent::Stopped(_) | TraceEvent::Reached(_));
        let is_end = match self {
            Self::Done(_) => matches!(event, TraceEvent::Done(..)),
            Self::Failed(_) => matches!(event, TraceEvent::Fails(..)),
            Self::Stopped => false,
        };
        is_answer || is_end
    }
}
