//! `dca lock`: shows the resource locks of running programs, their holders and waiting clients, from any host.

use crate::shown::{self, Arguments, Wanted};
use comms::logic::messaging::wire::LockStatus;
use node::console::Failure;

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    shown::run::<LockStatus>(arguments, &Wanted { type_name: "LockStatus", word: "lock" })
}
