//! The answers of several robots' databases to their callers.

#![expect(clippy::wildcard_enum_match_arm, reason = "a test looks for one variant and shows any other")]

mod failing;
mod past;
mod world;

use dbmanager::logic::message::Message;
use dbmanager::logic::record::Records;
use dbmanager::logic::replica::{Config, Replica};
use dbmanager::logic::txn::{Condition, Require, Write};
use dbmanager::logic::version_vector::{Dot, ReplicaId, VersionVector};
use dbmanager::logic::view::as_of::state_of;
use dbmanager::logic::view::past::{Filter, Keys};
use dbmanager::logic::view::transfer::{self, Absent};
use dbmanager::logic::view::value::Datum;
use node::logic::database::question::{AckLevel, AsOf, Choice, Commit, Envelope, Own, Question, Reply, Resolve};
use node::logic::database::{Database, Effect, Input};
use std::collections::BTreeSet;
use std::time::Duration;
use world::{World, commit, key_of, open, put};

#[test]
fn a_team_is_begun_once_and_takes_along_what_was_written_before() {
    let mut world = World::new(&["r1", "r2", "r3"]);
    let early = world.call(2, commit(vec![put("team/early", &Datum::from(1))], AckLevel::Local));
    assert!(matches!(world.replies(2, early), [Reply::Note(_), Reply::Committed(_)]));
    assert!(matches!(world.ask(0, Question::Found), Reply::Done(_)));
    world.run(Duration::from_secs(5));
    assert_eq!(world.read(1, "team/early"), [Datum::from(1)]);
    let states: BTreeSet<String> = (0..3).map(|robot| world.status(robot).contents.digest).collect();
    assert_eq!(states.len(), 1);
    assert!(matches!(world.ask(1, Question::Found), Reply::Done(said) if said.contains("already")));
}

#[test]
fn no_second_team_where_the_first_can_be_heard() {
    let mut world = World::team(&["r1", "r2"]);
    let disk = Records::new();
    // The newcomer has heard a member, and has not been admitted yet.
    world.robots[1].machine = Database::new(open("r2", &disk, 99), "r2", "dca", None);
    world.robots[1].away = true;
    let hello = {
        let (now, wall, mut effects) = (world.now, world.wall(), Vec::new());
        world.robots[0].machine.handle(now, wall, vec![Input::Appeared], &mut effects);
        effects
            .into_iter()
            .find_map(|effect| if let Effect::Broadcast(envelope) = effect { Some(envelope) } else { None })
    };
    world.robots[1].inbox.push(Input::Envelope(hello.unwrap()));
    assert!(matches!(world.ask(1, Question::Found), Reply::Refused(why) if why.contains("already")));
}

/// A robot whose team has left it joins the other team by itself: whoever orders that meanwhile is not refused.
#[test]
fn the_last_of_a_team_is_told_that_it_joins_by_itself() {
    let mut world = World::new(&["r1", "r2", "r3", "r4"]);
    world.away(&[2, 3], true);
    assert!(matches!(world.ask(0, Question::Found), Reply::Done(_)));
    world.run(Duration::from_secs(5));
    world.away(&[0, 1], true);
    world.away(&[2, 3], false);
    assert!(matches!(world.ask(2, Question::Found), Reply::Done(_)));
    world.run(Duration::from_secs(5));
    world.away(&[0, 1], false);
    world.run(Duration::from_secs(5));
    let join = || Question::Join { robot: "r1".into() };
    assert!(matches!(world.ask(2, join()), Reply::Done(said) if said.contains("asks `r1`")));
    let has_left = |world: &mut World| {
        world.run(Duration::from_millis(1));
        !world.status(3).member
    };
    assert!((0..20_000).any(|_| has_left(&mut world)), "it is alone in its team");
    assert!(matches!(world.ask(3, join()), Reply::Done(said) if said.contains("gives way")));
    world.run(Duration::from_secs(5));
    assert!(world.status(3).members.iter().any(|member| member.robot == "r1"), "{:?}", world.status(3));
}

