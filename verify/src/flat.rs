//! A plan as one complete system without any reduction, for comparisons and measurements.

use crate::explore::{Graph, Limits, Nobody, Reached, explore, is_over, is_stopping};
use crate::model::Model;
use crate::system::{Frame, Mode, Phase, System};
use language::algebra::Activity;
use language::plan::Plan;
use language::sites::Sites;
use std::collections::BTreeSet;

/// The complete behaviour of a plan, if its programs may fail and stops may come at any time.
#[derive(Debug)]
pub struct Flat {
    /// The number of states.
    pub states: u32,
    /// The number of transitions.
    pub transitions: u64,
    /// The used memory, in bytes.
    pub memory: usize,
    /// For each state, the activity of every member and the ending of the whole, without duplicates.
    pub situations: BTreeSet<(Vec<Activity>, Ending)>,
    /// Whether there is a state from which the plan cannot end although no program fails.
    pub gets_stuck: bool,
    /// Whether there is a state after a stop from which the plan cannot end although no program fails.
    pub stop_hangs: bool,
    /// The limit that was reached.
    pub reached: Option<Reached>,
}

/// The state of the whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Ending {
    /// The member has not started.
    Idle,
    /// The member is running.
    Running,
    /// The member was asked to stop.
    Stopping,
    /// The member is done.
    Done,
    /// The member has failed.
    Aborted,
    /// The member has stopped.
    Stopped,
}

/// The details that a flat exploration returns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Detail {
    /// Only the number of states.
    Count,
    /// Everything.
    All,
    /// Everything, if timers may elapse in any order, as in an export.
    AnyOrder,
}

/// Explores a whole plan.
pub fn flat(plan: &Plan, sites: &Sites, limits: &Limits<'_>, detail: Detail) -> Flat {
    let model = Model::of_groups(plan, sites);
    let mut system = System::new(&model, 0, &|_| true);
    if detail == Detail::AnyOrder {
        system.forget_order();
    }
    system.mode = Mode { aborts: true, stops: true, ..Mode::default() };
    let graph = explore(&system, limits, detail != Detail::Count, &Nobody).graph;
    let mut flat = Flat {
        states: graph.store.count(),
        transitions: graph.transitions,
        memory: graph.memory(),
        situations: BTreeSet::new(),
        gets_stuck: false,
        stop_hangs: false,
        reached: graph.reached,
    };
    if detail != Detail::Count {
        look(&system, &graph, &mut flat);
    }
    flat
}

fn look(system: &System<'_>, graph: &Graph, flat: &mut Flat) {
    let over = graph.which(system, is_over);
    let can = graph.can_reach(&over, &|label| system.is_natural(label));
    let running = graph.which(system, |frame| frame.phase == Phase::Running);
    let stopping = graph.which(system, is_stopping);
    let hangs = |which: &[bool]| which.iter().zip(&can).any(|(which, can)| *which && !can);
    (flat.gets_stuck, flat.stop_hangs) = (hangs(&running), hangs(&stopping));
    graph.which(system, |frame| {
        flat.situations.insert(situation(system, frame));
        false
    });
}

fn situation(system: &System<'_>, frame: &Frame) -> (Vec<Activity>, Ending) {
    let mut all = Vec::new();
    for (unit, state) in system.units.iter().zip(&frame.states) {
        let slots = 0..u32::try_from(unit.seats.len()).unwrap_or(u32::MAX);
        all.extend(slots.map(|slot| state.activity(slot)));
    }
    let ending = match frame.phase {
        Phase::Idle => Ending::Idle,
        Phase::Running => Ending::Running,
        Phase::Stopping => Ending::Stopping,
        Phase::Done => Ending::Done,
        Phase::Aborted => Ending::Aborted,
        Phase::Stopped => Ending::Stopped,
    };
    (all, ending)
}
