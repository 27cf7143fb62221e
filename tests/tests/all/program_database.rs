//! Programs use the database of their robot. They write 100 keys/s, watch, and count with expected versions, while they
//! are killed, cut off, or without a node.

#![expect(clippy::print_stdout, reason = "a test says how long it took")]

use dca_tests::cluster::{Cluster, Host, Hosts, Network, Program, SOON, Stream, executable, pass, rounds, wait_until};
use rustix::process::Signal;
use std::collections::BTreeSet;
use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::time::Duration;

/// The number of changes for which a test waits.
const SOME: usize = 300;
/// How long hosts are cut off. Hosts that are away for longer count as lost, which would end the mission.
const CUT: Duration = Duration::from_secs(3);
/// No answer of a database takes as long as this, even on a busy machine.
const LATE: Duration = Duration::from_secs(5);

/// Deploys a spec of writers, watchers and counters. Each is `(type, name, host, its other arguments, after its
/// declaration)`.
fn deploy((cluster, here): (&Cluster, &Host), all: &[(&str, &str, &str, &str, &str)], expression: &str) -> Program {
    let program = executable("dca-keys").display().to_string();
    let instance = |(kind, name, host, arguments, after): &(&str, &str, &str, &str, &str)| {
        let file = cluster.folder().join(name).display().to_string();
        let end = if after.is_empty() { ";".to_owned() } else { format!(" {{ {after} }}") };
        format!("{name} instof {kind}({host}, {arguments}, file = \"{file}\"){end}\n")
    };
    let text = format!(
        "module Writer(host: Host, prefix: Text, keys: Number, file: Text) {{ exec \"'{program}' Writer\"; service; }}
        module Watcher(host: Host, prefix: Text, file: Text) {{ exec \"'{program}' Watcher\"; service; }}
        module Counter(host: Host, key: Text, times: Number, file: Text) {{ exec \"'{program}' Counter\"; done; }}
        process main() {{
            host {{ c1 }}
            supervision {{ restarts 100 within 60 s; }}
            instantiated_processes {{ {} }}
            internal_event_actions {{ {expression} }}
        }}",
        all.iter().map(instance).collect::<String>()
    );
    let mission = here.dca(&["deploy", "--no-record", &cluster.file("keys.dca", &text)]);
    mission.wait_for(Stream::Err, "▸", 2 * SOON);
    mission
}

/// Returns the complete lines of a log that begin with a word. The word itself is left out.
fn lines(cluster: &Cluster, name: &str, word: &str) -> Vec<String> {
    let text = fs::read_to_string(cluster.folder().join(name)).unwrap_or_default();
    let whole = text.rfind('\n').map_or("", |end| &text[..end]);
    let rest = |line: &str| Some(line.strip_prefix(word)?.trim_start().to_owned());
    whole.lines().filter_map(rest).collect()
}

/// Waits until a log has `more` additional lines that begin with a word.
#[track_caller]
fn wait_for_more(cluster: &Cluster, name: &str, word: &str, more: usize) {
    let before = lines(cluster, name, word).len();
    let waited = wait_until(2 * SOON, || lines(cluster, name, word).len() >= before + more);
    let text = fs::read_to_string(cluster.folder().join(name)).unwrap_or_default();
    assert!(waited.is_some(), "`{name}` does not say `{word}` {more} times more: {text}");
}

/// A change in a watcher's log.
struct Changed {
    at: u64,
    txn: String,
    values: Vec<u64>,
}

fn changes(cluster: &Cluster, name: &str) -> Vec<Changed> {
    let number = |word: &str| word.parse().expect("it is a number");
    let read = |line: String| {
        let words: Vec<&str> = line.split(' ').collect();
        let values: Vec<u64> = words[3..].iter().map(|word| number(word)).collect();
        assert_eq!(words[1], values.len().to_string(), "{line}");
        Changed { at: number(words[0]), txn: words[2].to_owned(), values }
    };
    lines(cluster, name, "changed").into_iter().map(read).collect()
}

/// Checks that each change has all keys of its transaction, with the same value.
#[track_caller]
fn expect_whole(changes: &[Changed], keys: usize) {
    for change in changes {
        assert_eq!(change.values.len(), keys, "{}", change.txn);
        assert!(change.values.iter().all(|value| *value == change.values[0]), "{}: {:?}", change.txn, change.values);
    }
}

/// Returns the times from the calculation that wrote to the calculation that received the news.
fn figures(what: &str, changes: &[Changed]) -> Duration {
    let mut times: Vec<Duration> =
        changes.iter().map(|change| Duration::from_nanos(change.at.saturating_sub(change.values[0]))).collect();
    times.sort_unstable();
    let [p50, p99, max] = [50, 99, 100].map(|percent| times[(times.len() - 1) * percent / 100]);
    println!("{what}: {} changes, p50 {p50:.1?}, p99 {p99:.1?}, max {max:.1?}", times.len());
    max
}

fn stop(here: &Host, mission: Program) {
    assert_eq!(here.ask(&["stop", "keys"]).code, Some(0));
    assert_eq!(mission.ended(SOON).code, Some(1));
}

#[test]
fn a_program_writes_100_keys_a_second_and_another_one_hears_of_each() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let _node = here.node("c1", &[]);
    let found = here.ask(&["db", "put", "team/keys/old", "7"]);
    assert_eq!(found.code, Some(0), "{found}");
    let all = [
        ("Watcher", "watcher", "c1", "prefix = \"team/keys/\"", ""),
        ("Writer", "writer", "c1", "prefix = \"team/keys/\", keys = 1", ""),
        ("Writer", "forbidden", "c1", "prefix = \"robot/c1/params/\", keys = 1", ""),
    ];
    let mission = deploy((&cluster, &here), &all, "watcher, writer, forbidden");
    wait_for_more(&cluster, "watcher", "changed", rounds(SOME));
    stop(&here, mission);
    let told = fs::read_to_string(cluster.folder().join("watcher")).expect("it has written");
    assert!(told.starts_with("begin\npresent ") && told.contains("\ncomplete\nchanged "), "{told}");
    let changes = changes(&cluster, "watcher");
    expect_whole(&changes, 1);
    // From the first to the last one, each acknowledged commit of the writer was reported once, in order.
    let number = |txn: &String| txn.split(':').nth(1).and_then(|seq| seq.parse::<u64>().ok()).expect("it is a name");
    let told: Vec<u64> = changes.iter().map(|change| number(&change.txn)).collect();
    assert!(told.is_sorted_by(|one, next| one < next), "{told:?}");
    // Later puts are committed later, and each value is the time of its calculation.
    let values: Vec<u64> = changes.iter().map(|change| change.values[0]).collect();
    assert!(values.is_sorted(), "{values:?}");
    let committed: BTreeSet<u64> = lines(&cluster, "writer", "committed").iter().map(number).collect();
    let meanwhile: Vec<u64> = committed.range(told[0]..=told[told.len() - 1]).copied().collect();
    assert!(meanwhile.iter().all(|seq| told.contains(seq)), "{meanwhile:?} and {told:?}");
    assert!(meanwhile.len() >= rounds(SOME) - 50, "{}", meanwhile.len());
    assert_eq!([lines(&cluster, "writer", "refused"), lines(&cluster, "writer", "unknown")].concat(), [""; 0]);
    let max = figures("100 keys/s, to a watcher on the same host", &changes);
    assert!(max < LATE, "{max:?}");
    assert_eq!(lines(&cluster, "forbidden", "committed"), [""; 0]);
    let why = lines(&cluster, "forbidden", "refused");
    assert!(why[0].contains("cannot be written by programs"), "{why:?}");
}

/// Two programs count at one key, each 50 times. With expected versions, no count is lost.
#[test]
fn two_programs_count_at_one_key_and_lose_no_count() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let _node = here.node("c1", &[]);
    let all = [
        ("Counter", "one", "c1", "key = \"team/count\", times = 50", ""),
        ("Counter", "other", "c1", "key = \"team/count\", times = 50", ""),
    ];
    let mission = deploy((&cluster, &here), &all, "one, other");
    let ended = mission.ended(4 * SOON);
    assert_eq!(ended.code, Some(0), "{ended}");
    assert_eq!(here.ask(&["db", "get", "team/count"]).out, "100\n");
    let unmet: usize = ["one", "other"].iter().map(|name| lines(&cluster, name, "unmet").len()).sum();
    println!("100 counts, {unmet} refused and tried again");
}

/// Two programs claim the same keys through ports that the spec connects. Each key is claimed once, and both programs
/// hear of all claims.
#[test]
fn ports_that_are_connected_with_keys_claim_each_key_once() {
    const COUNT: usize = 40;
    let cluster = Cluster::new();
    let here = cluster.here();
    let _node = here.node("c1", &[]);
    let program = executable("dca-keys").display().to_string();
    let [one, other] = ["one", "other"].map(|name| cluster.folder().join(name).display().to_string());
    let text = format!(
        "module Claimer(host: Host, count: Number, file: Text) {{
            exec \"'{program}' Claimer\"; in Claims: KeyNews; in Answers: KeyAnswer; out Claim: KeyPut; done;
        }}
        process main() {{
            host {{ c1 }}
            instantiated_processes {{
                one instof Claimer(c1, count = {COUNT}, file = \"{one}\");
                other instof Claimer(c1, count = {COUNT}, file = \"{other}\");
            }}
            internal_connections {{
                db(\"team/claim/**\") -> one, Claims; one, Claim -> db(\"team/claim/**\"); db(\"team/claim/**\") -> one, Answers;
                db(\"team/claim/**\") -> other, Claims; other, Claim -> db(\"team/claim/**\"); db(\"team/claim/**\") -> other, Answers;
            }}
            internal_event_actions {{ one, other }}
        }}"
    );
    let ended = here.dca(&["deploy", "--no-record", &cluster.file("claims.dca", &text)]).ended(4 * SOON);
    assert_eq!(ended.code, Some(0), "{ended}");
    let of = |word| ["one", "other"].map(|name| lines(&cluster, name, word));
    let (committed, heard) = (of("committed").concat(), of("changed"));
    let [first, second] = heard.map(|keys| keys.into_iter().collect::<BTreeSet<_>>());
    let claimed: BTreeSet<&String> = committed.iter().collect();
    assert!(committed.len() == claimed.len() && claimed.len() <= COUNT, "{committed:?}");
    assert!(first.len() == COUNT && first == second, "{first:?} and {second:?}");
    println!("{COUNT} keys claimed, {} refused to one of two", of("refused").concat().len());
}

/// `specs/claims.dca`: two explorers share six rooms through ports. The faster one gets the room, and both know it.
#[test]
fn explorers_claim_each_room_once() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let _node = here.node("c1", &[]);
    let program = format!("'{}'", executable("dca-examples").display());
    let text = include_str!("../../../specs/claims.dca").replace("target/debug/dca-examples", &program);
    let ended = here.dca(&["deploy", "--no-record", &cluster.file("claims.dca", &text)]).ended(4 * SOON);
    assert_eq!(ended.code, Some(0), "{ended}");
    let by = |room: u32| here.ask(&["db", "get", &format!("team/flat/claim/{room}")]).out;
    let all: Vec<String> = (1..=6).map(by).collect();
    assert!(all.iter().all(|by| by.contains("main/ann") || by.contains("main/bob")), "{all:?}");
    // Claimed rooms stay claimed, so a later explorer finds nothing to do and says so.
    let again = here.dca(&["deploy", "--no-record", &cluster.file("claims.dca", &text)]).ended(4 * SOON);
    assert_eq!((again.code, (1..=6).map(by).collect()), (Some(0), all), "{again}");
}

/// In a team with keys, two programs write the same keys. The spec connects only one of them with the keys.
#[test]
fn in_a_team_a_program_writes_what_its_spec_connects() {
    let cluster = Cluster::new();
    let Some(network) = Network::new(1) else { return };
    let here = cluster.host(&network, 1);
    let passphrase = cluster.file("passphrase", "correct horse battery\n");
    fs::set_permissions(&passphrase, fs::Permissions::from_mode(0o600)).expect("a file of ours");
    let keys = [
        "--keys".to_owned(),
        cluster.folder().join("keys").display().to_string(),
        "--passphrase".to_owned(),
        passphrase,
    ];
    let with = |arguments: &[&'static str]| -> Vec<String> {
        arguments.iter().map(|word| (*word).to_owned()).chain(keys.clone()).collect()
    };
    let dca = |arguments: &[String]| here.dca(&arguments.iter().map(String::as_str).collect::<Vec<_>>());
    let done = |arguments: &[&'static str]| {
        let ended = dca(&with(arguments)).ended(SOON);
        assert_eq!(ended.code, Some(0), "{ended}");
    };
    done(&["team", "init", "acme"]);
    let invitation = dca(&with(&["team", "invite", "c1"]));
    invitation.wait_for(Stream::Out, "\n", SOON);
    let line = invitation.text(Stream::Out).trim().trim_start_matches("dca team join ").to_owned();
    let joined = here.ask(&["team", "join", &line, "--state", &here.state().display().to_string()]);
    assert_eq!((joined.code, invitation.ended(SOON).code), (Some(0), Some(0)), "{joined}");
    let _node = here.node("c1", &[]);
    let has_begun = || here.ask(&["db", "status"]).out.contains("`c1` is its only member so far");
    assert!(
        wait_until(SOON, has_begun).is_some(),
        "the first robot begins the database: {}",
        here.ask(&["db", "status"])
    );
    let program = executable("dca-keys").display().to_string();
    let [bound, free] = ["bound", "free"].map(|name| cluster.folder().join(name).display().to_string());
    let text = format!(
        "module Writer(host: Host, prefix: Text, keys: Number, file: Text) {{ exec \"'{program}' Writer\"; service; }}
        process main() {{
            host {{ c1 }}
            instantiated_processes {{
                bound instof Writer(c1, prefix = \"team/keys/\", keys = 1, file = \"{bound}\");
                free instof Writer(c1, prefix = \"team/keys/\", keys = 1, file = \"{free}\");
            }}
            internal_connections {{ bound, database -> db(\"team/keys/**\"); }}
            internal_event_actions {{ bound, free }}
        }}"
    );
    let spec = cluster.file("team.dca", &text);
    let deploy: Vec<String> =
        ["deploy".to_owned(), "--no-record".to_owned(), spec].into_iter().chain(keys.clone()).collect();
    let mission = dca(&deploy);
    mission.wait_for(Stream::Err, "▸", 2 * SOON);
    wait_for_more(&cluster, "bound", "committed", 20);
    wait_for_more(&cluster, "free", "refused", 20);
    assert_eq!((lines(&cluster, "bound", "refused"), lines(&cluster, "free", "committed")), (vec![], vec![]));
    let why = lines(&cluster, "free", "refused").swap_remove(0);
    assert!(why.contains("in a team its spec says which keys it writes"), "{why}");
    done(&["stop", "team"]);
    assert_eq!(mission.ended(SOON).code, Some(1));
}

/// The writer is killed several times between a put and its answer. A watcher and the database see only whole
/// transactions.
#[test]
fn a_program_that_is_killed_leaves_whole_transactions() {
    const KEYS: usize = 16;
    let cluster = Cluster::new();
    let here = cluster.here();
    let _node = here.node("c1", &[]);
    let writer = format!("prefix = \"team/keys/\", keys = {KEYS}");
    let all = [
        ("Watcher", "watcher", "c1", "prefix = \"team/keys/\"", ""),
        ("Writer", "writer", "c1", &writer, "restart transient;"),
    ];
    let mission = deploy((&cluster, &here), &all, "watcher, writer");
    for round in 0..rounds(4_u64) {
        let is_up = || cluster.leaf("main/writer").is_some();
        assert!(wait_until(SOON, is_up).is_some(), "{}{}", mission.text(Stream::Out), mission.text(Stream::Err));
        wait_for_more(&cluster, "writer", "committed", 5);
        // The time since the last answer differs between rounds.
        pass(Duration::from_micros(1700 * round));
        let before = cluster.expect_leaf("main/writer");
        before.signal(Signal::KILL);
        wait_for_more(&cluster, "watcher", "changed", 1);
    }
    stop(&here, mission);
    let changes = changes(&cluster, "watcher");
    expect_whole(&changes, KEYS);
    let shown = here.ask(&["db", "get", "team/keys/"]).out;
    let values: BTreeSet<&str> = shown.lines().filter_map(|line| line.split(" = ").nth(1)).collect();
    assert_eq!((shown.lines().count(), values.len()), (KEYS, 1), "{shown}");
    println!("{} transactions of {KEYS} keys, all whole", changes.len());
}

/// The node is killed and restarted while its programs run. Their puts in the meantime are answered, and a watch starts
/// again.
#[test]
fn a_node_that_is_killed_leaves_its_programs_their_database() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let node = here.node("c1", &[]);
    let all = [
        ("Watcher", "watcher", "c1", "prefix = \"team/keys/\"", ""),
        ("Writer", "writer", "c1", "prefix = \"team/keys/\", keys = 2", ""),
    ];
    let mission = deploy((&cluster, &here), &all, "watcher, writer");
    wait_for_more(&cluster, "watcher", "changed", 20);
    // A program that reconnects also receives its parameters.
    let put = here.ask(&["db", "put", "robot/c1/params/keys/writer/keys", "2.0"]);
    assert_eq!(put.code, Some(0), "{put}");
    node.kill();
    let _node = here.node("c1", &[]);
    wait_for_more(&cluster, "watcher", "changed", 50);
    wait_for_more(&cluster, "writer", "committed", 20);
    assert_eq!(lines(&cluster, "watcher", "begin").len(), 2);
    assert_eq!(lines(&cluster, "watcher", "complete").len(), 2);
    assert_eq!(here.ask(&["stop", "keys"]).code, Some(0));
    drop(mission);
    let changes = changes(&cluster, "watcher");
    expect_whole(&changes, 2);
    let count = |word| lines(&cluster, "writer", word).len();
    let [committed, refused, unknown] = ["committed", "refused", "unknown"].map(count);
    println!("{committed} committed, {refused} refused while there was no node, {unknown} unknown");
    // A program that asks faster than its node answers is told this.
    let is_honest = |why: &String| why.contains("the node is not connected") || why.contains("have no answer yet");
    let why = lines(&cluster, "writer", "refused");
    assert!(why.iter().all(is_honest), "{why:?}");
}

/// Two hosts are cut off from each other. Their programs continue, and both have everything when they meet again.
#[test]
fn programs_of_hosts_that_are_cut_off_write_on() {
    let Some(hosts) = Hosts::start(3, None) else { return };
    let (cluster, here) = (&hosts.cluster, hosts.host(1));
    assert_eq!(here.ask(&["db", "found"]).code, Some(0));
    let all_in = || ["c1", "c2", "c3"].iter().all(|name| here.ask(&["db", "status"]).out.contains(name));
    assert!(wait_until(2 * SOON, all_in).is_some(), "not all have joined");
    let all = [
        ("Watcher", "near", "c1", "prefix = \"team/keys/\"", ""),
        ("Watcher", "far", "c2", "prefix = \"team/keys/\"", ""),
        ("Writer", "one", "c1", "prefix = \"team/keys/one/\", keys = 1", "on_link_loss keep;"),
        ("Writer", "other", "c2", "prefix = \"team/keys/other/\", keys = 1", "on_link_loss keep;"),
    ];
    let mission = deploy((cluster, &here), &all, "near, far, one, other");
    for name in ["near", "far"] {
        wait_for_more(cluster, name, "changed", 20);
    }
    hosts.network.cut(2);
    let before = lines(cluster, "other", "committed").len();
    pass(CUT);
    let after = lines(cluster, "other", "committed").len();
    println!("cut off for {CUT:?}: {} committed there", after - before);
    assert!(after > before + 20, "{before}, then {after}");
    hosts.network.heal(2);
    for name in ["near", "far"] {
        wait_for_more(cluster, name, "changed", 50);
    }
    drop(mission);
    hosts.end();
}
