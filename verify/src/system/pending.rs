//! The parts of a stop that are not finished: answers, orders and reports in transit.

use super::{Frame, Occupant, System};
use crate::system::MemberRef;
use language::algebra::Activity;

impl System<'_> {
    /// Whether an answer to a stop, an order, a report between hosts, or the note of a loss is still in transit.
    pub(crate) fn has_stops(&self, frame: &Frame) -> bool {
        let is_stopping = |unit: usize| {
            let state = &frame.states[unit];
            let is_box = |member: u32| matches!(self.units[unit].seats[member as usize], Occupant::Box(_));
            let is_awaited = |member: u32| {
                is_box(member) && state.activity(member) == Activity::Stopping
                    || self.is_refused(frame, MemberRef { unit, member })
            };
            !self.is_silent(frame, unit) && state.members_active().any(is_awaited)
        };
        frame.ordered.contains(&true)
            || self.has_messages(frame)
            || self.is_news_due(frame)
            || (0..self.units.len()).any(is_stopping)
    }

    /// Whether a `shield` or a `finally` holds a stop up.
    pub(crate) fn is_held_up(&self, frame: &Frame) -> bool {
        let unit = |unit: usize| !self.is_silent(frame, unit) && frame.states[unit].is_held_up(self.program(unit));
        (0..self.units.len()).any(unit)
    }
}
