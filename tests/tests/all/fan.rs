//! One writer with 20 readers, and 20 writers with one reader, at 100 Hz. Values that may be lost are counted, and all
//! others arrive. A suspended or killed reader delays no other reader. A killed program leaves nothing behind.

#![expect(clippy::print_stdout, reason = "a test says what was lost, and what was late")]

use comms::io::clock::now;
use comms::logic::random::Random;
use comms::logic::time::Time;
use dca_tests::cluster::{Cluster, Host, Hosts, Program, SOON, Stream, executable, pass, wait_until};
use node::logic::protocol::LostValues;
use rustix::process::Signal;
use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsString;
use std::time::Duration;

/// The number of programs on the side with many.
const MANY: usize = 20;
/// The period of all loops. It is the one in `dca-counting`.
const BEAT: Duration = Duration::from_millis(10);
/// The number of beats for which a test waits.
const SOME: usize = 50;
/// After such a short cut, TCP repeats the delayed data.
const SHORT_CUT: Duration = Duration::from_millis(500);
/// This cut is long enough to lose links, but too short to lose hosts.
const LONG_CUT: Duration = Duration::from_secs(3);
/// The largest number of long cuts until something is lost. A busy machine may notice a cut link late.
const LONG_CUTS_MAX: usize = 5;
/// How long a reader is suspended. Its node does not yet report a hang after this time.
const SUSPENDED: Duration = Duration::from_secs(3);
/// More beats than a link and the queue of a suspended reader hold.
const FULL: usize = 270;
/// A busy machine never delays a loop for this long, but a blocking write to a suspended reader would.
const HELD_UP_MAX: Duration = Duration::from_secs(2);

/// A beat received by a reader.
#[derive(Clone, Debug)]
struct Heard {
    at: Time,
    age: Duration,
    from: String,
    number: u64,
    /// The loss counter of the reader's port at that time.
    lost: u64,
}

/// Returns the lines of a log by activation. Each line is a list of words.
fn lives(cluster: &Cluster, name: &str) -> Vec<Vec<Vec<String>>> {
    let text = std::fs::read_to_string(cluster.folder().join(name)).unwrap_or_default();
    let whole = text.rfind('\n').map_or("", |end| &text[..end]);
    let words = |line: &str| line.split(' ').map(str::to_owned).collect();
    whole.split("begins\n").skip(1).map(|life| life.lines().map(words).collect()).collect()
}

fn nanos(word: &str) -> u64 {
    word.parse().expect("it is a number")
}

/// Returns the beats received by a reader, by activation.
fn heard(cluster: &Cluster, name: &str) -> Vec<Vec<Heard>> {
    let beat = |words: &Vec<String>| match &words[..] {
        [at, age, from, number, lost] => Heard {
            at: Time::from_nanos(nanos(at)),
            age: Duration::from_nanos(nanos(age)),
            from: from.clone(),
            number: nanos(number),
            lost: nanos(lost),
        },
        _ => panic!("{name}: {words:?}"),
    };
    lives(cluster, name).iter().map(|life| life.iter().map(beat).collect()).collect()
}

/// Checks that the numbers of each writer are in order. Returns how many numbers are missing between the first and the
/// last one, and how many were counted as lost.
fn missing_and_counted(name: &str, life: &[Heard]) -> (u64, u64) {
    let (mut last, mut missing) = (BTreeMap::new(), 0);
    for beat in life {
        if let Some(before) = last.insert(&beat.from, beat.number) {
            assert!(beat.number > before, "{name}: {before} of {}, then {}", beat.from, beat.number);
            missing += beat.number - before - 1;
        }
    }
    let counted = life.last().map_or(0, |beat| beat.lost) - life.first().map_or(0, |beat| beat.lost);
    (missing, counted)
}

/// Returns how many beats of one writer are missing. All of them were counted.
fn missing(name: &str, life: &[Heard]) -> u64 {
    let (missing, counted) = missing_and_counted(name, life);
    assert_eq!(missing, counted, "{name}: so many are missing, and so many were counted");
    missing
}

/// Returns the number before and after each gap, with the times since the first beat.
fn gaps(life: &[Heard]) -> Vec<String> {
    let gap = |pair: &[Heard]| {
        let of = |beat: &Heard| format!("{} at {:.3?}, {:.3?} old", beat.number, beat.at - life[0].at, beat.age);
        (pair[1].number > pair[0].number + 1).then(|| format!("{}, then {}", of(&pair[0]), of(&pair[1])))
    };
    life.windows(2).filter_map(gap).collect()
}

