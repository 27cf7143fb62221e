//! A guest that sends messages to an activity and receives its answers, and a bell whose message may not get lost.

use crate::headline;
use controllers::sdk::messaging::{Label, QueueClient, QueueMessage, Receipt, SendEnd};
use controllers::sdk::{
    About, Arguments, Calls, Controller, Every, Inputs, Kind, Out, Outputs, Parameter, Progress, Registry, Signal,
    Tick, Time,
};
use std::time::Duration;

/// How long an answer is waited for before a word is said again: the activity may not have begun.
const AGAIN_AFTER: Duration = Duration::from_secs(2);
/// How long the bell rings for a receipt.
const WITHIN: Duration = Duration::from_secs(30);

#[derive(Inputs)]
struct GuestInputs {
    /// The words of the activity.
    #[port("Heard")]
    heard: Every<String>,
}

#[derive(Outputs)]
struct GuestOutputs {
    /// The words of the guest.
    #[port("Words")]
    words: Out<String>,
}

/// Says one word after the other, and waits for the answer to each.
struct Guest {
    words: Vec<String>,
    answers: usize,
    said: Option<Time>,
}

impl Controller for Guest {
    type Inputs = GuestInputs;
    type Outputs = GuestOutputs;
    const TYPE: &'static str = "Guest";

    fn about() -> About {
        const WORDS: &[Parameter] = &[Parameter::new("words", Kind::Text(&[]))];
        About::task("Says words, and waits for the answer to each.").every(Duration::from_millis(5)).with(WORDS)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        let words: Vec<String> = arguments.text("words").split_whitespace().map(str::to_owned).collect();
        Ok(Self { words, answers: 0, said: None })
    }

    fn main_calc(&mut self, tick: Tick, inputs: &GuestInputs, outputs: &mut GuestOutputs) -> Progress {
        for _answer in inputs.heard.iter().filter(|_| self.said.take().is_some()) {
            self.answers += 1;
        }
        let Some(word) = self.words.get(self.answers) else { return Progress::Done(Vec::new()) };
        if self.said.is_none_or(|said| tick.now.since(said) > AGAIN_AFTER) {
            self.said = Some(tick.now);
            outputs.words.send(word.clone());
        }
        Progress::Continue
    }

    #[expect(clippy::cast_precision_loss, reason = "a count for people")]
    fn signals(&self) -> Vec<Signal> {
        vec![headline("answers", "", self.answers as f64)]
    }
}

#[derive(Outputs)]
struct BellOutputs {
    /// The queue of the activity.
    #[calls("Ring")]
    ring: Calls<QueueMessage, Receipt>,
}

/// Hands over one word with the highest priority, and is done when the activity has it.
struct Bell {
    word: String,
    client: QueueClient<String>,
    has_rung: bool,
}

impl Controller for Bell {
    type Inputs = ();
    type Outputs = BellOutputs;
    const TYPE: &'static str = "Bell";

    fn about() -> About {
        const WORD: &[Parameter] = &[Parameter::new("word", Kind::Text(&[]))];
        About::task("Hands over one word.").every(Duration::from_millis(5)).with(WORD)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        let client = QueueClient::new(arguments.instance()).map_err(|cause| cause.to_string())?;
        Ok(Self { word: arguments.text("word").to_owned(), client, has_rung: false })
    }

    fn main_calc(&mut self, tick: Tick, (): &(), outputs: &mut BellOutputs) -> Progress {
        if !self.has_rung {
            let label = Label { category: "bell", priority: 255, marker: 0 };
            if let Err(why) = self.client.send(tick.now, label, &self.word, None, WITHIN) {
                return Progress::Aborted(why);
            }
            self.has_rung = true;
        }
        self.client.work(tick.now, &mut outputs.ring);
        match self.client.end_of() {
            None => Progress::Continue,
            Some((_, SendEnd::Accepted)) => Progress::Done(Vec::new()),
            Some((_, SendEnd::Rejected(why))) => Progress::Aborted(format!("the activity has not taken it: {why}")),
            Some((_, SendEnd::Unknown(error))) => Progress::Aborted(format!("no activity is connected: {error}")),
            Some((_, SendEnd::Deadline | SendEnd::Gone)) => {
                Progress::Aborted("no answer; it may have arrived".to_owned())
            }
        }
    }
}

/// Adds the controllers of this example.
pub(crate) fn add(registry: &mut Registry) {
    registry.add::<Guest>().add::<Bell>();
}
