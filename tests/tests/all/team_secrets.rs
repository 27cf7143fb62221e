//! A secret in a team's database. Only its program has the secret. The test searches all files, command lines,
//! environments and outputs of three robots, and the memory of those that may not read it.

use dca_tests::cluster::{Capture, Cluster, Ended, Host, Network, Program, SOON, Stream, executable, wait_until};
use node::logic::database::question::Status;
use std::fs::{self, File, Permissions};
use std::net::UdpSocket;
use std::os::unix::fs::{FileExt as _, PermissionsExt as _};
use std::path::Path;
use std::process::Command;

const SECRET: &str = "Swordfish-Quartz-8261";
/// A secret on a command line. It differs from the first one, which another test of this file would otherwise find.
const OTHER: &str = "Lantern-Marigold-5507";
/// The secret with each letter moved by 13 places. The program writes this to show that it has read the secret.
const SHOWN: &str = "Fjbeqsvfu-Dhnegm-8261";
const KEY: &str = "team/camera/password";
const NAMES: [&str; 3] = ["r1", "r2", "r3"];

/// Returns a spec with one program on a robot that receives the secret.
fn spec(robot: &str) -> String {
    format!(
        r#"module Camera(host, password: Secret) {{
    exec "sh -c 'tr A-Za-z N-ZA-Mn-za-m < \"${{1#password=}}\"; echo; stat -L -c %a \"${{1#password=}}\"; sleep 3600' sh";
    plain;
}}
process main() {{
    host {{ "{robot}" }}
    instantiated_processes {{ camera instof Camera("{robot}", password = secret("{KEY}")); }}
    internal_event_actions {{ camera }}
}}
"#
    )
}

/// A team of three robots. The operator's desk is on the first host.
struct Robots {
    nodes: Vec<Program>,
    cluster: Cluster,
    network: Network,
    keys: Vec<String>,
}

impl Robots {
    fn new() -> Option<Self> {
        let (cluster, network) = (Cluster::new(), Network::new(3)?);
        let passphrase = cluster.file("passphrase", "correct horse battery\n");
        fs::set_permissions(&passphrase, Permissions::from_mode(0o600)).expect("a file of ours");
        let keys = cluster.folder().join("keys").display().to_string();
        let keys = ["--keys".to_owned(), keys, "--passphrase".to_owned(), passphrase].to_vec();
        let mut robots = Self { nodes: Vec::new(), cluster, network, keys };
        robots.done(&["team", "init", "acme"]);
        for (number, name) in (1..).zip(NAMES) {
            robots.join(number, name);
            robots.nodes.push(robots.host(number).node(name, &[]));
        }
        let is_everybody_there = || {
            let nodes = robots.host(1).ask(&["nodes"]);
            NAMES.iter().all(|name| nodes.out.lines().any(|line| line.starts_with(name)))
        };
        assert!(wait_until(SOON, is_everybody_there).is_some(), "{}", robots.host(1).ask(&["nodes"]));
        let has_joined = |number| {
            let status = robots.host(number).ask(&["db", "status", "--json"]);
            serde_json::from_str::<Status>(&status.out).is_ok_and(|status| status.member && status.members.len() == 3)
        };
        assert!(wait_until(SOON, || (1..=3).all(has_joined)).is_some(), "all are members of the database");
        Some(robots)
    }

    fn host(&self, number: usize) -> Host {
        self.cluster.host(&self.network, number)
    }

    fn join(&self, number: usize, name: &str) {
        let invitation = self.host(1).dca(&self.with(&["team", "invite", name]));
        invitation.wait_for(Stream::Out, "\n", SOON);
        let said = invitation.text(Stream::Out);
        let line = said.trim().strip_prefix("dca team join ").expect("it prints what to type").to_owned();
        let state = self.host(number).state().display().to_string();
        let joined = self.host(number).ask(&["team", "join", &line, "--state", &state]);
        assert_eq!((joined.code, invitation.ended(SOON).code), (Some(0), Some(0)), "{joined}");
    }

