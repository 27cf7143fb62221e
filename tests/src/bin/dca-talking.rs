//! A controller for tests that talks at 100 Hz to an activity, and writes down the replies. The activity repeats its
//! words.

use controllers::sdk::messaging::{Label, QueueClient, QueueMessage, Receipt, SendEnd};
use controllers::sdk::{
    About, Arguments, Calls, Controller, Every, Inputs, Kind, Out, Outputs, Parameter, Progress, Registry, Tick,
    process,
};
use std::collections::{BTreeMap, BTreeSet};
use std::process::ExitCode;
use std::time::Duration;

/// 100 Hz.
const PERIOD: Duration = Duration::from_millis(10);
/// How long a message may take.
const WITHIN: Duration = Duration::from_secs(60);
/// The first word. The controller repeats it until the activity answers.
const HELLO: &str = "hello";

#[derive(Inputs)]
struct TalkerInputs {
    #[port("Heard")]
    heard: Every<String>,
}

#[derive(Outputs)]
struct TalkerOutputs {
    #[port("Words", optional)]
    words: Out<String>,
    #[calls("Orders", optional)]
    orders: Calls<QueueMessage, Receipt>,
}

/// Says the numbers from 1 to `count`, over the wire or as messages with receipts. It is done when it has heard all of
/// them, or has heard nothing for 10 s. Its file lists the missing numbers.
struct Talker {
    file: String,
    count: u64,
    has_receipts: bool,
    client: QueueClient<String>,
    /// The numbers of the messages without a receipt so far.
    open: BTreeMap<u64, u64>,
    said: u64,
    accepted: u64,
    rejected: Vec<u64>,
    heard: BTreeMap<u64, u64>,
    is_answered: bool,
    quiet: u32,
}

impl Talker {
    fn say(&mut self, tick: Tick, word: String, number: u64, outputs: &mut TalkerOutputs) -> Result<(), String> {
        if !self.has_receipts {
            outputs.words.send(word);
            return Ok(());
        }
        let label = Label { category: "test", priority: 3, marker: number };
        let sent = self.client.send(tick.now, label, &word, None, WITHIN)?;
        self.open.insert(sent, number);
        Ok(())
    }

    /// Takes the receipts.
    fn receive(&mut self) -> Result<(), String> {
        while let Some((sent, end)) = self.client.end_of() {
            let number = self.open.remove(&sent).unwrap_or_default();
            match end {
                SendEnd::Accepted if number > 0 => self.accepted += 1,
                SendEnd::Accepted => {}
                // The activity has not begun yet.
                SendEnd::Rejected(_) if number == 0 => {}
                SendEnd::Rejected(_) => self.rejected.push(number),
                SendEnd::Unknown(error) => return Err(error.to_string()),
                SendEnd::Deadline | SendEnd::Gone => return Err(format!("no receipt for {number}")),
            }
        }
        Ok(())
    }

    fn write(&self) {
        let twice: BTreeSet<u64> =
            self.heard.iter().filter(|(_, times)| **times > 1).map(|(number, _)| *number).collect();
        let missing: Vec<u64> = (1..=self.count).filter(|number| !self.heard.contains_key(number)).collect();
        let Self { accepted, rejected, .. } = self;
        let text = format!("accepted {accepted}\nrejected {rejected:?}\nmissing {missing:?}\ntwice {twice:?}\n");
        std::fs::write(&self.file, text).expect("the folder is the test's own");
    }
}

impl Controller for Talker {
    type Inputs = TalkerInputs;
    type Outputs = TalkerOutputs;
    const TYPE: &'static str = "Talker";

    fn about() -> About {
        const PARAMETERS: &[Parameter] = &[
            Parameter::new("file", Kind::Text(&[])),
            Parameter::new("count", Kind::Number(0.0, 1e6)),
            Parameter::new("receipts", Kind::Truth).or("false"),
        ];
        About::task("Says numbers, and waits until it has heard all.").every(PERIOD).with(PARAMETERS)
    }

    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "it is within its range")]
    fn new(arguments: &Arguments) -> Result<Self, String> {
        Ok(Self {
            file: arguments.text("file").to_owned(),
            count: arguments.number("count") as u64,
            has_receipts: arguments.truth("receipts"),
            client: QueueClient::new(arguments.instance()).map_err(|cause| cause.to_string())?,
            open: BTreeMap::new(),
            said: 0,
            accepted: 0,
            rejected: Vec::new(),
            heard: BTreeMap::new(),
            is_answered: false,
            quiet: 0,
        })
    }

    fn main_calc(&mut self, tick: Tick, inputs: &TalkerInputs, outputs: &mut TalkerOutputs) -> Progress {
        self.quiet += 1;
        for word in inputs.heard.iter() {
            self.is_answered = true;
            self.quiet = 0;
            if let Ok(number) = word.parse() {
                *self.heard.entry(number).or_default() += 1;
            }
        }
        let done = match self.receive() {
            Err(why) => return Progress::Aborted(why),
            Ok(()) if !self.is_answered => {
                // It says this once a second until the activity has begun.
                if self.quiet % 100 == 1 { self.say(tick, HELLO.to_owned(), 0, outputs) } else { Ok(()) }
            }
            Ok(()) if self.said < self.count && self.open.len() < 30 => {
                self.said += 1;
                self.say(tick, self.said.to_string(), self.said, outputs)
            }
            Ok(()) => Ok(()),
        };
        self.client.work(tick.now, &mut outputs.orders);
        if let Err(why) = done {
            return Progress::Aborted(why);
        }
        let is_over = self.said == self.count && self.open.is_empty();
        let has_all = self.heard.len() as u64 + self.rejected.len() as u64 >= self.count;
        // After 10 s of silence, the remaining numbers count as missing.
        if is_over && (has_all || self.quiet > 1000) {
            self.write();
            return Progress::Done(Vec::new());
        }
        Progress::Continue
    }
}

fn main() -> ExitCode {
    let mut registry = Registry::default();
    registry.add::<Talker>();
    process::run(&registry)
}
