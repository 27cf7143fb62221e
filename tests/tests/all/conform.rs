//! Compares runs with crashes with the verified plan. There are simulated and real runs, and runs with a deliberate
//! mistake.

use cli::io::recorder::{self, Recorder};
use cli::logic::record::{Entry, Run};
use comms::logic::time::Time;
use controllers::sdk::harness::Disturbance;
use dca_tests::cluster::{Cluster, SOON, Stream, rounds, spec, wait_until};
use dca_tests::simulation::{Simulation, plan};
use language::algebra::Command;
use language::sites::Sites;
use language::{Options, Source, compile_with_sites};
use node::logic::protocol::Report;
use rustix::process::Signal;
use std::path::Path;
use std::time::Duration;
use verify::{Alone, Always, Conformance, Limits, Verdict};

const LIMITS: Limits<'static> = Limits { states: 100_000, memory: 64 << 20, threads: &Alone, goes_on: &Always };
/// The longest mission, on its own clock.
const MISSION_MAX: Time = Time::from_nanos(90_000_000_000);

fn door() -> (String, Sites) {
    let text = std::fs::read_to_string(spec("door_opening")).expect("the spec is there");
    let interfaces = [Source::new("controllers", controllers::registry().interface_text())];
    let (_, sites) =
        compile_with_sites(&Source::new("door.dca", text.clone()), &interfaces, &Options::named("door_opening"));
    (text, sites.expect("the door has a plan"))
}

/// Opens the door once. `seed` chooses the program that dies, and its time.
fn opened(text: &str, sites: &Sites, seed: u64, loses: Option<fn(&Command) -> bool>) -> (bool, Conformance) {
    let plan = plan("door_opening", text).unwrap_or_else(|error| panic!("{error}"));
    let mut simulation =
        Simulation::new(plan.clone(), Disturbance::busy(seed)).unwrap_or_else(|error| panic!("{error}"));
    if let Some(loses) = loses {
        simulation.lose(loses);
    }
    let leaves: Vec<String> = simulation.leaves().map(str::to_owned).collect();
    // Neighbouring seeds result in very different numbers.
    let random = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let victim = leaves[usize::try_from(random >> 40).expect("24 bits") % leaves.len()].clone();
    let at = Time::from_nanos((random >> 16) % 36_000 * 1_000_000);
    let mut has_crashed = false;
    simulation.run(MISSION_MAX, &mut |simulation| {
        // An inactive program dies as soon as it becomes active.
        has_crashed = has_crashed || simulation.now() >= at && simulation.crash(&victim);
    });
    let records: Vec<_> = simulation.steps().iter().map(|steps| vec![steps.clone()]).collect();
    (has_crashed, verify::conform(&plan, sites, &records, &LIMITS))
}

/// `DCA_TEST_ROUNDS=200` makes the number of runs that the acceptance requires.
#[test]
fn simulated_doors_with_crashes_conform() {
    let (text, sites) = door();
    let (mut crashes, all) = (0, rounds(6_u64));
    for seed in 0..all {
        let (has_crashed, found) = opened(&text, &sites, seed, None);
        crashes += u64::from(has_crashed);
        assert!(found.steps > 0);
        assert_eq!(found.deviations, Vec::new(), "seed {seed}");
        let broken: Vec<_> = found.sentences.iter().filter(|it| it.verdict == Verdict::Fails).collect();
        assert!(broken.is_empty(), "seed {seed}: {broken:?}");
    }
    assert!(2 * crashes >= all, "{crashes} of {all} runs had a crash");
}

#[test]
fn a_supervisor_that_forgets_to_stop_is_found() {
    let (text, sites) = door();
    let (_, found) = opened(&text, &sites, 1, Some(|command| matches!(command, Command::Stop { .. })));
    let deviation = found.deviations.first().and_then(|finding| finding.diagnostic.as_ref()).expect("it is found");
    assert!(deviation.help.iter().any(|help| help.contains("expected: stops")), "{deviation:?}");
}