    fn with<'a>(&'a self, arguments: &[&'a str]) -> Vec<&'a str> {
        arguments.iter().copied().chain(self.keys.iter().map(String::as_str)).collect()
    }

    /// Runs a command at the desk with the operator's keys.
    fn done(&self, arguments: &[&str]) -> Ended {
        let ended = self.host(1).ask(&self.with(arguments));
        assert_eq!(ended.code, Some(0), "{ended}");
        ended
    }

    /// Seals a secret at the desk, and waits until every robot has received it.
    fn seal(&self, value: &str, robots: &str) -> Ended {
        let put = ["db", "put", "--secret", KEY, "--for", robots, "--level", "everywhere", "--within", "25s"];
        self.host(1).ask_given(&self.with(&put), value.as_bytes())
    }

    fn deploy(&self, robot: &str, name: &str) -> Program {
        let spec = self.cluster.file(&format!("{name}.dca"), &spec(robot));
        self.host(1).dca(&self.with(&["deploy", &spec]))
    }
}

/// Adds the files below a folder that contain the secret.
fn files_with(folder: &Path, found: &mut Vec<String>) {
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let (path, kind) = (entry.path(), entry.file_type().expect("Linux tells it"));
        if kind.is_dir() {
            files_with(&path, found);
        } else if kind.is_file() && has_secret(&fs::read(&path).unwrap_or_default()) {
            found.push(path.display().to_string());
        }
    }
}

fn has_secret(bytes: &[u8]) -> bool {
    bytes.windows(SECRET.len()).any(|part| part == SECRET.as_bytes())
}

/// Returns whether the memory of a process contains the secret. A core dump contains no more than that.
fn memory_has_secret(pid: u32) -> bool {
    let maps = fs::read_to_string(format!("/proc/{pid}/maps")).expect("it runs");
    let memory = File::open(format!("/proc/{pid}/mem")).expect("the test may look");
    let mut seen = 0;
    let has = maps.lines().any(|line| {
        let (range, rest) = line.split_once(' ').expect("a range, and more");
        let (begin, end) = range.split_once('-').expect("two ends");
        let [begin, end] = [begin, end].map(|end| u64::from_str_radix(end, 16).expect("the kernel writes hex"));
        let size = usize::try_from(end - begin).expect("it is in memory");
        let mut bytes = vec![0; if rest.starts_with("rw") && size < 256 << 20 { size } else { 0 }];
        let is_read = memory.read_exact_at(&mut bytes, begin).is_ok();
        seen += if is_read { bytes.len() } else { 0 };
        is_read && has_secret(&bytes)
    });
    assert!(seen > 1 << 20, "the memory of {pid} was read");
    has
}

/// Returns the command lines and environments of any processes that contain the secret.
fn processes_with() -> Vec<String> {
    let pids = fs::read_dir("/proc").expect("it is mounted").flatten().map(|entry| entry.path());
    let files = pids.flat_map(|path| ["cmdline", "environ"].map(|name| path.join(name)));
    files
        .filter(|file| has_secret(&fs::read(file).unwrap_or_default()))
        .map(|file| file.display().to_string())
        .collect()
}

/// Checks the search itself: a search that never finds anything would always pass.
fn the_search_finds_what_is_there(robots: &Robots) {
    let bait = robots.cluster.file("bait", &format!("a {SECRET} b"));
    let mut found = Vec::new();
    files_with(robots.cluster.folder(), &mut found);
    assert_eq!(found, [bait]);
    let held = format!("in memory: {SECRET}");
    assert!(memory_has_secret(std::process::id()), "{held}");
    let mut child = Command::new("sleep").arg("60").env("BAIT", SECRET).spawn().expect("there is a `sleep`");
    let found = processes_with();
    child.kill().and_then(|()| child.wait()).expect("it is ours");
    assert_eq!(found, [format!("/proc/{}/environ", child.id())]);
    let capture = Capture::begin(&robots.network);
    let send = || UdpSocket::bind("10.77.0.1:0")?.send_to(format!("a {SECRET} b").as_bytes(), "10.77.0.2:9");
    robots.network.inside(1, send).join().expect("it ends").expect("it is sent");
    assert!(capture.end().iter().any(|packet| has_secret(packet)), "a packet that has it is seen");
}

