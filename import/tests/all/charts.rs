//! An imported chart does what the algorithm of SCXML says.
//!
//! Random charts have nested and parallel states, histories, internal transitions, several targets, conditions, raised events,
//! delayed events and wildcards. The interpreter and the imported activity get the same events from outside. They are in the same
//! states behind each of them, and have carried out the same actions in the same order.

mod chart;
mod interpreter;

use crate::player::{Played, Player};
use crate::random::Random;
use chart::{OUTSIDE, chart, xml};
use import::import;
use interpreter::Interpreter;
use language::Source;
use language::automaton::{Automaton, Event};
use std::collections::BTreeSet;
use std::time::Duration;

/// Compares a chart; returns false if the import says that it differs before many events have come.
fn check(seed: u64) -> bool {
    let mut random = Random(seed);
    let chart = chart(&mut random);
    let text = xml(&chart);
    let imported =
        import(&Source::new("chart.scxml", text.as_str()), &[]).unwrap_or_else(|why| panic!("{seed}: {why}\n{text}"));
    let played = Played::of(imported);
    let automaton = Automaton::new(played.chart.chart.clone()).expect("the plan has it");
    let mut model = Interpreter::start(&chart);
    let mut player = Player::start(&played, &automaton);
    let mut time = Duration::ZERO;
    for number in 0..12_u64 {
        if model.differs {
            return number > 3;
        }
        let leaves: BTreeSet<String> = model.leaves().into_iter().map(|state| format!("s{state}")).collect();
        let why = match player.expect(&leaves) {
            Ok(()) if player.logs == model.log => None,
            Ok(()) => Some(format!("{:?}, not {:?}", player.logs, model.log)),
            Err(why) => Some(why),
        };
        if let Some(why) = why {
            panic!("seed {seed} at {time:?}: {why}\n{text}\n{}", played.imported.text);
        }
        if model.end.is_some() {
            return true;
        }
        let next = time + Duration::from_nanos(1_000_000 * random.below(2_000) as u64 + 1_013 * (number + 1));
        player.pass(next - time);
        model.pass(next);
        time = next;
        if model.differs {
            return number > 3;
        }
        let event = random.pick(&OUTSIDE);
        if let Some(port) = played.port(event) {
            player.send(Event::message(port));
            player.pass(Duration::ZERO);
        }
        model.send(event);
    }
    true
}

#[test]
fn imported_charts_run_as_the_algorithm_says() {
    let compared = (0..100).filter(|seed| check(*seed)).count();
    assert!(compared > 50, "{compared} of 100 charts were compared");
}

/// An internal transition of a region leaves neither the region, with its actions, nor the other regions. The end of all regions
/// is heard although the region has an internal transition.
#[test]
fn an_internal_transition_leaves_the_region_and_its_neighbours_alone() {
    let text = "<scxml><parallel id=\"p\"><transition event=\"done.state.p\" target=\"over\"/>\
                <state id=\"a\"><onentry><log expr=\"'in'\"/></onentry><onexit><log expr=\"'out'\"/></onexit>\
                <transition event=\"again\" type=\"internal\" target=\"a1\"/><transition event=\"reset\" target=\"a1\"/>\
                <state id=\"a1\"><transition event=\"go\" target=\"a2\"/></state><final id=\"a2\"/></state>\
                <state id=\"b\"><state id=\"b1\"><transition event=\"go\" target=\"b2\"/></state><state id=\"b2\">\
                <transition event=\"end\" target=\"b3\"/></state><final id=\"b3\"/></state></parallel>\
                <state id=\"over\"/></scxml>";
    let played = Played::of(import(&Source::new("chart.scxml", text), &[]).expect("a good chart"));
    let automaton = Automaton::new(played.chart.chart.clone()).expect("the plan has it");
    let mut player = Player::start(&played, &automaton);
    let mut is_in = |event: &str, states: [&str; 2], logs: &[&str]| {
        player.send(Event::message(played.port(event).expect("it comes from outside")));
        assert_eq!(player.expect(&states.map(str::to_owned).into()), Ok(()), "{event}");
        assert_eq!(player.logs, logs, "{event}");
    };
    is_in("go", ["a2", "b2"], &["in"]);
    is_in("again", ["a1", "b2"], &["in"]);
    is_in("go", ["a2", "b2"], &["in"]);
    is_in("reset", ["a1", "b1"], &["in", "out", "in"]);
    is_in("go", ["a2", "b2"], &["in", "out", "in"]);
    is_in("end", ["over", "over"], &["in", "out", "in", "out"]);
}

#[test]
#[ignore = "long: 20,000 charts"]
fn many_imported_charts_run_as_the_algorithm_says() {
    let compared = (0..20_000).filter(|seed| check(*seed)).count();
    println!("{compared} of 20000 charts were compared");
}
