//! Speech, off board: sentences wait in a queue, the most urgent first. A router tells each robot which of its sentences
//! were spoken.
//!
//! The engine is a stand-in: a sentence takes the time that its words take, and is written to the log.

use super::ear::{NAME, robot_name, subscriber};
use super::museum::EXHIBITS;
use super::{ANSWER_WITHIN, PERIOD, Tour, TourLeg, exhibit, start};
use crate::headline;
use controllers::sdk::messaging::{
    Delivery, Full, Label, Queue, QueueClient, QueueMessage, Receipt, Router, RouterUser, SendEnd, Subscription, Taken,
};
use controllers::sdk::serde::{Deserialize, Serialize};
use controllers::sdk::{
    About, Arguments, Calls, Controller, Exports, Message, Outcome, Outputs, Progress, Signal, Tick, Time,
};
use std::time::Duration;

/// How many sentences wait for the engine, and how many reports for a robot.
const SENTENCES_MAX: usize = 8;
/// How long a word takes.
const WORD: Duration = Duration::from_millis(250);
/// How long a robot waits for its sentence, with the sentences of the other robot before it.
const PATIENCE: Duration = Duration::from_secs(8);

/// A sentence to speak, or one that was spoken.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(crate = "controllers::sdk::serde")]
pub(super) struct Sentence {
    text: String,
}

impl Message for Sentence {
    const TYPE: &'static str = "Sentence";
    const FIELDS: &'static str = "text: Text";
}

/// Speaks one sentence after the other.
pub(super) struct SpeechService {
    sentences: Queue<Sentence>,
    spoken: Router<Sentence>,
    present: Option<Utterance>,
    count: f64,
}

/// A sentence that is being spoken.
struct Utterance {
    sentence: Taken<Sentence>,
    until: Time,
}

impl Controller for SpeechService {
    type Inputs = ();
    type Outputs = ();
    const TYPE: &'static str = "SpeechService";

    fn about() -> About {
        About::service("Speaks sentences, the most urgent first.").every(PERIOD).signals_every(Duration::from_secs(1))
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        let spoken = Router::new("speech", SENTENCES_MAX).map_err(|cause| cause.to_string())?;
        Ok(Self { sentences: Queue::new(SENTENCES_MAX, Full::Reject), spoken, present: None, count: 0.0 })
    }

    fn exports(exports: &mut Exports<Self>) {
        exports
            .procedure("Sentences", "Takes a sentence to speak: a queue.", |service: &mut Self, message| {
                Ok(service.sentences.receive(message))
            })
            .state("sentences", "The sentences that wait.", |service| service.sentences.status())
            .procedure_later("Spoken", "Tells of spoken sentences: a router.", |service: &mut Self, asked, reply| {
                service.spoken.ask(asked, reply);
            })
            .state("spoken", "The robots that are told of spoken sentences.", |service| service.spoken.status());
    }

    fn main_calc(&mut self, tick: Tick, (): &(), (): &mut ()) -> Progress {
        if let Some(Utterance { sentence, .. }) = self.present.take_if(|present| present.until <= tick.now) {
            self.count += 1.0;
            let label = Label { category: &sentence.header.sender, priority: 0, marker: sentence.header.marker };
            if let Err(why) = self.spoken.send(tick.now, label, &sentence.data) {
                return Progress::Aborted(why);
            }
        }
        if self.present.is_none() {
            self.present = self.sentences.take(tick.now).map(|sentence| {
                let words = sentence.data.text.split_whitespace().take(100).map(|_| WORD).sum::<Duration>();
                Utterance { sentence, until: tick.now + words }
            });
        }
        self.spoken.work(tick.now);
        Progress::Continue
    }

    fn signals(&self) -> Vec<Signal> {
        vec![headline("sentences", "", self.count)]
    }
}

#[derive(Outputs)]
pub(super) struct SayOutputs {
    /// The queue of the speech service.
    #[calls("Speak")]
    speak: Calls<QueueMessage, Receipt>,
    /// The router of the speech service.
    #[calls("Spoken")]
    spoken: Calls<Subscription, Delivery>,
}

/// Has the story of the next exhibit spoken, and ends with the rest of the tour.
pub(super) struct Say {
    client: QueueClient<Sentence>,
    user: RouterUser,
    reports: Queue<Sentence>,
    leg: TourLeg,
    /// The number of the sentence of this activation.
    marker: u64,
    began: Option<Time>,
}

impl Say {
    /// Sends the story of the exhibit.
    fn send(&mut self, now: Time) -> Result<(), String> {
        let stop = self.leg.stops.first().and_then(|number| exhibit(*number));
        let text = stop.map_or("", |stop| EXHIBITS[stop].story).to_owned();
        self.marker += 1;
        let label = Label { category: "story", priority: 1, marker: self.marker };
        self.client.send(now, label, &Sentence { text }, None, PATIENCE).map(drop)
    }
}

impl Controller for Say {
    type Inputs = ();
    type Outputs = SayOutputs;
    const TYPE: &'static str = "Say";

    fn about() -> About {
        const OUTCOMES: &[Outcome] =
            &[Outcome { tag: "spoken", type_name: Some("Tour") }, Outcome { tag: "silent", type_name: Some("Tour") }];
        About::task("Has the story of an exhibit spoken. `silent`: the speech service does not answer.")
            .every(PERIOD)
            .with(NAME)
            .starts_with::<TourLeg>()
            .ends_with(OUTCOMES)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        let name = robot_name(arguments)?;
        let client = QueueClient::new(&name).map_err(|cause| cause.to_string())?;
        let reports = Queue::new(SENTENCES_MAX, Full::DropOldest);
        Ok(Self { client, user: subscriber(&name)?, reports, leg: TourLeg::default(), marker: 0, began: None })
    }

    fn init(&mut self, value: &[u8]) -> Result<(), String> {
        (self.leg, self.began) = (start(value)?, None);
        Ok(())
    }

    fn main_calc(&mut self, tick: Tick, (): &(), outputs: &mut SayOutputs) -> Progress {
        let rest: Tour = self.leg.tour().rest();
        if self.began.is_none() {
            self.began = Some(tick.now);
            if let Err(why) = self.send(tick.now) {
                return Progress::Aborted(why);
            }
        }
        self.user.work(tick.now, &mut outputs.spoken, &mut self.reports);
        self.client.work(tick.now, &mut outputs.speak);
        while let Some(report) = self.reports.take(tick.now) {
            if report.header.marker == self.marker {
                return Progress::outcome("spoken", &rest);
            }
        }
        while let Some((_, end)) = self.client.end_of() {
            match end {
                SendEnd::Accepted => {}
                SendEnd::Rejected(_) | SendEnd::Unknown(_) | SendEnd::Deadline | SendEnd::Gone => {
                    return Progress::outcome("silent", &rest);
                }
            }
        }
        let is_late = self.began.is_some_and(|began| tick.now.since(began) > PATIENCE + ANSWER_WITHIN);
        if is_late { Progress::outcome("silent", &rest) } else { Progress::Continue }
    }
}
