use super::*;
use crate::logic::txn::Draft;
use crate::logic::version_vector::{Dot, ReplicaId};
use crate::logic::view::tests::{Robot, Step, heal, key, play, steps};
use crate::logic::view::token;
use proptest::prelude::*;
use std::collections::BTreeMap;

fn all() -> Keys {
    Keys::Below(String::new())
}

/// Returns all notifications that are available now.
fn drain(watch: &mut Watch, robot: &Robot) -> Vec<Notification> {
    let mut all = Vec::new();
    loop {
        let Notifications { list, more } = watch.next(&robot.past(), 2);
        all.extend(list);
        if !more {
            return all;
        }
    }
}

fn dots(notifications: &[Notification]) -> Vec<Dot> {
    let dot = |one: &Notification| {
        let Notification::Event(event) = one else { panic!("{one:?}") };
        event.entry.dot
    };
    notifications.iter().map(dot).collect()
}

/// A watcher of one robot with little room, which checks its notifications.
struct Watcher {
    watch: Watch,
    /// The transactions that were reported to it, or that it has read in the state.
    has: VersionVector,
    lagged: usize,
}

impl Watcher {
    fn look(
        &mut self,
        robot: &Robot,
        room: usize,
        contexts: &BTreeMap<Dot, VersionVector>,
    ) -> Result<(), TestCaseError> {
        let Notifications { list, more } = self.watch.next(&robot.past(), room);
        prop_assert!(list.len() <= room.max(1) && !(more && list.is_empty()));
        for one in list {
            match one {
                Notification::Event(event) => {
                    let dot = event.entry.dot;
                    prop_assert_eq!(self.has.get(dot.origin) + 1, dot.seq, "each once, none left out");
                    prop_assert!(self.has.dominates(&contexts[&dot]), "after all that it had seen");
                    self.has.include(dot);
                }
                Notification::Lagged { resume } => {
                    self.lagged += 1;
                    prop_assert!(resume.dominates(&self.has));
                    self.has = resume;
                }
                Notification::Replaced { .. } => prop_assert!(false, "nothing was replaced"),
            }
        }
        prop_assert_eq!(self.watch.position(), &self.has);
        Ok(())
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]

    #[test]
    fn each_transaction_once_or_told_of_the_gap(
        steps in steps(),
        rooms in proptest::collection::vec(0_usize..3, 1..20),
        forget in proptest::option::of(0_usize..2000),
    ) {
        let mut team = Robot::team(3);
        let begin = Watch::new(all(), VersionVector::default(), &team[0].log).unwrap();
        let mut watcher = Watcher { watch: begin, has: VersionVector::default(), lagged: 0 };
        let mut rooms = rooms.into_iter().cycle();
        for step in steps.chunks(1) {
            play(&mut team, step, |_| ());
            // The context of each transaction does not change; a complete log shows it.
            let mut contexts = BTreeMap::new();
            team[0].past().walk(&BTreeMap::new(), |txn, seen| drop(contexts.insert(txn.dot(), seen.clone())));
            watcher.look(&team[0], rooms.next().unwrap(), &contexts)?;
            if let (Some(size), Step::Write(..)) = (forget, &step[0]) {
                // Other robots must still be served: only transactions that all of them have may be dropped.
                let mut common = team[0].vector();
                team.iter().for_each(|robot| common.meet(robot.log.vector()));
                team[0].forget_within(&common, size);
            }
        }
        let whole = forget.is_none();
        let last = team[0].clone();
        for _ in 0..100 {
            let mut contexts = BTreeMap::new();
            last.past().walk(&BTreeMap::new(), |txn, seen| drop(contexts.insert(txn.dot(), seen.clone())));
            watcher.look(&last, 3, &contexts)?;
        }
        prop_assert_eq!(&watcher.has, last.log.vector());
        prop_assert!(!whole || watcher.lagged == 0);
    }
}

