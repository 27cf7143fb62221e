//! Programs that could not be ended while their deployment goes on: the resources they may still use are given to no
//! other.

use super::changes::outcome;
use super::losses::{cut, heal};
use super::world::{Draw, World};
use node::logic::agent::Input;
use node::logic::protocol::{Answer, Change, Ending, Estop, FailureCause, Report, Request};
use shim::protocol::ShimReport;
use std::collections::BTreeSet;
use std::time::Duration;

/// `rock` ignores its stop, and its shim cannot kill it; `near` wants its resource.
fn zone(actions: &str, rest: &str) -> String {
    format!(
        r#"
process Inner(there) {{
    host {{ there }}
    instantiated_processes {{ stone instof Stubborn(there); beside instof Step(there); }}
    internal_event_actions {{ (stone within 200 ms) else beside }}
}}
process main() {{
    host {{ "c1" }}
    resource zone;
    instantiated_processes {{ {rest} near instof Step("c1"); }}
    internal_event_actions {{ {actions} }}
}}
"#
    )
}

fn world_of(text: &str) -> (World, u64) {
    let mut world = World::new(&["c1", "c2", "c3"]);
    world.immortal = true;
    let call = world.deploy("c1", text);
    world.run_for(Duration::from_secs(60));
    (world, call)
}

/// Returns how often the program of a module was activated.
fn runs(world: &World, module: &str) -> usize {
    world.log.iter().filter(|line| line.starts_with(module)).count()
}

/// Returns the changes of a process that watchers were told.
fn told(world: &World, call: u64, of: &str) -> Vec<Change> {
    let change = |answer: &Answer| match answer {
        Answer::Report(Report::Process { change: Change::Started { .. }, .. }) => None,
        Answer::Report(Report::Process { path, change, .. }) if path == of => Some(change.clone()),
        _ => None,
    };
    world.answers[&call].iter().filter_map(change).collect()
}

/// Returns the state of a process as `dca status` has it.
fn state(world: &mut World, host: &str, path: &str) -> String {
    let call = world.ask(host, Request::Status);
    world.run_for(Duration::from_millis(1));
    let [Answer::Status(status)] = &world.answers[&call][..] else { panic!("{:?}", world.answers[&call]) };
    let mut processes = status.deployments.iter().flat_map(|one| &one.processes);
    processes.find(|process| process.path == path).map(|process| process.state.clone()).unwrap_or_default()
}

/// Lets the programs end that could not be ended, on all hosts.
fn end_stuck(world: &mut World, module: &str) {
    let is_its = |world: &World, process| world.modules[process] == module;
    let stuck: Vec<_> = world.alive.iter().filter(|(_, process)| is_its(world, process)).cloned().collect();
    for (host, process) in stuck {
        world.kill(&host, process.leaf);
    }
}

/// Its resources do not become free when it is removed from the plan.
#[test]
fn what_could_not_be_ended_is_not_taken_away() {
    for host in ["c1", "c2"] {
        let rest = "(wait(1 s) ; using(zone) near) , (wait(7200 s))";
        let rock = format!("rock instof Stubborn(\"{host}\");");
        let (mut world, _) = world_of(&zone(&format!("(using(zone) (rock within 200 ms))? , {rest}"), &rock));
        let away = |world: &mut World| {
            let change = world.change("c1", &zone(rest, ""), (1, 0), &[]);
            world.run_for(Duration::from_secs(30));
            outcome(world, change)
        };
        let why = format!(
            "host `{host}`: `main/rock` could not be ended, and may still use its resources; end its program, and then remove the process"
        );
        assert_eq!(away(&mut world), Err(vec![why]));
        assert_eq!(runs(&world, "Step"), 0, "on {host}: the rock may still move in the zone");
        end_stuck(&mut world, "Stubborn");
        world.run_for(Duration::from_secs(10));
        assert!(away(&mut world).is_ok());
        assert_eq!(runs(&world, "Step"), 1, "on {host}");
    }
}

#[test]
fn what_an_unended_program_may_still_use_is_given_to_nobody() {
    for host in ["c1", "c2"] {
        let rock = format!("rock instof Stubborn(\"{host}\");");
        let text = zone("(using(zone) (rock within 200 ms))? , (wait(1 s) ; using(zone) near)", &rock);
        let (mut world, call) = world_of(&text);
        world.run_for(Duration::from_secs(3600));
        assert_eq!(runs(&world, "Step"), 0, "on {host}: the rock may still move in the zone");
        let held = Change::HeldBy { resource: "zone".into(), by: "main/rock".into(), host: host.into() };
        assert_eq!(told(&world, call, "main/near"), std::slice::from_ref(&held), "people are told once");
        let expected = format!("running; `main/near` {}", held.held_text().unwrap());
        assert_eq!(state(&mut world, "c1", "main"), expected);
        let rock = state(&mut world, host, "main/rock");
        assert!(rock.starts_with("unconfirmed; its stop could not be confirmed: end"), "{rock}");
        end_stuck(&mut world, "Stubborn");
        world.run_for(Duration::from_secs(5));
        assert_eq!(runs(&world, "Step"), 1, "on {host}");
        assert_eq!(told(&world, call, "main/rock").last(), Some(&Change::EndedLate));
        assert_eq!(world.ending(call), &Ending::Done(vec![]));
        assert_eq!(world.alive, BTreeSet::new());
    }
}