#[test]
fn how_far_a_write_has_got_is_told_honestly() {
    let mut world = World::team(&["r1", "r2", "r3"]);
    let call = world.call(0, commit(vec![put("team/a", &Datum::from(1))], AckLevel::Everywhere));
    world.run(Duration::from_millis(900));
    assert!(matches!(world.replies(0, call), [Reply::Committed(a), Reply::Reached(b)] if a == b));
    world.away(&[2], true);
    let call = world.call(0, commit(vec![put("team/a", &Datum::from(2))], AckLevel::On(vec!["r3".into()])));
    let one = world.call(0, commit(vec![put("team/b", &Datum::from(2))], AckLevel::Replicated(1)));
    world.run(Duration::from_secs(2));
    assert!(matches!(world.replies(0, call), [Reply::Committed(_), Reply::Pending(_)]));
    assert!(matches!(world.replies(0, one), [Reply::Committed(_), Reply::Reached(_)]));
    let status = world.status(0);
    let r3 = status.members.iter().find(|member| member.robot == "r3").unwrap();
    assert!(r3.pins && r3.lacks.transactions == 2 && status.members.iter().filter(|one| one.pins).count() == 1);
    world.away(&[2], false);
    world.run(Duration::from_millis(100));
    assert_eq!(world.read(2, "team/a"), [Datum::from(2)], "who is back is told at once");
}

#[test]
fn only_the_owner_writes_its_keys() {
    let mut world = World::team(&["r1", "r2"]);
    let key = "robot/r2/gain";
    let refused = world.ask(0, commit(vec![put(key, &Datum::from(1))], AckLevel::Local));
    assert_eq!(refused, Reply::NotOwner { owner: "r2".into() });
    world.write(1, key, 1);
    assert_eq!(world.read(0, key), [Datum::from(1)]);
}

#[test]
fn a_prefix_of_the_team_is_given_released_and_taken_by_force() {
    let mut world = World::team(&["r1", "r2"]);
    let own = |robot: Option<&str>, by_force| {
        let (prefix, robot) = (key_of("team/arm"), robot.map(str::to_owned));
        let (reason, level, within) = (String::new(), AckLevel::Local, Duration::from_secs(1));
        Question::Own(Own { prefix, robot, by_force, reason, level, within })
    };
    let arm = || commit(vec![put("team/arm/x", &Datum::from(1))], AckLevel::Local);
    let not_owner = |owner: &str| Reply::NotOwner { owner: owner.to_owned() };
    for nobody in ["r9", "", "a/b", "r2 "] {
        let refused = world.ask(0, own(Some(nobody), true));
        assert!(matches!(&refused, Reply::Refused(why) if why.contains("its robots are `r1`, `r2`")), "{refused:?}");
    }
    assert_eq!(world.ask(0, Question::Owners), Reply::Owners(vec![]), "nothing was given");
    assert!(matches!(world.ask(0, own(Some("r2"), false)), Reply::Committed(_)));
    world.run(Duration::from_secs(1));
    assert_eq!(world.ask(1, Question::Owners), Reply::Owners(vec![("team/arm".into(), Some("r2".into()))]));
    assert_eq!(world.ask(0, arm()), not_owner("r2"));
    assert_eq!(world.ask(0, own(Some("r1"), false)), not_owner("r2"), "only its owner gives it away");
    assert!(matches!(world.ask(1, arm()), Reply::Committed(_)));
    world.away(&[1], true);
    assert!(matches!(world.ask(0, own(Some("r1"), true)), Reply::Committed(_)), "unless by force");
    assert!(matches!(world.ask(0, arm()), Reply::Committed(_)));
    world.run(Duration::from_secs(1));
    assert!(matches!(world.ask(1, arm()), Reply::Committed(_)), "who is cut off does not know");
    world.away(&[1], false);
    world.run(Duration::from_secs(5));
    let Reply::Conflicts(_, races) = world.ask(0, Question::Conflicts { prefix: String::new() }) else {
        panic!("no answer")
    };
    assert!(races.iter().any(|race| race.relied.by == "r2"), "but it is listed: {races:?}");
    assert!(matches!(world.ask(0, own(None, false)), Reply::Committed(_)));
    world.run(Duration::from_secs(1));
    assert!(matches!(world.ask(1, arm()), Reply::Committed(_)));
}

