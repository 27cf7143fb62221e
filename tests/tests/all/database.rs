//! The database of a team: three hosts with one node each, on a network that is cut and repaired.

#![expect(clippy::wildcard_enum_match_arm, reason = "a test looks for one variant and shows any other")]

mod teams;

use comms::io::clock::now;
use comms::io::session::Session;
use comms::logic::{codec, key};
use dbmanager::logic::key::Key;
use dbmanager::logic::state::Version;
use dbmanager::logic::txn::Write;
use dbmanager::logic::version_vector::Dot;
use dbmanager::logic::view::value::Datum;
use dca_tests::cluster::{Cluster, Ended, Host, Network, Program, SOON, Stream, wait_until};
use node::logic::database::question::{AckLevel, AsOf, Commit, Question, Reply, Status};
use node::logic::protocol::{Answer, Request};
use rustix::process::{Pid, Resource, Rlimit, Signal, getuid, prlimit};
use std::collections::BTreeSet;
use std::time::Duration;
use tokio::runtime::Runtime;

const NAMES: [&str; 3] = ["r1", "r2", "r3"];

/// Three robots, and a way to query each of them, whatever the state of the network.
struct Robots {
    // The fields are dropped in this order: the ways, the processes, their folder, the network.
    ways: Vec<Way>,
    nodes: Vec<Program>,
    cluster: Cluster,
    network: Network,
}

/// A connection to one node over the node's own socket.
struct Way {
    host: String,
    session: Session,
    runtime: Runtime,
}

impl Way {
    fn open(host: &Host, name: &str) -> Self {
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(1)
            .enable_all()
            .build()
            .expect("it is as the test has made it");
        let session = runtime
            .block_on(Session::open_client(&host.run_dir().join(name).join("node.sock")))
            .expect("it is as the test has made it");
        Self { host: name.to_owned(), session, runtime }
    }

    /// Asks a question. Returns all answers, or nothing if the node does not answer.
    fn ask(&self, question: Question) -> Option<Vec<Reply>> {
        self.runtime.block_on(async {
            let bytes = codec::encode(&Request::Database(question)).expect("it is as the test has made it");
            let mut replies = self.session.call_stream(&key::rpc(&self.host, "request"), bytes, SOON).ok()?;
            let mut all = Vec::new();
            while let Some(reply) = replies.next().await {
                match codec::decode(&reply.ok()?).expect("it is as the test has made it") {
                    Answer::Database(reply) => all.push(reply),
                    other => panic!("{other:?}"),
                }
            }
            Some(all)
        })
    }

    fn status(&self) -> Status {
        match self.ask(Question::Status).as_deref() {
            Some([Reply::Status(status)]) => (**status).clone(),
            other => panic!("{}: {other:?}", self.host),
        }
    }

    /// Returns the nodes that this node reaches.
    fn sees(&self) -> Vec<String> {
        let bytes = codec::encode(&Request::Status).expect("it is as the test has made it");
        let answer = self
            .runtime
            .block_on(self.session.call(&key::rpc(&self.host, "request"), bytes, SOON))
            .expect("it is as the test has made it");
        match codec::decode(&answer).expect("it is as the test has made it") {
            Answer::Status(status) => status.peers,
            other => panic!("{other:?}"),
        }
    }

    /// Writes all of these in one transaction. Returns the name of the transaction once it is acknowledged.
    fn write(&self, writes: &[(&str, &str)]) -> Option<Dot> {
        let write = |(key, value): &(&str, &str)| Write {
            key: Key::new(*key).expect("it is as the test has made it"),
            value: Some(Datum::from(*value).encode().expect("it is as the test has made it")),
        };
        let commit = Commit {
            reason: "a test".to_owned(),
            requires: vec![],
            writes: writes.iter().map(write).collect(),
            level: AckLevel::Local,
            within: SOON,
        };
        self.ask(Question::Commit(commit))?.iter().find_map(|reply| match reply {
            Reply::Committed(dot) => Some(*dot),
            Reply::Note(_) => None,
            other => panic!("{}: {other:?}", self.host),
        })
    }

