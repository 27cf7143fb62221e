//! Plays a row on one machine, with stand-ins for the door's controllers.

use super::row::{Row, is_below};
use super::seen::{Seen, expect_blind, expect_running};
use comms::io::clock::now;
use dca_tests::cluster::{Cluster, Fakes, Freezer, Program, SOON, Trace, pass, spec, wait_until};
use dca_tests::simulation::plan;
use language::TraceEvent;
use language::plan::{MemberKind, Plan};
use rustix::process::Signal;
use std::time::Duration;

/// The longest limit up to which a row is played.
const LIMIT_MAX: Duration = Duration::from_secs(20);
/// A supervisor gives up an unconfirmed stop after 22 s.
const UNCONFIRMED_MAX: Duration = Duration::from_secs(60);

/// The ways to cause a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Strike {
    /// The program receives this signal.
    Signal(Signal),
    /// The program is suspended until the watchdog finds it.
    Suspend,
    /// The program continues, but sends nothing and does not end.
    Hang,
    /// Nothing can end the program, so it does not answer its stop.
    Freeze,
}

/// Which step of a race ends first, if the test continues the mission.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum First {
    /// The step that watches over the others.
    Detector,
    /// The others.
    Others,
}

/// The steps of the door in which a process ends. The watching steps come first.
const DETECTORS: [&str; 5] =
    ["distdetect/threshold", "hit/threshold", "closegrip/fingers", "presshandle", "dooropen/model"];

/// Returns the door, and the programs in it that end on their own.
pub(crate) fn door() -> (Plan, Vec<String>) {
    let text = std::fs::read_to_string(spec("door_opening")).expect("the spec is there");
    let plan = plan("door_opening", &text).unwrap_or_else(|error| panic!("{error}"));
    let members = plan.groups.iter().flat_map(|group| &group.members);
    let steps = members.filter(|member| !member.service).filter_map(|member| match member.kind {
        MemberKind::Leaf(leaf) => Some(plan.leaves[leaf as usize].path.clone()),
        MemberKind::Group(_) => None,
    });
    let steps = steps.collect();
    (plan, steps)
}

/// A mission of stand-ins.
pub(crate) struct Game<'c> {
    pub(crate) row: &'c Row,
    pub(crate) fakes: Fakes<'c>,
    pub(crate) steps: Vec<String>,
}

/// Plays a row, once for each possible end of the mission.
pub(crate) fn play(row: &Row, strike: Strike) {
    let began = now();
    let wanted: &[(First, i32)] = match row.mission.as_str() {
        "may fail" => &[(First::Detector, 0), (First::Others, 1)],
        "can be done" => &[(First::Detector, 0)],
        "fails" | "fails at a limit" => &[(First::Detector, 1)],
        other => panic!("{}: no test for a mission that {other}", row.name),
    };
    for (first, code) in wanted {
        play_once(row, strike, *first, *code);
    }
    println!("{}: {} in {:.1?}", row.name, row.verdict, now() - began);
}

fn play_once(row: &Row, strike: Strike, first: First, code: i32) {
    let program = row.program.as_deref().expect("a row of a program");
    let cluster = Cluster::new();
    let (plan, steps) = door();
    let game = Game { row, fakes: Fakes::new(&cluster), steps };
    let controllers = Fakes::program();
    let mission = cluster.here().dca(&["run", &spec("door_opening"), "--controllers", &controllers]);
    match strike {
        Strike::Freeze => return unconfirmed(&game, &cluster, mission),
        Strike::Signal(_) | Strike::Suspend | Strike::Hang => game.before(&row.before),
    }
    game.expect_phase();
    match strike {
        Strike::Signal(which) => crash(&cluster, program, which),
        Strike::Suspend => cluster.expect_leaf(program).signal(Signal::STOP),
        Strike::Hang | Strike::Freeze => game.fakes.order(program, "hang"),
    }
    if row.verdict != "safe" {
        expect_running(row, &game.fakes, SOON);
    }
    if strike == Strike::Hang {
        expect_blind(row, &game.fakes, &plan, program);
    }
    match row.mission.as_str() {
        "may fail" | "can be done" => game.go_on(&mission, first),
        _ => {}
    }
    let ended = mission.ended(SOON + LIMIT_MAX);
    assert_eq!(ended.code, Some(code), "{}: {ended}", row.name);
    let trace = Trace::read(&cluster.folder().join("runs/door_opening-1"));
    if strike != Strike::Hang {
        Seen::since_the_end_of(&trace, program).expect_at_once(row);
    }
    assert!(game.fakes.active().is_empty(), "{}: {:?} is still active", row.name, game.fakes.active());
    if let Some(within) = row.safe_within {
        let took = Seen::since_the_end_of(&trace, program).safe_after();
        println!("{}: safe after {took:.2?}, the row says {within:?}", row.name);
        assert!(took <= within, "{}: safe after {took:?}, the row says {within:?}", row.name);
    }
}

/// Sends a signal to a program until it is gone. The first SIGSEGV from outside only removes a Rust program's
/// handler.
pub(crate) fn crash(cluster: &Cluster, program: &str, signal: Signal) {
    let first = cluster.expect_leaf(program);
    let is_gone = || {
        let left = cluster.leaf(program).filter(|process| process.pid == first.pid);
        left.iter().for_each(|process| process.signal(signal));
        left.is_none()
    };
    wait_until(SOON, is_gone).unwrap_or_else(|| panic!("`{program}` outlives {signal:?}"));
}

