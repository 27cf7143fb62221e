//! Hardware that outlives missions: the server of a base with a lock in front of its wheels, and a
//! pilot that drives the base for any mission.

use crate::headline;
use controllers::sdk::messaging::{
    Denied, Full, Label, Lock, LockAnswer, LockRequest, LockSettings, LockUser, Queue, QueueClient, QueueMessage,
    Receipt, Rejected, SendEnd,
};
use controllers::sdk::serde::{Deserialize, Serialize};
use controllers::sdk::{
    About, Arguments, Calls, Controller, Exports, Kind, Message, Outputs, Parameter, Progress, Quantity, Registry,
    Signal, Tick, Time,
};
use std::time::Duration;

/// How long the wheels turn after the last command.
const WATCHDOG: Duration = Duration::from_millis(100);
/// How long a grant of the lock lasts without a renewal.
const LEASE: Duration = Duration::from_millis(300);
/// How often a pilot sends its speed.
const EVERY: Duration = Duration::from_millis(20);
/// How long a command is worth sending: after that the next one is newer.
const COMMAND_WITHIN: Duration = Duration::from_millis(80);
/// How long the base has to answer.
const WITHIN: Duration = Duration::from_secs(1);
/// How many calls in a row may fail before a pilot gives up.
const FAILURES_MAX: u32 = 5;

/// How fast to go.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(crate = "controllers::sdk::serde")]
struct Pace {
    /// (m/s)
    speed: f64,
}

impl Message for Pace {
    const TYPE: &'static str = "Pace";
    const FIELDS: &'static str = "speed: Speed";
}

/// How the base moves. Times are since the host was started.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
#[serde(crate = "controllers::sdk::serde")]
struct Motion {
    /// From where the server began (m).
    travelled: f64,
    /// (m/s)
    speed: f64,
    /// When a command was taken last (s).
    commanded: f64,
    /// When the watchdog has stopped the wheels last; 0 if it never had to (s).
    stopped: f64,
    /// The longest time between two looks of the watchdog since that command (s).
    pause: f64,
    /// How many commands were refused because their sender did not hold the lock.
    fenced: f64,
}

impl Message for Motion {
    const TYPE: &'static str = "Motion";
    const FIELDS: &'static str =
        "travelled: Length, speed: Speed, commanded: Time, stopped: Time, pause: Time, fenced: Number";
}

/// The server of a simulated base.
struct Base {
    /// The greatest speed (m/s).
    limit: f64,
    motion: Motion,
    commands: Queue<Pace>,
    wheels: Lock,
    /// When the last command was taken.
    last: Time,
    /// The time of the last look.
    looked: Time,
}

impl Base {
    /// Receives a command, only from the holder of the lock.
    fn receive(&mut self, message: QueueMessage) -> Receipt {
        let receipt = self.commands.receive_under(&mut self.wheels, message);
        if matches!(receipt, Receipt::Rejected(Rejected::Fenced(_))) {
            self.motion.fenced += 1.0;
        }
        receipt
    }
}

impl Controller for Base {
    type Inputs = ();
    type Outputs = ();
    const TYPE: &'static str = "Base";

    fn about() -> About {
        const LIMIT: &[Parameter] = &[Parameter::new("limit", Kind::Quantity(Quantity::Speed, 0.0, 10.0)).or("1")];
        About::service("A base, simulated: commands under a lock, and a watchdog that stops its wheels.")
            .every(Duration::from_millis(5))
            .with(LIMIT)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        Ok(Self {
            limit: arguments.number("limit"),
            motion: Motion::default(),
            // The newest command is used.
            commands: Queue::new(4, Full::DropOldest),
            wheels: Lock::new(LockSettings { lease: LEASE, preempt_after: None, waiting_max: 8 }),
            last: Time::ZERO,
            looked: Time::ZERO,
        })
    }

    fn exports(exports: &mut Exports<Self>) {
        exports
            .procedure(
                "Commands",
                "How fast to go, for 100 ms or until the next command.",
                |base: &mut Self, message| Ok(base.receive(message)),
            )
            .procedure_later("wheels", "The lock of the wheels.", |base: &mut Self, request, reply| {
                base.wheels.ask(request, reply);
            })
            .state("motion", "How it moves.", |base| base.motion)
            .state("commands", "The commands that wait.", |base| base.commands.status())
            .state("lock", "The holder of the wheels.", |base| base.wheels.status());
    }