/// Deploys a spec of hearts, ears and eyes. Each is `(type, name, host, after its declaration)`.
fn deploy(
    (cluster, here): (&Cluster, &Host),
    all: &[(&str, String, &str, &str)],
    connections: &str,
    expression: &str,
) -> Program {
    let program = executable("dca-counting").display().to_string();
    let instance = |(kind, name, host, after): &(&str, String, &str, &str)| {
        let file = cluster.folder().join(name).display().to_string();
        let end = if after.is_empty() { ";".to_owned() } else { format!(" {{ {after} }}") };
        format!("{name} instof {kind}({host}, file = \"{file}\"){end}\n")
    };
    let text = format!(
        "module Heart(host: Host, file: Text) {{ exec \"'{program}' Heart\"; out Out: Beat; service; }}
        module Drum(host: Host, file: Text) {{ exec \"'{program}' Drum\"; out Out: Beat; service; }}
        module Ear(host: Host, file: Text) {{ exec \"'{program}' Ear\"; in In: Beat; service; }}
        module Eye(host: Host, file: Text) {{ exec \"'{program}' Eye\"; in In: Beat; service; }}
        process main() {{
            host {{ c1 }}
            instantiated_processes {{ {} }}
            internal_connections(first, on) {{ {connections} }}
            internal_event_actions {{ {expression} }}
        }}",
        all.iter().map(instance).collect::<String>()
    );
    let mission = here.dca(&["deploy", "--no-record", &cluster.file("fan.dca", &text)]);
    mission.wait_for(Stream::Err, "▸", 2 * SOON);
    mission
}

/// Waits until each of these logs has `SOME` more lines than now.
#[track_caller]
fn wait_for_more(cluster: &Cluster, names: &[String]) {
    let count = |name: &String| lives(cluster, name).last().map_or(0, Vec::len);
    let before: Vec<usize> = names.iter().map(count).collect();
    let has_more = || names.iter().zip(&before).all(|(name, before)| count(name) >= before + SOME);
    let waited = wait_until(2 * SOON, has_more);
    assert!(waited.is_some(), "{before:?}, then {:?} of {names:?}", names.iter().map(count).collect::<Vec<_>>());
}

/// Cuts host 2 off for a short time, then until its links are lost and one of these readers has lost something. `again`
/// waits until data flows again.
fn cut(hosts: &Hosts, readers: &[&String], again: impl Fn()) {
    let here = hosts.host(1);
    let lost = |name: &&String| heard(&hosts.cluster, name).concat().last().map_or(0, |beat| beat.lost);
    let once = |time: Duration| {
        hosts.network.cut(2);
        pass(time);
        hosts.network.heal(2);
        again();
        // Nodes that have not met since the previous cut would consider both cuts as one.
        let all_meet = || here.statuses(&[]).iter().all(|node| node.peers.len() == 2);
        assert!(wait_until(SOON, all_meet).is_some(), "the nodes do not meet again");
    };
    once(SHORT_CUT);
    let is_lossy = (0..LONG_CUTS_MAX).any(|_| {
        once(LONG_CUT);
        readers.iter().any(|name| lost(name) > 0)
    });
    assert!(is_lossy, "no cut has lost anything");
}

fn host_of(number: usize) -> &'static str {
    ["c1", "c2", "c3"][number % 3]
}

/// Most readers receive each beat, and some fetch the newest one.
#[test]
fn one_writer_and_many_readers_over_a_link_that_is_cut() {
    let Some(hosts) = Hosts::start(3, None) else { return };
    let (cluster, here) = (&hosts.cluster, hosts.host(1));
    let is_eye = |number: usize| number % 5 == 4;
    let mut all = vec![("Heart", "first".to_owned(), "c1", "")];
    let names: Vec<String> = (0..MANY).map(|number| format!("r{number}")).collect();
    let kind = |number| if is_eye(number) { "Eye" } else { "Ear" };
    all.extend(names.iter().enumerate().map(|(number, name)| (kind(number), name.clone(), host_of(number), "")));
    let how = |number| if is_eye(number) { "pull" } else { "queue 8000" };
    let wire = |(number, name): (usize, &String)| format!("first, Out -> {name}, In {}; ", how(number));
    let wires: String = names.iter().enumerate().map(wire).collect();
    let mission = deploy((cluster, &here), &all, &wires, &format!("first[on], {}", names.join(", ")));
    wait_for_more(cluster, &names);
    let far: Vec<&String> = (0..MANY).filter(|number| host_of(*number) == "c2").map(|number| &names[number]).collect();
    let is_sent = |name: &&&String| !is_eye(names.iter().position(|other| other == **name).unwrap_or_default());
    let far_ears: Vec<&String> = far.iter().filter(is_sent).copied().collect();
    cut(&hosts, &far_ears, || wait_for_more(cluster, &names));
    assert_eq!(here.ask(&["stop", "fan"]).code, Some(0));
    assert_eq!(mission.ended(SOON).code, Some(1));
    for (number, name) in names.iter().enumerate() {
        let [life] = &heard(cluster, name)[..] else { panic!("`{name}` was started again") };
        if is_eye(number) {
            assert!(life.is_sorted_by_key(|beat| beat.number), "`{name}` has seen an older beat after a newer one");
            continue;
        }
        let lost = missing(name, life);
        println!("{name} on {}: {} heard, {lost} lost and counted", host_of(number), life.len());
        let whole = lost == 0 || host_of(number) == "c2";
        assert!(whole, "`{name}`, whose link was not cut, has lost {lost}: {:?}", gaps(life));
    }
    hosts.end();
}

/// One reader has room for all beats, and the other one has room for three.
#[test]
fn many_writers_and_one_reader_over_a_link_that_is_cut() {
    let Some(hosts) = Hosts::start(3, None) else { return };
    let (cluster, here) = (&hosts.cluster, hosts.host(1));
    let names: Vec<String> = (0..MANY).map(|number| format!("w{number}")).collect();
    let mut all = vec![("Ear", "first".to_owned(), "c1", ""), ("Ear", "narrow".to_owned(), "c3", "")];
    all.extend(names.iter().enumerate().map(|(number, name)| ("Heart", name.clone(), host_of(number), "")));
    let wire = |name: &String| format!("{name}, Out -> first, In queue 8000; {name}, Out -> narrow, In queue 3; ");
    let wires: String = names.iter().map(wire).collect();
    let mission = deploy((cluster, &here), &all, &wires, &format!("first[on], narrow, {}", names.join(", ")));
    let readers = ["first", "narrow"].map(str::to_owned);
    wait_for_more(cluster, &[&names[..], &readers].concat());
    let count = |name: &String| heard(cluster, "first").concat().iter().filter(|beat| beat.from == *name).count();
    cut(&hosts, &[&readers[0]], || {
        let before: Vec<usize> = names.iter().map(count).collect();
        let from_all = || names.iter().zip(&before).all(|(name, before)| count(name) >= before + SOME);
        assert!(wait_until(2 * SOON, from_all).is_some(), "not all are heard again");
    });
    assert_eq!(here.ask(&["stop", "fan"]).code, Some(0));
    assert_eq!(mission.ended(SOON).code, Some(1));
    for name in &readers {
        let [life] = &heard(cluster, name)[..] else { panic!("`{name}` was started again") };
        let (missing, counted) = missing_and_counted(name, life);
        println!("{name}: {} heard, {missing} missing, {counted} counted", life.len());
        // The port also counts losses before the first beat from a writer and after its last, but these are not visible
        // here.
        let sent = |name: &String| u64::try_from(lives(cluster, name).concat().len()).unwrap_or_default();
        let at_ends = |name: &String| {
            let of = || life.iter().filter(|beat| beat.from == *name).map(|beat| beat.number);
            of().next().unwrap_or(1) - 1 + sent(name).saturating_sub(of().next_back().unwrap_or_default())
        };
        let unseen: u64 = names.iter().map(at_ends).sum();
        assert!((missing..=missing + unseen).contains(&counted), "{name}: {missing} missing, {counted} counted");
    }
    let life = heard(cluster, "first").concat();
    for (number, name) in names.iter().enumerate().filter(|(number, _)| host_of(*number) != "c2") {
        let numbers: Vec<u64> = life.iter().filter(|beat| beat.from == *name).map(|beat| beat.number).collect();
        let is_whole = numbers.windows(2).all(|pair| pair[1] == pair[0] + 1);
        assert!(is_whole, "beats of `{name}` on {}, whose link was not cut, are missing", host_of(number));
    }
    hosts.end();
}

/// Returns the median, the 99th percentile and the maximum of some times.
fn figures(mut times: Vec<Duration>) -> [Duration; 3] {
    times.sort_unstable();
    [50, 99, 100].map(|percent| times.get((times.len().saturating_sub(1)) * percent / 100).copied().unwrap_or_default())
}

/// Compares the times before a disturbance with those during it. It compares medians, since this machine also has other
/// users.
#[track_caller]
fn expect_no_later(what: &str, before: Vec<Duration>, meanwhile: Vec<Duration>) {
    assert!(!before.is_empty() && !meanwhile.is_empty(), "{what}: nothing to compare");
    let ([usual, ..], [median, p99, max]) = (figures(before), figures(meanwhile));
    println!("{what}: median {usual:.1?} before, {median:.1?} meanwhile, p99 {p99:.1?}, max {max:.1?}");
    assert!(median <= usual + BEAT, "{what}: a median of {median:?} meanwhile, {usual:?} before");
    assert!(max < HELD_UP_MAX, "{what}: held up for {max:?}");
}

/// Of 20 readers, one is suspended for 3 s, which is longer than the buffer of the link. Another one is killed during
/// this time. The writer and all other readers continue as before, and lose nothing.
#[test]
fn a_reader_that_is_suspended_or_killed_delays_nobody() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let _node = here.node("c1", &[]);
    let names: Vec<String> = (0..MANY).map(|number| format!("r{number}")).collect();
    let (suspended, killed) = (&names[3], &names[7]);
    let after = |name: &String| if name == killed { "restart transient;" } else { "" };
    let mut all = vec![("Heart", "first".to_owned(), "c1", "")];
    all.extend(names.iter().map(|name| ("Ear", name.clone(), "c1", after(name))));
    let wires: String = names.iter().map(|name| format!("first, Out -> {name}, In queue 200; ")).collect();
    let mission = deploy((&cluster, &here), &all, &wires, &format!("first[on], {}", names.join(", ")));
    wait_for_more(&cluster, &names);
    let began = now();
    pass(SUSPENDED);
    let leaf = |name: &String| cluster.expect_leaf(&format!("main/{name}"));
    let at = now();
    let reader = leaf(suspended);
    reader.signal(Signal::STOP);
    leaf(killed).signal(Signal::KILL);
    let count = || heard(&cluster, &names[0]).concat().len();
    let before = count();
    pass(SUSPENDED);
    // On a busy machine, the writer may beat more slowly.
    assert!(wait_until(4 * SOON, || count() >= before + FULL).is_some(), "{before}, then {}", count());
    reader.signal(Signal::CONT);
    let until = now();
    wait_until(SOON, || heard(&cluster, killed).len() == 2).expect("it is started again");
    wait_for_more(&cluster, &names);
    let is_told = || here.ask(&["status"]).out.contains(&format!("first, Out -> main/{suspended}, In"));
    assert!(wait_until(SOON, is_told).is_some(), "{}", here.ask(&["status"]));
    let lost: Vec<LostValues> =
        here.statuses(&[]).into_iter().flat_map(|node| node.deployments).flat_map(|one| one.lost).collect();
    assert!(lost.iter().all(|lost| lost.wire.contains(suspended.as_str()) && lost.count > 0), "{lost:?}");
    assert_eq!(here.ask(&["stop", "fan"]).code, Some(0));
    assert_eq!(mission.ended(SOON).code, Some(1));
    for name in &names {
        let lives = heard(&cluster, name);
        assert_eq!(lives.len(), if name == killed { 2 } else { 1 }, "{name}");
        let lost: u64 = lives.iter().map(|life| missing(name, life)).sum();
        assert_eq!(lost > 0, name == suspended, "{name}: {lost} lost");
        if name == suspended {
            println!("{name}, which was suspended: {lost} lost and counted");
        }
    }
    let (before, meanwhile) = (began..at, at..until);
    let beats = |during: &std::ops::Range<Time>| {
        let lines = lives(&cluster, "first").concat();
        let at = |line: &&Vec<String>| during.contains(&Time::from_nanos(nanos(&line[0])));
        lines.iter().filter(at).map(|line| Duration::from_nanos(nanos(&line[1]))).collect::<Vec<_>>()
    };
    expect_no_later("the writer, from beat to beat", beats(&before), beats(&meanwhile));
    for name in names.iter().filter(|name| ![suspended, killed].contains(name)) {
        let life = heard(&cluster, name).concat();
        let ages = |during: &std::ops::Range<Time>| {
            life.iter().filter(|beat| during.contains(&beat.at)).map(|beat| beat.age).collect::<Vec<_>>()
        };
        expect_no_later(&format!("{name}, from the writer to its calculation"), ages(&before), ages(&meanwhile));
    }
}

/// Checks the beats from one writer that was restarted this number of times. Its numbers rise, and start again in each
/// of its lives. Missing numbers between two beats were counted. Returns the number of missing beats.
#[track_caller]
fn missing_over_lives(name: &str, life: &[Heard], restarts: usize) -> u64 {
    let runs: Vec<&[Heard]> = life.chunk_by(|one, next| next.number > one.number).collect();
    assert!(runs.len() <= 1 + restarts, "{name}: {} runs of numbers, {restarts} restarts", runs.len());
    let missing: u64 = runs.iter().map(|run| run[run.len() - 1].number + 1 - run[0].number - run.len() as u64).sum();
    // Values before a writer's first received number are missing only if the reader was already on the wire.
    let unsure: u64 = runs.iter().map(|run| run[0].number - 1).sum();
    let counted = life.last().map_or(0, |beat| beat.lost) - life.first().map_or(0, |beat| beat.lost);
    assert!((missing..=missing + unsure).contains(&counted), "{name}: {missing} missing, {counted} counted");
    missing
}

/// Two writers, one with short values and one with values in shared memory, and two readers of each. They are killed in
/// turn, at arbitrary times.
#[test]
fn whoever_is_killed_leaves_nothing_behind() {
    const KILLS: usize = 4;
    // A benchmark may have files there, and they do not count.
    let others = shared_memory();
    let cluster = Cluster::new();
    let here = cluster.here();
    let _node = here.node("c1", &[]);
    let names = ["first", "drum", "r0", "r1", "r2", "r3"].map(str::to_owned);
    let kind =
        |name: &str| ["Heart", "Drum", "Ear"][["first", "drum"].iter().position(|one| *one == name).unwrap_or(2)];
    let all: Vec<_> = names.iter().map(|name| (kind(name), name.clone(), "c1", "restart permanent;")).collect();
    let wires: String = (0..4).map(|number| format!("{}, Out -> r{number}, In; ", names[number % 2])).collect();
    let mission = deploy((&cluster, &here), &all, &wires, "first[on], drum, r0, r1, r2, r3");
    wait_for_more(&cluster, &names);
    let mut random = Random::new(7);
    for turn in 0..KILLS * names.len() {
        let killed = &names[turn % names.len()];
        let before = lives(&cluster, killed).len();
        pass(Duration::from_micros(random.below(20_000)));
        let leaf = cluster.expect_leaf(&format!("main/{killed}"));
        leaf.signal(Signal::KILL);
        let is_back = || lives(&cluster, killed).len() > before;
        assert!(wait_until(2 * SOON, is_back).is_some(), "`{killed}` is not started again");
        wait_for_more(&cluster, &names);
    }
    assert_eq!(here.ask(&["stop", "fan"]).code, Some(0));
    assert_eq!(mission.ended(SOON).code, Some(1));
    for name in &names[2..] {
        let lives = heard(&cluster, name);
        assert_eq!(lives.len(), 1 + KILLS, "{name}");
        let missing: u64 = lives.iter().map(|life| missing_over_lives(name, life, KILLS)).sum();
        println!("{name}: {} heard, {missing} missing and counted", lives.concat().len());
    }
    let left: Vec<_> = shared_memory().difference(&others).cloned().collect();
    assert!(left.is_empty(), "{left:?}");
}

/// Returns the names in shared memory that could belong to DCA.
fn shared_memory() -> BTreeSet<OsString> {
    let entries = std::fs::read_dir("/dev/shm").into_iter().flatten().flatten();
    entries.map(|entry| entry.file_name()).filter(|name| name.to_string_lossy().contains("dca")).collect()
}