#[test]
fn a_conflict_is_listed_and_settled_everywhere() {
    let mut world = World::team(&["r1", "r2"]);
    world.away(&[0, 1], true);
    world.write(0, "team/x", 1);
    world.write(1, "team/x", 2);
    world.away(&[0, 1], false);
    world.run(Duration::from_millis(200));
    for robot in 0..2 {
        let Reply::Conflicts(conflicts, _) = world.ask(robot, Question::Conflicts { prefix: "team/".into() }) else {
            panic!("no conflicts")
        };
        let values: BTreeSet<String> =
            conflicts[0].versions.iter().map(|one| one.value.as_ref().unwrap().to_toml()).collect();
        assert_eq!((conflicts.len(), values), (1, ["1".to_owned(), "2".to_owned()].into()));
    }
    let Reply::Conflicts(conflicts, _) = world.ask(0, Question::Conflicts { prefix: "team/".into() }) else {
        panic!("no conflicts")
    };
    let resolve = |choice| resolve(choice, &conflicts[0].seen());
    assert!(matches!(world.ask(0, resolve(Choice::By("r9".into()))), Reply::Refused(why) if why.contains("`r9`")));
    assert!(matches!(world.ask(0, resolve(Choice::By("r1".into()))), Reply::Committed(_)));
    world.run(Duration::from_millis(200));
    for robot in 0..2 {
        assert_eq!(world.read(robot, "team/x"), [Datum::from(1)]);
    }
    assert!(matches!(world.ask(1, resolve(Choice::Shown)), Reply::Done(_)), "there is nothing to settle any more");
    // A choice that came too late, or a key that was misspelt, was not done.
    let late = world.ask(1, resolve(Choice::By("r2".into())));
    assert!(matches!(&late, Reply::Refused(why) if why.contains("nothing was written")), "{late:?}");
    let Question::Resolve(other) = resolve(Choice::Shown) else { panic!("it is a choice") };
    let nothing = world.ask(1, Question::Resolve(Resolve { key: key_of("team/other"), ..other }));
    assert!(
        matches!(&nothing, Reply::Refused(why) if why.ends_with("has neither a conflict nor a value")),
        "{nothing:?}"
    );
}

fn resolve(choice: Choice, seen: &str) -> Question {
    let (key, reason, within, seen) = (key_of("team/x"), String::new(), Duration::from_secs(1), seen.to_owned());
    Question::Resolve(Resolve { key, choice, reason, level: AckLevel::Local, within, seen })
}

/// Each of two robots relies on a key that the other deletes: no key has two values, so the status counts races, and
/// the key is settled as it stands.
#[test]
fn a_race_is_counted_and_settled() {
    let mut world = World::team(&["r1", "r2"]);
    for key in ["team/a", "team/b"] {
        world.write(0, key, 1);
    }
    world.run(Duration::from_millis(200));
    world.away(&[0, 1], true);
    for (robot, relies, deletes) in [(0, "team/b", "team/a"), (1, "team/a", "team/b")] {
        let requires = vec![Require { key: key_of(relies), condition: Condition::Exists }];
        let writes = vec![Write { key: key_of(deletes), value: None }];
        let (reason, level, within) = ("the other is there".to_owned(), AckLevel::Local, Duration::from_secs(1));
        let swap = Question::Commit(Commit { reason, requires, writes, level, within });
        assert!(matches!(world.ask(robot, swap), Reply::Committed(_)));
    }
    world.away(&[0, 1], false);
    world.run(Duration::from_millis(200));
    assert_eq!((world.status(0).contents.conflicts, world.status(0).contents.races), (0, 1));
    let Reply::Conflicts(_, races) = world.ask(0, Question::Conflicts { prefix: String::new() }) else {
        panic!("no answer")
    };
    let settle = |seen: &str| {
        let (reason, level, within) = (String::new(), AckLevel::Local, Duration::from_secs(1));
        let (key, seen) = (races[0].key.clone(), seen.to_owned());
        Question::Resolve(Resolve { key, choice: Choice::Shown, reason, level, within, seen })
    };
    assert!(matches!(world.ask(0, settle("000000000000")), Reply::Refused(_)));
    assert!(matches!(world.ask(0, settle(&races[0].seen)), Reply::Committed(_)));
    world.run(Duration::from_millis(200));
    assert_eq!((world.status(0).contents.races, world.status(1).contents.races), (0, 0));
}

#[test]
fn nobody_settles_what_they_have_not_seen() {
    let mut world = World::team(&["r1", "r2", "r3"]);
    world.away(&[0, 1, 2], true);
    for (number, robot) in (1..).zip(0..3) {
        world.write(robot, "team/x", number);
    }
    world.away(&[0, 1], false);
    world.run(Duration::from_millis(200));
    let Reply::Conflicts(conflicts, _) = world.ask(0, Question::Conflicts { prefix: "team/".into() }) else {
        panic!("no conflicts")
    };
    let seen = conflicts[0].seen();
    assert_eq!(conflicts[0].versions.len(), 2);
    // Between the look and the decision the third robot's write arrives.
    world.away(&[2], false);
    world.run(Duration::from_millis(200));
    let refused = world.ask(0, resolve(Choice::By("r1".into()), &seen));
    assert!(
        matches!(&refused, Reply::Refused(why) if why.contains("no longer those that you have seen")),
        "{refused:?}"
    );
    let refused = world.ask(0, resolve(Choice::By("r1".into()), ""));
    assert!(matches!(&refused, Reply::Refused(why) if why.contains("say which")), "{refused:?}");
    assert_eq!(world.read(0, "team/x").len(), 3, "all of them stand");
}

