//! The Puma 560: a controller that moves the arm, a controller that only reads its joints, and a whole arm for
//! compliant motion.

mod load;

use super::grant::{Grant, LockCalls, PRIORITY, Right};
use super::{FORCE_MAX, FRESH, SENSED, Still, Watch, ramp_dt, seconds};
use crate::control::filter::Debounce;
use crate::control::follow::{Follow, HELD};
use crate::control::puma560::{self, Joints};
use crate::control::ramp::towards;
use crate::message::{ArmCommand, ArmState, FtState, JointState, JointVelocity, Velocity};
use crate::sdk::{About, Arguments, Controller, In, Inputs, Out, Outputs, Parameter, Progress, Stopping, Tick};
use load::{Load, size};
use nalgebra::Vector6;
use std::time::Duration;

const ACCELERATION_MAX: f64 = 8.0;
/// Five time constants of the drives, after which the arm is at rest.
const SETTLING: Duration = Duration::from_millis(100);
/// A joint this close to its limit moves only away from the limit (rad).
const LIMIT_MARGIN: f64 = 0.03;
/// The longest stop. In it the hand lets go of its force.
const STOP_WITHIN: Duration = Duration::from_millis(3500);
/// The motion ends after this number of samples in a row with too large a force on the hand, under every law that moves the arm.
/// Single samples may be wrong.
const FORCE_IN_A_ROW: u32 = 4;
/// The inputs of [`Puma560Ctrl`].
#[derive(Debug, Inputs)]
pub(super) struct CtrlInputs {
    /// The rates of the joints.
    #[port("In")]
    rates: In<JointVelocity>,
    /// The arm's encoders.
    #[device("arm/state")]
    state: In<ArmState>,
    /// The wrist sensor: an arm that stops lets go of the force on its hand.
    #[device("ft/state")]
    force: In<FtState>,
}

/// The outputs of [`Puma560Ctrl`].
#[derive(Debug, Outputs)]
pub(super) struct CtrlOutputs {
    /// The joints.
    #[port("Out")]
    joints: Out<JointState>,
    /// To the arm.
    #[device("arm/cmd")]
    command: Out<ArmCommand>,
    /// The lock of the arm.
    #[calls("Lock", optional)]
    lock: LockCalls,
}

/// The last command to the arm, how it may change, and the right to give it.
#[derive(Debug)]
struct Servo {
    owner: &'static str,
    command: Joints,
    follow: Follow,
    watch: Watch,
    overload: Debounce,
    load: Load,
    still: Still,
    grant: Grant,
}

/// The parameters of a controller that moves the arm.
const PARAMETERS: &[Parameter] = &[PRIORITY];

impl Servo {
    fn new(owner: &'static str, arguments: &Arguments) -> Result<Self, String> {
        let (command, watch, grant) = (Joints::zeros(), Watch::default(), Grant::new("arm", arguments)?);
        let (follow, load, still) = (Follow::default(), Load::default(), Still::default());
        let overload = Debounce::new(FORCE_IN_A_ROW);
        Ok(Self { owner, command, follow, watch, overload, load, still, grant })
    }

    fn begin(&mut self) -> Result<(), String> {
        (self.command, self.watch, self.still) = (Joints::zeros(), Watch::default(), Still::default());
        (self.follow, self.load) = (Follow::default(), Load::default());
        self.overload = Debounce::new(FORCE_IN_A_ROW);
        self.grant.begin()
    }

    /// Takes a new sample of the wrist sensor, if there is one. Returns why the arm has to stop and let go, if it has
    /// to.
    fn overloaded(&mut self, force: Option<&FtState>) -> Option<String> {
        self.overload
            .update(size(force?) > FORCE_MAX)
            .then(|| format!("the force on the hand exceeds {FORCE_MAX:.0} N"))
    }

    /// Takes whether another law has taken the load off the hand, and a new sample of the wrist sensor.
    fn hold(&mut self, tick: Tick, rests: bool, force: Option<&FtState>) {
        self.load.hold(rests, force);
        self.still.update(tick.now, self.load.is_held() && self.command.amax() <= 0.0);
    }

    /// Sends the command that brings the joints to `wanted` (rad/s), if the controller has the right to command.
    fn work(
        &mut self,
        tick: Tick,
        state: &In<ArmState>,
        wanted: &Joints,
        command: &mut Out<ArmCommand>,
        lock: &mut LockCalls,
    ) -> Progress {
        let fence = match self.grant.ask(tick.now, lock) {
            Right::Command(fence) => Some(fence),
            Right::Wait => None,
            Right::Lost(why) => return Progress::Aborted(why),
        };
        let rates = match self.step(tick, state, wanted) {
            Ok(rates) => rates,
            Err(reason) => return Progress::Aborted(reason),
        };
        match fence {
            Some(fence) => {
                self.follow.command(&rates.into(), tick.now);
                command.send(ArmCommand { owner: self.owner.to_owned(), rates: Some(rates), fence });
            }
            // By now the watchdog has stopped the arm.
            None => (self.command, self.follow) = (Joints::zeros(), Follow::default()),
        }
        Progress::Continue
    }

