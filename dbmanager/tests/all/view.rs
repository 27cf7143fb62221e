//! The views of real replicas: two robots that write while they are cut off from each other, and then meet. In some
//! tests, one of them was retired while it was away.

#![expect(clippy::unwrap_used, reason = "it is a test")]

use comms::logic::time::Time;
use dbmanager::logic::clock::{Quality, Wall};
use dbmanager::logic::key::Key;
use dbmanager::logic::message::Message;
use dbmanager::logic::record::Records;
use dbmanager::logic::replica::{AckLevel, Answer, CommitRequest, Config, Effect, Input, Replica};
use dbmanager::logic::txn::{Draft, Grant};
use dbmanager::logic::version_vector::VersionVector;
use dbmanager::logic::view::conflict::Race;
use dbmanager::logic::view::past::{Filter, HistoryEntry, Keys, Past};
use dbmanager::logic::view::transfer::{self, Absent};
use dbmanager::logic::view::value::Datum;
use dbmanager::logic::view::watch::{Event, Notification, Watch};
use std::time::Duration;

fn key(text: &str) -> Key {
    Key::new(text).unwrap()
}

fn past(replica: &Replica) -> Past<'_> {
    Past { log: replica.log(), state: replica.state() }
}

/// A robot, with a client that watches it.
struct Robot {
    replica: Replica,
    watch: Watch,
    notifications: Vec<Notification>,
}

/// Two robots, and the time.
struct Team {
    now: Time,
    robots: Vec<Robot>,
}

impl Team {
    /// Returns a team of which both robots are members.
    fn new() -> Self {
        let mut team = Self::strangers();
        team.meet();
        assert!(team.robots.iter().all(|robot| robot.replica.is_member()));
        team
    }

    /// Returns a team of which `r1` is a member, and `r2` is about to become one.
    fn strangers() -> Self {
        let robot = |number: u64| {
            let config = Config { robot: format!("r{number}"), seed: number, log_size: 1 << 20 };
            let replica = Replica::open(config, &Records::new()).unwrap();
            let watch = Watch::new(Keys::Below("team/".into()), VersionVector::default(), replica.log()).unwrap();
            Robot { replica, watch, notifications: Vec::new() }
        };
        let mut team = Self { now: Time::ZERO, robots: vec![robot(1), robot(2)] };
        team.handle(0, Input::Found(team.wall()), false);
        team
    }

    fn wall(&self) -> Wall {
        let since = u64::try_from(self.now.since(Time::ZERO).as_millis()).unwrap();
        Wall { millis: 1_795_255_200_000 + since, quality: Quality::Network }
    }

    /// Gives an input to a robot, and passes its messages to the other one if they can reach each other.
    fn handle(&mut self, at: usize, input: Input, hears: bool) -> Vec<Answer> {
        let (mut answers, mut messages) = (Vec::new(), vec![(at, input)]);
        while let Some((at, input)) = messages.pop() {
            let (wall, mut effects) = (self.wall(), Vec::new());
            let Robot { replica, watch, notifications } = &mut self.robots[at];
            replica.handle(self.now, input, &mut effects);
            let from = replica.address();
            for effect in effects {
                let message: Option<Message> = match effect {
                    Effect::Broadcast(message) | Effect::Send(_, message) => Some(message),
                    Effect::Answer(_, answer) => {
                        answers.push(answer);
                        None
                    }
                    Effect::Replaced => {
                        watch.replaced();
                        None
                    }
                    Effect::Persist(_) | Effect::Visible(..) | Effect::Renamed(..) | Effect::Alarm(_) => None,
                };
                if let Some(message) = message.filter(|_| hears) {
                    messages.insert(0, (1 - at, Input::Received(from, message, wall)));
                }
            }
            notifications.extend(watch.next(&past(replica), 16).list);
        }
        answers
    }

    /// Connects the two robots for a minute.
    fn meet(&mut self) {
        for _ in 0..120 {
            self.now = self.now + Duration::from_millis(500);
            for at in 0..2 {
                self.handle(at, Input::Tick(self.wall()), true);
            }
        }
    }

    /// Commits on an isolated robot.
    fn commit(&mut self, at: usize, draft: Draft) {
        self.now = self.now + Duration::from_secs(1);
        self.commit_when(self.wall(), at, draft);
    }

    fn commit_when(&mut self, wall: Wall, at: usize, draft: Draft) {
        let request = CommitRequest { ticket: 1, draft, level: AckLevel::Local, until: self.now };
        let answers = self.handle(at, Input::Commit(vec![request], wall), false);
        assert!(matches!(answers[..], [Answer::Committed(_)]), "{answers:?}");
    }

    fn retire(&mut self, at: usize) {
        self.now = self.now + Duration::from_secs(1);
        let origin = self.robots[at].replica.origin();
        self.handle(1 - at, Input::Retire(origin, self.wall()), false);
    }