    fn list(&self, prefix: &str) -> Vec<(Key, Vec<Version>)> {
        let replies = self
            .ask(Question::List { prefix: prefix.to_owned(), at: AsOf::Now })
            .expect("it is as the test has made it");
        let entries = replies.into_iter().map(|reply| match reply {
            Reply::Entries(entries) => entries,
            other => panic!("{other:?}"),
        });
        entries.flatten().collect()
    }
}

impl Robots {
    /// Starts three robots. The robots in `apart` cannot reach each other.
    fn start(apart: &[usize]) -> Option<Self> {
        let (cluster, network) = (Cluster::new(), Network::new(3)?);
        network.keep_apart(apart);
        let mut robots = Self { ways: Vec::new(), nodes: Vec::new(), cluster, network };
        for number in 1..=3 {
            robots.nodes.push(robots.host(number).node(NAMES[number - 1], &["--lan"]));
            robots.ways.push(Way::open(&robots.host(number), NAMES[number - 1]));
        }
        Some(robots)
    }

    fn host(&self, number: usize) -> Host {
        self.cluster.host(&self.network, number)
    }

    fn ask(&self, number: usize, arguments: &[&str]) -> Ended {
        self.host(number).ask(&[&["db"], arguments].concat())
    }

    /// Runs a verb that must succeed, and returns its output.
    #[track_caller]
    fn db(&self, number: usize, arguments: &[&str]) -> String {
        let ended = self.ask(number, arguments);
        assert_eq!(ended.code, Some(0), "{arguments:?}: {ended}");
        ended.out
    }

    /// Waits until all robots have all data of the others, and `members` of them are members. Returns how long it
    /// took.
    #[track_caller]
    fn expect_agreement(&self, members: usize) -> Duration {
        let agreed = || {
            let all: Vec<Status> = self.ways.iter().map(Way::status).collect();
            all.iter().all(|one| {
                one.members.len() == members
                    && one.member
                    && one.contents.digest == all[0].contents.digest
                    && one.contents.version == all[0].contents.version
            })
        };
        let took = wait_until(SOON, agreed);
        took.unwrap_or_else(|| panic!("no agreement: {:#?}", self.ways.iter().map(Way::status).collect::<Vec<_>>()))
    }

    /// Asserts that values which were written together are seen together.
    fn check_whole(&self) {
        for way in &self.ways {
            let entries = way.list("team/pair/");
            let writers = |versions: &[Version]| versions.iter().map(|one| one.dot).collect::<BTreeSet<Dot>>();
            let all: Vec<_> = entries.iter().map(|(_, versions)| writers(versions)).collect();
            assert!(all.windows(2).all(|two| two[0] == two[1]), "{}: {entries:?}", way.host);
            assert!(matches!(all.len(), 0 | 2), "{}: {entries:?}", way.host);
        }
    }
}

