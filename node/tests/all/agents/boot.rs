//! The home after a reboot: the fate of its running deployments, on virtual time.

use super::world::{Coming, World, offered};
use node::logic::agent::{Agent, Identity, Input};
use node::logic::node_state::NodeState;
use node::logic::protocol::{
    Answer, Before, Deployment, Earlier, Ending, FailureCause, Report, Request, StopReply, Tombstone,
};
use std::collections::BTreeSet;
use std::time::Duration;

/// A mission on two hosts that ends on request.
pub(super) const LONG: &str = r#"
process main() {
    host { "c1" }
    on_boot { resume }
    instantiated_processes { near instof Sensor("c1"); far instof Sensor("c2") { on_link_loss keep; } }
    internal_event_actions { far , near }
}
"#;

fn deployment(epoch: u64) -> Deployment {
    Deployment { name: "test".into(), epoch }
}

/// The power of a host fails: its programs are gone, and its node only keeps the state on its disk. Other hosts do not
/// see it any more.
pub(super) fn power_off(world: &mut World, host: &str) {
    world.cut.insert(host.to_owned());
    world.agents.remove(host);
    world.alive.retain(|(on, _)| on != host);
    world.running.retain(|(on, _), _| on != host);
    world.holders.remove(host);
    world.rounds.remove(host);
    let boot = world.boots[host];
    for other in world.agents.keys().cloned().collect::<Vec<_>>() {
        world.at(1, &other, Coming::Input(Input::Vanished { host: host.to_owned(), boot }));
    }
}

/// The host boots, with the state on its disk.
pub(super) fn power_on(world: &mut World, host: &str, was_rebooted: bool) {
    let boot = world.boots[host] + 100;
    // A new boot takes nothing over.
    world.written.remove(host);
    let kept = world.kept.get(host).cloned().unwrap_or_default();
    let epoch = kept.keys().max().copied().unwrap_or(0).max(1);
    let open = kept.values().map(|kept| (kept.deployment.clone(), kept.hosts.clone())).collect();
    let running = kept.into_values().map(|kept| Before { kept, was_rebooted }).collect();
    let tombstones = world.tombstones.get(host).cloned().unwrap_or_default();
    let identity = Identity {
        host: host.to_owned(),
        boot,
        pid: 1,
        machine: host.to_owned(),
        epoch,
        open,
        is_guarded: world.is_guarded,
        estop: world.estops.get(host).cloned().flatten(),
        earlier: Earlier { running, tombstones },
    };
    world.agents.insert(host.to_owned(), NodeState::new(Agent::new(identity, offered(), world.now), world.now));
    world.cut.remove(host);
    for (other, other_boot) in world.boots.clone().into_iter().filter(|(other, _)| other != host) {
        if world.agents.contains_key(&other) {
            world.at(1, &other, Coming::Input(Input::Appeared { host: host.to_owned(), boot }));
            world.at(1, host, Coming::Input(Input::Appeared { host: other, boot: other_boot }));
        }
    }
    world.boots.insert(host.to_owned(), boot);
}

/// The answer to a `dca deploy` that asks again after its node was away.
pub(super) fn told(world: &mut World, epoch: u64) -> Answer {
    let call = world.ask("c1", Request::Watch { deployment: deployment(epoch), seen: u64::MAX });
    world.run_for(Duration::from_millis(10));
    world.answers[&call].last().cloned().expect("it is answered")
}

/// The deployments whose programs run, and the hosts of these.
pub(super) fn runs(world: &World) -> BTreeSet<(u64, String)> {
    world.alive.iter().map(|(host, process)| (process.deployment.epoch, host.clone())).collect()
}

pub(super) fn on_both(epoch: u64) -> BTreeSet<(u64, String)> {
    ["c1", "c2"].map(|host| (epoch, host.to_owned())).into()
}

#[test]
fn a_mission_is_begun_again_after_a_reboot_where_its_spec_says_so() {
    let cases = [
        // The text, whether the machine was rebooted, and whether it runs again.
        (LONG.to_owned(), true, true),
        (LONG.to_owned(), false, false),
        (LONG.replace("resume", "none"), true, false),
        (LONG.replace("on_boot { resume }", ""), true, false),
    ];
    for (text, was_rebooted, again) in cases {
        let mut world = World::new(&["c1", "c2"]);
        world.deploy("c1", &text);
        world.run_for(Duration::from_secs(1));
        assert_eq!((runs(&world), world.kept["c1"].len()), (on_both(1), 1), "{text}");
        power_off(&mut world, "c1");
        world.run_for(Duration::from_secs(3));
        power_on(&mut world, "c1", was_rebooted);
        world.run_for(Duration::from_secs(5));
        let cause = if was_rebooted { FailureCause::Rebooted } else { FailureCause::Restarted };
        let Answer::Report(Report::Finished { ending: Ending::Aborted(failure), .. }) = told(&mut world, 1) else {
            panic!("{:?}", told(&mut world, 1))
        };
        assert_eq!(failure.cause, cause, "{text}");
        assert_eq!(runs(&world), BTreeSet::new(), "{text}: nothing of the one before, and nothing new so soon");
        world.run_for(Duration::from_secs(10));
        assert_eq!(runs(&world), if again { on_both(2) } else { BTreeSet::new() }, "{text}");
        assert_eq!(world.kept["c1"].keys().copied().collect::<Vec<_>>(), if again { vec![2] } else { vec![] });
        if again {
            let stop = world.stop("c1");
            world.run_for(Duration::from_secs(10));
            assert_eq!(world.answers[&stop], [Answer::Stop(StopReply::Stopped)]);
            assert_eq!((runs(&world), world.kept["c1"].len()), (BTreeSet::new(), 0));
        }
    }
}

