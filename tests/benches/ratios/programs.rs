//! The measured controllers. Each is as small as a controller can be, and none reads a clock.

use crate::streams::{Tally, message};
use comms::logic::bytes::Bytes;
use comms::logic::time::Time;
use controllers::sdk::messaging::{Full, Queue, QueueMessage};
use controllers::sdk::{
    About, Arguments, Controller, Every, Exports, In, Inputs, Kind, Message, Out, Outputs, Parameter, Progress,
    Registry, Tick,
};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

/// The time after which a ping counts as lost and is sent again.
const LOST_AFTER: Duration = Duration::from_secs(1);

/// Bytes of any length, like an image or a scan for its carrier. Cloning does not copy them.
#[derive(Clone, Debug)]
pub(crate) struct Blob(Arc<Bytes>);

impl Message for Blob {
    const TYPE: &'static str = "Blob";
}

impl Serialize for Blob {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.0.serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Blob {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Bytes::deserialize(deserializer).map(|bytes| Self(Arc::new(bytes)))
    }
}

/// The inputs.
#[derive(Debug, Inputs)]
pub(crate) struct Hears {
    /// From the other side.
    #[port("In", optional)]
    heard: In<Blob>,
}

/// The outputs.
#[derive(Debug, Outputs)]
pub(crate) struct Says {
    /// To the other side.
    #[port("Out", optional)]
    said: Out<Blob>,
}

/// Returns all controllers of this program.
pub(crate) fn registry() -> Registry {
    let mut registry = Registry::default();
    registry.add::<Ping>();
    registry.add::<Echo>();
    registry.add::<Turn>();
    registry.add::<Beat>();
    registry.add::<Link>();
    registry.add::<Callee>();
    registry.add::<Shout<PACED>>();
    registry.add::<Shout<FLOOD>>();
    registry.add::<Hear>();
    crate::caterpillar::add(&mut registry);
    crate::ros::add(&mut registry);
    registry
}

/// Returns the initial value for a [`Ping`]: the size of its messages in bytes, the number of timed messages, and the
/// number of messages before them.
pub(crate) fn ping_value(size: u32, count: u32, warm_up: u32) -> Vec<u8> {
    [size, count, warm_up].iter().flat_map(|number| number.to_le_bytes()).collect()
}

/// Returns the round-trip times in the result of a [`Ping`].
pub(crate) fn times_of(value: &[u8]) -> Vec<Duration> {
    let numbers = value.chunks_exact(8).filter_map(|bytes| Some(u64::from_le_bytes(bytes.try_into().ok()?)));
    numbers.map(Duration::from_nanos).collect()
}

fn value_of(times: &[Duration]) -> Vec<u8> {
    times.iter().flat_map(|time| u64::try_from(time.as_nanos()).unwrap_or(u64::MAX).to_le_bytes()).collect()
}

/// Sends, waits for the answer, and sends again. A round trip is the time between two calculations.
#[derive(Debug, Default)]
pub(crate) struct Ping {
    bytes: Arc<Bytes>,
    left: u32,
    warm_up: u32,
    sent: Option<Time>,
    times: Vec<Duration>,
}

impl Controller for Ping {
    type Inputs = Hears;
    type Outputs = Says;
    const TYPE: &'static str = "Ping";

    fn about() -> About {
        About::task("Measures round trips.").every(LOST_AFTER).triggered_by("In")
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        Ok(Self::default())
    }

    fn init(&mut self, value: &[u8]) -> Result<(), String> {
        let numbers: Vec<u32> =
            value.chunks_exact(4).filter_map(|bytes| Some(u32::from_le_bytes(bytes.try_into().ok()?))).collect();
        let [size, count, warm_up] = numbers[..] else { return Err("three numbers are needed".to_owned()) };
        *self = Self {
            bytes: Arc::new(Bytes(vec![1; size as usize])),
            left: count + warm_up,
            warm_up,
            sent: None,
            times: Vec::new(),
        };
        Ok(())
    }

