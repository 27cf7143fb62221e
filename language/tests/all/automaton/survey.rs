//! Random activities under random events: `step` and the reference must agree in everything that can be seen.

use super::charts::{self, FILTERS, NOTICES, PORTS, TAGS};
use super::reference::Machine;
use crate::random::Random;
use language::algebra::{Activation, Cause, Outcome, Reason, Value};
use language::automaton::{Automaton, Chart, Command, Configuration, Event, step};
use language::script::ScriptErrorKind;
use std::collections::BTreeMap;

/// An activity that ends at once would do little else.
const ENDS_MAX: usize = 2;

/// The figures of a survey.
#[derive(Debug, Default)]
struct Figures {
    activities: u64,
    events: u64,
    /// How often something worth testing was seen.
    seen: BTreeMap<&'static str, u64>,
}

/// An activity in both interpreters.
struct Pair<'a> {
    automaton: &'a Automaton,
    configuration: Configuration,
    machine: Machine<'a>,
}

impl Pair<'_> {
    fn send(&mut self, event: &Event, figures: &mut Figures) -> Option<Outcome> {
        let mut commands = vec![];
        let was_waiting = self.configuration.is_waiting();
        self.configuration.begin_reaction();
        let outcome = step(self.automaton, &mut self.configuration, event.clone(), &mut commands);
        let expected = self.machine.handle(event.clone());
        assert_eq!((&commands, &outcome), (&expected.0, &expected.1), "{event:?}");
        let states = 0..self.automaton.chart().states.len();
        let active: Vec<usize> = states.filter(|&state| self.configuration.is_active(state)).collect();
        assert!(
            active.iter().eq(self.machine.active.iter()),
            "{event:?} gives {active:?}, not {:?}",
            self.machine.active
        );
        let variables = (0..).map_while(|variable| self.configuration.variable(variable));
        assert!(variables.eq(self.machine.variables.iter().copied()), "variables after {event:?}");
        let slots = (0..).map_while(|slot| self.configuration.slot(slot));
        assert!(slots.eq(self.machine.slots.iter()), "slots after {event:?}");
        self.count(figures, &commands, &outcome, was_waiting);
        outcome
    }

    fn count(&self, figures: &mut Figures, commands: &[Command], outcome: &Option<Outcome>, was_waiting: bool) {
        let mut see = |what| *figures.seen.entry(what).or_default() += 1;
        match outcome {
            Some(Outcome::Done(_)) => see("done"),
            Some(Outcome::Stopped) => see("stopped"),
            Some(Outcome::Aborted(Reason { cause: Cause::Failed(why), .. })) if why.contains("for ever") => {
                see("livelock");
            }
            Some(Outcome::Aborted(Reason { cause: Cause::Failed(why), .. })) if why.contains("outside") => see("range"),
            Some(Outcome::Aborted(Reason { cause: Cause::StopUnconfirmed, .. })) => see("unconfirmed"),
            Some(Outcome::Aborted(Reason { cause: Cause::Script(error), .. })) => see(match error.kind {
                ScriptErrorKind::Budget => "script over budget",
                ScriptErrorKind::Failed => "script failed",
            }),
            Some(Outcome::Aborted(_)) => see("aborted"),
            None if was_waiting && !self.configuration.is_waiting() => see("waited"),
            None => {}
        }
        if commands.iter().any(|command| matches!(command, Command::Lost { .. })) {
            see("lost");
        }
    }

    /// Chooses an event; most move the activity on, some are about nothing that runs.
    fn choose(&self, random: &mut Random) -> Event {
        let (runs, timers) = self.machine.pending();
        if self.configuration.is_idle() && !random.one_in(8) {
            return Event::Start(Value::new(b"first"));
        }
        match random.below(20) {
            0 => Event::Stop,
            1 if random.one_in(4) => Event::Start(Value::EMPTY),
            1..=2 => Event::Notice(random.below(NOTICES)),
            3..=8 if !runs.is_empty() => {
                let (state, number) = runs[random.below(runs.len())];
                Event::Ended { state, activation: Activation(number), outcome: ending(random) }
            }
            9..=11 if !timers.is_empty() => {
                let (transition, number) = timers[random.below(timers.len())];
                Event::Elapsed { transition, activation: Activation(number) }
            }
            12 => Event::Ended { state: random.below(12), activation: Activation(1), outcome: ending(random) },
            13 => Event::Elapsed { transition: random.below(12), activation: Activation(1) },
            _ => Event::Message {
                port: random.below(PORTS),
                filters: (0..FILTERS).filter(|_| random.one_in(2)).collect(),
                priority: u8::try_from(random.below(3)).expect("it is small"),
                value: Value::new(b"message"),
            },
        }
    }
}

