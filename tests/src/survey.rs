//! The door survey: the door mission in many worlds, on virtual time, and its results.
//!
//! A *row* is a kind of world: one dimension drawn from its range, all dimensions at once, or a trigger, something that
//! goes wrong in the middle. Each row is flown in so many worlds; the same seed draws the same worlds. The table says
//! how each row ended, the page shows where in its range it did.

mod far;
pub mod page;
mod rooms;
mod rows;
pub mod table;
mod troubles;

use crate::simulation::{Finish, Simulation, plan};
use comms::logic::time::Time;
use controllers::sdk::harness::Disturbance;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

pub use rows::{Group, Row, rows};

const WORLD: &str = "main/world";
/// The place in a spec for the arguments of its world.
const PLACE: &str = "DoorWorld(\"c3\"";
/// The task with the drive through the door, and how long it may take.
const THROUGH: &str = include_str!("../../specs/door_through.dca");
const THROUGH_LIMIT: Duration = Duration::from_secs(200);
/// The task that is tried again, and how long it may take.
const RECOVERY: &str = include_str!("../../specs/door_recovery.dca");
const RECOVERY_LIMIT: Duration = Duration::from_secs(240);
/// The place for arguments of the law that opens the door.
const LAW: &str = "ModelBasedCtrl(host1";
/// A mission that ended well below this angle is a false success (deg).
pub const OPEN: f64 = 60.0;
/// Strict runs hit the handle with no more than this (N).
pub const HIT_MAX: f64 = 30.0;
/// Strict runs open the door with no more than this (N).
pub const PULL_MAX: f64 = 60.0;
/// The distance beyond the wall at which a base is on the other side: its radius (m).
pub const BEYOND: f64 = 0.31;
/// The angle from which leaf and wall can be distinguished (deg).
const SEEN_FROM: f64 = 15.0;
/// The period at which a mission is looked at: half a window of the world's peaks, so none is missed.
const LOOK: Duration = Duration::from_millis(20);
/// The phases of the mission, each with a part of the paths of its active processes, and the time of the disturbance
/// after its start (s).
pub const PHASES: [(&str, f64); 5] =
    [("/visualserv", 5.0), ("/approach", 3.0), ("/closegrip", 0.4), ("/presshandle", 1.2), ("/dooropen/", 6.0)];

/// A phase of the mission.
#[derive(Clone, Debug)]
pub struct Phase {
    /// A part of the path of the process that marks it.
    pub part: &'static str,
    /// The longest time into it at which things are done to it (s).
    pub span: f64,
    /// The paths of all that is active in it.
    pub active: Vec<String>,
}

/// One mission in one world.
#[derive(Clone, Debug)]
pub struct Mission {
    /// The arguments of its world, as in a spec.
    pub arguments: String,
    /// The task.
    pub task: Task,
    /// The opening direction that is given to the law, if any.
    pub told: Option<&'static str>,
    /// The calibration given to controllers: the beginning of an instance in the spec, and its further arguments.
    pub calibration: Vec<(&'static str, String)>,
    /// The disturbance of its network.
    pub disturbance: Disturbance,
    /// The meddling with a controller in the middle.
    pub meddling: Option<Meddling>,
    /// The value in the row's range, if the row has one.
    pub value: Option<f64>,
}

/// The task of a mission.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Task {
    /// The task of the spec that is surveyed: open the door.
    Open,
    /// Then drive through, as `specs/door_through.dca` has it.
    Through,
    /// Open it, and try again after any failure, as in `specs/door_recovery.dca`.
    Recover,
}

/// Something that is done to one controller.
#[derive(Clone, Debug)]
pub struct Meddling {
    /// Its path, or the end of it.
    pub leaf: String,
    /// A part of the paths of the phase in which it is done.
    pub phase: &'static str,
    /// The time after both are active.
    pub after: Duration,
    /// The disruption.
    pub disruption: Disruption,
}

/// A disruption of a controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Disruption {
    /// Started again with its memory gone, as a supervisor does that restarts it alone.
    Restart,
    /// It is killed.
    Kill,
}

/// The outcome of a mission.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// The ending.
    pub finish: Finish,
    /// The true angle of the door then (deg).
    pub angle: f64,
    /// The distance of the base's middle beyond the wall then (m), if it was to drive through.
    pub beyond: Option<f64>,
    /// The largest force while the hand came to the handle and closed (N).
    pub hit: f64,
    /// The largest force while the door opened (N).
    pub pull: f64,
    /// The largest force at all (N).
    pub worst: f64,
    /// The largest error of the angle that the laser sees while the door opens (deg).
    pub wrong: f64,
    /// The duration (s).
    pub seconds: f64,
}