/// Each robot writes while it is cut off. When the links are back, all have the same state. Each transaction is
/// whole, and every overwrite is listed with all its values. A conflict that is settled on one robot is settled on
/// all.
#[test]
fn three_robots_agree_after_each_was_alone() {
    let Some(robots) = Robots::start(&[]) else { return };
    let alone = robots.ask(3, &["put", "team/before", "1"]);
    assert!(alone.code == Some(0) && alone.err.contains("belongs to no team yet"), "{alone}");
    robots.db(1, &["found"]);
    println!("a team of three after {:.2?}", robots.expect_agreement(3));
    assert_eq!(robots.db(2, &["get", "team/before"]), "1\n", "what was written before there was a team");

    (1..=3).for_each(|number| robots.network.cut(number));
    let alone = wait_until(SOON, || robots.ways.iter().all(|way| way.sees().is_empty()));
    assert!(alone.is_some(), "a cable that is pulled is noticed");
    for (way, name) in robots.ways.iter().zip(NAMES) {
        let own = format!("robot/{name}/own");
        way.write(&[("team/shared", name), (&own, name)]).expect("it writes alone");
        way.write(&[("team/pair/left", name), ("team/pair/right", name)]).expect("it writes alone");
    }
    (1..=3).for_each(|number| robots.network.heal(number));
    let healed = now();
    let whole = wait_until(SOON, || {
        robots.check_whole();
        let states: BTreeSet<String> = robots.ways.iter().map(|way| way.status().contents.digest).collect();
        states.len() == 1
    });
    println!("the same state {:.2?} after the links were back", now() - healed);
    assert!(whole.is_some(), "{:#?}", robots.ways.iter().map(Way::status).collect::<Vec<_>>());
    robots.expect_agreement(3);

    for number in 1..=3 {
        let listed: serde_json::Value =
            serde_json::from_str(&robots.db(number, &["conflicts", "--json"])).expect("it is as the test has made it");
        let conflicts = listed["conflicts"].as_array().expect("it is as the test has made it");
        let keys: Vec<&str> =
            conflicts.iter().map(|one| one["key"].as_str().expect("it is as the test has made it")).collect();
        assert_eq!(keys, ["team/pair/left", "team/pair/right", "team/shared"]);
        for conflict in conflicts {
            let versions = conflict["versions"].as_array().expect("it is as the test has made it");
            let values: BTreeSet<&str> =
                versions.iter().map(|one| one["value"].as_str().expect("it is as the test has made it")).collect();
            assert_eq!(values, NAMES.into(), "{conflict}");
            let shown: Vec<&serde_json::Value> =
                versions.iter().filter(|one| one["shown"] == true).map(|one| &one["value"]).collect();
            let key = conflict["key"].as_str().expect("it is a text");
            let read: serde_json::Value =
                serde_json::from_str(&robots.db(number, &["get", key, "--json"])).expect("it is JSON");
            assert_eq!(shown, [&read], "what a read shows is marked, and nothing else: {conflict}");
        }
        assert_eq!(robots.db(number, &["get", &format!("robot/{}/own", NAMES[number % 3])]).trim(), {
            format!("\"{}\"", NAMES[number % 3])
        });
    }
    for (number, key) in [(2, "team/shared"), (1, "team/pair/left"), (3, "team/pair/right")] {
        let listed: serde_json::Value =
            serde_json::from_str(&robots.db(number, &["conflicts", key, "--json"])).expect("it is JSON");
        let seen = listed["conflicts"][0]["seen"].as_str().expect("it is told");
        let settled = ["resolve", key, "--by", "r1", "--seen", seen, "-m", "r1 was right", "--level", "everywhere"];
        robots.db(number, &settled);
    }
    robots.expect_agreement(3);
    for number in 1..=3 {
        assert_eq!(robots.db(number, &["conflicts"]), "no conflicts\n");
        assert_eq!(robots.db(number, &["get", "team/shared"]), "\"r1\"\n");
    }
}

/// The disk of a robot is full, and another robot repeats its write. The log tells this only once. When there is room, the robot gets
/// the write.
#[test]
fn a_full_disk_is_told_once_while_others_write() {
    let Some(robots) = Robots::start(&[]) else { return };
    robots.db(1, &["found"]);
    robots.expect_agreement(3);
    // For a node with a file size limit, the kernel behaves as with a full disk.
    let limit = |bytes: Option<u64>| {
        let pid = Pid::from_raw(robots.nodes[1].pid().try_into().expect("a process id is positive"));
        prlimit(pid, Resource::Fsize, Rlimit { current: bytes, maximum: None }).expect("the process is ours");
    };
    limit(Some(0));
    robots.ways[0].write(&[("team/while", "r1")]).expect("its own disk has room");
    let lines = || robots.nodes[1].text(Stream::Err).lines().filter(|line| line.contains("store")).count();
    assert!(wait_until(SOON, || lines() > 0).is_some(), "the full disk is told");
    let is_repeated = wait_until(Duration::from_secs(3), || lines() > 4);
    assert!(is_repeated.is_none(), "{}", robots.nodes[1].text(Stream::Err));
    limit(None);
    robots.expect_agreement(3);
    assert_eq!(robots.db(2, &["get", "team/while"]), "\"r1\"\n");
}