#[test]
fn a_level_that_nobody_can_reach_is_refused_at_once() {
    let mut world = World::team(&["r1", "r2", "r3"]);
    for (level, part) in [
        (AckLevel::On(vec!["r2".into(), "nobody".into()]), "no member `nobody`"),
        (AckLevel::Replicated(3), "2 robots besides `r1`"),
    ] {
        let refused = world.ask(0, commit(vec![put("team/a", &Datum::from(1))], level));
        assert!(matches!(&refused, Reply::Refused(why) if why.contains(part)), "{refused:?}");
    }
    assert!(world.read(0, "team/a").is_empty(), "nothing was written");
    let mut alone = World::new(&["r1"]);
    for level in [AckLevel::Replicated(1), AckLevel::On(vec!["r2".into()])] {
        let refused = alone.ask(0, commit(vec![put("team/a", &Datum::from(1))], level));
        assert!(matches!(&refused, Reply::Refused(why) if why.contains("`r1` belongs to no team yet")), "{refused:?}");
    }
    world.away(&[2], true);
    let call = world.call(0, commit(vec![put("team/a", &Datum::from(1))], AckLevel::On(vec!["r3".into()])));
    assert!(matches!(world.replies(0, call), [Reply::Committed(_)]), "who is away may come back");
}

#[test]
fn a_key_in_no_namespace_is_refused() {
    let mut world = World::team(&["r1"]);
    for key in ["a", "tean/a", "team", "robot", "robot/r1", "local", "robots/r1/a"] {
        let refused = world.ask(0, commit(vec![put(key, &Datum::from(1))], AckLevel::Local));
        assert!(matches!(&refused, Reply::Refused(why) if why.contains("namespace")), "{key}: {refused:?}");
    }
    for key in ["team/a", "robot/r1/a", "local/a", "team/a/b"] {
        let written = world.ask(0, commit(vec![put(key, &Datum::from(1))], AckLevel::Local));
        assert!(matches!(written, Reply::Committed(_)), "{key}: {written:?}");
    }
}

#[test]
fn what_is_local_is_told_to_nobody_on_another_machine() {
    let mut world = World::team(&["r1", "r2"]);
    world.write(0, "local/serial", 7);
    world.write(0, "team/a", 1);
    let mut ask = |question| {
        world.robots[0].inbox.push(Input::Elsewhere(900, question));
        world.turns();
        world.robots[0].replies.remove(&900).expect("it is answered")
    };
    let requires = vec![Require { key: key_of("local/serial"), condition: Condition::Exists }];
    let (reason, level, within) = (String::new(), AckLevel::Local, Duration::ZERO);
    let probe = Commit { reason, requires, writes: vec![put("team/b", &Datum::from(1))], level, within };
    for question in [
        Question::Get { key: key_of("local/serial") },
        Question::List { prefix: "local/".into(), at: AsOf::Now },
        Question::Export { prefix: "local/".into(), at: AsOf::Now },
        Question::Commit(probe),
        commit(vec![put("local/serial", &Datum::from(8))], AckLevel::Local),
    ] {
        let replies = ask(question);
        assert!(matches!(&replies[..], [Reply::Refused(why)] if why.contains("own machine")), "{replies:?}");
    }
    for prefix in ["", "lo", "local"] {
        for question in [
            Question::List { prefix: prefix.into(), at: AsOf::Now },
            Question::Export { prefix: prefix.into(), at: AsOf::Now },
        ] {
            let told = format!("{:?}", ask(question));
            assert!(!told.contains("serial") && (!prefix.is_empty() || told.contains("team/a")), "{prefix}: {told}");
        }
    }
    let told = ask(commit(vec![put("team/b", &Datum::from(1))], AckLevel::Local));
    assert!(matches!(&told[..], [Reply::Committed(_)]), "{told:?}");
}

