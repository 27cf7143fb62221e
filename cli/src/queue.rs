//! `dca queue`: shows the queues of running programs, from any host.

use crate::shown::{self, Arguments, Wanted};
use comms::logic::messaging::wire::QueueStatus;
use node::console::Failure;

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    shown::run::<QueueStatus>(arguments, &Wanted { type_name: "QueueStatus", word: "queue" })
}