const ROUNDS: &str = "
    module Step(host) { exec \"sleep 0.2\"; plain; done; }
    module Watch(host) { exec \"sleep 60\"; plain; service; }

    process Cell(there){
        host{there}
        instantiated_processes{ watch instof Watch(there); pick instof Step(there); place instof Step(there); }
        internal_event_actions{ watch , (pick ; place) }
    }
    process main(){
        host{c1}
        instantiated_processes{ cell instof Cell(\"c1\"); home instof Step(c1) { restart transient; } }
        internal_event_actions{ (cell else home) ; retry(2) home }
        verify{ home only after cell.ended; }
    }";

/// Writes a record again with changed entries.
fn rewritten(run: &Run, folder: &Path, change: impl Fn(&mut Report)) {
    let recorder = Recorder::create(folder, &run.header).expect("a test can write in its own folder");
    for entry in &run.entries {
        let mut entry = entry.clone();
        if let Entry::Report(report) = &mut entry {
            change(report);
        }
        recorder.push(entry);
    }
    recorder.finish().expect("the record is written");
}

#[test]
fn real_runs_with_kills_conform_and_a_planted_deviation_is_found() {
    let cluster = Cluster::new();
    let file = cluster.file("cell.dca", ROUNDS);
    let victims = ["main/cell/watch", "main/cell/pick", "main/home", "main/cell/place"];
    let all = rounds(4_u32);
    for round in 0..all {
        let mission = cluster.here().dca(&["run", &file]);
        mission.wait_for(Stream::Err, "▸", SOON);
        let victim = victims[round as usize % victims.len()];
        if let Some(program) = cluster.leaf(victim) {
            program.signal(Signal::KILL);
        }
        mission.ended(SOON);
        cluster.expect_nothing_left(Duration::from_secs(5));
        let folder = cluster.folder().join(format!("runs/cell-{}", round + 1));
        let compared = cluster.here().ask(&["conform", &folder.display().to_string(), &file]);
        assert!(
            compared.code == Some(0) && compared.out.contains("all steps agree with the spec"),
            "{victim}: {compared}"
        );
        assert!(compared.out.contains("proved: main: home only after cell.ended"), "{compared}");
    }
    let run = recorder::read(&cluster.folder().join("runs/cell-1").join(recorder::FILE)).expect("the record is whole");
    let planted = cluster.folder().join("planted");
    rewritten(&run, &planted, |report| {
        if let Report::Stepped { steps, .. } = report {
            let is_lost = |command: &Command| matches!(command, Command::Activate { member: 1, .. });
            steps.iter_mut().for_each(|step| step.commands.retain(|command| !is_lost(command)));
        }
    });
    let compared = cluster.here().ask(&["conform", &planted.display().to_string(), &file]);
    assert!(compared.code == Some(1) && compared.err.is_empty(), "{compared}");
    assert!(compared.out.contains("did something else than the spec says"), "{compared}");
    let other = cluster.file("other.dca", &ROUNDS.replace("pick ; place", "pick , place"));
    let compared = cluster.here().ask(&["conform", &planted.display().to_string(), &other]);
    assert!(compared.code == Some(1) && compared.err.contains("`main/cell` differs"), "{compared}");
}

/// The kind of the part that ends the data of a record.
const END_OF_DATA: u8 = 0x0f;

/// Returns where the parts of a record begin and where the record ends, and where its data ends. Each part has one
/// byte for its kind and eight bytes for its length.
fn boundaries(bytes: &[u8]) -> (Vec<usize>, usize) {
    let (mut at, mut all, mut data) = (8, vec![0, 8], bytes.len());
    while let Some(length) = bytes.get(at + 1..at + 9).and_then(|length| <[u8; 8]>::try_from(length).ok()) {
        let Ok(length) = usize::try_from(u64::from_le_bytes(length)) else { break };
        let kind = bytes[at];
        at += 9 + length;
        all.push(at.min(bytes.len()));
        if kind == END_OF_DATA {
            data = at;
        }
    }
    (all, data)
}

/// A damaged record was cut, or has a wrong bit. It is never called compared, and never counts as a deviation.
#[test]
fn a_damaged_record_is_not_decided() {
    let cluster = Cluster::new();
    let file = cluster.file("cell.dca", ROUNDS);
    let done = cluster.here().ask(&["run", &file]);
    assert!(done.code == Some(0), "{done}");
    let bytes = std::fs::read(cluster.folder().join("runs/cell-1").join(recorder::FILE)).expect("it is recorded");
    let damaged = cluster.folder().join("damaged.mcap");
    let conform = |bytes: &[u8]| {
        std::fs::write(&damaged, bytes).expect("a test can write in its own folder");
        cluster.here().ask(&["conform", &damaged.display().to_string(), &file])
    };
    let (boundaries, data) = boundaries(&bytes);
    assert!(boundaries.len() > 8 && data < bytes.len(), "{boundaries:?}");
    let near = boundaries.iter().flat_map(|at| [at.saturating_sub(1), *at, at + 1, at + 5, at + 9, at + 20]);
    let mut cuts: Vec<usize> = near.chain([3]).filter(|cut| *cut < bytes.len()).collect();
    cuts.sort_unstable();
    cuts.dedup();
    let (mut without_steps, mut reasons) = (0, 0);
    for cut in thinned(&cuts) {
        let compared = conform(&bytes[..cut]);
        // A table of contents after its data belongs to a whole record.
        assert_eq!(compared.code, Some(4), "cut at {cut}, where the data ends at {data}: {compared}");
        assert!(!compared.err.contains("earlier version") && !compared.out.contains("earlier version"), "{compared}");
        without_steps += usize::from(compared.out.contains("not decided: the record has no step of a supervisor"));
        reasons += usize::from(compared.out.contains("not decided: ") || compared.err.contains("is not whole: "));
    }
    assert!(without_steps > 0 && reasons > 0, "{without_steps} without steps, {reasons} with a reason");
    for at in thinned(&cuts).filter(|at| *at >= 8) {
        let mut turned = bytes.clone();
        turned[at] ^= 0x10;
        let compared = conform(&turned);
        assert!([Some(0), Some(4)].contains(&compared.code), "a bit of byte {at} turned: {compared}");
    }
    assert_eq!(conform(&bytes).code, Some(0));
    assert_eq!(conform(b"another file").code, Some(1));
}

/// Selects some of many, since each one means running a program.
fn thinned(cuts: &[usize]) -> impl Iterator<Item = usize> {
    let step = (cuts.len() / rounds(30)).max(1);
    cuts.iter().copied().step_by(step)
}

/// A different host, program, argument or policy makes a different version of the spec.
#[test]
fn a_record_of_another_deployment_is_told_by_what_differs() {
    let cluster = Cluster::new();
    let text = ROUNDS.replace("cell instof Cell(\"c1\")", "cell instof Cell(\"c2\")");
    let file = cluster.file("cell.dca", &text);
    let done = cluster.here().ask(&["run", &file]);
    assert!(done.code == Some(0), "{done}");
    let record = cluster.folder().join("runs/cell-1").display().to_string();
    let cases = [
        ("Cell(\"c2\")", "Cell(\"c1\")", "`main/cell` differs in its host: `c2` in the record, `c1` in the spec"),
        ("sleep 0.2", "sleep 0.3", "differs in its exec: `sleep 0.2` in the record, `sleep 0.3` in the spec"),
        ("restart transient", "restart permanent", "`main/home` differs in its restart: `transient` in the record"),
        (
            "watch instof Watch(there)",
            "watch instof Watch(there) { memory 900 MB; }",
            "`main/cell/watch` differs in its limits",
        ),
        ("retry(2)", "retry(3)", "`main` differs in its event actions"),
    ];
    for (from, to, expected) in cases {
        let other = cluster.file("other.dca", &text.replace(from, to));
        let compared = cluster.here().ask(&["conform", &record, &other]);
        assert!(compared.code == Some(1) && compared.err.contains(expected), "{from} -> {to}: {compared}");
    }
    assert_eq!(cluster.here().ask(&["conform", &record, &file]).code, Some(0));
}

/// A spec without a proof does not run.
#[test]
fn a_spec_that_is_not_proved_is_not_started() {
    let cluster = Cluster::new();
    let file = cluster.file("cell.dca", &ROUNDS.replace("home only after cell.ended", "home at most once"));
    let refused = cluster.here().ask(&["run", "--require-verified", &file]);
    assert!(refused.code == Some(1) && refused.err.contains("nothing was started"), "{refused}");
    assert!(!cluster.folder().join("runs").exists());
    let proved = ROUNDS.replace(" { restart transient; }", ";");
    let done = cluster.here().ask(&["run", "--require-verified", &cluster.file("proved.dca", &proved)]);
    assert!(done.code == Some(0), "{done}");
    // The proved text is also the text that runs, since it is read only once.
    let done = cluster.here().ask_given(&["run", "--require-verified", "-"], proved.as_bytes());
    assert!(done.code == Some(0), "{done}");
}

/// A program is removed while it runs. The end of the program does not count as an abort, and the steps before the
/// change are compared.
#[test]
fn a_run_is_compared_up_to_the_change_of_its_event_actions() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let text = "module Sleep(host) { exec \"sleep 600\"; plain; service; }
        process main() {
            host { c1 }
            instantiated_processes { dust instof Sleep(c1); drive instof Sleep(c1); }
            internal_event_actions { dust , drive , wait(600 s) }
        }";
    let file = cluster.file("rooms.dca", text);
    let _node = here.node("c1", &[]);
    let mission = here.dca(&["deploy", &file]);
    mission.wait_for(Stream::Err, "▸", SOON);
    let replaced = here.ask(&["replace", "rooms", "drive", "--probation", "0"]);
    assert_eq!(replaced.code, Some(0), "{replaced}");
    let removed = here.ask(&["remove", "rooms", "dust"]);
    assert_eq!(removed.code, Some(0), "{removed}");
    let has_ended = || {
        here.ask(&["events", "rooms"]).out.lines().any(|line| line.contains("main/dust") && line.ends_with("stopped"))
    };
    assert!(wait_until(SOON, has_ended).is_some(), "{}", here.ask(&["events", "rooms"]));
    let stopped = here.ask(&["stop", "rooms"]);
    assert_eq!(stopped.code, Some(0), "{stopped}");
    let ended = mission.ended(SOON);
    assert!(!ended.err.contains("dust aborted"), "{ended}");
    let compared = here.ask(&["conform", &cluster.folder().join("runs/rooms-1").display().to_string(), &file]);
    assert!(compared.code == Some(4) && compared.out.contains("all steps agree with the spec"), "{compared}");
    assert!(compared.out.contains("steps of main, after a change of its event actions during the run"), "{compared}");
}