    fn main_calc(&mut self, tick: Tick, (): &(), (): &mut ()) -> Progress {
        let motion = &mut self.motion;
        motion.travelled += motion.speed * tick.dt();
        motion.pause = motion.pause.max(tick.now.since(self.looked).as_secs_f64());
        self.looked = tick.now;
        while let Some(command) = self.commands.take_under(&mut self.wheels, tick.now) {
            motion.speed = command.data.speed.clamp(-self.limit, self.limit);
            (self.last, motion.commanded, motion.pause) = (tick.now, seconds(tick.now), 0.0);
        }
        if motion.speed != 0.0 && tick.now.since(self.last) >= WATCHDOG {
            (motion.speed, motion.stopped) = (0.0, seconds(tick.now));
        }
        Progress::Continue
    }

    fn signals(&self) -> Vec<Signal> {
        vec![headline("travelled", "m", self.motion.travelled)]
    }
}

fn seconds(time: Time) -> f64 {
    time.since(Time::ZERO).as_secs_f64()
}

#[derive(Outputs)]
struct PilotOutputs {
    #[calls("Commands")]
    commands: Calls<QueueMessage, Receipt>,
    #[calls("wheels")]
    wheels: Calls<LockRequest, LockAnswer>,
    #[calls("Motion")]
    motion: Calls<(), Motion>,
}

/// Drives some way as soon as it holds the wheels, and is done.
struct Pilot {
    /// (m)
    distance: f64,
    /// (m/s)
    speed: f64,
    client: QueueClient<Pace>,
    user: LockUser,
    start: Option<f64>,
    failures: u32,
    due: Time,
}

impl Controller for Pilot {
    type Inputs = ();
    type Outputs = PilotOutputs;
    const TYPE: &'static str = "Pilot";

    fn about() -> About {
        const WAY: &[Parameter] = &[
            Parameter::new("distance", Kind::Quantity(Quantity::Length, 0.0, 1e6)),
            Parameter::new("speed", Kind::Quantity(Quantity::Speed, 0.0, 10.0)),
        ];
        About::task("Takes the wheels of a base, and drives some way.").every(Duration::from_millis(5)).with(WAY)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        let client = QueueClient::new("pilot").map_err(|cause| cause.to_string())?;
        let user = LockUser::new("pilot").map_err(|cause| cause.to_string())?;
        let (distance, speed) = (arguments.number("distance"), arguments.number("speed"));
        Ok(Self { distance, speed, client, user, start: None, failures: 0, due: Time::ZERO })
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        (self.start, self.failures) = (None, 0);
        self.user.want(0);
        Ok(())
    }

    fn main_calc(&mut self, tick: Tick, (): &(), outputs: &mut PilotOutputs) -> Progress {
        self.user.work(tick.now, &mut outputs.wheels);
        self.client.work(tick.now, &mut outputs.commands);
        while let Some((_, end)) = self.client.end_of() {
            // The base refuses commands sent under a grant that has ended, and the lock reports the end as well.
            if let SendEnd::Unknown(error) = end {
                return Progress::Aborted(format!("there is no base: {error}"));
            }
        }
        while let Some((_, result)) = outputs.motion.answer() {
            match result {
                Ok(motion) => {
                    self.failures = 0;
                    if motion.travelled - *self.start.get_or_insert(motion.travelled) >= self.distance {
                        self.user.let_go();
                        self.user.work(tick.now, &mut outputs.wheels);
                        return Progress::Done(Vec::new());
                    }
                }
                Err(error) => {
                    self.failures += 1;
                    if self.failures >= FAILURES_MAX {
                        return Progress::Aborted(format!("the base does not answer: {error}"));
                    }
                }
            }
        }
        let fence = self.user.held(tick.now);
        // The distance is measured from the place where the wheels were granted, because another mission drives before that.
        if fence.is_some() && outputs.motion.pending() == 0 {
            outputs.motion.call((), WITHIN);
        }
        if let Some(why) = self.user.lost() {
            // Another client may have driven in between: this one continues from the present place.
            if why == Denied::TooManyWait {
                return Progress::Aborted("too many want the wheels".to_owned());
            }
            self.user.want(0);
        }
        if let Some(fence) = fence
            && self.due <= tick.now
        {
            self.due = tick.now + EVERY;
            let pace = Pace { speed: self.speed };
            if let Err(why) = self.client.send(
                tick.now,
                Label { category: "pace", priority: 0, marker: 0 },
                &pace,
                Some(fence),
                COMMAND_WITHIN,
            ) {
                return Progress::Aborted(why);
            }
        }
        Progress::Continue
    }
}

/// Adds the controllers of this example.
pub(crate) fn add(registry: &mut Registry) {
    registry.add::<Base>().add::<Pilot>();
}
