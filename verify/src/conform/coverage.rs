//! The part of a group's verified behaviour that occurred in a run.

use super::{Follower, Steps};
use crate::explore::{Found, Limits, Nobody, explore};
use crate::model::Model;
use crate::system::{Label, Mode, System};
use std::collections::BTreeSet;

/// The part of a group's verified behaviour that occurred in a run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Coverage {
    /// The path of the group.
    pub group: String,
    /// How many of the group's states the run reached, and how many the group has.
    pub states: (usize, usize),
    /// How many of the group's transitions the run took, and how many the group has.
    pub transitions: (usize, usize),
    /// The same for states that can be reached only by a failure.
    pub fault_states: (usize, usize),
    /// The members that never failed in the run.
    pub never_failed: Vec<String>,
    /// The number of events outside the verified behaviour, such as a stop that was not confirmed, or a service that
    /// was done.
    pub outside: usize,
    /// Whether a limit was reached: the group has more states and transitions than were counted.
    pub is_limited: bool,
}

impl Coverage {
    pub(super) fn of(model: &Model<'_>, group: u32, lives: &[Steps], limits: &Limits<'_>) -> Self {
        let mut system = System::new(model, group as usize, &|_| false);
        system.mode = Mode { aborts: true, stops: true, ..Mode::default() };
        let (seen, outside) = follow(&system, lives);
        let Found { graph: all, .. } = explore(&system, limits, true, &Nobody);
        system.mode.aborts = false;
        let Found { graph: calm, .. } = explore(&system, limits, false, &Nobody);
        let without_faults: BTreeSet<&[u8]> = (0..calm.store.count()).map(|state| calm.store.get(state)).collect();
        let (mut states, mut fault_states) = ((0, 0), (0, 0));
        for bytes in (0..all.store.count()).map(|state| all.store.get(state)) {
            let is_seen = usize::from(seen.states.contains(bytes));
            states = (states.0 + is_seen, states.1 + 1);
            if !without_faults.contains(bytes) {
                fault_states = (fault_states.0 + is_seen, fault_states.1 + 1);
            }
        }
        let members = model.plan.groups[group as usize].members.len();
        let has_failed = |member: &u32| seen.failed.contains(member);
        let never_failed = (0..u32::try_from(members).unwrap_or(0)).filter(|member| !has_failed(member));
        Self {
            group: model.group_name(group),
            states,
            transitions: (seen.transitions.len(), usize::try_from(all.transitions).unwrap_or(usize::MAX)),
            fault_states,
            never_failed: never_failed.map(|member| model.name(group, member)).collect(),
            outside,
            is_limited: all.reached.is_some() || calm.reached.is_some(),
        }
    }
}

/// The part of the system that a run has reached: packed states, transitions, and failed members.
#[derive(Default)]
struct Seen {
    states: BTreeSet<Vec<u8>>,
    transitions: BTreeSet<(Vec<u8>, String)>,
    failed: BTreeSet<u32>,
}

/// Follows a run. Returns the states and transitions reached, and how often the run left the system.
fn follow(system: &System<'_>, lives: &[Steps]) -> (Seen, usize) {
    let (mut seen, mut outside) = (Seen::default(), 0);
    let (mut follower, mut stepper) = (Follower::new(system), system.stepper());
    let (mut frame, mut bytes) = (system.initial(), Vec::new());
    system.pack(&frame, &mut bytes);
    seen.states.insert(bytes.clone());
    for (place, step) in lives.iter().flat_map(|steps| steps.iter().enumerate()) {
        if place == 0 {
            follower.begins_anew();
        }
        match follower.label(&mut frame, step) {
            Ok(None) => {}
            Err(_) => outside += 1,
            Ok(Some(label)) => {
                system.pack(&frame, &mut bytes);
                seen.transitions.insert((bytes.clone(), format!("{label:?}")));
                if let Label::Aborted(_, member, _) = label {
                    seen.failed.insert(u32::from(member));
                }
                stepper.apply(&mut frame, label, None);
                system.pack(&frame, &mut bytes);
                seen.states.insert(bytes.clone());
            }
        }
    }
    (seen, outside)
}
