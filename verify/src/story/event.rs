//! Converts a label to an event in the form that simulators and tests use.

use crate::system::{FaultKind, Label, LossKind, System};
use language::plan::MemberKind;
use language::{ProgramFault, TraceEvent};

/// Returns the event of a label; none for an event of a piece of a group, which has no name.
pub(super) fn event(system: &System<'_>, label: Label) -> Option<TraceEvent> {
    let member = |unit: u16, member: u16| path(system, usize::from(unit), u32::from(member));
    let group = |unit: u16| {
        let part = &system.model.parts[system.units[usize::from(unit)].part];
        (!part.is_piece).then(|| system.model.plan.groups[part.group as usize].path.clone())
    };
    let host = |host: u32| system.model.plan.hosts.get(host as usize).cloned();
    Some(match label {
        Label::Start => TraceEvent::Start(group(0)?),
        Label::Stop => TraceEvent::Stop,
        Label::Done(unit, slot, value) => TraceEvent::Done(member(unit, slot)?, system.tag(value).map(str::to_owned)),
        Label::Aborted(unit, slot, why) => TraceEvent::Fails(member(unit, slot)?, system.reason_told(why)),
        Label::Stopped(unit, slot) => TraceEvent::Stopped(member(unit, slot)?),
        Label::Elapsed(unit, timer) => TraceEvent::Elapsed(group(unit)?, u32::from(timer) + 1),
        Label::Told(unit, number) => TraceEvent::Told(group(unit)?, u32::from(number) + 1),
        Label::Script(unit, kind) => TraceEvent::Script(group(unit)?, kind),
        Label::Reached(unit) => TraceEvent::Reached(group(unit)?),
        Label::Arrived(unit, slot) => TraceEvent::Arrived(member(unit, slot)?),
        Label::Heard(unit, slot) => TraceEvent::Heard(member(unit, slot)?),
        Label::Fault(unit, slot) => TraceEvent::Struck(fault(system, false)?, member(unit, slot)?),
        Label::Second(unit, slot) => TraceEvent::Struck(fault(system, true)?, member(unit, slot)?),
        Label::StartWith(_) => return None,
        Label::Lost => match system.mode.lost?.kind {
            LossKind::Cut => TraceEvent::Cut(host(system.mode.lost?.host)?),
            LossKind::Death => TraceEvent::Lost(host(system.mode.lost?.host)?),
            LossKind::Programs => return None,
        },
        Label::Noted(noting) => TraceEvent::Noted(host(u32::from(noting))?),
        Label::Died(unit, slot) => TraceEvent::Dies(member(unit, slot)?),
        Label::Back(unit, slot) => TraceEvent::Back(member(unit, slot)?),
        Label::TooMany(unit) => TraceEvent::TooMany(group(unit)?),
    })
}

/// Returns the path of a member; none for a piece of a group.
pub(super) fn path(system: &System<'_>, unit: usize, member: u32) -> Option<String> {
    let plan = system.model.plan;
    let group = &plan.groups[system.model.parts[system.units[unit].part].group as usize];
    Some(match group.members.get(member as usize)?.kind {
        MemberKind::Leaf(leaf) => plan.leaves[leaf as usize].path.clone(),
        MemberKind::Group(inner) => plan.groups[inner as usize].path.clone(),
    })
}

fn fault(system: &System<'_>, is_second: bool) -> Option<ProgramFault> {
    let injected = if is_second { system.mode.second } else { system.mode.fault };
    match injected?.kind {
        FaultKind::Crash => Some(ProgramFault::Crash),
        FaultKind::GivenUp => Some(ProgramFault::CrashTooOften),
        FaultKind::TooMany => Some(ProgramFault::CrashTooMany),
        FaultKind::Hang => Some(ProgramFault::Hang),
        FaultKind::Unanswered => Some(ProgramFault::Unanswered),
        FaultKind::HostLost | FaultKind::CutOff | FaultKind::LinkLost => None,
    }
}