#[test]
fn a_name_that_a_robot_left_behind_is_retired_by_one_word() {
    for asked in [0, 1] {
        let mut world = World::team(&["r1", "r2"]);
        // The disk of the first is new: it is admitted under another name.
        world.robots[0].disk = Records::new();
        world.robots[0].machine = Database::new(open("r1", &Records::new(), 99), "r1", "dca", None);
        world.robots[0].address = world.robots[0].machine.address();
        world.run(Duration::from_secs(10));
        assert_eq!(world.status(asked).members.len(), 3, "its old name is still there");
        let several = world.ask(1, Question::Retire { member: "r1".into() });
        assert!(matches!(&several, Reply::Refused(why) if why.contains("dca db retire r1 --older")), "{several:?}");
        let retired = world.ask(asked, Question::RetireOlder { robot: "r1".into() });
        assert!(matches!(&retired, Reply::Done(_)), "{retired:?}");
        world.run(Duration::from_secs(5));
        let members = world.status(1 - asked).members;
        let present = world.robots[0].machine.address();
        assert!(members.len() == 2 && members.iter().any(|member| member.origin == present), "{members:?}");
        let again = world.ask(asked, Question::RetireOlder { robot: "r1".into() });
        assert!(matches!(&again, Reply::Done(said) if said.contains("only one name")), "{again:?}");
    }
}

#[test]
fn a_watcher_hears_of_everything_once_and_goes_on_where_it_was() {
    let mut world = World::team(&["r1", "r2"]);
    let keys = || Keys::Below("team/".into());
    let call = world.call(0, Question::Watch { keys: keys(), from: None });
    let [Reply::Version(from)] = world.replies(0, call) else { panic!("not watching") };
    let from = from.clone();
    let written: Vec<Dot> = (0..200).map(|number| world.write(1, &format!("team/{number}"), number)).collect();
    world.write(1, "robot/r2/other", 1);
    world.run(Duration::from_millis(500));
    assert_eq!(world.told(0, call), written);
    let again = world.call(0, Question::Watch { keys: keys(), from: Some(from) });
    world.run(Duration::from_millis(100));
    assert_eq!(world.told(0, again), written);
    world.robots[0].inbox.push(Input::Gone(call));
    world.write(0, "team/more", 1);
    assert_eq!((world.told(0, call).len(), world.told(0, again).len()), (200, 201));
}

#[test]
fn what_is_local_is_read_like_anything_else() {
    let mut world = World::team(&["r1", "r2"]);
    world.write(0, "local/serial", 7);
    world.write(0, "team/a", 1);
    assert_eq!((world.read(0, "local/serial"), world.read(1, "local/serial")), (vec![Datum::from(7)], vec![]));
    let mut list = |robot, prefix: &str, at| match world.ask(robot, Question::List { prefix: prefix.into(), at }) {
        Reply::Entries(entries) => entries.iter().map(|(key, _)| key.to_string()).collect::<Vec<_>>(),
        Reply::Refused(why) => vec![why],
        other => panic!("{other:?}"),
    };
    assert_eq!(list(0, "local/", AsOf::Now), ["local/serial"]);
    assert_eq!(list(0, "", AsOf::Now)[0], "local/serial");
    assert_eq!(list(1, "local/", AsOf::Now), [""; 0]);
    assert!(list(0, "local/", AsOf::Date(1_700_000_001_000))[0].contains("no history"));
    let Reply::Text(file) = world.ask(0, Question::Export { prefix: "local/".into(), at: AsOf::Now }) else {
        panic!("no file")
    };
    let question = Question::List { prefix: "local/".into(), at: AsOf::Now };
    let Reply::Entries(entries) = world.ask(0, question) else { panic!("no answer") };
    let import = |file: &str| transfer::import(file, &state_of(entries.clone()), Absent::Keep, "").unwrap();
    assert_eq!(import(&file).differences, [], "{file}");
    let differences = import(&file.replace("= 7", "= 8")).differences;
    assert_eq!((differences.len(), differences[0].before.clone()), (1, Some(Datum::from(7))), "{file}");
}

#[test]
fn the_longest_transaction_comes_over_the_slowest_radio() {
    let mut world = World::team(&["r1", "r2"]);
    world.away(&[1], true);
    let text = "x".repeat(60 << 10);
    let writes = (0..4).map(|number| put(&format!("team/{number}"), &Datum::Text(text.clone()))).collect();
    assert!(matches!(world.ask(0, commit(writes, AckLevel::Local)), Reply::Committed(_)));
    world.rate = Some(50_000 / 8);
    world.away(&[1], false);
    world.run(Duration::from_secs(60));
    assert_eq!(world.read(1, "team/3").len(), 1);
}