fn ending(random: &mut Random) -> Outcome {
    let aborted = |cause| Outcome::Aborted(Reason { member: Some(0), cause });
    match random.below(12) {
        0..=4 => Outcome::Done(Value::new(b"v")),
        5..=6 => Outcome::Done(Value::tagged(TAGS[random.below(2)], b"v").expect("the tag is short")),
        7 => Outcome::Stopped,
        8 => {
            let reports = [&b"r"[..], b"\x01f", b"\x00\x01", b"\x00\x04", b"\x00\x05"];
            aborted(Cause::Reported(Value::new(reports[random.below(reports.len())])))
        }
        9 => aborted(Cause::Failed("f".into())),
        10 if random.one_in(3) => aborted(Cause::Failed("the deadline `a within 1 s` in line 1 has passed".into())),
        10 => aborted([Cause::Busy, Cause::NoMatch, Cause::ServiceEnded][random.below(3)].clone()),
        _ => aborted(Cause::StopUnconfirmed),
    }
}

/// Follows one activity through a number of events, then stops it.
fn follow(chart: &Chart, random: &mut Random, (events, figures): (usize, &mut Figures)) -> bool {
    let Ok(automaton) = Automaton::new(chart.clone()) else { return false };
    let mut pair =
        Pair { automaton: &automaton, configuration: Configuration::new(&automaton), machine: Machine::new(chart) };
    pair.send(&Event::Start(Value::new(b"first")), figures);
    let mut ends = 0;
    for _ in 0..events {
        let event = pair.choose(random);
        ends += usize::from(pair.send(&event, figures).is_some());
        if ends == ENDS_MAX {
            break;
        }
    }
    // A stop always comes to its end: once every run has confirmed, nothing is active or armed.
    let mut outcome = pair.send(&Event::Stop, figures);
    let mut confirmed = 0;
    while outcome.is_none() {
        let (runs, _) = pair.machine.pending();
        let (state, number) = runs[0];
        outcome =
            pair.send(&Event::Ended { state, activation: Activation(number), outcome: Outcome::Stopped }, figures);
        confirmed += 1;
    }
    assert!(confirmed <= chart.states.len() && pair.configuration.is_idle());
    assert_eq!(pair.machine.pending(), (vec![], vec![]), "a stopped activity has nothing left");
    figures.activities += 1;
    figures.events += (events + confirmed + 2) as u64;
    true
}

/// Surveys activities of at most about this size, small ones first.
fn survey(activities: u64, size_max: u64, seed: u64) -> Figures {
    let mut figures = Figures::default();
    let mut seed = seed;
    while figures.activities < activities {
        seed += 1;
        let size = 2 + usize::try_from(figures.activities * (size_max - 1) / activities).expect("it is small");
        let mut random = Random(seed);
        let chart = charts::chart(&mut random, size);
        let result =
            std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| follow(&chart, &mut random, (30, &mut figures))));
        assert!(result.is_ok(), "seed {seed}, {chart:#?}");
    }
    let rare = ["done", "stopped", "livelock", "range", "unconfirmed", "aborted", "waited", "lost"];
    let rare = rare.into_iter().chain(["script over budget", "script failed"]);
    for what in rare {
        assert!(figures.seen.get(what).is_some_and(|&count| count * 2000 > activities), "{what}: {figures:?}");
    }
    figures
}

#[test]
fn random_activities_agree_with_the_reference() {
    survey(1_000, 8, 0);
}

#[test]
#[ignore = "long: 100,000 activities, 3 minutes of one processor"]
fn many_random_activities_agree_with_the_reference() {
    let figures = survey(100_000, 14, 1 << 32);
    println!("{figures:?}");
}
