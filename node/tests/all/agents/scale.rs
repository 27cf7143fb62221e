//! The cost of one input, with few leaves and with as many as a plan may have: the number of a participant's machines
//! that it looks at.

use super::world::World;
use node::logic::agent::Input;
use std::fmt::Write;
use std::time::Duration;

/// Leaves of one group.
const GROUP: usize = 100;
/// Programs that die and are started again while the node is watched.
const DEATHS: u32 = 20;

/// A mission of `leaves` leaves on one host, in groups of [`GROUP`].
fn mission(leaves: usize) -> String {
    let members: Vec<String> = (0..GROUP).map(|leaf| format!("a{leaf}")).collect();
    let groups: Vec<String> = (0..leaves / GROUP).map(|group| format!("g{group}")).collect();
    let mut text = String::new();
    for (head, names, instance) in [
        ("process Some()", &members, "instof Sensor(\"c1\") { restart transient; }"),
        ("process main()", &groups, "instof Some();"),
    ] {
        let declared: String = names.iter().map(|name| format!("{name} {instance} ")).collect();
        let actions = names.join(" , ");
        writeln!(
            text,
            "{head} {{ host {{ \"c1\" }} instantiated_processes {{ {declared}}} internal_event_actions {{ {actions} }} }}"
        )
        .expect("a text takes a line");
    }
    text
}

/// Returns how many machines a node with so many leaves looks at: for each input of its start, for an input about none
/// of them, and for the death of a program with its restart.
fn visits(leaves: usize) -> (u64, u64, u64) {
    let mut world = World::new(&["c1"]);
    world.deploy("c1", &mission(leaves));
    world.run_for(Duration::from_secs(10));
    assert_eq!(world.running.len(), leaves);
    let visits = |world: &World| world.agents["c1"].agent.visits();
    let start = visits(&world) / leaves as u64;
    let before = visits(&world);
    (0..100).for_each(|_| world.give("c1", Input::Tick));
    let idle = visits(&world) - before;
    let before = visits(&world);
    for leaf in 0..DEATHS {
        world.kill("c1", leaf);
        world.run_for(Duration::from_millis(200));
    }
    assert_eq!(world.running.len(), leaves);
    (start, idle, (visits(&world) - before) / u64::from(DEATHS))
}

/// A plan may have 10,000 processes, groups included. Each input is about one of them or none.
#[test]
fn an_input_costs_the_same_with_ten_thousand_leaves() {
    let (few, many) = (visits(GROUP), visits(9_900));
    println!("machines looked at (start a leaf, 100 ticks, death): {few:?} with {GROUP} leaves, {many:?} with 9,900");
    let (start, idle, death) = many;
    assert_eq!(idle, 0, "what nothing is due of is not looked at");
    assert!(start <= few.0 + 5 && death <= few.2 + 5, "{few:?} with {GROUP} leaves, {many:?} with 9,900");
}
