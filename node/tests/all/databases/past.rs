//! Questions about earlier states, and answers that come in parts.

use super::*;

#[test]
fn another_moment_can_be_looked_at() {
    let mut world = World::team(&["r1"]);
    world.write(0, "team/a", 1);
    let Reply::Version(before) = world.ask(0, Question::Version(AsOf::Now)) else { panic!("no version") };
    world.run(Duration::from_secs(60));
    world.write(0, "team/a", 2);
    let (from, to, prefix) = (AsOf::Version(before), AsOf::Now, String::from("team/"));
    let Reply::Differences(differences) = world.ask(0, Question::Diff { from, to, prefix }) else {
        panic!("no answer")
    };
    assert_eq!((differences.len(), differences[0].before.clone()), (1, Some(Datum::from(1))));
    let past = AsOf::Date(world.wall().millis - 30_000);
    let Reply::Entries(entries) = world.ask(0, Question::List { prefix: "team/".into(), at: past }) else {
        panic!("no answer")
    };
    let value = entries[0].1[0].value.as_ref().map(Datum::of);
    assert_eq!((entries.len(), value), (1, Some(Datum::from(1))));
    assert_eq!(world.robots[0].name, "r1");
}

#[test]
fn who_joined_later_can_look_back_to_then() {
    let mut world = World::team(&["r1", "r2"]);
    world.write(1, "team/a", 1);
    let Reply::Version(before) = world.ask(1, Question::Version(AsOf::Now)) else { panic!("no version") };
    world.run(Duration::from_secs(60));
    world.write(1, "team/a", 2);
    for at in [AsOf::Version(before), AsOf::Date(world.wall().millis - 30_000)] {
        let answer = world.ask(1, Question::List { prefix: "team/".into(), at });
        let Reply::Entries(entries) = &answer else { panic!("{answer:?}") };
        let value = entries[0].1[0].value.as_ref().map(Datum::of);
        assert_eq!((entries.len(), value), (1, Some(Datum::from(1))));
    }
}

#[test]
fn a_long_answer_comes_in_parts() {
    let mut world = World::team(&["r1"]);
    let text = Datum::Text("x".repeat(60 << 10));
    for number in 0..12 {
        let write = vec![put(&format!("team/{number}"), &text)];
        assert!(matches!(world.ask(0, commit(write, AckLevel::Local)), Reply::Committed(_)));
    }
    let keys = Keys::Below("team/".into());
    let filter = Filter { keys, by: None, from: None, until: None, limit: 100 };
    let (from, to, prefix) = (AsOf::Version(VersionVector::default()), AsOf::Now, "team/".to_owned());
    for question in [Question::History(filter), Question::Diff { from, to, prefix }] {
        let call = world.call(0, question);
        let sizes = world.replies(0, call).iter().map(|reply| match reply {
            Reply::History(part) => part.len(),
            Reply::Differences(part) => part.len(),
            other => panic!("{other:?}"),
        });
        let sizes: Vec<usize> = sizes.collect();
        assert!(
            sizes.iter().sum::<usize>() == 12 && sizes.len() > 2 && sizes.iter().all(|size| *size < 6),
            "{sizes:?}"
        );
    }
}

/// The keys that a robot lacks are the changes since the part of this copy that it has too.
#[test]
fn what_a_robot_lacks_is_listed() {
    let mut world = World::team(&["r1", "r2", "r3"]);
    world.write(0, "team/a", 1);
    world.run(Duration::from_secs(2));
    world.away(&[2], true);
    world.write(0, "team/a", 2);
    world.write(1, "team/b", 3);
    world.run(Duration::from_secs(2));
    let lacked = |world: &mut World, robot: &str| {
        let (from, to, prefix) = (AsOf::On(robot.to_owned()), AsOf::Now, "team/".to_owned());
        let answer = world.ask(0, Question::Diff { from, to, prefix });
        let Reply::Differences(all) = &answer else { panic!("{answer:?}") };
        all.iter().map(|one| one.key.to_string()).collect::<Vec<_>>()
    };
    assert_eq!(lacked(&mut world, "r3"), ["team/a", "team/b"]);
    assert_eq!((lacked(&mut world, "r2"), lacked(&mut world, "r1")), (vec![], vec![]));
    let unknown = world.ask(0, Question::Version(AsOf::On("r9".to_owned())));
    assert!(matches!(&unknown, Reply::Refused(why) if why.contains("no robot `r9`")), "{unknown:?}");
    world.away(&[2], false);
    world.run(Duration::from_secs(5));
    assert_eq!(lacked(&mut world, "r3"), Vec::<String>::new());
}
