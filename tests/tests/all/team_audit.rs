//! Audit logs of two nodes of a team. Each node signs the head of the other's log, so it is noticed if a log is cut
//! off or rewritten.

use dca_tests::cluster::{Cluster, Ended, Host, Network, Program, SOON, wait_until};
use dca_tests::made_team::MadeTeam;
use rustix::process::{Pid, Resource, Rlimit, Signal, prlimit};
use std::fs;
use std::path::PathBuf;
use trust::audit::{Decision, Entry, Log};
use trust::name::UnixTime;

/// The number of records in the log before it is signed.
const RECORDS: usize = 5;

/// Two robots of a team that see each other.
struct Robots {
    nodes: [Option<Program>; 2],
    cluster: Cluster,
    network: Network,
}

impl Robots {
    fn new() -> Option<Self> {
        let (cluster, network) = (Cluster::new(), Network::new(2)?);
        let team = MadeTeam::default();
        let mut robots = Self { nodes: [None, None], cluster, network };
        for number in [1, 2] {
            team.admit(&robots.host(number), &name(number));
            robots.start(number);
        }
        Some(robots)
    }

    fn host(&self, number: usize) -> Host {
        self.cluster.host(&self.network, number)
    }

    fn start(&mut self, number: usize) {
        self.nodes[number - 1] = Some(self.host(number).node(&name(number), &[]));
    }

    fn stop(&mut self, number: usize) {
        let Some(node) = self.nodes[number - 1].take() else { return };
        node.signal(Signal::TERM);
        let ended = node.ended(SOON);
        assert_eq!(ended.code, Some(0), "{ended}");
    }

    fn file(&self, number: usize, file: &str) -> PathBuf {
        self.host(number).state().join(name(number)).join("team").join(file)
    }

    fn log(&self, number: usize) -> String {
        fs::read_to_string(self.file(number, "audit")).unwrap_or_default()
    }

    /// Verifies a text as the log of the first robot, against the heads that the second one has signed.
    fn verify(&self, text: &str) -> Ended {
        let file = self.cluster.file("c1.audit", text);
        let (heads, state) = (self.file(2, "heads").display().to_string(), self.cluster.folder().join("none"));
        let arguments = ["audit", "--verify", &file, "--heads", &heads, "--state", &state.display().to_string()];
        self.host(2).ask(&arguments)
    }
}

fn name(number: usize) -> String {
    format!("c{number}")
}

#[test]
fn a_log_that_was_cut_or_written_anew_is_found_out() {
    let Some(mut robots) = Robots::new() else { return };
    let first = robots.host(1);
    let see_each_other = || first.ask(&["nodes"]).out.lines().filter(|line| line.starts_with('c')).count() == 2;
    assert!(wait_until(SOON, see_each_other).is_some(), "{}", first.ask(&["nodes"]));
    // Every user may stop everything, and each stop adds a record.
    for _ in 0..RECORDS {
        let stopped = first.ask(&["estop", "test"]);
        assert_eq!(stopped.code, Some(0), "{stopped}");
    }
    assert!(wait_until(SOON, || robots.log(1).lines().count() > RECORDS).is_some(), "{}", robots.log(1));
    // A joining node receives the heads at once.
    robots.stop(2);
    robots.start(2);
    let state = first.state().display().to_string();
    let shown = || first.ask(&["audit", "c1", "--state", &state]);
    let signed = || shown().err.split_once("the last of record ")?.1.split_once(' ')?.0.parse::<usize>().ok();
    assert!(wait_until(SOON, || signed() >= Some(RECORDS)).is_some(), "{}", shown());
    let good = robots.log(1);
    let fits = robots.verify(&good);
    assert!(fits.code == Some(0) && fits.out.contains("signed heads fit"), "{fits}");
    // A shortened log is consistent in itself, but does not match the head that the other node has signed.
    let cut: String = good.lines().take(1).map(|line| format!("{line}\n")).collect();
    let refused = robots.verify(&cut);
    assert!(refused.code == Some(1) && refused.err.contains("was changed after it was written"), "{refused}");
    assert!(refused.err.contains("ends with nothing, but"), "{refused}");
    // A rewritten log with the same number of records.
    let (mut log, begin) = {
        let mut verifier = trust::audit::Verifier::new(Vec::new()).expect("no heads");
        good.lines().for_each(|line| verifier.line(line).expect("it is whole"));
        let (team, node) = verifier.finish().expect("it is whole").of();
        Log::begin(team, node, None)
    };
    let mut forged = begin + "\n";
    for _ in good.lines().skip(1) {
        let (at, decision, who, what) = (UnixTime(1), Decision::Done, "nobody", "nothing");
        forged += &(log.add(&Entry { at, decision, who, what, request: [0; 16], reason: "" }) + "\n");
    }
    let refused = robots.verify(&forged);
    assert!(refused.code == Some(1) && refused.err.contains("differs from the record that"), "{refused}");
    // The node continues with a shorter log. The other node no longer signs it, and records this.
    robots.stop(1);
    let short: String = forged.lines().take(2).map(|line| format!("{line}\n")).collect();
    fs::write(robots.file(1, "audit"), short).expect("a file of ours");
    robots.start(1);
    let is_told = || robots.log(2).contains("\trefused\tc1\tsign the audit log of `c1`\t");
    assert!(wait_until(SOON, is_told).is_some(), "{}", robots.log(2));
    assert!(robots.verify(&good).code == Some(0), "what was signed stays");
}

/// A disk that is full for a while damages no record. Events during that time are written when there is room, and the
/// log still matches the signed heads.
#[test]
fn a_log_on_a_full_disk_stays_whole() {
    let Some(mut robots) = Robots::new() else { return };
    let first = robots.host(1);
    let stop_all = |reason: &str| first.ask(&["estop", reason]);
    assert_eq!(stop_all("before").code, Some(0));
    assert!(wait_until(SOON, || robots.log(1).contains(": before")).is_some(), "{}", robots.log(1));
    // For a node with a file size limit, the kernel behaves as with a full disk: a short write, then an error.
    let pid = robots.nodes[0].as_ref().and_then(|node| Pid::from_raw(node.pid().try_into().ok()?));
    let room = fs::metadata(robots.file(1, "audit")).expect("it is there").len() + 40;
    let limit = |bytes: Option<u64>| {
        let limit = Rlimit { current: bytes, maximum: None };
        prlimit(pid, Resource::Fsize, limit).expect("the process is ours");
    };
    limit(Some(room));
    for number in 0..20 {
        let stopped = stop_all(&format!("full {number}"));
        assert!(stopped.out.contains("c1: stopped; no program runs"), "{stopped}");
    }
    assert!(robots.log(1).ends_with('\n') && !robots.log(1).contains(": full"), "{}", robots.log(1));
    limit(None);
    assert!(wait_until(SOON, || robots.log(1).contains(": full 19")).is_some(), "{}", robots.log(1));
    if let Some(node) = robots.nodes[0].take() {
        node.signal(Signal::KILL);
        drop(node.ended(SOON));
    }
    robots.start(1);
    assert_eq!(stop_all("after").code, Some(0));
    assert!(wait_until(SOON, || robots.log(1).contains(": after")).is_some(), "{}", robots.log(1));
    let shown = first.ask(&["audit", "c1", "--state", &first.state().display().to_string()]);
    assert!(shown.code == Some(0) && shown.err.contains("complete up to record "), "{shown}");
    let stops = |what: &str| shown.out.lines().filter(|line| line.contains(&format!(": {what}"))).count();
    assert_eq!((stops("before"), stops("full"), stops("after")), (1, 20, 1), "{shown}");
}