/// Two robots that never meet get each other's data through a third robot. If only one robot writes a key, every
/// robot that reaches it asks it.
#[test]
fn data_goes_through_the_one_who_meets_both() {
    let Some(robots) = Robots::start(&[1, 3]) else { return };
    robots.db(2, &["found"]);
    robots.expect_agreement(3);
    robots.ways[0].write(&[("team/from", "r1")]).expect("it is as the test has made it");
    println!("through another after {:.2?}", robots.expect_agreement(3));
    assert_eq!(robots.db(3, &["get", "team/from"]), "\"r1\"\n");

    robots.db(2, &["put", "robot/r1/gain", "2.5"]);
    robots.expect_agreement(3);
    assert_eq!(robots.db(3, &["get", "robot/r1/gain"]), "2.5\n");
    let refused = robots.ask(3, &["put", "robot/r1/gain", "3.5"]);
    assert!(refused.code == Some(3) && refused.err.contains("nothing was written"), "{refused}");
    robots.network.cut(1);
    let pending = robots.ask(2, &["put", "team/late", "1", "--level", "everywhere", "--within", "500ms"]);
    assert!(pending.code == Some(3) && pending.err.contains("the write is committed"), "{pending}");
    robots.network.heal(1);
    robots.expect_agreement(3);
    assert_eq!(robots.db(1, &["get", "team/late"]), "1\n");
}

/// Killing a node loses no acknowledged write.
#[test]
fn a_killed_node_has_lost_nothing() {
    let cluster = Cluster::new();
    let host = cluster.here();
    let mut acknowledged: Vec<(String, String)> = Vec::new();
    for round in 0..5 {
        let node = host.node("r1", &[]);
        let way = Way::open(&host, "r1");
        let found: BTreeSet<Key> = way.list("team/").into_iter().map(|(key, _)| key).collect();
        for (key, _) in &acknowledged {
            assert!(found.contains(&Key::new(key.as_str()).expect("it is as the test has made it")), "{key} is lost");
        }
        let killer = std::thread::spawn(move || {
            dca_tests::cluster::pass(Duration::from_millis(150 + 70 * round));
            node.signal(Signal::KILL);
            node.ended(SOON)
        });
        for number in 0.. {
            let (key, value) = (format!("team/{round}/{number}"), number.to_string());
            if way.write(&[(&key, &value)]).is_none() {
                break;
            }
            acknowledged.push((key, value));
        }
        assert_eq!(killer.join().expect("it is as the test has made it").signal, Some(9));
    }
    println!("{} acknowledged writes, five kills, none lost", acknowledged.len());
    assert!(acknowledged.len() > 10);
}

/// A write is acknowledged only if it can be found again. An acknowledged write can still be read.
#[test]
fn a_store_whose_folder_is_deleted_takes_no_writes() {
    let cluster = Cluster::new();
    let host = cluster.here();
    let _node = host.node("r1", &[]);
    let check = |arguments: &[&str], code: i32, part: &str| {
        let ended = host.ask(&[&["db"], arguments].concat());
        assert!(ended.code == Some(code) && format!("{}{}", ended.out, ended.err).contains(part), "{ended}");
    };
    check(&["put", "team/a", "1"], 0, "committed");
    std::fs::remove_dir_all(host.state().join("r1/db")).expect("it is the test's own");
    check(&["put", "team/b", "2"], 1, "was deleted or moved");
    check(&["get", "team/a"], 0, "1");
    check(&["get", "team/b"], 1, "there is nothing");
    check(&["status"], 0, "was deleted or moved");
}

/// A node on a read-only disk starts, answers, and says why it accepts no writes. It was killed before, so the disk
/// first needs a recovery.
#[test]
fn a_node_on_a_read_only_disk_reads_and_reports() {
    if !getuid().is_root() {
        println!("skipped: needs root, for mounts");
        return;
    }
    let cluster = Cluster::new();
    let host = cluster.here();
    let node = host.node("r1", &[]);
    assert_eq!(host.ask(&["db", "put", "team/a", "1"]).code, Some(0));
    node.signal(Signal::KILL);
    assert_eq!(node.ended(SOON).signal, Some(9));
    for (name, read) in [("r1", Some(0)), ("r2", Some(1))] {
        let node = host.clone().with_read_only_state().node(name, &[]);
        assert_eq!(host.ask(&["db", "get", "team/a"]).code, read);
        let refused = host.ask(&["db", "put", "team/b", "1"]);
        assert!(refused.code == Some(1) && refused.err.contains("is read-only"), "{refused}");
        assert!(host.ask(&["db", "status"]).out.contains("is read-only"));
        node.signal(Signal::TERM);
        assert_eq!(node.ended(SOON).code, Some(0));
    }
}

