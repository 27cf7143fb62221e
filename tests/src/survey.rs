//! The door survey: the door mission in many worlds on virtual time, and the results.
//!
//! A *row* is a kind of world: one dimension drawn from its range, all dimensions at once, or a trigger, which is a
//! problem in the middle of the mission. Each row is flown in a number of worlds, and the same seed draws the same
//! worlds. The table shows how each row ended. The page also shows this over the range of the row.

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
/// The place in a spec where the arguments of its world belong.
const PLACE: &str = "DoorWorld(\"c3\"";
/// The task with the drive through the door, and its longest duration.
const THROUGH: &str = include_str!("../../specs/door_through.dca");
const THROUGH_LIMIT: Duration = Duration::from_secs(200);
/// The task with repeated attempts, and its longest duration.
const RECOVERY: &str = include_str!("../../specs/door_recovery.dca");
const RECOVERY_LIMIT: Duration = Duration::from_secs(240);
/// The place in a spec where the arguments of the law that opens the door belong.
const LAW: &str = "ModelBasedCtrl(host1";
/// A mission that reports success below this angle is a false success (deg).
pub const OPEN: f64 = 60.0;
/// The greatest force with which a strict run may hit the handle (N).
pub const HIT_MAX: f64 = 30.0;
/// The greatest force with which a strict run may open the door (N).
pub const PULL_MAX: f64 = 60.0;
/// The distance beyond the wall at which the whole base is on the other side: its radius (m).
pub const BEYOND: f64 = 0.31;
/// From this angle on, the laser can distinguish leaf and wall (deg).
const SEEN_FROM: f64 = 15.0;
/// The interval between two observations of a mission. It is half a window of the world's peaks, so no peak is missed.
const LOOK: Duration = Duration::from_millis(20);
/// The phases of the mission. Each has a part of the paths of its active processes, and the longest time from its start
/// to a disturbance (s).
pub const PHASES: [(&str, f64); 5] =
    [("/visualserv", 5.0), ("/approach", 3.0), ("/closegrip", 0.4), ("/presshandle", 1.2), ("/dooropen/", 6.0)];

/// A phase of the mission.
#[derive(Clone, Debug)]
pub struct Phase {
    /// A part of the path of the process that identifies the phase.
    pub part: &'static str,
    /// The longest time from the start of the phase to a disturbance (s).
    pub span: f64,
    /// The paths of all active processes in the phase.
    pub active: Vec<String>,
}

/// One mission in one world.
#[derive(Clone, Debug)]
pub struct Mission {
    /// The arguments of its world, in the form of a spec.
    pub arguments: String,
    /// The task.
    pub task: Task,
    /// The opening direction for the law, if it is given one.
    pub told: Option<&'static str>,
    /// The calibration for controllers: the beginning of an instance in the spec, and additional arguments for it.
    pub calibration: Vec<(&'static str, String)>,
    /// The disturbance of its network.
    pub disturbance: Disturbance,
    /// The disruption of a controller in the middle of the mission.
    pub meddling: Option<Meddling>,
    /// The value in the row's range, if the row has one.
    pub value: Option<f64>,
}

/// The task of a mission.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Task {
    /// The task of the surveyed spec: open the door.
    Open,
    /// Open it and then drive through, like `specs/door_through.dca`.
    Through,
    /// Open it, and try again after any failure, like `specs/door_recovery.dca`.
    Recover,
}

/// A disruption of one controller at some time.
#[derive(Clone, Debug)]
pub struct Meddling {
    /// The path of the controller, or the end of its path.
    pub leaf: String,
    /// A part of the paths of the phase in which the disruption happens.
    pub phase: &'static str,
    /// The time after which it happens, once both the phase and the controller are active.
    pub after: Duration,
    /// The disruption.
    pub disruption: Disruption,
}

/// A disruption of a controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Disruption {
    /// The controller is started again without its memory, as by a supervisor that restarts only this controller.
    Restart,
    /// The controller is killed.
    Kill,
}

/// The outcome of a mission.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// The ending.
    pub finish: Finish,
    /// The true angle of the door at the end (deg).
    pub angle: f64,
    /// The distance of the base's centre beyond the wall at the end (m), if the base had to drive through.
    pub beyond: Option<f64>,
    /// The largest force while the hand approached and grasped the handle (N).
    pub hit: f64,
    /// The largest force while the door opened (N).
    pub pull: f64,
    /// The largest force at all (N).
    pub worst: f64,
    /// The largest error of the angle from the laser while the door opens (deg).
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

    /// Returns whether the mission reports success, and everything is as required.
    pub fn is_success(&self) -> bool {
        self.finish == Finish::Done && self.is_there()
    }

    /// Returns whether everything is as required after a successful mission.
    fn is_there(&self) -> bool {
        self.angle >= OPEN && self.beyond.is_none_or(|beyond| beyond > BEYOND)
    }

    /// Returns whether the mission succeeded within the force limits.
    pub fn is_strict(&self) -> bool {
        self.is_success() && self.hit <= HIT_MAX && self.pull <= PULL_MAX
    }

    /// Returns whether the mission reports success, but not everything is as required.
    pub fn is_false(&self) -> bool {
        self.finish == Finish::Done && !self.is_there()
    }

    /// Returns the reason of the end in readable form.
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
    /// Returns the mission exactly as in the spec.
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

    /// Flies the mission with the spec `text` for at most `limit`.
    ///
    /// # Errors
    /// Fails if the spec does not compile with these arguments, or does not fit the controllers.
    pub fn fly(&self, text: &str, limit: Duration) -> Result<Outcome, String> {
        self.fly_watched(text, limit, &mut |_| {})
    }

    /// Flies the mission like [`Mission::fly`], and calls `watch` every 20 ms.
    ///
    /// # Errors
    /// Fails like [`Mission::fly`].
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
                // Before the first measurement, the angle is NaN, and `max` ignores it.
                self.wrong = self.wrong.max((simulation.signal("/dooropen/model", "seen angle") - angle).abs());
            }
        } else if is_active("/approach") || is_active("/closegrip") {
            self.hit = self.hit.max(simulation.signal(WORLD, "contact force"));
        }
    }
}

/// Returns the paths of the active processes in each phase of [`PHASES`], from one nominal mission. The world is left
/// out.
///
/// # Errors
/// Fails like [`Mission::fly`].
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

/// Flies missions on `threads` threads, and reports to `told` how many have been flown. The outcomes have the order of
/// the missions.
///
/// # Errors
/// Returns the first error of a mission.
///
/// # Panics
/// Panics if a mission panics.
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
