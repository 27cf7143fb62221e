//! Nodes that are killed and restarted adopt the running programs.

use super::TWO_HOSTS;
use super::world::{Coming, Draw, World};
use comms::logic::time::Time;
use node::logic::agent::Input;
use node::logic::effect::Effect;
use node::logic::node_state::NodeState;
use node::logic::protocol::{Answer, Deployment, Ending, Report, Request, StartMode};
use std::collections::BTreeSet;
use std::ops::Range;
use std::time::Duration;

/// The records of a node: a checkpoint, and its inputs since.
#[derive(Debug)]
pub(super) struct Written {
    checkpoint: Vec<u8>,
    inputs: Vec<Vec<u8>>,
}

impl Written {
    pub(super) fn of(node: &NodeState) -> Self {
        Self { checkpoint: postcard::to_allocvec(node).expect("a state is written"), inputs: Vec::new() }
    }

    pub(super) fn input(&mut self, at: Time, input: &Input) {
        self.inputs.push(postcard::to_allocvec(&(at, input)).expect("an input is written"));
    }

    fn replay(&self) -> NodeState {
        let mut node: NodeState = postcard::from_bytes(&self.checkpoint).expect("a state is read");
        for input in &self.inputs {
            let (at, input) = postcard::from_bytes(input).expect("an input is read");
            node.take(at, input, &mut Vec::new());
        }
        node
    }
}

impl World {
    /// Kills the node of a host with its next input, after `effects` of the effects are carried out.
    pub(super) fn crash_after(&mut self, host: &str, effects: usize) {
        self.dies_after = Some((host.to_owned(), effects));
    }

    /// Cancels the planned kill.
    pub(super) fn spare(&mut self) {
        self.dies_after = None;
    }

    /// Kills the node of a host. Its programs continue.
    pub(super) fn crash(&mut self, host: &str) {
        self.agents.remove(host);
        self.down.insert(host.to_owned(), Vec::new());
        let boot = self.boots[host];
        for other in self.agents.keys().cloned().collect::<Vec<_>>() {
            self.at(1, &other, Coming::Input(Input::Vanished { host: host.to_owned(), boot }));
        }
    }

    /// Restarts the node of a host, which adopts the programs of the previous one.
    pub(super) fn adopt(&mut self, host: &str) {
        let held = self.down.remove(host).expect("it is down");
        let node = self.written[host].replay();
        let away = self.there(host).since(node.at);
        let (calls, commits): (Vec<u64>, Vec<Deployment>) =
            (node.attachments.calls().collect(), node.attachments.commits().map(|(name, _)| name.clone()).collect());
        let programs: Vec<_> =
            node.attachments.programs().map(|(process, one)| (process.clone(), one.clone())).collect();
        self.written.insert(host.to_owned(), Written::of(&node));
        self.agents.insert(host.to_owned(), node);
        for deployment in commits {
            self.at(self.disk_ms, host, Coming::Input(Input::Committed { deployment, written: Ok(()) }));
        }
        for (process, program) in programs.clone().into_iter().filter(|(_, program)| !program.is_gone) {
            if program.reports == 0 && !self.took.contains_key(&process) {
                self.spawn(host, program.order);
                continue;
            }
            let (orders, shim_orders) = self.took[&process];
            for order in program.shim_orders(shim_orders) {
                self.carry_out(host, Effect::Shim { process: process.clone(), order });
            }
            for order in program.orders(orders).expect("all that was missed is kept") {
                self.carry_out(host, Effect::Control { process: process.clone(), order });
            }
        }
        let reached: BTreeSet<_> =
            programs.iter().filter(|(_, one)| !one.is_gone).map(|(process, _)| process.clone()).collect();
        self.give(host, Input::Adopted { away, programs: reached.clone() });
        calls.into_iter().for_each(|call| self.give(host, Input::CallGone { call }));
        held.into_iter().for_each(|coming| self.at(1, host, coming));
        reached.into_iter().for_each(|process| self.at(1, host, Coming::Input(Input::Reached { process })));
        let boot = self.boots[host];
        for other in self.agents.keys().cloned().collect::<Vec<_>>() {
            self.at(1, &other, Coming::Input(Input::Appeared { host: host.to_owned(), boot }));
        }
    }
}

fn first() -> Deployment {
    Deployment { name: "test".into(), epoch: 1 }
}

/// Returns all reports of the first deployment's home.
fn told(world: &mut World) -> Vec<Report> {
    let call = world.ask("c1", Request::Watch { deployment: first(), seen: 0 });
    world.run_for(Duration::from_millis(10));
    let answers = world.answers.remove(&call).unwrap_or_default();
    answers
        .into_iter()
        .map(|answer| match answer {
            Answer::Report(report) => report,
            other => panic!("{other:?}"),
        })
        .collect()
}

/// Whichever node is killed at whichever effect, and is back before it is lost: the mission ends as if nothing had happened, and
/// no program was started twice.
#[test]
fn a_mission_goes_on_where_its_nodes_were_killed() {
    a_mission_goes_on_where_its_nodes_were_killed_for(0..100);
}

#[test]
#[ignore = "long: 900 seeds"]
fn a_mission_goes_on_where_its_nodes_were_killed_for_more_seeds() {
    a_mission_goes_on_where_its_nodes_were_killed_for(100..1000);
}

