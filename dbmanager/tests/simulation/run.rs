//! One seed: a team in which things go wrong, that is mended, and whose history is checked.

use super::{Faults, World};
use comms::logic::random::Random;

/// Steps of a seed.
const STEPS: usize = 80;

/// Runs one seed; returns how many transactions there were.
pub(crate) fn run(seed: u64) -> Result<usize, String> {
    // From random numbers of its own, so that the other seeds are what they were before there was this fault.
    let second_team = Random::new(seed ^ 0x7ea).below(3) == 0;
    let faults = Faults { second_team, ..Faults::swarm(&mut Random::new(seed)) };
    run_with(seed, faults).map_err(|broken| format!("{broken}\nwith {faults:?}"))
}

fn run_with(seed: u64, faults: Faults) -> Result<usize, String> {
    let mut world = World::new(seed, faults);
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