/// A program that has ended by itself, and has left a process that its shim cannot kill. After 20 s its end is reported
/// as unconfirmed, and its resources are free once that process is gone.
#[test]
fn what_an_ended_program_has_left_is_not_waited_for_without_end() {
    let text = zone("(using(zone) rock)? , (wait(1 s) ; using(zone) near)", "rock instof Stubborn(\"c1\");");
    let mut world = World::new(&["c1"]);
    world.immortal = true;
    let call = world.deploy("c1", &text);
    world.run_for(Duration::from_secs(5));
    let (host, process) =
        world.alive.iter().find(|(_, one)| world.modules[one] == "Stubborn").cloned().expect("it runs");
    world.report(&host, &process, ShimReport::Exited { code: 1 });
    world.run_for(Duration::from_secs(19));
    assert_eq!(told(&world, call, "main/rock"), vec![Change::Activated]);
    world.run_for(Duration::from_secs(2));
    let rock = state(&mut world, "c1", "main/rock");
    assert!(rock.starts_with("unconfirmed; its stop could not be confirmed: end it there"), "{rock}");
    assert_eq!(runs(&world, "Step"), 0, "what it has left may still move in the zone");
    world.report(&host, &process, ShimReport::Gone);
    world.run_for(Duration::from_secs(5));
    assert_eq!(told(&world, call, "main/rock").last(), Some(&Change::EndedLate));
    assert_eq!(runs(&world, "Step"), 1);
    assert_eq!(world.ending(call), &Ending::Done(vec![]));
}

/// A mission that waits for it can be stopped, and the outcome says that something may be left.
#[test]
fn a_mission_that_waits_for_an_unended_program_can_be_stopped() {
    let text = zone("(using(zone) (rock within 200 ms))? , (using(zone) near)", "rock instof Stubborn(\"c2\");");
    let (mut world, call) = world_of(&text);
    world.stop("c1");
    world.run_for(Duration::from_secs(60));
    let Report::Finished { ending, unconfirmed, .. } = world.last_report(call) else { panic!("it has not ended") };
    assert_eq!((ending, &unconfirmed[..], runs(&world, "Step")), (&Ending::Stopped, &["c2".to_owned()][..], 0));
}

/// The loser of `#`, the first of `;` behind `?` or `else`, and a member below a group: nothing begins beside it with
/// the resources that were taken for both.
#[test]
fn nothing_begins_beside_it_in_what_was_taken_for_both() {
    let rock = "rock instof Stubborn(\"c2\"); hit instof Tuned(\"c1\");";
    let inner = "inner instof Inner(\"c2\");";
    for (actions, rest) in [
        ("using(zone) ((rock within 200 ms) else near)", rock),
        ("using(zone) ((rock # wait(200 ms))? ; near)", rock),
        ("(using(zone) (rock # wait(200 ms)))? ; using(zone) near", rock),
        ("using(zone) inner else near", inner),
        ("((using(zone) inner) # wait(20 s))? ; using(zone) near", inner),
    ] {
        let (mut world, _) = world_of(&zone(actions, &rest.replace("hit instof Tuned(\"c1\");", "")));
        world.run_for(Duration::from_secs(600));
        assert_eq!(runs(&world, "Step"), 0, "{actions}");
        let main = state(&mut world, "c1", "main");
        let inner = state(&mut world, "c2", "main/inner");
        assert!(main.contains("waits for") || inner.contains("waits for"), "{actions}: {main} {inner}");
        end_stuck(&mut world, "Stubborn");
        world.run_for(Duration::from_secs(30));
        assert_eq!(runs(&world, "Step"), 1, "{actions}: {:?}", world.log);
    }
}

