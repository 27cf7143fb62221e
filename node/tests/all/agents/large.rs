//! Many nodes, a deep tree, and a node that is killed again and again.

use super::world::{Draw, World};
use node::logic::protocol::{Answer, Request};
use std::fmt::Write;
use std::time::Duration;

const HOSTS: usize = 32;
const PROGRAMS: usize = 200;
/// From one kill to the next, and how long all others may take to be as before.
const EVERY: Duration = Duration::from_secs(5);
/// How many kills; 10 minutes are 120 of them.
const KILLS: u64 = 3;

fn host(number: usize) -> String {
    format!("h{:02}", number % HOSTS)
}

/// `main`, 4 regions of 5 areas of 10 programs each: every process is on another host than the previous one.
fn mission() -> String {
    let mut text = String::new();
    let mut group = |head: &str, at: usize, instances: Vec<(String, String)>| {
        let declared: String = instances.iter().map(|(name, kind)| format!("{name} instof {kind}; ")).collect();
        let names: Vec<&str> = instances.iter().map(|(name, _)| name.as_str()).collect();
        let (on, actions) = (host(at), names.join(" , "));
        writeln!(
            text,
            "process {head}() {{ host {{ \"{on}\" }} instantiated_processes {{ {declared}}} internal_event_actions {{ {actions} }} }}"
        )
        .expect("a text takes a line");
    };
    for area in 0..20 {
        let program = |number: usize| (format!("p{number}"), format!("Sensor(\"{}\")", host(area * 10 + number)));
        group(&format!("Area{area}"), area + 5, (0..10).map(program).collect());
    }
    for region in 0..4 {
        let area = |number: usize| (format!("a{number}"), format!("Area{}()", region * 5 + number));
        group(&format!("Region{region}"), region + 1, (0..5).map(area).collect());
    }
    group("main", 0, (0..4).map(|region| (format!("r{region}"), format!("Region{region}()"))).collect());
    text
}

/// Whichever node is killed: it is back, all programs run on, none was started twice, and everybody sees everybody in less than 5 s.
#[test]
fn thirty_two_nodes_are_as_before_after_each_kill() {
    let names: Vec<String> = (0..HOSTS).map(host).collect();
    let mut world = World::new(&names.iter().map(String::as_str).collect::<Vec<_>>());
    world.deploy("h00", &mission());
    world.run_for(Duration::from_secs(5));
    assert_eq!(world.running.len(), PROGRAMS);
    let kills = std::env::var("DCA_TEST_ROUNDS").ok().and_then(|rounds| rounds.parse().ok()).unwrap_or(KILLS);
    let mut draw = Draw::new(36);
    for kill in 0..kills {
        let killed = host(draw.index(HOSTS as u64));
        let away = Duration::from_millis(draw.below(2000));
        world.crash(&killed);
        world.run_for(away);
        world.adopt(&killed);
        world.run_for(EVERY.checked_sub(away).expect("it is shorter"));
        assert_eq!(world.running.len(), PROGRAMS, "after kill {kill}, of {killed}");
        assert!(world.lives.values().all(|lives| *lives == 1), "after kill {kill}, of {killed}");
        for name in &names {
            let call = world.ask(name, Request::Status);
            world.run_for(Duration::ZERO);
            let Some(Answer::Status(status)) = world.answers[&call].last() else { panic!("{name} does not answer") };
            assert_eq!(status.peers.len(), HOSTS - 1, "{name} after kill {kill}, of {killed}");
        }
    }
}
