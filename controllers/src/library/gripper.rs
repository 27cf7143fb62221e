//! GripperControl: opens or closes the fingers, and detects whether they hold anything.

use super::grant::{Grant, LockCalls, PRIORITY, Right};
use super::{SENSED, Watch};
use crate::control::filter::Debounce;
use crate::message::{FtState, GripperCommand, GripperState};
use crate::sdk::{About, Arguments, Controller, In, Inputs, Kind, Out, Outputs, Parameter, Progress, Stopping, Tick};
use comms::logic::time::Time;
use nalgebra::Vector3;
use std::time::Duration;

const OPEN: f64 = 0.08;
const OPEN_ENOUGH: f64 = 0.075;
/// Fingers this close together hold nothing (m).
const EMPTY: f64 = 0.006;
const HOLD_FORCE: f64 = 20.0;
/// Fingers that press with this force hold any object (N).
const FIRM: f64 = 40.0;
/// If the fingers meet an object off their centre, they pull the hand towards it with their force. So they first press
/// gently (N), until the hand has given way and feels less than this (N), or until this time has passed.
const GENTLE: f64 = 14.0;
const AT_EASE: f64 = 6.0;
const GENTLE_FOR: Duration = Duration::from_millis(1500);
/// Fingers that press with more than this have met something (N).
const MET: f64 = 5.0;
const TIMEOUT: Duration = Duration::from_secs(4);
const IN_A_ROW: u32 = 3;
/// The number of small forces in a row after which the load is off the hand.
const AT_EASE_IN_A_ROW: u32 = 10;

/// The inputs of the gripper's controllers.
#[derive(Debug, Inputs)]
pub(super) struct Inputs {
    /// The gripper.
    #[device("gripper/state")]
    state: In<GripperState>,
    /// The wrist sensor, which feels whether fingers that close pull the hand aside.
    #[device("ft/state")]
    force: In<FtState>,
}

/// The outputs of the gripper's controllers.
#[derive(Debug, Outputs)]
pub(super) struct Outputs {
    /// To the gripper.
    #[device("gripper/cmd")]
    command: Out<GripperCommand>,
    /// The lock of the gripper.
    #[calls("Lock", optional)]
    lock: LockCalls,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Goal {
    Open,
    Close,
}

/// Opens the gripper, or closes it on something; aborts if it closed on nothing.
#[derive(Debug)]
pub(super) struct GripperControl {
    goal: Goal,
    held: Debounce,
    empty: Debounce,
    started: Time,
    /// The time at which closing fingers met something, and whether the load has been off the hand since.
    met: Option<Time>,
    at_ease: Debounce,
    watch: Watch,
    grant: Grant,
}

impl GripperControl {
    fn owner(&self) -> String {
        match self.goal {
            Goal::Open => "GripperControl open".to_owned(),
            Goal::Close => "GripperControl close".to_owned(),
        }
    }

    /// Returns the force with which the fingers press (N).
    fn press(&mut self, now: Time, inputs: &Inputs) -> f64 {
        if self.goal == Goal::Open {
            return FIRM;
        }
        if inputs.state.latest().is_some_and(|state| state.force > MET) {
            self.met.get_or_insert(now);
        }
        let Some(met) = self.met else { return GENTLE };
        if let Some(wrench) = inputs.force.fresh() {
            self.at_ease.update(Vector3::from(wrench.force).norm() < AT_EASE);
        }
        if self.at_ease.is_sure() || now.since(met) > GENTLE_FOR { FIRM } else { GENTLE }
    }

    fn judge(&mut self, state: &GripperState) -> Progress {
        match self.goal {
            Goal::Open if state.width > OPEN_ENOUGH => Progress::Done(Vec::new()),
            Goal::Open => Progress::Continue,
            Goal::Close => {
                let presses = state.force > HOLD_FORCE;
                let held = self.held.update(presses && state.width > EMPTY);
                let empty = self.empty.update(presses && state.width <= EMPTY);
                if held {
                    Progress::done(&state.width)
                } else if empty {
                    Progress::Aborted("the gripper closed on nothing".to_owned())
                } else {
                    Progress::Continue
                }
            }
        }
    }
}

impl Controller for GripperControl {
    type Inputs = Inputs;
    type Outputs = Outputs;
    const TYPE: &'static str = "GripperControl";

    fn about() -> About {
        const GOAL: &[Parameter] = &[Parameter::new("goal", Kind::Text(&["open", "close"])), PRIORITY];
        About::task("Opens the gripper, or closes it on something; aborts when it closed on nothing.")
            .every(Duration::from_millis(20))
            .with(GOAL)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        let goal = if arguments.text("goal") == "open" { Goal::Open } else { Goal::Close };
        let debounce = Debounce::new(IN_A_ROW);
        let (started, at_ease) = (Time::ZERO, Debounce::new(AT_EASE_IN_A_ROW));
        let (watch, grant) = (Watch::default(), Grant::new("gripper", arguments)?);
        Ok(Self { goal, held: debounce, empty: debounce, started, met: None, at_ease, watch, grant })
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        (self.held, self.empty) = (Debounce::new(IN_A_ROW), Debounce::new(IN_A_ROW));
        (self.met, self.at_ease) = (None, Debounce::new(AT_EASE_IN_A_ROW));
        self.watch = Watch::default();
        self.grant.begin()
    }

    fn run(&mut self, now: Time) {
        self.started = now;
    }

    fn main_calc(&mut self, tick: Tick, inputs: &Inputs, outputs: &mut Outputs) -> Progress {
        let fence = match self.grant.ask(tick.now, &mut outputs.lock) {
            Right::Command(fence) => fence,
            Right::Wait => {
                // The time of the task is measured from the first motion of its fingers.
                self.started = tick.now;
                return Progress::Continue;
            }
            Right::Lost(why) => return Progress::Aborted(why),
        };
        let width = match self.goal {
            Goal::Open => OPEN,
            Goal::Close => 0.0,
        };
        let force = self.press(tick.now, inputs);
        outputs.command.send(GripperCommand { owner: self.owner(), width: Some(width), force, fence });
        if self.watch.is_silent(tick.now, inputs.state.fresh_within(tick.now, SENSED).is_some()) {
            return Progress::Aborted("no word from the gripper for 1 s".to_owned());
        }
        let progress = inputs.state.fresh().map_or(Progress::Continue, |state| self.judge(state));
        if progress == Progress::Continue && tick.now.since(self.started) > TIMEOUT {
            return Progress::Aborted("the gripper did not finish within 4 s".to_owned());
        }
        progress
    }

    fn stop(&mut self, tick: Tick, _: &Inputs, outputs: &mut Outputs) -> Stopping {
        // The gripper keeps its width. The controller only gives back the right to command it.
        if let Right::Command(fence) = self.grant.keep(tick.now, &mut outputs.lock) {
            outputs.command.send(GripperCommand { owner: self.owner(), width: None, force: FIRM, fence });
        }
        if self.grant.is_over(tick.now, true, &mut outputs.lock) { Stopping::Finished } else { Stopping::Again }
    }
}