/// Nothing ends the program before the end of the test, so it does not answer its stop.
fn unconfirmed(game: &Game<'_>, cluster: &Cluster, mission: Program) {
    let Some(freezer) = Freezer::new() else { return };
    let (row, program) = (game.row, game.row.program.as_deref().expect("a row of a program"));
    let is_cause = |event: &TraceEvent| matches!(event, TraceEvent::Done(..) | TraceEvent::Fails(..));
    let cause = row.before.iter().rposition(is_cause).expect("something makes it stop");
    game.before(&row.before[..cause]);
    wait_until(SOON, || game.fakes.active().iter().any(|path| path == program)).expect("it runs");
    let frozen = cluster.expect_leaf(program);
    freezer.freeze(frozen.pid.unsigned_abs());
    game.before(&row.before[cause..=cause]);
    let ended = mission.ended(UNCONFIRMED_MAX);
    assert_eq!(ended.code, Some(1), "{}: {ended}", row.name);
    let others: Vec<String> = game.fakes.active().into_iter().filter(|path| path != program).collect();
    assert!(others.is_empty(), "{}: {others:?} still run", row.name);
    let trace = Trace::read(&cluster.folder().join("runs/door_opening-1"));
    assert_eq!(trace.unconfirmed().len(), 1, "{}: the host of the program knows: {ended}", row.name);
    Seen::since_the_end_of(&trace, program).expect_at_once(row);
    assert_eq!(row.verdict, "unconfirmed");
}

impl Game<'_> {
    /// Plays the events of the row that happen before its fault.
    pub(crate) fn before(&self, events: &[TraceEvent]) {
        for event in events {
            match event {
                // Messages between hosts arrive without help.
                TraceEvent::Start(_) | TraceEvent::Reached(_) | TraceEvent::Arrived(_) | TraceEvent::Heard(_) => {}
                TraceEvent::Done(path, _) => self.done(path),
                TraceEvent::Stopped(path) => {
                    let has_stopped = || !self.fakes.active().iter().any(|active| is_below(active, path));
                    wait_until(SOON, has_stopped).unwrap_or_else(|| panic!("{}: `{path}` goes on", self.row.name));
                }
                TraceEvent::Stop
                | TraceEvent::Fails(..)
                | TraceEvent::Elapsed(..)
                | TraceEvent::Struck(..)
                | TraceEvent::Dies(_)
                | TraceEvent::Back(_)
                | TraceEvent::TooMany(_)
                | TraceEvent::Told(..)
                | TraceEvent::Script(..)
                | TraceEvent::Lost(_)
                | TraceEvent::Cut(_)
                | TraceEvent::Noted(_) => panic!("{}: the driver cannot let `{event}` happen", self.row.name),
            }
        }
    }

    /// Lets a step be done. This is the program itself, or the program of the group that ends on its own.
    fn done(&self, path: &str) {
        let running = || {
            let active = self.fakes.active();
            active.into_iter().find(|active| is_below(active, path) && self.steps.contains(active))
        };
        let mut found = None;
        wait_until(SOON, || {
            found = running();
            found.is_some()
        });
        let step = found.unwrap_or_else(|| panic!("{}: no step of `{path}` runs", self.row.name));
        self.end(&step);
    }

    fn end(&self, step: &str) {
        self.fakes.order(step, "done");
        let has_ended = || !self.fakes.active().iter().any(|active| active == step);
        wait_until(SOON, has_ended).unwrap_or_else(|| panic!("{}: `{step}` does not end", self.row.name));
    }

    /// Checks that exactly the steps of the phase run, apart from the program itself.
    pub(crate) fn expect_phase(&self) {
        let (row, own) = (self.row, self.row.program.as_deref().unwrap_or_default());
        let is_so = || {
            let active = self.fakes.active();
            let mut steps = active.iter().filter(|path| self.steps.contains(path));
            let is_own = own.is_empty() || active.iter().any(|path| path == own);
            is_own
                && row.phase.iter().all(|step| active.iter().any(|path| is_below(path, step)))
                && steps.all(|path| path == own || row.phase.iter().any(|step| is_below(path, step)))
        };
        let said = || format!("{}: the phase does not come, runs {:#?}", row.name, self.fakes.active());
        wait_until(SOON, is_so).unwrap_or_else(|| panic!("{}", said()));
        // The services have also begun, and their wires carry values.
        pass(Duration::from_millis(300));
    }

    /// Lets one step after the other be done, until the mission is over.
    pub(crate) fn go_on(&self, mission: &Program, first: First) {
        let rank = |path: &String| {
            let detector = DETECTORS.iter().any(|name| path.ends_with(name));
            detector == (first == First::Others)
        };
        let is_own = |path: &String| Some(path.as_str()) == self.row.program.as_deref();
        let next = || {
            let mut steps: Vec<String> =
                self.fakes.active().into_iter().filter(|path| self.steps.contains(path) && !is_own(path)).collect();
            steps.sort_by_key(rank);
            steps.into_iter().next()
        };
        let is_over = || {
            if let Some(step) = next() {
                self.fakes.order(&step, "done");
            }
            !mission.is_running()
        };
        wait_until(2 * SOON, is_over).unwrap_or_else(|| panic!("{}: the mission does not end", self.row.name));
    }
}