    /// Returns the races below a prefix that r2 knows. The log of r1 does not reach back so far if it was retired.
    fn races(&self, prefix: &str) -> Vec<Race> {
        past(&self.robots[1].replica).races(prefix)
    }

    fn put(&mut self, at: usize, why: &str, to: &str, number: i64) {
        self.commit(at, Draft::new(why).put(key(to), Datum::Integer(number).encode().unwrap()));
    }

    fn history(&self, at: usize, of: &str) -> Vec<HistoryEntry> {
        let mut history = past(&self.robots[at].replica).history(&Filter::new(Keys::Only(key(of)), 100));
        history.sort_by_key(|entry| entry.when);
        history
    }
}

/// Returns the reasons that were reported to a watcher since it last had to start again.
fn reasons(notifications: &[Notification]) -> Vec<&str> {
    let events = notifications.iter().rev().map_while(|one| match one {
        Notification::Event(event) => Some(event.entry.reason.as_str()),
        Notification::Lagged { .. } | Notification::Replaced { .. } => None,
    });
    let mut reasons: Vec<&str> = events.collect();
    reasons.reverse();
    reasons
}

#[test]
fn two_robots_that_did_not_hear_each_other() {
    let mut team = Team::new();
    team.put(0, "one", "team/gain", 1);
    let early = (team.robots[0].replica.log().vector().clone(), team.robots[0].replica.state().clone());
    team.put(1, "two", "team/gain", 2);
    team.put(1, "three", "team/rate", 3);
    team.meet();
    let replicas = || team.robots.iter().map(|robot| &robot.replica);
    let conflicts: Vec<_> = replicas().map(|replica| past(replica).conflicts("")).collect();
    assert_eq!(conflicts[0], conflicts[1]);
    let told: Vec<(&str, Option<&str>)> =
        conflicts[0][0].versions.iter().map(|one| (one.by.as_str(), one.reason.as_deref())).collect();
    assert_eq!(told, [("r1", Some("one")), ("r2", Some("two"))]);
    assert_eq!(team.history(0, "team/gain"), team.history(1, "team/gain"));
    assert!(team.history(0, "team/gain").iter().all(|entry| entry.concurrent.len() == 1));
    let mut seen: Vec<Vec<&str>> = team.robots.iter().map(|robot| reasons(&robot.notifications)).collect();
    seen[1].sort_unstable();
    assert_eq!(seen, [vec!["one", "two", "three"], vec!["one", "three", "two"]], "each transaction once");
    let shown = past(&team.robots[0].replica).at(&early.0, None).unwrap();
    assert_eq!(shown.digest(), early.1.digest());
    let file = transfer::export(team.robots[0].replica.state(), "team/");
    assert_eq!(file, transfer::export(team.robots[1].replica.state(), "team/"));
    let plan = transfer::import(&file.replace("= 2", "= 5"), &early.1, Absent::Delete, "").unwrap();
    assert_eq!(plan.differences.len(), 2);
}

#[test]
fn retired_while_away_returns_with_writes() {
    let mut team = Team::new();
    let away = team.robots[1].replica.origin();
    team.put(1, "while away", "team/gain", 2);
    let told_there = team.robots[1].watch.position().clone();
    team.retire(1);
    team.meet();
    let Robot { replica, notifications, .. } = &team.robots[1];
    assert_ne!(replica.origin(), away, "it goes on under another name");
    assert!(
        notifications.iter().any(|one| matches!(one, Notification::Replaced { .. })),
        "and whoever watched it reads anew: {notifications:?}"
    );
    for at in 0..2 {
        let history = team.history(at, "team/gain");
        let last = history.last().unwrap();
        assert_eq!((last.by.as_str(), last.reason.as_str()), ("r2", "while away"), "nothing was lost");
        assert_eq!(last.before.map(|dot| dot.origin), Some(away));
    }
    let known = |one: &Notification| matches!(one, Notification::Event(event) if matches!(&**event, Event { entry, .. } if entry.by == "r2"));
    assert!(team.robots[0].notifications.iter().any(known));
    let here = past(&team.robots[0].replica);
    let mut elsewhere = Watch::new(Keys::Below("team/".into()), told_there, here.log).unwrap();
    assert_eq!(elsewhere.next(&here, 16).list, vec![], "who was told there is not told again here");
}

#[test]
fn what_was_written_before_joining_has_an_author() {
    let mut team = Team::strangers();
    team.put(0, "one", "team/gain", 1);
    team.put(1, "two", "team/gain", 2);
    team.meet();
    for at in 0..2 {
        let by_r2 = Filter { by: Some("r2".into()), ..Filter::new(Keys::Only(key("team/gain")), 100) };
        let here = past(&team.robots[at].replica);
        let reasons: Vec<_> = here.history(&by_r2).into_iter().map(|entry| entry.reason).collect();
        assert_eq!(reasons, ["two"], "{at}");
        let authors: Vec<_> = here.conflicts("")[0].versions.iter().map(|one| one.by.clone()).collect();
        assert_eq!(authors, ["r1", "r2"], "{at}");
    }
}