/// A deployment that has ended, was stopped, or was refused is not resumed; a node that leaves, as at an orderly
/// reboot, stops nothing for good.
#[test]
fn what_has_ended_stays_ended() {
    for (what, is_kept) in [("ends", false), ("is stopped", false), ("is refused", false), ("leaves", true)] {
        let mut world = World::new(&["c1", "c2"]);
        if what == "is refused" {
            world.disk_refuses = Some("no space left on device".to_owned());
        }
        let text =
            if what == "ends" { LONG.replace("near instof Sensor", "near instof Step") } else { LONG.to_owned() };
        world.deploy("c1", &text);
        world.run_for(Duration::from_secs(1));
        match what {
            "is stopped" => drop(world.stop("c1")),
            "leaves" => world.at(0, "c1", Coming::Input(Input::Leave)),
            _ => {}
        }
        world.run_for(Duration::from_secs(40));
        assert_eq!(world.kept["c1"].len(), usize::from(is_kept), "it {what}");
        assert_eq!(world.alive, BTreeSet::new(), "it {what}");
    }
}

/// Hosts boot at their own pace. While one of them is missing nothing begins, and this is reported.
#[test]
fn it_waits_for_the_other_hosts_and_not_for_ever() {
    for (later, again) in [(60, true), (1000, false)] {
        let mut world = World::new(&["c1", "c2"]);
        world.deploy("c1", LONG);
        world.run_for(Duration::from_secs(1));
        power_off(&mut world, "c1");
        power_off(&mut world, "c2");
        world.run_for(Duration::from_secs(1));
        power_on(&mut world, "c1", true);
        world.run_for(Duration::from_secs(later));
        assert_eq!(runs(&world), BTreeSet::new());
        power_on(&mut world, "c2", true);
        world.run_for(Duration::from_secs(30));
        assert_eq!(runs(&world), if again { on_both(2) } else { BTreeSet::new() }, "after {later} s");
        if !again {
            let Answer::Report(Report::Refused { reasons }) = told(&mut world, 2) else {
                panic!("{:?}", told(&mut world, 2))
            };
            assert!(reasons.iter().any(|reason| reason.contains("host `c2` cannot be reached")), "{reasons:?}");
            assert!(world.kept["c1"].is_empty(), "that was all");
        }
    }
}

/// A user who has stopped everything has to release it; a reboot does not.
#[test]
fn nothing_is_begun_again_while_everything_is_stopped() {
    let mut world = World::new(&["c1", "c2"]);
    world.deploy("c1", LONG);
    world.run_for(Duration::from_secs(1));
    power_off(&mut world, "c1");
    let estop = node::logic::protocol::Estop { by: "ann@c1".into(), reason: "a person in the cell".into() };
    world.estops.insert("c1".to_owned(), Some(estop));
    power_on(&mut world, "c1", true);
    world.run_for(Duration::from_secs(30));
    assert_eq!((runs(&world), world.kept["c1"].len()), (BTreeSet::new(), 0));
    let Answer::Report(Report::Refused { reasons }) = told(&mut world, 1) else { panic!("{:?}", told(&mut world, 1)) };
    assert!(
        reasons[0].starts_with("the deployment is not resumed: ") && reasons[0].contains("a person in the cell"),
        "{reasons:?}"
    );
}

/// In a team the home asks whether the user who signed the mission still may have it, once all others that know of a
/// revocation are there.
#[test]
fn what_its_signer_may_not_have_any_more_is_not_begun_again() {
    for verdict in [None, Some("the key of `dan` is revoked")] {
        let mut world = World::guarded(&["c1", "c2"]);
        world.deploy("c1", LONG);
        world.run_for(Duration::from_secs(1));
        assert_eq!(runs(&world), on_both(1));
        power_off(&mut world, "c1");
        world.run_for(Duration::from_secs(3));
        world.judged.clear();
        power_on(&mut world, "c1", true);
        world.run_for(Duration::from_secs(5));
        assert_eq!(world.judged, [], "not before others had time to say what they know");
        world.verdict = verdict.map(str::to_owned);
        world.run_for(Duration::from_secs(25));
        assert_eq!(world.judged.iter().filter(|one| **one == ("c1".to_owned(), deployment(1))).count(), 1, "once");
        assert_eq!(runs(&world), if verdict.is_none() { on_both(2) } else { BTreeSet::new() });
        if let Some(why) = verdict {
            let Answer::Report(Report::Refused { reasons }) = told(&mut world, 1) else {
                panic!("{:?}", told(&mut world, 1))
            };
            assert_eq!(reasons, [format!("the deployment is not resumed: {why}")]);
            assert!(world.kept["c1"].is_empty(), "it is forgotten");
        }
    }
}

