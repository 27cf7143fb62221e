//! The XR4000: a controller that moves the base, and its odometry.

use super::grant::{Grant, LockCalls, PRIORITY, Right};
use super::{FRESH, SENSED, Still, Watch, ramp_dt, seconds};
use crate::control::caster::{Casters, Odometry};
use crate::control::ramp::towards_together;
use crate::control::redundancy::BASE_ACCELERATION_MAX;
use crate::message::{BaseCommand, BasePose, BaseState, BaseVelocity};
use crate::sdk::{
    About, Arguments, Controller, In, Inputs, Kind, Out, Outputs, Parameter, Progress, Quantity, Stopping, Tick,
};
use comms::logic::signals::Signal;
use comms::logic::time::Time;
use std::time::Duration;

/// If its bumper is pressed, a base drives back in the direction from which it came, with this
/// speed (m/s), for at most this time. If the base was slower than the minimum (m/s), it was hit,
/// and it stays.
const RETREAT: f64 = 0.06;
const RETREAT_MAX: Duration = Duration::from_millis(1000);
const SPEED_MIN: f64 = 0.01;
/// Five time constants of the drives, after which the base is at rest.
const SETTLING: Duration = Duration::from_millis(400);
/// The largest part of an encoder's step that no motion of the base explains (rad). Good wheels leave less than half of
/// it, even after a gap of 60 ms.
const RESIDUAL_MAX: f64 = 0.12;

/// The inputs of [`Xr4000Ctrl`].
#[derive(Debug, Inputs)]
pub(super) struct CtrlInputs {
    /// The velocity of the base.
    #[port("In")]
    velocity: In<BaseVelocity>,
    /// The bumper of the base.
    #[device("base/state")]
    state: In<BaseState>,
}

/// The outputs of [`Xr4000Ctrl`].
#[derive(Debug, Outputs)]
pub(super) struct CtrlOutputs {
    /// To the base.
    #[device("base/cmd")]
    command: Out<BaseCommand>,
    /// The lock of the base.
    #[calls("Lock", optional)]
    lock: LockCalls,
}

/// Moves the base as commanded.
#[derive(Debug)]
pub(super) struct Xr4000Ctrl {
    command: [f64; 3],
    /// The velocity away from the obstacle that the bumper has met, and the time for which the base has gone back.
    away: Option<[f64; 3]>,
    retreating: Duration,
    still: Still,
    grant: Grant,
}

impl Xr4000Ctrl {
    fn step(&mut self, tick: Tick, wanted: [f64; 3]) -> [f64; 3] {
        let steps = BASE_ACCELERATION_MAX.map(|most| most * ramp_dt(tick));
        self.command = towards_together(&self.command, &wanted, &steps);
        self.still.update(tick.now, self.command.iter().all(|rate| rate.abs() <= 0.0));
        self.command
    }

    /// Returns whether the bumper is pressed. A pressed bumper makes the command zero.
    fn bumped(&mut self, now: Time, state: &In<BaseState>) -> bool {
        let pressed = state.fresh_within(now, SENSED).is_some_and(|state| state.bumped);
        if pressed && self.away.is_none() {
            let [x, y, _] = std::mem::take(&mut self.command);
            let speed = x.hypot(y);
            self.away = Some(if speed < SPEED_MIN { [0.0; 3] } else { [-x, -y, 0.0].map(|v| v / speed * RETREAT) });
        }
        pressed
    }

    /// Returns the velocity of a base that stops: away from the obstacle while the bumper is pressed, then zero.
    fn retreat(&mut self, tick: Tick, state: &In<BaseState>) -> [f64; 3] {
        let goes = self.bumped(tick.now, state) && self.retreating < RETREAT_MAX;
        self.retreating += if goes { tick.elapsed } else { Duration::ZERO };
        self.away.filter(|_| goes).unwrap_or_default()
    }

    fn send(velocity: Option<[f64; 3]>, fence: Option<u64>, outputs: &mut CtrlOutputs) {
        outputs.command.send(BaseCommand { owner: Self::TYPE.to_owned(), velocity, fence });
    }
}

impl Controller for Xr4000Ctrl {
    type Inputs = CtrlInputs;
    type Outputs = CtrlOutputs;
    const TYPE: &'static str = "XR4000Ctrl";

    fn about() -> About {
        const PARAMETERS: &[Parameter] = &[PRIORITY];
        About::service(
            "Moves the XR4000 base with the received velocity, under its lock if it is connected; ends when the bumper is pressed.",
        )
        .with(PARAMETERS)
        .every(Duration::from_millis(10))
        .triggered_by("In")
        .stop_within(Duration::from_millis(2500))
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        let (away, retreating, still) = (None, Duration::ZERO, Still::default());
        Ok(Self { command: [0.0; 3], away, retreating, still, grant: Grant::new("base", arguments)? })
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        (self.command, self.still) = ([0.0; 3], Still::default());
        (self.away, self.retreating) = (None, Duration::ZERO);
        self.grant.begin()
    }

