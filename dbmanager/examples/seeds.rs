//! Runs many seeds of the simulation: `cargo run --release -p dbmanager --example seeds -- <first> <count>`. A
//! further argument `keys` gives keys to the robots.
//!
//! The named cases run first. `--example faults` runs them with injected faults.

#[path = "../tests/all/simulation/scenes.rs"]
mod scenes;
#[expect(dead_code, reason = "it is part of the tests, and the named cases use more of it")]
#[path = "../tests/all/simulation/world.rs"]
mod world;

use std::process::ExitCode;

#[expect(clippy::print_stdout, reason = "a program for people")]
fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number =
        |index: usize, otherwise: u64| arguments.get(index).and_then(|text| text.parse().ok()).unwrap_or(otherwise);
    let (first, count) = (number(0, 1), number(1, 1000));
    let run = if arguments.get(2).is_some_and(|word| word == "keys") { world::run_with_keys } else { world::run };
    let seeds = first..first.saturating_add(count);
    let (mut failed, mut transactions) = (0, 0);
    for (name, scene) in scenes::ALL {
        if let Err(broken) = scene() {
            failed += 1;
            println!("{name}: {broken}");
        }
    }
    for seed in seeds {
        match run(seed) {
            Ok(count) => transactions += count,
            Err(broken) => {
                failed += 1;
                println!("seed {seed}: {broken}");
            }
        }
    }
    println!("{count} seeds, {transactions} transactions, {failed} failed");
    ExitCode::from(u8::from(failed > 0))
}