fn stop_away(world: &mut World, host: &str, epoch: u64) -> Answer {
    let tombstone = Tombstone { home: "c1".into(), deployment: deployment(epoch) };
    let call = world.ask(host, Request::StopAway(Box::new(tombstone)));
    world.run_for(Duration::from_millis(1));
    world.answers[&call].first().cloned().expect("it is answered")
}

/// A user has stopped it while its home was away. Whether the home was rebooted or only cut off, nothing of it runs on,
/// and the tombstone is gone once the home has heard of it. A tombstone of an earlier deployment has no effect.
#[test]
fn what_was_stopped_while_its_home_was_away_is_not_resumed() {
    for (is_rebooted, is_late, epoch, runs_on) in [
        (true, false, 1, false),
        (true, false, 0, true),
        (true, true, 1, false),
        (false, false, 1, false),
        (false, false, 0, true),
    ] {
        let case = (is_rebooted, is_late, epoch);
        let mut world = World::new(&["c1", "c2", "c3"]);
        world.deploy("c1", &LONG.replace("Sensor(\"c2\")", "Sensor(\"c1\")"));
        world.run_for(Duration::from_secs(1));
        if is_rebooted {
            power_off(&mut world, "c1");
        } else {
            world.cut.insert("c1".to_owned());
            for other in ["c2", "c3"] {
                world.at(1, other, Coming::Input(Input::Vanished { host: "c1".into(), boot: 1 }));
            }
        }
        world.run_for(Duration::from_secs(20));
        assert_eq!(stop_away(&mut world, "c3", epoch), Answer::Stop(StopReply::Stopped), "{case:?}");
        assert_eq!(stop_away(&mut world, "c3", epoch), Answer::Stop(StopReply::Stopped), "{case:?}");
        assert_eq!(world.tombstones["c3"].len(), 1);
        if is_late {
            // The host with the tombstone is away itself.
            power_off(&mut world, "c3");
        }
        if is_rebooted {
            power_on(&mut world, "c1", true);
        } else {
            world.cut.remove("c1");
            for other in ["c2", "c3"] {
                world.at(1, other, Coming::Input(Input::Appeared { host: "c1".into(), boot: 1 }));
            }
        }
        world.run_for(Duration::from_secs(30));
        if is_late {
            assert_eq!(runs(&world), [(2, "c1".to_owned())].into(), "nobody has told it");
            power_on(&mut world, "c3", true);
            world.run_for(Duration::from_secs(30));
        }
        let expected = if is_rebooted { 2 } else { 1 };
        let expected = if runs_on { [(expected, "c1".to_owned())].into() } else { BTreeSet::new() };
        assert_eq!(runs(&world), expected, "{case:?}");
        assert_eq!(world.kept["c1"].len(), usize::from(runs_on), "{case:?}");
        assert_eq!(world.tombstones["c3"], [], "{case:?}: its home has heard of it");
    }
}

#[test]
fn a_home_that_answers_is_asked_itself() {
    let mut world = World::new(&["c1", "c2"]);
    world.run_for(Duration::from_secs(1));
    let refused = Answer::Refused("`c1` answers: `dca stop test` ends it there".to_owned());
    assert_eq!(stop_away(&mut world, "c2", 1), refused);
    let refused = Answer::Refused("`test` has its home here: `dca stop test` ends it".to_owned());
    assert_eq!((stop_away(&mut world, "c1", 1), world.tombstones.len()), (refused, 0));
}

/// A change of `on_boot` counts from the moment when it is made.
#[test]
fn a_change_says_what_the_next_reboot_does() {
    let mut world = World::new(&["c1", "c2"]);
    world.deploy("c1", LONG);
    world.run_for(Duration::from_secs(1));
    for (text, revision, resumes) in [(LONG.replace("resume", "none"), 0, false), (LONG.to_owned(), 1, true)] {
        world.change("c1", &text, (1, revision), &[]);
        world.run_for(Duration::from_secs(10));
        assert_eq!(world.kept["c1"][&1].resume.is_some(), resumes, "{text}");
    }
}

/// A node that is killed and restarted in the same boot adopts the running programs, and its disk keeps the right
/// state.
#[test]
fn a_node_that_takes_over_keeps_what_is_kept() {
    let mut world = World::new(&["c1", "c2"]);
    world.deploy("c1", LONG);
    world.run_for(Duration::from_secs(1));
    world.crash("c1");
    // It may have died before writing it.
    world.kept.clear();
    world.adopt("c1");
    world.run_for(Duration::from_secs(1));
    assert_eq!((runs(&world), world.kept["c1"].len()), (on_both(1), 1));
    world.stop("c1");
    world.run_for(Duration::from_secs(10));
    assert_eq!(world.kept["c1"].len(), 0);
}
