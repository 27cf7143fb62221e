//! Runs many seeds of the simulation: `cargo run --release -p dbmanager --example seeds -- <first> <count>`.
//!
//! With `--features mutants` and `mutants` as a third argument it runs them with each planted bug, and some named cases after
//! them, until one finds it, and prints which. A fourth argument names one bug.

#[path = "../tests/simulation/scenes.rs"]
mod scenes;
#[expect(dead_code, reason = "it is part of the tests, and the named cases use more of it")]
#[path = "../tests/simulation/world.rs"]
mod world;

#[cfg(feature = "mutants")]
use dbmanager::logic::mutant::Mutant;
#[cfg(feature = "mutants")]
use std::ops::Range;
use std::process::ExitCode;

#[expect(clippy::print_stdout, reason = "a program for people")]
fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number =
        |index: usize, otherwise: u64| arguments.get(index).and_then(|text| text.parse().ok()).unwrap_or(otherwise);
    let (first, count) = (number(0, 1), number(1, 1000));
    let seeds = first..first.saturating_add(count);
    #[cfg(feature = "mutants")]
    if arguments.get(2).is_some_and(|word| word == "mutants") {
        return plant(seeds, arguments.get(3));
    }
    let (mut failed, mut transactions) = (0, 0);
    for (name, scene) in scenes::ALL {
        if let Err(broken) = scene() {
            failed += 1;
            println!("{name}: {broken}");
        }
    }
    for seed in seeds {
        match world::run(seed) {
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

#[cfg(feature = "mutants")]
/// Runs the seeds with each planted bug, and the scenes with those that no seed has found.
#[expect(clippy::print_stdout, reason = "a program for people")]
fn plant(seeds: Range<u64>, only: Option<&String>) -> ExitCode {
    let mut survivors = 0;
    let wanted = |mutant: &&Mutant| only.is_none_or(|name| format!("{mutant:?}") == *name);
    for &mutant in Mutant::ALL.iter().filter(wanted) {
        Mutant::plant(Some(mutant));
        let by_seed = seeds.clone().find_map(|seed| Some((format!("seed {seed}"), world::run(seed).err()?)));
        let by_scene = || scenes::ALL.iter().find_map(|(name, scene)| Some(((*name).to_owned(), scene().err()?)));
        match by_seed.or_else(by_scene) {
            Some((finder, broken)) => {
                println!("{mutant:?}: {finder}: {}", broken.lines().next().unwrap_or_default());
            }
            None => {
                survivors += 1;
                println!("{mutant:?}: SURVIVES");
            }
        }
    }
    println!("{survivors} survive");
    ExitCode::from(u8::from(survivors > 0))
}