    fn main_calc(&mut self, tick: Tick, inputs: &Hears, outputs: &mut Says) -> Progress {
        if let Some(sent) = self.sent.filter(|_| inputs.heard.fresh().is_some()) {
            self.left -= 1;
            if self.warm_up > 0 {
                self.warm_up -= 1;
            } else {
                self.times.push(tick.now.since(sent));
            }
            if self.left == 0 {
                return Progress::Done(value_of(&self.times));
            }
        }
        self.sent = Some(tick.now);
        outputs.said.send(Blob(Arc::clone(&self.bytes)));
        Progress::Continue
    }
}

/// Sends each message back unchanged.
#[derive(Debug)]
pub(crate) struct Echo;

impl Controller for Echo {
    type Inputs = Hears;
    type Outputs = Says;
    const TYPE: &'static str = "Echo";

    fn about() -> About {
        About::service("Answers with what it hears.").every(LOST_AFTER).triggered_by("In")
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        Ok(Self)
    }

    fn main_calc(&mut self, _: Tick, inputs: &Hears, outputs: &mut Says) -> Progress {
        if let Some(heard) = inputs.heard.fresh() {
            outputs.said.send(heard.clone());
        }
        Progress::Continue
    }
}

/// The duration of a [`Turn`] that rests.
pub(crate) const REST: Duration = Duration::from_millis(8);

/// Is done at once, or after a rest. Its value is the time of its last calculation. With the value of the previous
/// process, it measures the time from there to here. It writes all measured times to a file when its program ends.
#[derive(Debug)]
pub(crate) struct Turn {
    file: PathBuf,
    rests: bool,
    calculations: u32,
    before: Option<Time>,
    times: Vec<Duration>,
}

impl Controller for Turn {
    type Inputs = ();
    type Outputs = ();
    const TYPE: &'static str = "Turn";

    fn about() -> About {
        const PARAMETERS: &[Parameter] = &[
            Parameter { name: "file", kind: Kind::Text(&[]), default: None },
            Parameter { name: "rests", kind: Kind::Truth, default: None },
        ];
        About::task("Is done soon.").every(REST).with(PARAMETERS)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        let (file, rests) = (arguments.text("file").into(), arguments.truth("rests"));
        Ok(Self { file, rests, calculations: 0, before: None, times: Vec::new() })
    }

    fn init(&mut self, value: &[u8]) -> Result<(), String> {
        self.calculations = 0;
        self.before = value.try_into().ok().map(|bytes| Time::from_nanos(u64::from_le_bytes(bytes)));
        Ok(())
    }

    fn run(&mut self, now: Time) {
        self.times.extend(self.before.map(|before| now.since(before)));
    }

    fn main_calc(&mut self, tick: Tick, (): &(), (): &mut ()) -> Progress {
        self.calculations += 1;
        if self.rests && self.calculations == 1 {
            return Progress::Continue;
        }
        Progress::Done(tick.now.nanos().to_le_bytes().to_vec())
    }
}

impl Drop for Turn {
    fn drop(&mut self) {
        // The reader reports a missing file.
        std::fs::write(&self.file, value_of(&self.times)).unwrap_or_default();
    }
}

/// The period of a [`Beat`].
pub(crate) const TICK: Duration = Duration::from_millis(1);

/// Calculates at 1 kHz. Measures by how much each interval between two calculations differs from its period, and
/// writes these differences to a file when its program ends.
#[derive(Debug)]
pub(crate) struct Beat {
    file: PathBuf,
    last: Option<Time>,
    times: Vec<Duration>,
}

impl Controller for Beat {
    type Inputs = ();
    type Outputs = ();
    const TYPE: &'static str = "Beat";

    fn about() -> About {
        const PARAMETERS: &[Parameter] = &[Parameter { name: "file", kind: Kind::Text(&[]), default: None }];
        About::service("Calculates at 1 kHz.").every(TICK).with(PARAMETERS)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        Ok(Self { file: arguments.text("file").into(), last: None, times: Vec::new() })
    }

    fn main_calc(&mut self, tick: Tick, (): &(), (): &mut ()) -> Progress {
        self.times.extend(self.last.map(|last| tick.now.since(last).abs_diff(TICK)));
        self.last = Some(tick.now);
        Progress::Continue
    }
}