    /// Moves the command towards `wanted` (rad/s); fails if the arm is silent.
    fn step(&mut self, tick: Tick, input: &In<ArmState>, wanted: &Joints) -> Result<[f64; 6], String> {
        let state = input.fresh_within(tick.now, SENSED);
        if self.watch.is_silent(tick.now, state.is_some()) {
            return Err("no word from the arm for 1 s".to_owned());
        }
        let measured = state.map(|state| (Joints::from(state.angles), Joints::from(state.rates)));
        // A comparison with an angle that is not a number would call every joint within its range.
        let measured = measured.filter(|(q, rates)| q.iter().chain(rates).all(|number| number.is_finite()));
        if let Some((_, rates)) = measured.filter(|_| tick.dt() > HELD.as_secs_f64()) {
            self.command = rates;
        }
        if let (Some((angles, _)), Some(at)) = (measured, input.measured())
            && let Some(joint) = self.follow.measure(&angles, at)
        {
            return Err(format!(
                "joint {joint} does not follow its commands: its encoder sticks, or something holds it"
            ));
        }
        let wanted = measured.map_or_else(Joints::zeros, |(q, _)| within(&q, wanted));
        self.move_towards(&wanted, tick);
        Ok(self.command.into())
    }

    fn move_towards(&mut self, wanted: &Joints, tick: Tick) {
        let step = ACCELERATION_MAX * ramp_dt(tick);
        self.command = self.command.zip_map(wanted, |rate, wanted| towards(rate, wanted, step));
    }

    /// Takes the load off the hand unless another law has done so, moves the command to rest, then lets go of the arm.
    fn stop(
        &mut self,
        tick: Tick,
        state: &In<ArmState>,
        force: &In<FtState>,
        command: &mut Out<ArmCommand>,
        lock: &mut LockCalls,
    ) -> Stopping {
        let wanted = self.load.take_off(tick, state, force).map(|wanted| {
            let within = |state: &ArmState| within(&state.angles.into(), &wanted);
            state.latest().map_or_else(Joints::zeros, within)
        });
        self.move_towards(&wanted.unwrap_or_else(Joints::zeros), tick);
        self.still.update(tick.now, wanted.is_none() && self.command.amax() <= 0.0);
        let rests = self.still.lasts(tick.now) >= SETTLING;
        if let Right::Command(fence) = self.grant.keep(tick.now, lock) {
            let rates = (!rests).then(|| self.command.into());
            command.send(ArmCommand { owner: self.owner.to_owned(), rates, fence });
        }
        if self.grant.is_over(tick.now, rests, lock) { Stopping::Finished } else { Stopping::Again }
    }
}

/// Sends a new sample of the encoders to the readers of the joints, if there is one.
fn tell(state: &In<ArmState>, joints: &mut Out<JointState>) {
    if let Some(state) = state.fresh() {
        joints.send(JointState { measured: seconds(state.stamp), angles: state.angles, rates: state.rates });
    }
}

/// Returns the `wanted` rates (rad/s), without those that lead beyond the ranges of joints at `q` (rad).
fn within(q: &Joints, wanted: &Joints) -> Joints {
    let (low, high) = (puma560::lowest(), puma560::highest());
    Joints::from_fn(|i, _| {
        if q[i] > high[i] - LIMIT_MARGIN {
            wanted[i].min(0.0)
        } else if q[i] < low[i] + LIMIT_MARGIN {
            wanted[i].max(0.0)
        } else {
            wanted[i]
        }
    })
}

/// Moves the arm's joints as commanded, within their limits, and publishes their angles.
#[derive(Debug)]
pub(super) struct Puma560Ctrl {
    servo: Servo,
}

impl Controller for Puma560Ctrl {
    type Inputs = CtrlInputs;
    type Outputs = CtrlOutputs;
    const TYPE: &'static str = "Puma560Ctrl";

    fn about() -> About {
        About::service("Moves the joints of the Puma 560 with the received rates, under the lock of the arm if it is connected, and sends \
                        their angles; at a stop, takes the load off the hand.")
            .with(PARAMETERS)
            .every(Duration::from_millis(10))
            .triggered_by("In")
            .stop_within(STOP_WITHIN)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        Ok(Self { servo: Servo::new(Self::TYPE, arguments)? })
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        self.servo.begin()
    }

    fn main_calc(&mut self, tick: Tick, inputs: &CtrlInputs, outputs: &mut CtrlOutputs) -> Progress {
        tell(&inputs.state, &mut outputs.joints);
        if let Some(why) = self.servo.overloaded(inputs.force.fresh()) {
            return Progress::Aborted(why);
        }
        let order = inputs.rates.fresh_within(tick.now, FRESH);
        if let Some(order) = order {
            self.servo.hold(tick, order.rests, inputs.force.fresh());
        }
        let wanted = order.map_or_else(Joints::zeros, |order| order.rates.into());
        self.servo.work(tick, &inputs.state, &wanted, &mut outputs.command, &mut outputs.lock)
    }