fn a_mission_goes_on_where_its_nodes_were_killed_for(seeds: Range<u64>) {
    for seed in seeds {
        let mut draw = Draw::new(seed);
        let mut world = World::new(&["c1", "c2", "c3"]);
        // Every other one is to begin at one moment on clocks that differ.
        world.start = if seed % 2 == 0 { StartMode::AtOnce } else { StartMode::Aligned };
        world.ahead.extend(["c1", "c2"].map(|host| (host.to_owned(), Duration::from_secs(draw.below(1000)))));
        world.deploy("c1", TWO_HOSTS);
        // The request itself has to arrive.
        world.run_for(Duration::from_millis(1 + draw.below(4)));
        for _ in 0..1 + draw.below(4) {
            world.crash_after(["c1", "c2"][draw.index(2)], draw.index(6));
            world.run_for(Duration::from_millis(draw.below(120)));
            for host in world.down.keys().cloned().collect::<Vec<_>>() {
                world.run_for(Duration::from_millis(draw.below(400)));
                world.adopt(&host);
            }
        }
        world.spare();
        world.run_for(Duration::from_secs(10));
        let told = told(&mut world);
        let Some(Report::Finished { ending: Ending::Done(_), unconfirmed, .. }) = told.last() else {
            panic!("seed {seed}: {told:#?}");
        };
        assert_eq!((unconfirmed.len(), &world.alive), (0, &BTreeSet::new()), "seed {seed}");
        assert!(world.lives.values().all(|lives| *lives == 1), "seed {seed}: {:?}", world.lives);
        let expected = ["Sensor", "Step", "Step", "Step"];
        let mut log: Vec<&str> = world.log.iter().filter_map(|line| line.split(' ').next()).collect();
        if world.start == StartMode::Aligned {
            // Of two that begin at one moment a node that is away begins its own later.
            log[..2].sort_unstable();
        }
        assert_eq!(log, expected, "seed {seed}");
    }
}

/// The user was told that the mission is lost: a node that is restarted much later begins nothing by itself.
#[test]
fn what_had_not_begun_does_not_begin_much_later() {
    for (away, again) in [(4, true), (6, false), (600, false)] {
        let mut world = World::new(&["c1", "c2"]);
        world.disk_ms = 200;
        world.deploy("c1", TWO_HOSTS);
        world.run_for(Duration::from_millis(100));
        world.crash("c1");
        world.run_for(Duration::from_secs(away));
        world.adopt("c1");
        world.run_for(Duration::from_secs(20));
        let told = told(&mut world);
        if again {
            assert!(told.iter().any(|report| matches!(report, Report::Go { .. })), "{told:#?}");
            continue;
        }
        let Some(Report::Refused { reasons }) = told.last() else { panic!("after {away} s: {told:#?}") };
        assert!(reasons.iter().any(|why| why.contains("its home was gone for")), "{reasons:?}");
        assert!(world.log.is_empty() && world.alive.is_empty(), "{:?} {:?}", world.log, world.alive);
    }
}

/// A caller that waits for the end of a mission may not have heard it when the node is killed: the next node tells it.
#[test]
fn an_end_that_nobody_has_heard_is_told_by_the_next_node() {
    for millis in [0, 1, 500, 9000] {
        let mut world = World::new(&["c1", "c2"]);
        let call = world.deploy("c1", TWO_HOSTS);
        let is_over = |world: &World| {
            let last = world.answers.get(&call).and_then(|answers| answers.last());
            matches!(last, Some(Answer::Report(Report::Finished { .. })))
        };
        while !is_over(&world) {
            world.run_for(Duration::from_millis(1));
        }
        world.run_for(Duration::from_millis(millis));
        assert!(world.agents["c1"].is_engaged(), "{millis} ms after its end");
        world.crash("c1");
        world.run_for(Duration::from_millis(300));
        world.adopt("c1");
        let told = told(&mut world);
        assert!(matches!(told.last(), Some(Report::Finished { ending: Ending::Done(_), .. })), "{told:#?}");
        // Then there is nothing left to adopt.
        world.run_for(Duration::from_secs(11));
        assert!(!world.agents["c1"].is_engaged());
    }
}

/// A node that is killed again and again ends its deployments and accepts no new ones for a minute.
#[test]
fn a_node_in_a_crash_loop_takes_nothing_new_on() {
    let mut world = World::new(&["c1", "c2"]);
    world.deploy("c1", TWO_HOSTS);
    world.run_for(Duration::from_millis(20));
    for _ in 0..6 {
        world.crash("c1");
        world.run_for(Duration::from_millis(10));
        world.adopt("c1");
    }
    let refused = world.deploy_as("other", "c1", "process main() { host { \"c1\" } instantiated_processes { a instof Step(\"c1\"); } internal_event_actions { a } }");
    world.run_for(Duration::from_secs(5));
    let Report::Refused { reasons } = world.last_report(refused) else { panic!("{:?}", world.last_report(refused)) };
    assert!(
        reasons[0].starts_with("its node was killed 6 times within 60 s and takes nothing new on for 60 s"),
        "{reasons:?}"
    );
    assert!(
        matches!(told(&mut world).last(), Some(Report::Finished { ending: Ending::Done(_), .. })),
        "what ran goes on"
    );
    world.run_for(Duration::from_secs(60));
    let again = world.deploy_as("again", "c1", "process main() { host { \"c1\" } instantiated_processes { a instof Step(\"c1\"); } internal_event_actions { a } }");
    world.run_for(Duration::from_secs(5));
    assert_eq!(world.ending(again), &Ending::Done(vec![]));
}