    fn main_calc(&mut self, tick: Tick, inputs: &CtrlInputs, outputs: &mut CtrlOutputs) -> Progress {
        if self.bumped(tick.now, &inputs.state) {
            return Progress::Aborted("the base has met something: its bumper is pressed".to_owned());
        }
        let fence = match self.grant.ask(tick.now, &mut outputs.lock) {
            Right::Command(fence) => fence,
            Right::Wait => {
                // By now the watchdog has stopped the base.
                self.command = [0.0; 3];
                return Progress::Continue;
            }
            Right::Lost(why) => return Progress::Aborted(why),
        };
        let wanted = inputs.velocity.fresh_within(tick.now, FRESH).map_or([0.0; 3], |velocity| velocity.rates);
        Self::send(Some(self.step(tick, wanted)), fence, outputs);
        Progress::Continue
    }

    fn stop(&mut self, tick: Tick, inputs: &CtrlInputs, outputs: &mut CtrlOutputs) -> Stopping {
        let wanted = self.retreat(tick, &inputs.state);
        let velocity = self.step(tick, wanted);
        let rests = self.still.lasts(tick.now) >= SETTLING;
        if let Right::Command(fence) = self.grant.keep(tick.now, &mut outputs.lock) {
            Self::send((!rests).then_some(velocity), fence, outputs);
        }
        let is_over = self.grant.is_over(tick.now, rests, &mut outputs.lock);
        if is_over { Stopping::Finished } else { Stopping::Again }
    }
}

/// The inputs of [`Xr4000Odometry`].
#[derive(Debug, Inputs)]
pub(super) struct OdometryInputs {
    /// The encoders of the casters.
    #[device("base/state")]
    state: In<BaseState>,
}

/// The outputs of [`Xr4000Odometry`].
#[derive(Debug, Outputs)]
pub(super) struct OdometryOutputs {
    /// The pose of the base in the frame of its start.
    #[port("Out")]
    pose: Out<BasePose>,
}

/// Publishes the pose of the base by dead reckoning from its casters.
#[derive(Debug)]
pub(super) struct Xr4000Odometry {
    wheel_radius: f64,
    odometry: Odometry,
    residual: f64,
    watch: Watch,
}

impl Controller for Xr4000Odometry {
    type Inputs = OdometryInputs;
    type Outputs = OdometryOutputs;
    const TYPE: &'static str = "XR4000Odometry";

    fn about() -> About {
        const PARAMETERS: &[Parameter] =
            &[Parameter::new("wheel_radius", Kind::Quantity(Quantity::Length, 0.01, 0.5)).or("0.055")];
        About::service(
            "Sends the position of the XR4000, by dead reckoning from its casters with wheels of a radius [m].",
        )
        .remembers()
        .with(PARAMETERS)
        .every(Duration::from_millis(50))
        .triggered_by("base/state")
        .signals_every(Duration::from_millis(100))
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        let wheel_radius = arguments.number("wheel_radius");
        Ok(Self { wheel_radius, odometry: Odometry::new(wheel_radius), residual: 0.0, watch: Watch::default() })
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        (self.odometry, self.residual, self.watch) = (Odometry::new(self.wheel_radius), 0.0, Watch::default());
        Ok(())
    }

    fn main_calc(&mut self, tick: Tick, inputs: &OdometryInputs, outputs: &mut OdometryOutputs) -> Progress {
        let fresh = inputs.state.fresh();
        if let Some(state) = fresh {
            let angles = Casters::from_fn(|i, _| if i < 4 { state.steering[i] } else { state.rolling[i - 4] });
            self.residual = self.odometry.update(&angles).residual;
            if self.residual > RESIDUAL_MAX {
                let why = "the casters contradict each other: an encoder jumps, or a wheel slips";
                return Progress::Aborted(format!("{why}: by {:.2} rad", self.residual));
            }
            outputs.pose.send(BasePose { measured: seconds(state.stamp), pose: (*self.odometry.pose()).into() });
        }
        if self.watch.is_silent(tick.now, fresh.is_some()) {
            return Progress::Aborted("no word from the base for 1 s".to_owned());
        }
        Progress::Continue
    }

    fn signals(&self) -> Vec<Signal> {
        vec![Signal { name: "wheel slip".into(), unit: "rad".into(), value: self.residual, headline: false }]
    }
}
