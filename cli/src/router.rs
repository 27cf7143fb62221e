//! `dca router`: shows the routers of running programs and their subscribers, from any host.

use crate::shown::{self, Arguments, Wanted};
use comms::logic::messaging::wire::RouterStatus;
use node::console::Failure;

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    shown::run::<RouterStatus>(arguments, &Wanted { type_name: "RouterStatus", word: "router" })
}
