//! Every controller of the library, each started as a separate program.

fn main() -> std::process::ExitCode {
    controllers::sdk::process::run(&controllers::registry())
}
