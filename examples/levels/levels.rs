//! Two levels of control: wheels that export their procedures, a guard that is built on them and replaces them, and a
//! trip.

use crate::headline;
use controllers::sdk::serde::{Deserialize, Serialize};
use controllers::sdk::{
    About, Arguments, Calls, Controller, Exports, Kind, Message, ObjectError, Outputs, Parameter, Progress, Quantity,
    Registry, Reply, Signal, Tick,
};
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

/// How long the wheels turn after the last command (s).
const WATCHDOG: f64 = 0.1;
/// How long the wheels have to answer.
const WITHIN: Duration = Duration::from_secs(1);
/// How many calls in a row may fail before the trip gives up.
const FAILURES_MAX: u32 = 5;
/// How many calls wait for the guard.
const WAITING_MAX: usize = 16;

/// How fast to go.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(crate = "controllers::sdk::serde")]
struct Go {
    /// (m/s)
    speed: f64,
}

impl Message for Go {
    const TYPE: &'static str = "Go";
    const FIELDS: &'static str = "speed: Speed";
}

/// Where the base is.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
#[serde(crate = "controllers::sdk::serde")]
struct Place {
    /// From where it started (m).
    travelled: f64,
    /// (m/s)
    speed: f64,
}

impl Message for Place {
    const TYPE: &'static str = "Place";
    const FIELDS: &'static str = "travelled: Length, speed: Speed";
}

/// The hardware level: a simulated base.
#[derive(Default)]
struct Wheels {
    place: Place,
    /// The time since the last command (s).
    idle: f64,
}

impl Wheels {
    fn drive(&mut self, go: Go) -> Result<Place, String> {
        if !go.speed.is_finite() || go.speed.abs() > 10.0 {
            return Err(format!("{} m/s is not a speed of these wheels: from -10 to 10", go.speed));
        }
        (self.place.speed, self.idle) = (go.speed, 0.0);
        Ok(self.place)
    }
}

impl Controller for Wheels {
    type Inputs = ();
    type Outputs = ();
    const TYPE: &'static str = "Wheels";

    fn about() -> About {
        About::service("Wheels, simulated; they stop when no program drives them.").every(Duration::from_millis(5))
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        Ok(Self::default())
    }

    fn exports(exports: &mut Exports<Self>) {
        exports
            .procedure("Drive", "Goes at a speed, for 100 ms or until the next call; answers where it is.", Self::drive)
            .state("place", "Where it is, and how fast it goes.", |wheels| wheels.place);
    }

    fn main_calc(&mut self, tick: Tick, (): &(), (): &mut ()) -> Progress {
        self.idle += tick.dt();
        if self.idle > WATCHDOG {
            self.place.speed = 0.0;
        }
        self.place.travelled += self.place.speed * tick.dt();
        Progress::Continue
    }

    fn signals(&self) -> Vec<Signal> {
        vec![headline("travelled", "m", self.place.travelled)]
    }
}

#[derive(Outputs)]
struct GuardOutputs {
    /// The guarded process.
    #[calls("Below")]
    below: Calls<Go, Place>,
}

/// Drives the process below it, and never too fast. It has the same exports, so it can stand in its place.
struct SpeedGuard {
    /// (m/s)
    limit: f64,
    waiting: VecDeque<(Go, Reply<Place>)>,
    /// By the number of the call below.
    passed: BTreeMap<u64, Reply<Place>>,
}

impl SpeedGuard {
    fn drive(&mut self, go: Go, reply: Reply<Place>) {
        if self.waiting.len() + self.passed.len() >= WAITING_MAX {
            return reply.refuse("too many drive at the same time");
        }
        self.waiting.push_back((go, reply));
    }
}

impl Controller for SpeedGuard {
    type Inputs = ();
    type Outputs = GuardOutputs;
    const TYPE: &'static str = "SpeedGuard";

    fn about() -> About {
        const LIMIT: &[Parameter] = &[Parameter::new("limit", Kind::Quantity(Quantity::Speed, 0.0, 100.0))];
        About::service("Drives what is below it, and never too fast.")
            .every(Duration::from_millis(5))
            .triggered_by("Below")
            .with(LIMIT)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        Ok(Self { limit: arguments.number("limit"), waiting: VecDeque::new(), passed: BTreeMap::new() })
    }

    fn exports(exports: &mut Exports<Self>) {
        exports.procedure_later("Drive", "Goes at a speed, but not too fast; answers where it is.", Self::drive);
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        (self.waiting, self.passed) = (VecDeque::new(), BTreeMap::new());
        Ok(())
    }

    fn main_calc(&mut self, _: Tick, (): &(), outputs: &mut GuardOutputs) -> Progress {
        while let Some((number, result)) = outputs.below.answer() {
            let Some(reply) = self.passed.remove(&number) else { continue };
            match result {
                Ok(place) => reply.send(place),
                Err(error) => reply.refuse(format!("the wheels: {error}")),
            }
        }
        for (go, reply) in self.waiting.drain(..) {
            // The guard does not drive for a caller that is gone.
            if reply.is_wanted() {
                let go = Go { speed: go.speed.clamp(-self.limit, self.limit) };
                self.passed.insert(outputs.below.call(go, WITHIN), reply);
            }
        }
        Progress::Continue
    }
}

#[derive(Outputs)]
struct TripOutputs {
    /// The base, in any implementation.
    #[calls("Drive")]
    drive: Calls<Go, Place>,
    /// Where the base is.
    #[calls("Place", optional)]
    place: Calls<(), Place>,
}

/// The robot level: drives some way, and is done.
struct Trip {
    /// (m)
    distance: f64,
    /// (m/s)
    speed: f64,
    start: Option<f64>,
    failures: u32,
}

impl Controller for Trip {
    type Inputs = ();
    type Outputs = TripOutputs;
    const TYPE: &'static str = "Trip";

    fn about() -> About {
        const WAY: &[Parameter] = &[
            Parameter::new("distance", Kind::Quantity(Quantity::Length, 0.0, 10_000.0)),
            Parameter::new("speed", Kind::Quantity(Quantity::Speed, 0.0, 100.0)),
        ];
        About::task("Drives some way.").every(Duration::from_millis(20)).with(WAY)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        let (distance, speed) = (arguments.number("distance"), arguments.number("speed"));
        Ok(Self { distance, speed, start: None, failures: 0 })
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        (self.start, self.failures) = (None, 0);
        Ok(())
    }

    fn main_calc(&mut self, _: Tick, (): &(), outputs: &mut TripOutputs) -> Progress {
        let (drive, place) = (&mut outputs.drive, &mut outputs.place);
        while let Some((_, result)) = place.answer().or_else(|| drive.answer()) {
            match result {
                Ok(place) => {
                    self.failures = 0;
                    let start = *self.start.get_or_insert(place.travelled);
                    if place.travelled - start >= self.distance {
                        return Progress::Done(Vec::new());
                    }
                }
                // A spec need not connect the state.
                Err(ObjectError::NotConnected { name }) if name == "Place" => {}
                Err(error) => {
                    self.failures += 1;
                    if self.failures >= FAILURES_MAX {
                        return Progress::Aborted(format!("the base does not drive: {error}"));
                    }
                }
            }
        }
        if drive.pending() == 0 {
            drive.call(Go { speed: self.speed }, WITHIN);
        }
        if self.start.is_none() && place.pending() == 0 {
            place.call((), WITHIN);
        }
        Progress::Continue
    }
}

/// Adds the controllers of this example.
pub(crate) fn add(registry: &mut Registry) {
    registry.add::<Wheels>().add::<SpeedGuard>().add::<Trip>();
}
