//! The words of people: the desk recognises them, and the ear of the robot hands them to its executive.

use super::{ANSWER_WITHIN, PERIOD};
use controllers::sdk::messaging::{
    Delivery, Filter, Full, Label, Queue, QueueClient, QueueMessage, Receipt, RouterUser, Subscription,
};
use controllers::sdk::{About, Arguments, Calls, Controller, Kind, Outputs, Parameter, Progress, Tick};

/// How many words wait for the executive.
const WORDS_MAX: usize = 16;

#[derive(Outputs)]
pub(super) struct EarOutputs {
    /// The router of the words.
    #[calls("Words")]
    words: Calls<Subscription, Delivery>,
    /// The executive.
    #[calls("Tell")]
    tell: Calls<QueueMessage, Receipt>,
}

/// Subscribes to the words for its robot. While the desk cannot be reached, the robot hears nothing.
pub(super) struct Ear {
    user: RouterUser,
    words: Queue<String>,
    executive: QueueClient<String>,
}

/// Reads the name of a robot. A `*` would subscribe to the messages for other robots.
///
/// # Errors
/// Says for a person why this is not a name of a robot.
pub(super) fn robot_name(arguments: &Arguments) -> Result<String, String> {
    let name = arguments.text("name");
    let is_name = !name.is_empty() && name.chars().all(|letter| letter.is_ascii_alphanumeric());
    if is_name { Ok(name.to_owned()) } else { Err(format!("`{name}` is not a name of letters and digits")) }
}

/// Returns a subscriber of the messages for a robot.
///
/// # Errors
/// Says for a person why the system gives no random number.
pub(super) fn subscriber(name: &str) -> Result<RouterUser, String> {
    let own = Filter { category: Some(name.to_owned()), ..Filter::default() };
    RouterUser::new(name, vec![own]).map_err(|cause| cause.to_string())
}

/// The parameter of a program that belongs to a robot.
pub(super) const NAME: &[Parameter] = &[Parameter::new("name", Kind::Text(&[]))];

impl Controller for Ear {
    type Inputs = ();
    type Outputs = EarOutputs;
    const TYPE: &'static str = "Ear";

    fn about() -> About {
        About::service("Hands the words of people to the executive.").every(PERIOD).with(NAME)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        let name = robot_name(arguments)?;
        let executive = QueueClient::new(&name).map_err(|cause| cause.to_string())?;
        Ok(Self { user: subscriber(&name)?, words: Queue::new(WORDS_MAX, Full::DropOldest), executive })
    }

    fn main_calc(&mut self, tick: Tick, (): &(), outputs: &mut EarOutputs) -> Progress {
        self.user.work(tick.now, &mut outputs.words, &mut self.words);
        while let Some(word) = self.words.take(tick.now) {
            let label = Label { category: "word", priority: word.header.priority, marker: word.header.marker };
            // If so many words are on their way already, the executive does not listen.
            let sent = self.executive.send(tick.now, label, &word.data, None, ANSWER_WITHIN);
            if let Err(why) = sent {
                return Progress::Aborted(why);
            }
        }
        self.executive.work(tick.now, &mut outputs.tell);
        // A word that the executive does not take has lost its moment.
        while self.executive.end_of().is_some() {}
        Progress::Continue
    }
}
