//! Requests over queues: a planner that takes the most urgent question first, and askers that get
//! each answer in their own queue.

use crate::headline;
use controllers::sdk::messaging::{
    Full, Header, Queue, QueueMessage, Receipt, Rejected, Replier, RequestFailure, Requester,
};
use controllers::sdk::serde::{Deserialize, Serialize};
use controllers::sdk::{
    About, Arguments, Calls, Controller, Exports, Kind, Message, Outputs, Parameter, Progress, Quantity, Registry,
    Signal, Tick,
};
use std::time::Duration;

/// How many questions wait for the planner.
const QUESTIONS_MAX: usize = 4;
/// How long an answer is worth sending.
const ANSWER_WITHIN: Duration = Duration::from_secs(5);
/// How fast the planner drives (m/s).
const SPEED: f64 = 0.5;

/// Where to go from here, straight ahead and to the left.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(crate = "controllers::sdk::serde")]
struct Leg {
    /// (m)
    ahead: f64,
    /// (m)
    left: f64,
}

impl Message for Leg {
    const TYPE: &'static str = "Leg";
    const FIELDS: &'static str = "ahead: Length, left: Length";
}

/// The way to the target.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(crate = "controllers::sdk::serde")]
struct Way {
    /// (m)
    length: f64,
    /// (s)
    time: f64,
}

impl Message for Way {
    const TYPE: &'static str = "Way";
    const FIELDS: &'static str = "length: Length, time: Time";
}

#[derive(Outputs)]
struct PlannerOutputs {
    /// The queues for the answers, of all callers.
    #[calls("Answers")]
    answers: Calls<QueueMessage, Receipt>,
}

/// Works on one question after the other, the most urgent first.
struct Planner {
    /// How long a question takes (s).
    pace: f64,
    /// How long this one still takes (s).
    left: f64,
    questions: Queue<Leg>,
    of: Option<(Header, Leg)>,
    replier: Replier<Way>,
    answered: f64,
}

impl Controller for Planner {
    type Inputs = ();
    type Outputs = PlannerOutputs;
    const TYPE: &'static str = "Planner";

    fn about() -> About {
        const PACE: &[Parameter] = &[Parameter::new("pace", Kind::Quantity(Quantity::Time, 0.0, 3600.0)).or("0.01")];
        About::service("Answers questions about ways, the most urgent first.")
            .every(Duration::from_millis(5))
            .with(PACE)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        let replier = Replier::new(arguments.instance()).map_err(|cause| cause.to_string())?;
        let questions = Queue::new(QUESTIONS_MAX, Full::Reject);
        Ok(Self { pace: arguments.number("pace"), left: 0.0, questions, of: None, replier, answered: 0.0 })
    }

    fn exports(exports: &mut Exports<Self>) {
        exports
            .procedure("Questions", "Takes a question.", |planner: &mut Self, message| {
                Ok(planner.questions.receive(message))
            })
            .state("questions", "The questions that wait.", |planner| planner.questions.status());
    }

    fn main_calc(&mut self, tick: Tick, (): &(), outputs: &mut PlannerOutputs) -> Progress {
        self.left -= tick.dt();
        if self.left <= 0.0 {
            if let Some((header, leg)) = self.of.take() {
                let length = leg.ahead.hypot(leg.left);
                let way = Way { length, time: length / SPEED };
                // A caller that no longer waits, or has too many calls in transit, learns of it by its deadline.
                if self.replier.reply(tick.now, &header, &way, ANSWER_WITHIN).is_ok() {
                    self.answered += 1.0;
                }
            }
            if let Some(question) = self.questions.take(tick.now) {
                (self.of, self.left) = (Some((question.header, question.data)), self.pace);
            }
        }
        self.replier.work(tick.now, &mut outputs.answers);
        while self.replier.end_of().is_some() {}
        Progress::Continue
    }

    fn signals(&self) -> Vec<Signal> {
        vec![headline("answered", "", self.answered)]
    }
}

#[derive(Outputs)]
struct AskerOutputs {
    /// The planner's queue.
    #[calls("Questions")]
    questions: Calls<QueueMessage, Receipt>,
}

/// Asks some questions, one after the other, and is done when each has its answer.
struct Asker {
    count: u64,
    priority: u8,
    /// How long an answer may take (s).
    patience: f64,
    planner: Requester<Leg, Way>,
    answered: u64,
    /// The marker of the open question.
    open: Option<u64>,
}

impl Controller for Asker {
    type Inputs = ();
    type Outputs = AskerOutputs;
    const TYPE: &'static str = "Asker";

    fn about() -> About {
        const ASKS: &[Parameter] = &[
            Parameter::new("count", Kind::Number(0.0, 1e6)).or("1"),
            Parameter::new("priority", Kind::Number(0.0, 255.0)).or("0"),
            Parameter::new("patience", Kind::Quantity(Quantity::Time, 0.0, 3600.0)).or("10"),
        ];
        About::task("Asks a planner about ways.").every(Duration::from_millis(5)).with(ASKS)
    }

    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "both are within their ranges")]
    fn new(arguments: &Arguments) -> Result<Self, String> {
        let planner = Requester::new(arguments.instance()).map_err(|cause| cause.to_string())?;
        let (count, priority) = (arguments.number("count") as u64, arguments.number("priority") as u8);
        Ok(Self { count, priority, patience: arguments.number("patience"), planner, answered: 0, open: None })
    }

    fn exports(exports: &mut Exports<Self>) {
        exports
            .procedure("Answers", "Takes an answer.", |asker: &mut Self, message| Ok(asker.planner.receive(message)))
            .state("answers", "The answers that wait.", |asker| asker.planner.status());
    }

    fn main_calc(&mut self, tick: Tick, (): &(), outputs: &mut AskerOutputs) -> Progress {
        self.planner.work(tick.now, &mut outputs.questions);
        while let Some((marker, end)) = self.planner.end_of() {
            if self.open != Some(marker) {
                return Progress::Aborted(format!("an answer to a question that was not asked: {marker}"));
            }
            self.open = None;
            match end {
                Ok(way) => {
                    let expected = Self::question(self.answered);
                    let length = expected.ahead.hypot(expected.left);
                    if (way.data.length - length).abs() > 1e-9 || (way.data.time - length / SPEED).abs() > 1e-9 {
                        return Progress::Aborted(format!("{:?} is not an answer to {expected:?}", way.data));
                    }
                    self.answered += 1;
                }
                // The planner is busy: the question is asked once more.
                Err(RequestFailure::Rejected(Rejected::Full { .. })) => {}
                Err(why) => return Progress::Aborted(why.to_string()),
            }
        }
        if self.answered >= self.count {
            return Progress::Done(Vec::new());
        }
        if self.open.is_none() {
            let within = Duration::from_secs_f64(self.patience);
            match self.planner.ask(tick.now, "way", self.priority, &Self::question(self.answered), within) {
                Ok(marker) => self.open = Some(marker),
                Err(why) => return Progress::Aborted(why.to_string()),
            }
        }
        Progress::Continue
    }
}

impl Asker {
    fn question(number: u64) -> Leg {
        Leg { ahead: 1.0 + number as f64, left: 2.0 }
    }
}

/// Adds the controllers of this example.
pub(crate) fn add(registry: &mut Registry) {
    registry.add::<Planner>().add::<Asker>();
}
