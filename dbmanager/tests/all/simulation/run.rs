//! One seed: a team with faults, which is then repaired, and whose history is checked.

use super::{Faults, World};
use comms::logic::random::Random;

/// Steps of a seed.
const STEPS: usize = 80;

/// Runs one seed; returns the number of transactions.
pub(crate) fn run(seed: u64) -> Result<usize, String> {
    let faults = faults(seed);
    run_with(World::new(seed, faults), seed).map_err(|broken| format!("{broken}\nwith {faults:?}"))
}

/// Runs one seed of a team whose robots have keys; returns the number of transactions.
pub(crate) fn run_with_keys(seed: u64) -> Result<usize, String> {
    let faults = faults(seed);
    run_with(World::new(seed, faults).with_keys(), seed).map_err(|broken| format!("{broken}\nwith {faults:?}"))
}

fn faults(seed: u64) -> Faults {
    // From separate random numbers, so that this fault did not change the other seeds when it was added.
    let second_team = Random::new(seed ^ 0x7ea).below(3) == 0;
    Faults { second_team, ..Faults::swarm(&mut Random::new(seed)) }
}

fn run_with(mut world: World, seed: u64) -> Result<usize, String> {
    let size = 2 + usize::try_from(seed % 4).expect("it is small");
    world.gather(size);
    world.curse(size);
    if world.faults.second_team {
        world.found_apart("team/apart", 1);
    }
    for _ in 0..STEPS {
        world.misfortune();
        world.somebody_acts();
        let pause = [1, 20, 400, 4000][world.below(4)];
        world.run_for(pause);
        world.check_step()?;
    }
    world.settle()?;
    world.clean_up()?;
    world.check_history()?;
    Ok(world.reference.len())
}
