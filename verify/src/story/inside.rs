//! Adds the steps inside a group with activities to a story that would only say that the group ends.
//!
//! A system treats such a group as a black box that may end in certain ways. The group's own exploration has found a
//! shortest way to each of these ends. The story contains the steps of this way before the end, so it shows the cause,
//! such as a time.

use super::{Step, tell};
use crate::model::{Part, Seat};
use crate::system::{Frame, Label, Mode, Occupant, System};
use language::algebra::{Activity, Value};
use language::plan::Expression;

/// A way through a part, from its start to an end.
#[derive(Clone, Debug)]
pub(crate) struct Way {
    /// Whether the part is done; otherwise it has failed.
    pub(crate) is_done: bool,
    /// The value for the next process, or the report of the failure.
    pub(crate) value: Value,
    pub(crate) labels: Vec<Label>,
}

/// Returns the mode in which a part is explored alone.
pub(crate) fn mode(aborts: bool) -> Mode {
    Mode { aborts, stops: aborts, ..Mode::default() }
}

/// Returns the steps of a box up to its end, which is the last step; none if the story shows only the end of the box.
pub(super) fn steps(system: &System<'_>, frame: &Frame, label: Label) -> Option<Vec<Step>> {
    let (is_done, unit, member, value) = if let Label::Done(unit, member, value) = label {
        (true, usize::from(unit), usize::from(member), system.value(value))
    } else if let Label::Aborted(unit, member, report) = label {
        (false, usize::from(unit), usize::from(member), system.value(report))
    } else {
        return None;
    };
    let own = system.units.get(unit)?;
    let (Occupant::Box(_), Seat::Part(inner)) = (own.seats.get(member)?, system.model.parts[own.part].members[member])
    else {
        return None;
    };
    let slot = u32::try_from(member).ok()?;
    if frame.states[unit].activity(slot) != Activity::Active || !system.ends_by_itself(frame, unit, slot) {
        return None;
    }
    let aborts = system.mode.aborts;
    let ways = &system.model.parts[inner].ways[usize::from(!aborts)];
    let is_it = |way: &&Way| match is_done {
        true => way.is_done && way.value.tag() == value.tag(),
        false => !way.is_done && way.value == value,
    };
    let way = ways.iter().find(is_it)?;
    let mut inside = System::new(system.model, inner, &|_| false);
    inside.mode = mode(aborts);
    let steps: Vec<Step> = tell(&inside, &way.labels).steps.into_iter().skip(1).collect();
    (!steps.is_empty()).then_some(steps)
}

/// Returns whether a part is or contains an activity.
pub(crate) fn has_activity(parts: &[Part], part: usize) -> bool {
    let own = &parts[part];
    let is_inside = |seat: &Seat| matches!(seat, Seat::Part(inner) if has_activity(parts, *inner));
    matches!(own.expression, Expression::Chart(_)) || own.members.iter().any(is_inside)
}