#[test]
fn watch_resume_after_compaction() {
    let mut team = Robot::team(1);
    let mut watch = Watch::new(all(), team[0].vector(), &team[0].log).unwrap();
    let notified = team[0].put("", "team/a", "1");
    assert_eq!(dots(&drain(&mut watch, &team[0])), [notified]);
    let text = token::token(watch.position());
    drop(watch);
    let missed = team[0].put("", "team/a", "2");
    let resume = |robot: &Robot| Watch::new(all(), token::vector(&text).unwrap(), &robot.log);
    assert_eq!(dots(&drain(&mut resume(&team[0]).unwrap(), &team[0])), [missed], "nothing is told twice");
    team[0].forget(0);
    let refused = resume(&team[0]).unwrap_err();
    assert_eq!(refused, AsOfError::Compacted { oldest: team[0].vector() }, "what was missed cannot be told any more");
    assert!(Watch::new(all(), team[0].vector(), &team[0].log).is_ok());
}

#[test]
fn slow_watcher() {
    let mut team = Robot::team(1);
    let mut watch = Watch::new(all(), team[0].vector(), &team[0].log).unwrap();
    let names: Vec<Dot> = (0..100).map(|number| team[0].put("", "team/a", &number.to_string())).collect();
    assert_eq!(
        watch.next(&team[0].past(), 0),
        Notifications { list: vec![], more: false },
        "no room: it keeps its place"
    );
    let first = watch.next(&team[0].past(), 3);
    assert_eq!((dots(&first.list), first.more), (names[..3].to_vec(), true));
    team[0].forget(0);
    let resume = team[0].vector();
    assert_eq!(drain(&mut watch, &team[0]), [Notification::Lagged { resume }]);
    let next = team[0].put("", "team/a", "100");
    assert_eq!(dots(&drain(&mut watch, &team[0])), [next]);
}

#[test]
fn goes_on_at_another_robot() {
    let mut team = Robot::team(2);
    let mut watch = Watch::new(all(), team[0].vector(), &team[0].log).unwrap();
    let first = team[0].put("", "team/a", "1");
    assert_eq!(dots(&drain(&mut watch, &team[0])), [first]);
    let mut elsewhere = Watch::new(all(), watch.position().clone(), &team[1].log).unwrap();
    let second = team[1].put("", "team/b", "1");
    assert_eq!(dots(&drain(&mut elsewhere, &team[1])), [second], "what has not arrived there is known already");
    heal(&mut team);
    assert_eq!(drain(&mut elsewhere, &team[1]), []);
}

#[test]
fn only_what_is_watched_and_whole() {
    let mut team = Robot::team(2);
    let mut watch = Watch::new(Keys::Below("team/cam/".into()), team[0].vector(), &team[0].log).unwrap();
    team[0].put("", "team/arm", "1");
    let both = Draft::new("").put(key("team/cam/a"), b"1").put(key("team/cam/b"), b"1").delete(key("team/arm"));
    team[0].commit(both);
    team[1].put("", "team/cam/b", "2");
    heal(&mut team);
    let notifications = drain(&mut watch, &team[0]);
    let events: Vec<(usize, usize, usize)> = notifications
        .iter()
        .map(|one| {
            let Notification::Event(event) = one else { panic!("{one:?}") };
            (event.entry.changes.len(), event.entry.others, event.conflicts.len())
        })
        .collect();
    assert_eq!(events, [(2, 1, 1), (1, 0, 1)]);
    assert_eq!(watch.position(), team[0].log.vector(), "what is not watched is behind it, too");
}

#[test]
fn begins_anew_when_the_state_was_replaced() {
    let mut team = Robot::team(2);
    let mut watch = Watch::new(all(), team[0].vector(), &team[0].log).unwrap();
    team[0].put("", "team/a", "1");
    // The robot was retired while it was away, and begins under a new origin with the other robot's data.
    let mut anew = team[1].clone();
    anew.origin = ReplicaId::new(9);
    watch.replaced();
    assert_eq!(drain(&mut watch, &anew), [Notification::Replaced { resume: anew.vector() }]);
    let next = anew.put("", "team/a", "1");
    assert_eq!(dots(&drain(&mut watch, &anew)), [next]);
}
