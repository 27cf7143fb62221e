//! Ends leaves at random times. The same seed gives the same run.

use super::{Ending, Simulation};
use crate::plan::{MemberKind, Plan};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// The shortest and the longest run of a leaf, in milliseconds.
const RUN_MIN: u64 = 500;
const RUN_MAX: u64 = 10_000;

/// Random times and kinds of the ends of leaves.
#[derive(Clone, Debug)]
pub struct RandomRun {
    state: u64,
    /// The number of failures in a hundred ends.
    faults: u64,
    services: BTreeSet<String>,
    /// The outcomes of each leaf that has several.
    outcomes: BTreeMap<String, Vec<String>>,
    /// The time and the kind of the end of each running leaf.
    due: BTreeMap<String, (Duration, Ending)>,
}

impl RandomRun {
    /// Returns the random run of a seed. Of a hundred ends, `faults` are failures. Services end only by failure.
    pub fn new(plan: &Plan, seed: u64, faults: u64) -> Self {
        let members = plan.groups.iter().flat_map(|group| &group.members).filter(|member| member.service);
        let services = members.filter_map(|member| match member.kind {
            MemberKind::Leaf(leaf) => Some(plan.leaves[leaf as usize].path.clone()),
            MemberKind::Group(_) => None,
        });
        let several = plan.leaves.iter().filter(|leaf| !leaf.outcomes.is_empty());
        let outcomes = several.map(|leaf| (leaf.path.clone(), leaf.outcomes.clone())).collect();
        Self { state: seed, faults: faults.min(100), services: services.collect(), outcomes, due: BTreeMap::new() }
    }

    /// Lets the next wait or leaf end. Returns `false` when none will ever end.
    pub fn step(&mut self, simulation: &mut Simulation<'_>) -> bool {
        let running: BTreeSet<String> = simulation.running().into_iter().map(str::to_owned).collect();
        self.due.retain(|path, _| running.contains(path));
        for path in running {
            if !self.due.contains_key(&path) {
                let (run, ending) = self.draw(&path);
                let is_endless = self.services.contains(&path) && ending == Ending::Done;
                let due = if is_endless { Duration::MAX } else { simulation.now().saturating_add(run) };
                self.due.insert(path, (due, ending));
            }
        }
        let next = self.due.iter().min_by_key(|(_, (due, _))| *due).filter(|(_, (due, _))| *due < Duration::MAX);
        let next = next.map(|(path, (due, ending))| (*due, path.clone(), ending.clone()));
        match (next, simulation.next_timer()) {
            (None, None) => return false,
            (Some((due, path, ending)), timer) if timer.is_none_or(|timer| due < timer) => {
                simulation.pass(due.saturating_sub(simulation.now()));
                self.due.remove(&path);
                // The leaf may have been stopped by the previous event.
                drop(simulation.end(&path, ending));
            }
            (_, Some(timer)) => simulation.pass(timer.saturating_sub(simulation.now())),
            (Some(_), None) => {}
        }
        true
    }

    fn draw(&mut self, path: &str) -> (Duration, Ending) {
        let run = Duration::from_millis(RUN_MIN + self.next() % (RUN_MAX - RUN_MIN));
        let fault = self.next();
        if fault % 100 < self.faults {
            let is_crash = (fault / 100).is_multiple_of(4);
            return (run, if is_crash { Ending::Crashed } else { Ending::Aborted("a fault by chance".to_owned()) });
        }
        let Some(outcomes) = self.outcomes.get(path) else { return (run, Ending::Done) };
        let count = outcomes.len() as u64;
        let which = usize::try_from(self.next() % count).unwrap_or(0);
        (run, self.outcomes[path].get(which).map_or(Ending::Done, |tag| Ending::Outcome(tag.clone())))
    }

    /// Source: Steele, Lea, Flood, "Fast splittable pseudorandom number generators" (SplitMix64).
    fn next(&mut self) -> u64 {
        self.state = self.state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.state;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Options, Source, Transition, compile};

    fn run(seed: u64, faults: u64) -> (Vec<super::super::SimulationEvent>, Option<Transition>) {
        let spec = "
            module Sensor(host) { service; }
            process main() {
                host{c1}
                instantiated_processes { a instof A(c1); b instof A(c1); c instof A(c1); s instof Sensor(c1); }
                internal_event_actions { s, ((a # b) ; (c within 5 s)?) }
            }";
        let plan = compile(&Source::new("a.dca", spec), &[], &Options::named("a")).plan.unwrap();
        let mut simulation = Simulation::start(&plan);
        let mut random = RandomRun::new(&plan, seed, faults);
        for _ in 0..100 {
            if simulation.outcome().is_some() || !random.step(&mut simulation) {
                break;
            }
        }
        (simulation.take_happenings(), simulation.outcome().cloned())
    }

    #[test]
    fn a_seed_gives_one_run_and_faults_give_others() {
        assert_eq!(run(1, 0), run(1, 0));
        assert_ne!(run(1, 0).0, run(2, 0).0);
        assert!((0..50).all(|seed| run(seed, 0).1 == Some(Transition::Done)));
        assert!((0..50).any(|seed| matches!(run(seed, 50).1, Some(Transition::Aborted(_)))));
    }
}