#[test]
fn the_last_hundred_deployments_of_each_name_are_kept() {
    let mut world = World::team(&["r1"]);
    for epoch in 0..480 {
        let name = if epoch % 4 == 0 { "rare" } else { "often" };
        let key = |what| format!("robot/r1/deployments/{name}/{epoch}/{what}");
        for what in ["begun", "ended"] {
            let question = commit(vec![put(&key(what), &Datum::from(1))], AckLevel::Local);
            world.robots[0].inbox.push(Input::Call(0, question));
            world.turns();
        }
    }
    let mut kept = |name: &str| {
        let prefix = format!("robot/r1/deployments/{name}/");
        let Reply::Text(file) = world.ask(0, Question::Export { prefix, at: AsOf::Now }) else { panic!("no file") };
        let lines = file.lines().filter(|line| line.ends_with("= 1")).map(str::to_owned);
        lines.filter(|line| line.contains("/deployments/")).collect::<Vec<_>>()
    };
    let (often, rare) = (kept("often"), kept("rare"));
    assert_eq!((often.len(), rare.len()), (200, 200));
    assert!(often.iter().any(|line| line.contains("/479/ended")) && !often.iter().any(|line| line.contains("/1/")));
    assert!(rare.iter().any(|line| line.contains("/80/begun")) && !rare.iter().any(|line| line.contains("/76/")));
}

#[test]
fn a_replica_that_is_no_member_retires_nobody() {
    let mut world = World::team(&["r1", "r2"]);
    world.away(&[0], true);
    let config = Config { robot: "r1".into(), seed: 5, log_size: 1 << 20 };
    let copied = Replica::open_copied(config, &world.robots[0].disk).expect("it was written by a replica");
    world.robots[0].machine = Database::new(copied, "r1", "dca", None);
    let answer = world.ask(0, Question::Retire { member: "r2".into() });
    assert!(matches!(&answer, Reply::Refused(why) if why.contains("waits to be admitted")), "{answer:?}");
    let answer = world.ask(1, Question::Retire { member: "r1".into() });
    assert!(matches!(&answer, Reply::Done(_)), "{answer:?}");
}

#[test]
fn strangers_take_no_place_from_members() {
    let mut world = World::team(&["r1", "r2"]);
    let disk = world.robots[0].disk.clone();
    world.robots[0].machine = Database::new(open("r1", &disk, 50), "r1", "dca", None);
    let stranger = |number| Envelope { from: ReplicaId::new(number), message: Message::Ack(VersionVector::default()) };
    let crowd = |from: u64| (from..from + 1100).map(stranger).map(Input::Envelope);
    world.robots[0].inbox.extend(crowd(10_000));
    world.run(Duration::from_secs(12));
    let heard = |world: &mut World| world.status(0).members.iter().filter(|one| one.heard.is_some()).count();
    assert_eq!(heard(&mut world), 1, "there is room for a member");
    world.robots[0].inbox.extend(crowd(20_000));
    assert_eq!(heard(&mut world), 1, "and it stays");
}

#[test]
fn a_peer_may_say_any_number() {
    let mut world = World::team(&["r1", "r2"]);
    let from = world.robots[1].machine.address();
    let said: VersionVector = [(ReplicaId::new(1), u64::MAX), (ReplicaId::new(2), u64::MAX)].into_iter().collect();
    world.robots[0].inbox.push(Input::Envelope(Envelope { from, message: Message::Ack(said) }));
    let status = world.status(0);
    assert_eq!(status.members.iter().find(|one| one.robot == "r2").unwrap().ahead, u64::MAX);
}

#[test]
fn a_schema_is_asked_before_a_value_is_written() {
    let mut world = World::team(&["r1"]);
    let schema = Datum::from_toml("{type = \"float\", min = 0.0, max = 2.0}").unwrap();
    let committed = world.ask(0, commit(vec![put("team/schema/robot/+/params", &schema)], AckLevel::Local));
    assert!(matches!(committed, Reply::Committed(_)), "{committed:?}");
    let mut try_out = |datum| world.ask(0, commit(vec![put("robot/r1/params/door/a/gain", &datum)], AckLevel::Local));
    let refused = try_out(Datum::float(3.0));
    assert!(matches!(&refused, Reply::Refused(why) if why.contains("between 0 and 2")), "{refused:?}");
    assert!(matches!(try_out(Datum::float(1.0)), Reply::Committed(_)));
    assert_eq!(world.robots[0].settings.parameters("door", "main/a"), [("gain".to_owned(), "1.0".to_owned())]);
}