impl Outcome {
    /// Returns the outcome of a mission that has not begun.
    fn unknown() -> Self {
        let (finish, angle, beyond) = (Finish::Unfinished, f64::NAN, None);
        Self { finish, angle, beyond, hit: 0.0, pull: 0.0, worst: 0.0, wrong: 0.0, seconds: 0.0 }
    }

    /// Returns whether it reports the door as open, and the door is open.
    pub fn is_success(&self) -> bool {
        self.finish == Finish::Done && self.is_there()
    }

    /// Returns whether everything is as required after a mission that is done.
    fn is_there(&self) -> bool {
        self.angle >= OPEN && self.beyond.is_none_or(|beyond| beyond > BEYOND)
    }

    /// Returns whether it succeeded with no more force than it may use.
    pub fn is_strict(&self) -> bool {
        self.is_success() && self.hit <= HIT_MAX && self.pull <= PULL_MAX
    }

    /// Returns whether it reports the door as open, and the door is not.
    pub fn is_false(&self) -> bool {
        self.finish == Finish::Done && !self.is_there()
    }

    /// Returns the reason of the end, for people.
    pub fn reason(&self) -> String {
        match &self.finish {
            Finish::Done if self.is_false() => "FALSE".to_owned(),
            Finish::Done if self.hit > HIT_MAX => "done, but hit too hard".to_owned(),
            Finish::Done if self.pull > PULL_MAX => "done, but pulled too hard".to_owned(),
            Finish::Done => "done".to_owned(),
            Finish::Aborted(why) => why.trim_start_matches("main/dooropensyst/").to_owned(),
            Finish::Unfinished => "still running at the limit".to_owned(),
        }
    }
}

impl Mission {
    /// Returns the mission as the spec has it.
    pub fn nominal() -> Self {
        Self {
            arguments: String::new(),
            task: Task::Open,
            told: None,
            calibration: Vec::new(),
            disturbance: Disturbance::NONE,
            meddling: None,
            value: None,
        }
    }

    /// Flies it with the spec `text`, at most for `limit`.
    ///
    /// # Errors
    /// If the spec does not compile with these arguments, or does not fit the controllers.
    pub fn fly(&self, text: &str, limit: Duration) -> Result<Outcome, String> {
        self.fly_watched(text, limit, &mut |_| {})
    }

    /// Flies it as [`Mission::fly`] does; `watch` sees it every 20 ms.
    ///
    /// # Errors
    /// As [`Mission::fly`].
    pub fn fly_watched(
        &self,
        text: &str,
        limit: Duration,
        watch: &mut dyn FnMut(&Simulation),
    ) -> Result<Outcome, String> {
        let (text, limit) = match self.task {
            Task::Open => (text, limit),
            Task::Through => (THROUGH, THROUGH_LIMIT),
            Task::Recover => (RECOVERY, RECOVERY_LIMIT),
        };
        let mut simulation = self.simulation(text)?;
        let mut outcome = Outcome::unknown();
        let (mut looked, mut since, mut done) = (None, None, false);
        outcome.finish = simulation.run(Time::ZERO + limit, &mut |simulation| {
            let now = simulation.now();
            if looked.is_none_or(|at| now.since(at) >= LOOK) {
                looked = Some(now);
                outcome.look(simulation);
                watch(simulation);
            }
            let Some(meddling) = self.meddling.as_ref().filter(|_| !done) else { return };
            if simulation.is_active(&meddling.leaf) && simulation.is_any_active(meddling.phase) {
                done = now.since(*since.get_or_insert(now)) >= meddling.after && meddling.meddle(simulation);
            }
        });
        outcome.angle = simulation.signal(WORLD, "door angle");
        let through = self.task == Task::Through;
        outcome.beyond = through.then(|| simulation.signal(WORLD, "base beyond wall"));
        outcome.worst = simulation.signal(WORLD, "peak force");
        outcome.seconds = simulation.now().since(Time::ZERO).as_secs_f64();
        Ok(outcome)
    }

