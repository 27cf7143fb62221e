//! Everything that can happen to a term.

use super::Then::{Ends, Goes};
use super::{Config, End, Event, Expr, Phase, Rules, Slot, Then};
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// Everything that can happen, by the reference.
#[derive(Debug, Default)]
pub(crate) struct Universe {
    pub(crate) situations: BTreeSet<(Vec<u8>, Phase)>,
    pub(crate) states: usize,
    pub(crate) gets_stuck: bool,
    pub(crate) stop_hangs: bool,
}

type State = (Phase, Option<Config>);

impl Universe {
    /// Explores an expression.
    pub(crate) fn explore(expr: &Expr, services: &[bool]) -> Self {
        let rules = Rules { services };
        let first: State = (Phase::Idle, None);
        let mut numbers: BTreeMap<State, usize> = BTreeMap::from([(first.clone(), 0)]);
        let mut edges: Vec<(usize, usize, bool)> = Vec::new();
        let mut open = VecDeque::from([first]);
        while let Some(state) = open.pop_front() {
            let from = numbers[&state];
            for (target, is_natural) in rules.steps(&state, expr) {
                let next = numbers.len();
                let to = *numbers.entry(target.clone()).or_insert(next);
                if to == next {
                    open.push_back(target);
                }
                edges.push((from, to, is_natural));
            }
        }
        let mut can: Vec<bool> = vec![false; numbers.len()];
        for ((phase, _), &number) in &numbers {
            can[number] = [Phase::Done, Phase::Aborted, Phase::Stopped].contains(phase);
        }
        loop {
            let before = can.iter().filter(|can| **can).count();
            edges.iter().filter(|edge| edge.2).for_each(|edge| can[edge.0] |= can[edge.1]);
            if can.iter().filter(|can| **can).count() == before {
                break;
            }
        }
        let mut universe = Self { states: numbers.len(), ..Self::default() };
        for ((phase, config), &number) in &numbers {
            universe.gets_stuck |= *phase == Phase::Running && !can[number];
            universe.stop_hangs |= *phase == Phase::Stopping && !can[number];
            let mut activities = vec![0; services.len()];
            if let Some(config) = config {
                leaves(config, &mut |leaf, is_stopping| activities[leaf] = 1 + u8::from(is_stopping));
            }
            universe.situations.insert((activities, *phase));
        }
        universe
    }
}

impl Rules<'_> {
    fn steps(&self, (phase, config): &State, expr: &Expr) -> Vec<(State, bool)> {
        let Some(config) = config else {
            let starts = *phase == Phase::Idle;
            return starts.then(|| (after(Phase::Running, self.start(expr)), true)).into_iter().collect();
        };
        let mut events = Vec::new();
        leaves(config, &mut |leaf, is_stopping| match is_stopping {
            true => events.push(Event::Stopped(leaf)),
            false => {
                events.push(Event::Aborted(leaf));
                if !self.services[leaf] {
                    events.push(Event::Done(leaf));
                }
            }
        });
        let mut steps: Vec<(State, bool)> = Vec::new();
        for event in events {
            if let Some(then) = self.react(config, event) {
                steps.push((after(*phase, then), !matches!(event, Event::Aborted(_))));
            }
        }
        let mut running = Vec::new();
        timers(&mut config.clone(), &mut running);
        for timer in running {
            if let Some(then) = self.react(config, Event::Elapsed(timer)) {
                steps.push((after(*phase, then), true));
            }
        }
        if *phase == Phase::Running {
            steps.push((after(Phase::Stopping, self.stop(config.clone())), false));
        }
        steps
    }
}

fn after(phase: Phase, then: Then) -> State {
    match then {
        Goes(config) => (phase, Some(config)),
        Ends(End::Done) => (Phase::Done, None),
        Ends(End::Aborted) => (Phase::Aborted, None),
        Ends(End::Killed) => (Phase::Stopped, None),
    }
}

/// The configurations right below one.
fn parts(config: &mut Config) -> Vec<&mut Config> {
    match config {
        Config::Active(_) | Config::Stopping(_) | Config::Timer(_) | Config::Never => Vec::new(),
        Config::Seq(inner, _)
        | Config::Else(inner, _)
        | Config::RecP(inner, ..)
        | Config::RecQ(inner, ..)
        | Config::Fin1(inner, _)
        | Config::Fin2(_, inner)
        | Config::Shield(inner)
        | Config::Held(inner)
        | Config::Only(inner) => vec![inner],
        Config::Par(slots, _) | Config::FailFast(slots) | Config::Any(_, slots) => slots
            .iter_mut()
            .filter_map(|slot| match slot {
                Slot::Runs(config) => Some(&mut **config),
                Slot::Done | Slot::Aborted | Slot::Gone => None,
            })
            .collect(),
        Config::Disable(all) | Config::Drain(_, all) => all.iter_mut().collect(),
    }
}

fn leaves(config: &Config, visit: &mut impl FnMut(usize, bool)) {
    fn walk(config: &mut Config, visit: &mut dyn FnMut(usize, bool)) {
        if let Config::Active(leaf) | Config::Stopping(leaf) = config {
            visit(*leaf, matches!(config, Config::Stopping(_)));
        }
        parts(config).into_iter().for_each(|part| walk(part, visit));
    }
    walk(&mut config.clone(), visit);
}

/// The timers that run.
fn timers(config: &mut Config, running: &mut Vec<u32>) {
    if let Config::Timer(number) = config {
        running.push(*number);
    }
    parts(config).into_iter().for_each(|part| timers(part, running));
}
