//! Part of the copy of the sources: runs the seeds with each injected fault, and then the scenes with the faults that
//! no seed has found.

#[path = "../tests/all/simulation/scenes.rs"]
mod scenes;
#[allow(dead_code, reason = "it is part of the tests")]
#[path = "../tests/all/simulation/world.rs"]
mod world;

use dbmanager::logic::fault;
use std::process::ExitCode;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number = |index: usize| arguments.get(index).and_then(|text| text.parse::<u64>().ok()).unwrap_or(1);
    let seeds = number(0)..number(0).saturating_add(number(1));
    let names = arguments.iter().skip(2).map(|name| &*name.clone().leak());
    let mut survivors = 0;
    for name in names {
        fault::plant(name);
        let by_seed = seeds.clone().find_map(|seed| Some((format!("seed {seed}"), world::run(seed).err()?)));
        let by_scene = || scenes::ALL.iter().find_map(|(name, scene)| Some(((*name).to_owned(), scene().err()?)));
        match by_seed.or_else(by_scene) {
            Some((finder, broken)) => println!("{name}: {finder}: {}", broken.lines().next().unwrap_or_default()),
            None => {
                survivors += 1;
                println!("{name}: SURVIVES");
            }
        }
    }
    println!("{survivors} survive");
    ExitCode::from(u8::from(survivors > 0))
}