    fn simulation(&self, text: &str) -> Result<Simulation, String> {
        if !text.contains(PLACE) {
            return Err(format!("the spec has no world that is written `{PLACE}`, so no world can be put into it"));
        }
        let comma = if self.arguments.is_empty() { "" } else { ", " };
        let text = text.replace(PLACE, &format!("{PLACE}{comma}{}", self.arguments));
        let mut text =
            self.told.map_or(text.clone(), |swing| text.replace(LAW, &format!("{LAW}, swing = \"{swing}\"")));
        for (instance, arguments) in &self.calibration {
            if !text.contains(instance) {
                return Err(format!(
                    "the spec has no instance that is written `{instance}`, so it cannot be calibrated"
                ));
            }
            text = text.replace(instance, &format!("{instance}, {arguments}"));
        }
        Simulation::new(plan("survey.dca", &text)?, self.disturbance.clone())
    }
}

impl Meddling {
    fn meddle(&self, simulation: &mut Simulation) -> bool {
        match self.disruption {
            Disruption::Restart => simulation.restart(&self.leaf),
            Disruption::Kill => simulation.crash(&self.leaf),
        }
    }
}

impl Outcome {
    fn look(&mut self, simulation: &Simulation) {
        let is_active = |phase| simulation.is_any_active(phase);
        if is_active("/dooropen/") {
            self.pull = self.pull.max(simulation.signal(WORLD, "contact force"));
            let angle = simulation.signal(WORLD, "door angle");
            if angle > SEEN_FROM {
                // An angle that has not been seen yet is NaN, which `max` passes over.
                self.wrong = self.wrong.max((simulation.signal("/dooropen/model", "seen angle") - angle).abs());
            }
        } else if is_active("/approach") || is_active("/closegrip") {
            self.hit = self.hit.max(simulation.signal(WORLD, "contact force"));
        }
    }
}

/// Returns the paths of the active processes in each phase of [`PHASES`], from one nominal mission; the world is left
/// out.
///
/// # Errors
/// As [`Mission::fly`].
pub fn active_in_phases(text: &str, limit: Duration) -> Result<Vec<Phase>, String> {
    let nominal = Mission::nominal();
    let mut simulation = nominal.simulation(text)?;
    let leaves: Vec<String> = simulation.leaves().filter(|path| *path != WORLD).map(str::to_owned).collect();
    let mut phases: Vec<_> = PHASES.iter().map(|&(part, span)| Phase { part, span, active: Vec::new() }).collect();
    let _finish = simulation.run(Time::ZERO + limit, &mut |simulation| {
        for phase in &mut phases {
            if simulation.is_any_active(phase.part) {
                let is_new = |leaf: &&String| !phase.active.contains(leaf) && simulation.is_active(leaf);
                let new: Vec<String> = leaves.iter().filter(is_new).cloned().collect();
                phase.active.extend(new);
            }
        }
    });
    Ok(phases)
}

/// Flies missions on `threads` threads; `told` hears how many have been flown. The outcomes are in the missions' order.
///
/// # Errors
/// The first that a mission meets.
///
/// # Panics
/// If a mission does.
pub fn fly_all(
    missions: &[Mission],
    (text, limit): (&str, Duration),
    threads: usize,
    told: &(dyn Fn(usize) + Sync),
) -> Result<Vec<Outcome>, String> {
    let (next, flown) = (AtomicUsize::new(0), AtomicUsize::new(0));
    let outcomes = Mutex::new(Vec::with_capacity(missions.len()));
    let work = || {
        while let Some((index, mission)) = {
            let index = next.fetch_add(1, Ordering::Relaxed);
            missions.get(index).map(|mission| (index, mission))
        } {
            let outcome = mission.fly(text, limit);
            if outcome.is_err() {
                next.store(missions.len(), Ordering::Relaxed);
            }
            outcomes.lock().unwrap_or_else(PoisonError::into_inner).push((index, outcome));
            told(flown.fetch_add(1, Ordering::Relaxed) + 1);
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..threads.max(1) {
            let _worker = scope.spawn(work);
        }
    });
    let mut outcomes = outcomes.into_inner().unwrap_or_else(PoisonError::into_inner);
    outcomes.sort_by_key(|(index, _)| *index);
    outcomes.into_iter().map(|(_, outcome)| outcome).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spec_that_takes_no_world_is_refused() {
        let mission = Mission::nominal();
        let why = mission.fly("process main(){ }", Duration::from_secs(1)).expect_err("it has no world");
        assert!(why.contains("the spec has no world"), "{why}");
    }
}