/// A device is not a resource of the group, so its next user is refused instead of kept waiting.
#[test]
fn a_device_of_an_unended_program_is_refused_to_the_next() {
    let text = r#"
module Holder(host) { exec "sh Endless"; plain; done; claims arm; stop within 100 ms; }
module Next(host) { exec "sh Script"; plain; done; claims arm; }
module Looks(host) { exec "sh Script"; plain; done; claims eye; }
process main() {
    host { "c1" }
    instantiated_processes { rock instof Holder("c2"); next instof Next("c2"); looks instof Looks("c2"); }
    internal_event_actions { (rock # wait(200 ms))? ; looks ; next }
}
"#;
    let (world, call) = world_of(text);
    let Report::Finished { ending: Ending::Aborted(failure), unconfirmed, .. } = world.last_report(call) else {
        panic!("{:?}", world.last_report(call))
    };
    let cause = FailureCause::DeviceHeld { device: "arm".into(), by: "main/rock".into() };
    assert_eq!((failure.origin.as_str(), &failure.cause), ("main/next", &cause));
    assert_eq!(unconfirmed, &["c2"]);
    let looked = told(&world, call, "main/looks");
    assert!(looked.contains(&Change::Ended(Ending::Done(vec![]))), "{looked:?}");
}

/// A user who stops a mission while a host is cut off hears neither that a process has failed nor that it has stopped.
#[test]
fn a_stop_during_a_cut_is_told_as_unconfirmed() {
    let mut world = World::new(&["c1", "c2"]);
    let call = world.deploy("c1", &zone("rock , near", "rock instof Long(\"c2\") { on_link_loss keep; }"));
    world.run_for(Duration::from_secs(1));
    cut(&mut world, "c2");
    world.run_for(Duration::from_secs(1));
    world.stop("c1");
    world.run_for(Duration::from_secs(60));
    let Report::Finished { ending, unconfirmed, .. } = world.last_report(call) else { panic!("it has not ended") };
    assert_eq!((ending, &unconfirmed[..]), (&Ending::Unconfirmed, &["c2".to_owned()][..]));
}

/// A node that leaves, or was lost, has not ended its stuck programs.
#[test]
fn a_host_that_leaves_its_program_behind_gives_nothing_back() {
    let text = zone("(using(zone) rock)? , (wait(1 s) ; using(zone) near)", "rock instof Stubborn(\"c2\");");
    for is_lost in [true, false] {
        let mut world = World::new(&["c1", "c2", "c3"]);
        world.immortal = true;
        world.lingers = true;
        let call = world.deploy("c1", &text);
        world.run_for(Duration::from_secs(2));
        if is_lost {
            cut(&mut world, "c2");
            world.run_for(Duration::from_secs(30));
            heal(&mut world, "c2");
        } else {
            world.give("c2", Input::Leave);
        }
        world.run_for(Duration::from_secs(600));
        assert_eq!(runs(&world, "Step"), 0, "lost: {is_lost}");
        if is_lost {
            end_stuck(&mut world, "Stubborn");
            world.run_for(Duration::from_secs(30));
            assert_eq!(runs(&world, "Step"), 1);
            assert!(matches!(world.last_report(call), Report::Finished { .. }), "{:?}", world.last_report(call));
        }
    }
}

/// Three groups on three hosts share an arm, some of whose programs cannot be ended; hosts are cut off and frames are lost. No
/// two use it at a time; once all have ended and all hosts are there, it comes to an end.
#[test]
fn two_never_use_one_thing_although_programs_are_not_ended() {
    let text = r#"
process Hand(where: Host, there: Host, arm: Resource) {
    host { where }
    instantiated_processes {
        near instof Stubborn(where) { on_link_loss keep; }
        far instof Step(there);
    }
    internal_event_actions { using(arm) ((near within 300 ms)? ; far?) }
}
process main() {
    host { "c1" }
    resource arm;
    instantiated_processes {
        a instof Hand("c2", "c3", arm);
        b instof Hand("c3", "c3", arm);
        c instof Hand("c1", "c2", arm);
    }
    internal_event_actions { ((a? , b? , c?) ;; skip) # (wait(400 s)) }
}
"#;
    let mut steps = 0;
    for seed in 0..30 {
        let mut draw = Draw::new(seed);
        let mut world = World::new(&["c1", "c2", "c3"]);
        (world.immortal, world.loses_one_in) = (true, (seed % 3 > 0).then_some(7 + seed));
        let call = world.deploy("c1", text);
        world.run_for(Duration::from_secs(2));
        let mut gone = None;
        for _ in 0..400 {
            world.run_for(Duration::from_millis(200 + draw.below(600)));
            let users: Vec<_> = world.running.keys().collect();
            assert!(users.len() <= 1, "seed {seed} at {:?}: {users:?}", world.now);
            match gone {
                None if draw.below(60) == 0 => {
                    let host = ["c2", "c3"][draw.index(2)];
                    cut(&mut world, host);
                    gone = Some(host);
                }
                Some(host) if draw.below(30) == 0 => {
                    heal(&mut world, host);
                    gone = None;
                }
                None | Some(_) => {}
            }
            if draw.below(30) == 0 {
                end_stuck(&mut world, "Stubborn");
            }
        }
        gone.into_iter().for_each(|host| heal(&mut world, host));
        for _ in 0..400 {
            world.run_for(Duration::from_secs(1));
            end_stuck(&mut world, "Stubborn");
        }
        assert!(
            matches!(world.last_report(call), Report::Finished { .. }),
            "seed {seed}: {:?}",
            world.last_report(call)
        );
        assert_eq!(world.alive, BTreeSet::new(), "seed {seed}");
        steps += runs(&world, "Step");
    }
    assert!(steps > 100, "it went on now and then: {steps}");
}

/// A program has stopped, and something outside of it may go on: no end of its mission hides this.
#[test]
fn what_may_go_on_outside_of_a_program_is_told() {
    let cause = FailureCause::MayGoOn("the goal may go on".into());
    for actions in ["nav # hit", "nav within 200 ms", "(nav # hit) ; hit", "nav"] {
        let mut world = World::new(&["c1"]);
        let rest = r#"nav instof Walker("c1", way = loose); hit instof Step("c1");"#;
        let call = world.deploy("c1", &zone(actions, rest));
        world.run_for(Duration::from_millis(500));
        if actions == "nav" {
            world.stop("c1");
        }
        world.run_for(Duration::from_secs(5));
        let Report::Finished { ending, unconfirmed, .. } = world.last_report(call) else { panic!("it has not ended") };
        match ending {
            Ending::Unconfirmed => assert_eq!(actions, "nav"),
            Ending::Aborted(failure) => assert_eq!((&failure.cause, failure.origin.as_str()), (&cause, "main/nav")),
            Ending::Done(_) | Ending::Stopped => panic!("{actions}: {ending:?}"),
        }
        assert!(unconfirmed.is_empty(), "its programs have ended");
        let nav = told(&world, call, "main/nav");
        let is_told =
            |change: &Change| matches!(change, Change::Ended(Ending::Aborted(failure)) if failure.cause == cause);
        assert!(nav.iter().any(is_told), "{actions}: {nav:?}");
    }
}

/// A user who stops everything has to know that as well.
#[test]
fn an_emergency_stop_names_what_may_go_on() {
    let mut world = World::new(&["c1"]);
    let call = world.deploy("c1", &zone("nav", r#"nav instof Walker("c1", way = loose);"#));
    world.run_for(Duration::from_millis(500));
    let asked = world.ask("c1", Request::Estop(Estop { by: "ann@c1".into(), reason: String::new() }));
    world.run_for(Duration::from_secs(5));
    let [Answer::Estopped(there)] = &world.answers[&asked][..] else { panic!("{:?}", world.answers[&asked]) };
    assert_eq!(there.unended, ["test@1 main/nav: its stop could not be confirmed: the goal may go on"]);
    let nav = told(&world, call, "main/nav");
    assert!(nav.iter().any(|change| format!("{change:?}").contains("MayGoOn")), "{nav:?}");
}

/// A stop has the same limit whether the program was told to stop or has begun to stop by itself. The next process begins only when the
/// program is gone, and the late stop is the end of the activation.
#[test]
fn a_program_whose_stop_takes_too_long_is_ended() {
    let text = |events: &str| {
        format!(
            "process main() {{ host {{ \"c1\" }}
            instantiated_processes {{
                stone instof Stubborn(\"c1\");
                walker instof Walker(\"c1\", \"sticks\") {{ restart transient; }}
                hit instof Step(\"c1\");
            }}
            internal_event_actions {{ {events} }} }}"
        )
    };
    for (events, path, limit) in [("walker ; hit", "main/walker", 2000), ("stone # hit", "main/stone", 100)] {
        let mut world = World::new(&["c1"]);
        let call = world.deploy("c1", &text(events));
        world.run_for(Duration::from_secs(30));
        let late = FailureCause::StopTimeout(Duration::from_millis(limit));
        let changes = told(&world, call, path);
        let is_late = |change: &Change| matches!(change, Change::Ended(Ending::Aborted(of)) if of.cause == late);
        assert!(changes.iter().any(is_late), "{events}: {changes:?}");
        let is_first = path == "main/walker";
        assert_eq!(matches!(world.ending(call), Ending::Aborted(_)), is_first, "{events}: {:?}", world.ending(call));
        assert_eq!(runs(&world, "Step"), usize::from(!is_first), "{events}");
        assert_eq!(runs(&world, "Walker"), usize::from(is_first), "its stop is over, so it is not run again");
        assert_eq!(world.alive, BTreeSet::new());
    }
}