impl Drop for Beat {
    fn drop(&mut self) {
        // The reader reports a missing file.
        std::fs::write(&self.file, value_of(&self.times)).unwrap_or_default();
    }
}

/// A controller with an input and an output that only waits.
#[derive(Debug)]
pub(crate) struct Link;

impl Controller for Link {
    type Inputs = Hears;
    type Outputs = Says;
    const TYPE: &'static str = "Link";

    fn about() -> About {
        About::service("Does nothing.").every(LOST_AFTER)
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        Ok(Self)
    }

    fn main_calc(&mut self, _: Tick, _: &Hears, _: &mut Says) -> Progress {
        Progress::Continue
    }
}

/// Answers a call with its argument. It also has a queue, from which it takes nothing.
struct Callee {
    queue: Queue<Blob>,
}

impl Controller for Callee {
    type Inputs = ();
    type Outputs = ();
    const TYPE: &'static str = "Callee";

    fn about() -> About {
        About::service("Answers calls.").every(Duration::from_secs(1))
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        Ok(Self { queue: Queue::new(64, Full::DropOldest) })
    }

    fn exports(exports: &mut Exports<Self>) {
        exports.procedure("Echo", "Answers what it is called with.", |_, blob: Blob| Ok(blob));
        exports.procedure("Orders", "Takes a message.", |callee: &mut Self, message: QueueMessage| {
            Ok(callee.queue.receive(message))
        });
    }

    fn main_calc(&mut self, _: Tick, (): &(), (): &mut ()) -> Progress {
        Progress::Continue
    }
}

/// The period of a [`Shout`] that pauses, and of one that never pauses, in nanoseconds.
const PACED: u64 = 2_000_000;
const FLOOD: u64 = 1000;

/// Sends messages with their numbers, one in each calculation. It is initialised like a [`Ping`].
#[derive(Debug)]
struct Shout<const PERIOD: u64> {
    size: u32,
    count: u32,
    number: u64,
}

impl<const PERIOD: u64> Controller for Shout<PERIOD> {
    type Inputs = ();
    type Outputs = Says;
    const TYPE: &'static str = if PERIOD == FLOOD { "Flood" } else { "Shout" };

    fn about() -> About {
        About::task("Sends.").every(Duration::from_nanos(PERIOD))
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        Ok(Self { size: 0, count: 0, number: 0 })
    }

    fn init(&mut self, value: &[u8]) -> Result<(), String> {
        let numbers: Vec<u32> =
            value.chunks_exact(4).filter_map(|bytes| Some(u32::from_le_bytes(bytes.try_into().ok()?))).collect();
        let [size, count, _] = numbers[..] else { return Err("three numbers are needed".to_owned()) };
        *self = Self { size, count, number: 0 };
        Ok(())
    }

    fn main_calc(&mut self, tick: Tick, (): &(), outputs: &mut Says) -> Progress {
        if self.number == u64::from(self.count) {
            return Progress::Done(Vec::new());
        }
        self.number += 1;
        outputs.said.send(Blob(Arc::new(Bytes(message(self.number, tick.now, self.size)))));
        Progress::Continue
    }
}

/// The input of a [`Hear`].
#[derive(Debug, Inputs)]
pub(crate) struct HearsAll {
    #[port("In")]
    heard: Every<Blob>,
}

/// Keeps its samples, and is done once no more samples arrive.
#[derive(Debug, Default)]
struct Hear(Tally);

impl Controller for Hear {
    type Inputs = HearsAll;
    type Outputs = ();
    const TYPE: &'static str = "Hear";

    fn about() -> About {
        About::task("Listens.").every(LOST_AFTER).triggered_by("In")
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        Ok(Self::default())
    }

    fn main_calc(&mut self, tick: Tick, inputs: &HearsAll, (): &mut ()) -> Progress {
        let mut is_silent = true;
        for blob in inputs.heard.iter() {
            is_silent = false;
            self.0.take(&blob.0.0, tick.now);
        }
        if is_silent && !self.0.is_empty() { Progress::Done(self.0.bytes()) } else { Progress::Continue }
    }
}
