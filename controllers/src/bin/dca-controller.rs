//! Every controller of the library, each started as a separate program, and the stand-in of `dca replay`.

use comms::logic::replay::REPLAY;

fn main() -> std::process::ExitCode {
    let is_replay = std::env::args().nth(1).is_some_and(|name| name == REPLAY);
    controllers::sdk::process::run(&if is_replay { controllers::replay() } else { controllers::registry() })
}