/// A command on a machine without a node finds the robot that it names, even if the discovery takes long. It does not
/// receive data that is local to that robot.
#[test]
fn a_robot_is_asked_from_a_machine_without_a_node() {
    let (cluster, Some(network)) = (Cluster::new(), Network::new(2)) else { return };
    let (robot, desk) = (cluster.host(&network, 1), cluster.host(&network, 2));
    let _node = robot.node("r1", &["--lan"]);
    let put = robot.ask(&["db", "put", "local/serial", "7"]);
    assert!(put.code == Some(0) && put.out == "written, on this robot only\n", "{put}");
    assert_eq!(robot.ask(&["db", "get", "local/serial"]).out, "7\n");
    for _ in 0..10 {
        let ended = desk.ask(&["db", "put", "team/a", "1", "--lan", "--robot", "r1"]);
        assert_eq!(ended.code, Some(0), "{ended}");
    }
    let refused = desk.ask(&["db", "get", "local/serial", "--lan", "--robot", "r1"]);
    assert!(refused.code == Some(1) && refused.out.is_empty() && refused.err.contains("own machine"), "{refused}");
    let all = desk.ask(&["db", "get", "--lan", "--robot", "r1"]);
    assert!(all.code == Some(0) && all.out.contains("team/a") && !all.out.contains("serial"), "{all}");
    let nobody = desk.ask(&["db", "get", "team/a", "--lan", "--robot", "r9"]);
    assert_eq!(nobody.code, Some(3), "{nobody}");
}

/// A robot that has not yet heard of another robot's team does not begin a team of the same name.
#[test]
fn a_team_is_begun_once() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let _nodes = ["r1", "r2", "r3"].map(|name| here.node(name, &[]));
    let all = || here.ask(&["nodes", "--json"]).out.matches("\"host\"").count() >= 3;
    assert!(wait_until(SOON, all).is_some(), "{}", here.ask(&["nodes"]));
    let first = here.ask(&["db", "found", "--robot", "r1"]);
    assert!(first.code == Some(0) && first.out.contains("begins with `r1`"), "{first}");
    for robot in ["r2", "r3"] {
        let next = here.ask(&["db", "found", "--robot", robot]);
        assert!(!next.out.contains("begins with"), "{next}");
    }
    let is_one = || here.ask(&["db", "status", "--robot", "r3"]).out.contains("r1");
    assert!(wait_until(SOON, is_one).is_some(), "{}", here.ask(&["db", "status", "--robot", "r3"]));
}

/// With `--json`, every output is JSON, even for a failure.
#[test]
fn json_is_never_prose() {
    let cluster = Cluster::new();
    let (host, _node) = (cluster.here(), cluster.here().node("r1", &[]));
    let empty = cluster.file("empty.toml", "format = 1\nbelow = \"team/none/\"\n[values]\n# end\n");
    let tx = cluster.file("tx", "put team/b 2\n");
    for arguments in [
        &["found"][..],
        &["found"],
        &["put", "team/a", "1"],
        &["delete", "team/c"],
        &["tx", tx.as_str()],
        &["get", "team/a"],
        &["get", "team/none/"],
        &["history"],
        &["history", "team/none"],
        &["conflicts"],
        &["resolve", "team/a", "--shown"],
        &["diff", "0"],
        &["diff", "now"],
        &["at", "now"],
        &["version"],
        &["status"],
        &["export", "team/"],
        &["import", empty.as_str()],
        &["import", empty.as_str(), "--dry-run"],
        &["own"],
        &["own", "team/arm", "r1"],
        &["retire", "r1", "--older"],
        &["heal-clock"],
    ] {
        let ended = host.ask(&[&["db"], arguments, &["--json"]].concat());
        let json: Result<serde_json::Value, _> = serde_json::from_str(&ended.out);
        assert!(ended.code == Some(0) && json.is_ok(), "{arguments:?}: {ended}");
    }
    let refused = host.ask(&["db", "put", "nowhere", "1", "--json"]);
    assert!(refused.code == Some(1) && refused.out.is_empty(), "{refused}");
}