/// A conflict is shown in the order of the timestamps, so dates refer to this order. A robot that joins later changes
/// neither order nor dates.
#[test]
fn what_was_written_before_joining_has_its_own_date() {
    let mut team = Team::strangers();
    team.put(1, "two", "team/gain", 2);
    let written = team.wall().millis;
    team.put(0, "one", "team/gain", 1);
    let after = team.wall().millis;
    team.now = team.now + Duration::from_secs(3600);
    team.meet();
    for at in 0..2 {
        let here = past(&team.robots[at].replica);
        let conflict = &here.conflicts("")[0];
        let told: Vec<_> = conflict.versions.iter().map(|one| (one.by.as_str(), one.when.millis)).collect();
        assert_eq!(told, [("r2", written), ("r1", after)], "{at}");
        assert!(!conflict.versions[0].when.trusted, "it is the date of its timestamp, not of a clock");
        let history = team.history(at, "team/gain");
        let told: Vec<_> = history.iter().map(|entry| (entry.reason.as_str(), entry.when.millis)).collect();
        // A robot that has joined begins with a state, and its log begins with its rebased transactions.
        let kept = if at == 0 { &[("two", written), ("one", after)][..] } else { &[("two", written)] };
        assert_eq!(told, kept, "{at}");
        let early = Filter { until: Some(after), ..Filter::new(Keys::Only(key("team/gain")), 100) };
        let reasons: Vec<_> = here.history(&early).into_iter().map(|entry| entry.reason).collect();
        assert_eq!(reasons, ["two"], "{at}");
    }
}

fn give(prefix: &str, robot: Option<&str>) -> Draft {
    Draft::new("give").grant(key(prefix), Grant::Give(robot.map(str::to_owned)))
}

fn take_over(prefix: &str, robot: &str) -> Draft {
    Draft::new("r1 is lost").grant(key(prefix), Grant::TakeOver(robot.to_owned()))
}

#[test]
fn what_is_written_unaware_of_an_owner_is_listed() {
    // (the prefix, whether it was granted to r1 before, whether r1 has no clock, whether r1 is retired)
    let cases = [
        ("team/arm", true, false, false),
        ("team/arm", true, true, false),
        ("team/arm", true, false, true),
        ("team/arm", true, true, true),
        ("team/arm", false, false, false),
        ("team/arm", false, true, true),
        ("robot/r1", false, false, false),
        ("robot/r1", false, true, false),
        ("robot/r1", true, false, true),
    ];
    for case @ (prefix, granted, no_clock, retired) in cases {
        let mut team = Team::new();
        if granted {
            team.commit(0, give(prefix, Some("r1")));
            team.meet();
        }
        let late = Wall { millis: team.wall().millis + 600_000, ..team.wall() };
        team.commit_when(late, 1, take_over(prefix, "r2"));
        team.put(1, "its owner by now", &format!("{prefix}/speed"), 1);
        let wall = if no_clock { Wall { millis: 0, quality: Quality::Unset } } else { team.wall() };
        let written = Datum::Integer(2).encode().unwrap();
        team.commit_when(wall, 0, Draft::new("unaware").put(key(&format!("{prefix}/mode")), written));
        if retired {
            team.retire(0);
        }
        team.meet();
        let races = team.races(&format!("{prefix}/"));
        let told: Vec<_> = races.iter().map(|race| (&race.relied.reason[..], &race.changed.reason[..])).collect();
        assert_eq!(told, [("unaware", "r1 is lost")], "{case:?}");
        assert_eq!(team.races(""), races, "once: {case:?}");
        assert!(retired || past(&team.robots[0].replica).races("") == races, "{case:?}");
        team.put(1, "seen", &format!("{prefix}/mode"), 3);
        team.meet();
        assert_eq!(team.races(""), vec![], "settled by a write that has seen both: {case:?}");
    }
}

#[test]
fn what_its_owner_writes_is_not_listed() {
    for retired in [false, true] {
        let mut team = Team::new();
        let mut before = |at: usize, draft: Draft| {
            team.commit(at, draft);
            team.meet();
        };
        before(1, give("team/arm", Some("r2")));
        before(1, give("team/arm", Some("r1")));
        before(0, give("team/leg", Some("r2")));
        before(1, give("team/leg/left", Some("r1")));
        before(1, give("team/old", Some("r2")));
        before(1, give("team/old", None));
        team.commit(1, take_over("team/arm", "r1"));
        team.commit(1, take_over("team/leg", "r2"));
        team.commit(1, take_over("robot/r1", "r1"));
        for at in ["team/arm/x", "team/leg/left/x", "team/old/x", "robot/r1/x"] {
            team.put(0, "its own", at, 1);
        }
        team.put(1, "its own", "team/leg/x", 1);
        if retired {
            team.retire(0);
        }
        team.meet();
        assert!(past(&team.robots[1].replica).state.get(&key("team/leg/left/x")).is_some());
        assert_eq!(team.races(""), vec![], "retired: {retired}");
    }
}
