//! Every controller of the library, each started as a program of its own.

fn main() -> std::process::ExitCode {
    controllers::sdk::process::run(&controllers::registry())
}
