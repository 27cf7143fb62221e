//! Every controller of the library, each started as a separate program, the ports of activities, and the stand-in of `dca replay`.

use comms::logic::messaging::port::PORTS;
use comms::logic::replay::REPLAY;

fn main() -> std::process::ExitCode {
    let registry = match std::env::args().nth(1).as_deref() {
        Some(REPLAY) => controllers::replay(),
        Some(PORTS) => controllers::activity_ports(),
        Some(_) | None => controllers::registry(),
    };
    controllers::sdk::process::run(&registry)
}