/// Every verb prints this instead of unreadable bytes. Only a file keeps the bytes, and can be imported.
fn every_verb_says_who_may_read(robots: &Robots) {
    let phrase = "secret for r2, generation 1";
    for verb in [&["history"][..], &["history", KEY], &["diff", "0"], &["at", "now"]] {
        let shown = robots.done(&[&["db"][..], verb].concat());
        assert!(shown.out.contains(phrase) && !shown.out.contains("$sealed"), "{shown}");
        let json = robots.done(&[&["db"][..], verb, &["--json"]].concat());
        let read: serde_json::Value = serde_json::from_str(&json.out).expect("it is JSON");
        assert!(read.to_string().contains(r#"{"secret":{"for":["r2"],"generation":1}}"#), "{json}");
    }
    let watch = robots.host(1).dca(&robots.with(&["db", "watch", KEY, "--from", "0"]));
    watch.wait_for(Stream::Out, phrase, SOON);
    drop(watch);

    let file = robots.cluster.folder().join("team.toml").display().to_string();
    drop(robots.done(&["db", "export", "team/", "-o", &file]));
    let text = fs::read_to_string(&file).expect("it was written");
    assert!(text.contains(&format!("\n# {phrase}\n\"{KEY}\" = {{\"$sealed\" = \"")), "{text}");
    assert!(robots.done(&["db", "export", "team/"]).out.starts_with(text.trim_end()), "as on standard output");
    assert!(robots.done(&["db", "import", &file]).err.contains("nothing differs"));
    drop(robots.done(&["db", "delete", KEY]));
    let gone = robots.done(&["db", "import", &file, "--dry-run"]);
    assert!(gone.out.contains(&format!("+ {KEY}  {phrase}")), "{gone}");
    drop(robots.done(&["db", "import", &file, "--level", "everywhere", "--within", "25s"]));
    assert_eq!(robots.done(&["db", "get", KEY]).out, format!("{phrase}\n"));
}

#[test]
fn a_secret_is_for_its_robot_alone() {
    let Some(robots) = Robots::new() else { return };
    let capture = Capture::begin(&robots.network);
    let mut said = vec![robots.seal(&format!("{SECRET}\n"), "r2")];
    assert_eq!(said[0].code, Some(0), "{}", said[0]);
    assert!(said[0].err.contains("sealed for 1 robot as generation 1"), "{}", said[0]);
    let shown = robots.done(&["db", "get", KEY]);
    assert_eq!(shown.out, "secret for r2, generation 1\n");
    every_verb_says_who_may_read(&robots);

    let mission = robots.deploy("r2", "camera");
    mission.wait_for(Stream::Err, "camera", SOON);
    let logs = || robots.host(1).ask(&["logs", "camera"]);
    let is_shown = wait_until(SOON, || logs().out.contains(&format!("{SHOWN}\n")));
    assert!(is_shown.is_some(), "{}{}", logs(), mission.text(Stream::Err));
    assert!(logs().out.contains("400"), "{}", logs());
    said.extend([
        logs(),
        robots.host(2).ask(&["status"]),
        robots.host(2).ask(&["status", "--json"]),
        robots.host(2).ask(&["events"]),
        robots.host(2).ask(&["audit", "r2", "--state", &robots.host(2).state().display().to_string()]),
        robots.host(3).ask(&["db", "export"]),
        robots.host(2).ask(&["db", "history"]),
        robots.host(2).ask(&["db", "get", "--json"]),
    ]);
    let outputs = said.iter().map(|ended| format!("{ended}"));
    let streams = [Stream::Out, Stream::Err];
    let nodes = robots.nodes.iter().chain([&mission]).flat_map(|program| streams.map(|stream| program.text(stream)));
    for text in outputs.chain(nodes) {
        assert!(!has_secret(text.as_bytes()), "{text}");
    }
    let mut found = Vec::new();
    files_with(robots.cluster.folder(), &mut found);
    for number in 1..=3 {
        files_with(robots.host(number).run_dir(), &mut found);
    }
    assert_eq!(found, [""; 0], "files");
    assert_eq!(processes_with(), [""; 0], "command lines and environments");
    // Even the node of r2 does not keep it.
    for (name, node) in NAMES.iter().zip(&robots.nodes) {
        assert!(!memory_has_secret(node.pid()), "{name}");
    }
    let packets = capture.end();
    assert!(packets.len() > 100, "{} packets were seen", packets.len());
    assert!(!packets.iter().any(|packet| has_secret(packet)), "a packet has it");
    the_search_finds_what_is_there(&robots);

    let refused = robots.deploy("r3", "thief").ended(SOON);
    assert_eq!(refused.code, Some(1), "{refused}");
    assert!(refused.out.contains("the secret `team/camera/password` is not for `r3`"), "{refused}");
    drop(robots.done(&["stop", "camera"]));
    drop(mission.ended(SOON));

    let sealed = robots.seal(SECRET, "r1,r3");
    assert!(sealed.code == Some(0) && sealed.err.contains("2 robots as generation 2"), "{sealed}");
    let refused = robots.deploy("r2", "camera").ended(SOON);
    assert!(refused.out.contains("the secret `team/camera/password` is not for `r2`"), "{refused}");
    let run_dir = robots.host(1).run_dir().display().to_string();
    let revoked = robots.done(&["team", "revoke", "r3", "--run-dir", &run_dir]);
    assert!(revoked.out.ends_with(&format!("{KEY}\n")), "{revoked}");
    assert!(revoked.err.contains("`r3` could read these secrets"), "{revoked}");
}

/// A running controller receives a changed secret, even if its node was killed in the meantime. A secret that is no
/// longer for its robot changes nothing.
#[test]
fn a_secret_that_changes_reaches_the_controller_that_runs() {
    let Some(mut robots) = Robots::new() else { return };
    assert_eq!(robots.seal("Swordfish-1", "r2").code, Some(0));
    let (program, log) = (executable("dca-keys").display().to_string(), robots.cluster.folder().join("keeper"));
    let text = format!(
        "module Keeper(host: Host, password: Secret, file: Text) {{ exec \"'{program}' Keeper\"; service; }}
        process main() {{
            host {{ r2 }}
            instantiated_processes {{ keeper instof Keeper(r2, password = secret(\"{KEY}\"), file = \"{}\"); }}
            internal_event_actions {{ keeper }}
        }}",
        log.display()
    );
    let spec = robots.cluster.file("keeper.dca", &text);
    let mission = robots.host(1).dca(&robots.with(&["deploy", "--no-record", &spec]));
    mission.wait_for(Stream::Err, "▸", SOON);
    let lines = || fs::read_to_string(&log).unwrap_or_default();
    let says =
        |line: &str| assert!(wait_until(SOON, || lines().contains(line)).is_some(), "no {line:?} in {}", lines());
    says("made Fjbeqsvfu-1\n");
    assert_eq!(robots.seal(SECRET, "r2").code, Some(0));
    says(&format!("changed {SHOWN}\n"));
    let keeps_it = |node: &Program| memory_has_secret(node.pid());
    assert!(!robots.nodes.iter().any(keeps_it), "it went through the node of r2, and is not kept there");
    assert_eq!(robots.seal("Swordfish-3", "r3").code, Some(0), "not for r2");
    assert_eq!(robots.seal("Swordfish-4", "r2,r3").code, Some(0));
    says("changed Fjbeqsvfu-4\n");
    // A change made during the absence of its node arrives with the next node.
    robots.nodes[1].kill();
    let put = ["db", "put", "--secret", KEY, "--for", "r2", "--level", "local"];
    let sealed = robots.host(1).ask_given(&robots.with(&put), b"Swordfish-5");
    assert_eq!(sealed.code, Some(0), "{sealed}");
    robots.nodes[1] = robots.host(2).node("r2", &[]);
    says("changed Fjbeqsvfu-5\n");
    let all = ["made Fjbeqsvfu-1", &format!("changed {SHOWN}"), "changed Fjbeqsvfu-4", "changed Fjbeqsvfu-5"];
    assert_eq!(lines().lines().collect::<Vec<_>>(), all, "each once");
    drop(mission);
}

#[test]
fn what_is_no_robot_of_the_team_is_refused_before_anything_is_written() {
    let Some(robots) = Robots::new() else { return };
    for (readers, why) in [("r9", "`r9` is not a robot that the team trusts"), ("r2,root", "`root` is not a robot")] {
        let refused = robots.seal(SECRET, readers);
        assert_eq!(refused.code, Some(1), "{refused}");
        assert!(refused.err.contains(why), "{refused}");
    }
    let empty = robots.seal("", "r2");
    assert!(empty.code == Some(1) && empty.err.contains("the secret is empty"), "{empty}");
    let twice = robots.host(1).ask(&robots.with(&["db", "put", "--secret", KEY, OTHER, "--for", "r2"]));
    assert_eq!(twice.code, Some(2), "{twice}");
    assert!(!format!("{twice}").contains(OTHER), "{twice}");
    let none = robots.host(1).ask(&["db", "get", KEY]);
    assert_eq!(none.code, Some(1), "{none}");
    // A spec cannot use a value that is not a secret as a secret.
    drop(robots.done(&["db", "put", KEY, "--text", "plain", "--level", "everywhere", "--within", "25s"]));
    let refused = robots.deploy("r2", "camera").ended(SOON);
    assert!(refused.out.contains("`team/camera/password` is not a secret"), "{refused}");
}

/// A robot gets new keys under its name. With these it is a member, the old keys are revoked, and the secrets sealed
/// for them are listed.
#[test]
fn a_robot_with_new_keys_is_a_member_and_the_old_ones_are_revoked() {
    let Some(robots) = Robots::new() else { return };
    assert_eq!(robots.seal(SECRET, "r2").code, Some(0));
    let (state, old) = (robots.host(2).state(), robots.cluster.folder().join("old"));
    let copied = Command::new("cp").arg("-a").arg(&state).arg(&old).status().expect("there is a `cp`");
    assert!(copied.success());
    let desk = robots.host(1);
    let unknown = desk.ask(&robots.with(&["team", "rotate", "r9"]));
    assert!(unknown.code == Some(1) && unknown.err.contains("the team has no `r9`"), "{unknown}");
    let run_dir = desk.run_dir().display().to_string();
    let rotation = desk.dca(&robots.with(&["team", "rotate", "r2", "--run-dir", &run_dir]));
    rotation.wait_for(Stream::Out, "\n", SOON);
    let line = rotation.text(Stream::Out).trim().trim_start_matches("dca team join ").to_owned();
    let joined = robots.host(2).ask(&["team", "join", &line, "--state", &state.display().to_string()]);
    assert!(joined.code == Some(0) && joined.err.contains("`r2` was in a team before"), "{joined}");
    let rotated = rotation.ended(SOON);
    assert!(rotated.code == Some(0) && rotated.err.contains("the old keys of `r2` are revoked"), "{rotated}");
    assert!(rotated.out.ends_with(&format!("{KEY}\n")), "what the old keys could read: {rotated}");
    let log = || fs::read_to_string(robots.host(3).state().join("r3/team/audit")).expect("there is an audit log");
    assert!(wait_until(SOON, || log().contains("\trevoke: number 1")).is_some(), "{}", log());
    let sees_r2 = || {
        let nodes = robots.host(3).ask(&["nodes"]);
        // A node that is away has no process.
        nodes.out.lines().any(|line| line.starts_with("r2") && line.split_whitespace().nth(1) != Some("-"))
    };
    robots.nodes[1].kill();
    assert!(wait_until(SOON, || !sees_r2()).is_some(), "{}", robots.host(3).ask(&["nodes"]));
    let renewed = robots.host(2).node("r2", &[]);
    assert!(wait_until(SOON, sees_r2).is_some(), "{}{}", robots.host(3).ask(&["nodes"]), log());
    assert_eq!(robots.seal("Swordfish-2", "r2").code, Some(0), "it is sealed for the new keys, and everybody has it");
    renewed.kill();
    assert!(wait_until(SOON, || !sees_r2()).is_some(), "{}", robots.host(3).ask(&["nodes"]));
    // A node with a copy of the old keys is refused.
    fs::rename(&state, robots.cluster.folder().join("new"))
        .and_then(|()| fs::rename(&old, &state))
        .expect("folders of ours");
    let refusals = || log().matches("the key of `r2` is revoked").count();
    let before = refusals();
    let thief = robots.host(2).start_node("r2", &[]);
    // There is one line each minute.
    assert!(wait_until(3 * SOON, || refusals() > before).is_some(), "{}", log());
    assert!(!sees_r2(), "{}", robots.host(3).ask(&["nodes"]));
    drop(thief);
}
