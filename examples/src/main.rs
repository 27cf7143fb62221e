//! The controllers of all examples in one program.

use controllers::sdk::process;

fn main() -> std::process::ExitCode {
    process::run(&dca_examples::registry())
}