    fn stop(&mut self, tick: Tick, inputs: &CtrlInputs, outputs: &mut CtrlOutputs) -> Stopping {
        // If a reader of the joints missed them, it would end first and hide the true reason of an abort.
        tell(&inputs.state, &mut outputs.joints);
        self.servo.stop(tick, &inputs.state, &inputs.force, &mut outputs.command, &mut outputs.lock)
    }

    fn unconfirmed(&self) -> Option<String> {
        self.servo.load.unconfirmed()
    }
}

/// The inputs of [`Puma560Joints`].
#[derive(Debug, Inputs)]
pub(super) struct JointsInputs {
    /// The arm's encoders.
    #[device("arm/state")]
    state: In<ArmState>,
}

/// The outputs of [`Puma560Joints`].
#[derive(Debug, Outputs)]
pub(super) struct JointsOutputs {
    /// The joints.
    #[port("Out")]
    joints: Out<JointState>,
}

/// Publishes the angles of the arm's joints.
#[derive(Debug, Default)]
pub(super) struct Puma560Joints {
    watch: Watch,
}

impl Controller for Puma560Joints {
    type Inputs = JointsInputs;
    type Outputs = JointsOutputs;
    const TYPE: &'static str = "Puma560Joints";

    fn about() -> About {
        About::service("Sends the joint angles of the Puma 560.")
            .every(Duration::from_millis(50))
            .triggered_by("arm/state")
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        Ok(Self::default())
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        *self = Self::default();
        Ok(())
    }

    fn main_calc(&mut self, tick: Tick, inputs: &JointsInputs, outputs: &mut JointsOutputs) -> Progress {
        tell(&inputs.state, &mut outputs.joints);
        if self.watch.is_silent(tick.now, inputs.state.fresh().is_some()) {
            return Progress::Aborted("no word from the arm for 1 s".to_owned());
        }
        Progress::Continue
    }
}

/// The inputs of [`Puma560`].
#[derive(Debug, Inputs)]
pub(super) struct ArmInputs {
    /// The velocity of the hand.
    #[port("In1")]
    velocity: In<Velocity>,
    /// The arm's encoders.
    #[device("arm/state")]
    state: In<ArmState>,
    /// The wrist sensor: an arm that stops lets go of the force on its hand.
    #[device("ft/state")]
    force: In<FtState>,
}

/// The outputs of [`Puma560`].
#[derive(Debug, Outputs)]
pub(super) struct ArmOutputs {
    /// To the arm.
    #[device("arm/cmd")]
    command: Out<ArmCommand>,
    /// The lock of the arm.
    #[calls("Lock", optional)]
    lock: LockCalls,
}

/// Moves the hand as commanded with the arm alone; the base does not move.
#[derive(Debug)]
pub(super) struct Puma560 {
    servo: Servo,
}

impl Puma560 {
    fn wanted(&mut self, tick: Tick, inputs: &ArmInputs) -> Option<Joints> {
        let state = inputs.state.fresh_within(tick.now, SENSED)?;
        let velocity = inputs.velocity.fresh_within(tick.now, FRESH)?;
        let rests = velocity.moves_nothing() && (velocity.rests || self.servo.load.is_held());
        self.servo.hold(tick, rests, inputs.force.fresh());
        Some(puma560::rates_for(&state.angles.into(), &Vector6::from(velocity.twist)))
    }
}

impl Controller for Puma560 {
    type Inputs = ArmInputs;
    type Outputs = ArmOutputs;
    const TYPE: &'static str = "Puma560";

    fn about() -> About {
        About::service(
            "Moves the hand of the Puma 560 with the received velocity, only with the arm, under the lock of the arm if it is connected.",
        )
        .with(PARAMETERS)
        .every(Duration::from_millis(10))
        .triggered_by("In1")
        .stop_within(STOP_WITHIN)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        Ok(Self { servo: Servo::new(Self::TYPE, arguments)? })
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        self.servo.begin()
    }

    fn main_calc(&mut self, tick: Tick, inputs: &ArmInputs, outputs: &mut ArmOutputs) -> Progress {
        if let Some(why) = self.servo.overloaded(inputs.force.fresh()) {
            return Progress::Aborted(why);
        }
        let wanted = self.wanted(tick, inputs).unwrap_or_else(Joints::zeros);
        self.servo.work(tick, &inputs.state, &wanted, &mut outputs.command, &mut outputs.lock)
    }

    fn stop(&mut self, tick: Tick, inputs: &ArmInputs, outputs: &mut ArmOutputs) -> Stopping {
        self.servo.stop(tick, &inputs.state, &inputs.force, &mut outputs.command, &mut outputs.lock)
    }

    fn unconfirmed(&self) -> Option<String> {
        self.servo.load.unconfirmed()
    }
}
