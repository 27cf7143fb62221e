//! Compares brute force with the answers about a crash or a hang of a program: the rows of `fmea`, and the sentences of
//! `verify`.

use super::explore::{Edge, Graph, Move, Seen, Trouble, explore};
use super::random::{Dice, Taste, group};
use super::rules::Event;
use super::term::{Outcome, expression};
use super::text::text;
use crate::faults::{MISSION, contradicts, proved};
use language::plan::{Expression, Group, Plan};
use language::{Options, Source, compile_with_sites};
use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;
use std::time::Duration;
use verify::{Alone, Always, Faults, Limits, Mission, Row, Severity, Table};

/// The test leaves out a group with a `,` and more states: `verify` may explore the operands of a large `,` alone, and
/// the rows then name fewer steps.
const STATES_MAX: usize = 50;

/// The result for a seed.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Compared {
    /// The number of compared rows, and of those in which a limit passes on the way to success.
    Same {
        rows: usize,
        caught: usize,
    },
    /// The check refused the spec, or the spec has too many states for brute force.
    LeftOut,
    Differs(String),
}

/// The name of a mission's result, as `fmea` prints it.
type Words = &'static str;

/// The results of one fault by brute force.
#[derive(Debug, Default)]
struct Struck {
    /// By the steps that run beside the program: the results of the mission, and whether something may get stuck.
    phases: BTreeMap<BTreeSet<String>, BTreeSet<(Words, bool)>>,
    /// The phases in which a limit may pass on the way to success, and no success is possible without it.
    caught: BTreeSet<BTreeSet<String>>,
    /// Whether each sentence of [`MISSION`] holds.
    holds: [bool; 3],
}

pub(crate) fn compare(seed: u64) -> Compared {
    let mut dice = Dice::new(seed);
    let mut made = group(&mut dice, Taste::Text);
    limited(&mut dice, &mut made.expression);
    let members = 0..u32::try_from(made.members.len()).expect("few members");
    let troubles = members.flat_map(|member| [Trouble::Crash(member), Trouble::Hang(member)]);
    let troubles: Vec<Trouble> = troubles.collect();
    let sentences = |trouble: &Trouble| MISSION.map(|what| format!("        {}: {what};\n", on(*trouble))).concat();
    let (text, tags) = text(&made, &troubles.iter().map(sentences).collect::<String>());
    let source = Source::new("random.dca", text.clone());
    let (compiled, sites) = compile_with_sites(&source, &[], &Options::named("random"));
    let Some((plan, sites)) = compiled.plan.zip(sites) else { return Compared::LeftOut };
    let lowered = Rc::new(plan.groups[0].clone());
    let limits = Limits { states: 200_000, memory: 64 << 20, threads: &Alone, goes_on: &Always };
    let (report, table) = (verify::verify(&plan, &sites, &limits), verify::fmea(&plan, &sites, &limits, Faults::One));
    let (mut differences, mut rows, mut caught) = (Vec::new(), 0, 0);
    for trouble in troubles {
        let is_whole = |graph: &Graph| graph.seen.len() <= STATES_MAX || !has_parallel(&lowered.expression);
        let Some(graph) = explore(&lowered, &tags, trouble).filter(is_whole) else { return Compared::LeftOut };
        let struck = struck(&plan, &graph, trouble);
        let proved = proved(&report, &on(trouble));
        if proved != struck.holds {
            let holds = struck.holds;
            differences.push(format!("{MISSION:?} {}: {holds:?} by brute force, verify says {proved:?}", on(trouble)));
        }
        differences.extend(of_rows(trouble, &struck, &table));
        rows += struck.phases.len();
        caught += struck.caught.len();
    }
    match differences.is_empty() {
        true => Compared::Same { rows, caught },
        false => Compared::Differs(format!("seed {seed}: {}\n{text}", differences.join("\n"))),
    }
}

/// Compares the rows of the loss of a host, or of the link to it, with the sentences about this loss. Every second
/// program runs on this host. Returns the number of rows, or nothing if the check refuses the spec.
pub(crate) fn compare_loss(seed: u64) -> Result<Option<usize>, String> {
    let mut dice = Dice::new(seed);
    let mut made = group(&mut dice, Taste::Text);
    limited(&mut dice, &mut made.expression);
    let sentences = MISSION.map(|what| format!("        on loss of host(c2): {what};\n")).concat();
    let (mut text, _) = text(&made, &sentences);
    for slot in (0..made.members.len()).step_by(2) {
        text = text.replace(&format!("instof M{slot}(c1)"), &format!("instof M{slot}(c2)"));
    }
    let (compiled, sites) = compile_with_sites(&Source::new("a.dca", &text), &[], &Options::named("a"));
    let Some((plan, sites)) = compiled.plan.zip(sites) else { return Ok(None) };
    let limits = Limits { states: 200_000, memory: 64 << 20, threads: &Alone, goes_on: &Always };
    let proved = proved(&verify::verify(&plan, &sites, &limits), "on loss of host(c2)");
    let table = verify::fmea(&plan, &sites, &limits, Faults::One);
    let is_of_loss = |row: &&Row| ["host c2", "c1 - c2"].contains(&row.program.as_str());
    let rows: Vec<&Row> = table.rows.iter().filter(is_of_loss).collect();
    match rows.iter().find(|row| contradicts(row, proved)) {
        None => Ok(Some(rows.len())),
        Some(row) => Err(format!("seed {seed}: {} but {proved:?} of {MISSION:?}\n{text}", row.cells().join(" | "))),
    }
}

/// Adds limits to some of the operands. Something around a limit may catch its failure.
fn limited(dice: &mut Dice, expression: &mut Expression) {
    use Expression as E;
    let inside: Vec<&mut E> = if let E::Sequence(of, _) | E::Otherwise(of, _) | E::Finally(of, _) = expression {
        vec![&mut **of]
    } else if let E::Catch { of, .. } = expression {
        vec![&mut **of]
    } else if let E::Concurrent(of) | E::Disable(of) = expression {
        of.iter_mut().collect()
    } else {
        Vec::new()
    };
    inside.into_iter().for_each(|of| limited(dice, of));
    if !dice.one_in(4) {
        return;
    }
    let seconds = |seconds| E::Wait(Duration::from_secs(seconds));
    let limit = E::Sequence(Box::new(seconds(5)), Box::new(E::Fail("broken".to_owned())));
    let limited = E::Disable(vec![std::mem::replace(expression, E::Skip), limit]);
    let caught = |limited| E::Otherwise(Box::new(limited), Box::new(E::Skip));
    *expression = match dice.below(3) {
        0 => limited,
        1 => caught(limited),
        _ => E::Sequence(Box::new(caught(limited)), Box::new(seconds(1))),
    };
}

fn on(trouble: Trouble) -> String {
    match trouble {
        Trouble::Crash(member) => format!("on crash of m{member}"),
        Trouble::Hang(member) => format!("on hang of m{member}"),
        Trouble::None | Trouble::Any => unreachable!("only single faults are compared"),
    }
}

fn has_parallel(expression: &Expression) -> bool {
    matches!(expression, Expression::Concurrent(_)) || expression.operands().into_iter().any(has_parallel)
}

/// Adds for each timer of an expression whether it is a limit, by the number of the timer.
fn limits_of(expression: &Expression, limits: &mut Vec<bool>) {
    if let Expression::Sequence(clock, end) = expression
        && matches!((&**clock, &**end), (Expression::Wait(_), Expression::Fail(_)))
    {
        return limits.push(true);
    }
    if matches!(expression, Expression::Wait(_) | Expression::Shield { bound: Some(_), .. }) {
        limits.push(false);
    }
    expression.operands().into_iter().for_each(|of| limits_of(of, limits));
}

/// Finds the results of one fault.
fn struck(plan: &Plan, graph: &Graph, trouble: Trouble) -> Struck {
    let group = &plan.groups[0];
    let mut limits = Vec::new();
    limits_of(&group.expression, &mut limits);
    let passes = |edge: &Edge| matches!(edge.what, Move::Leaf(Event::Elapsed(timer)) if limits[timer as usize]);
    let is_free = |edge: &Edge| edge.is_natural() && !passes(edge);
    let done = graph.can_reach(is_done);
    let done_freely = graph.can_reach_by(is_done, is_free);
    let (fails, fails_freely) = (graph.can_reach(is_failed), graph.can_reach_by(is_failed, is_free));
    let hung = if let Trouble::Hang(member) = trouble { Some(member) } else { None };
    let hung = hung.filter(|member| !group.members[*member as usize].service);
    let is_gone = |seen: &Seen| hung.is_none_or(|it| !seen.active.contains(&it) && !seen.stopping.contains(&it));
    let ended = graph.can_reach(is_gone);
    let is_service = expression(group).is_service;
    let mut struck = Struck::default();
    for (before, edges) in graph.edges.iter().enumerate() {
        for target in edges.iter().filter(|edge| edge.what == Move::Fault).map(|edge| edge.target) {
            let at_last = settled(graph, target);
            let may_anyway = fails_freely[before];
            let mission = match (done[target], fails_freely[target], fails[target]) {
                _ if is_done(&graph.seen[at_last]) => Mission::Done,
                _ if is_failed(&graph.seen[at_last]) => Mission::Fails,
                _ if is_service && !done[target] && !fails[target] => Mission::GoesOn,
                (true, true, _) if !may_anyway => Mission::MayFail,
                (true, ..) => Mission::CanBeDone,
                (false, true, _) => Mission::Fails,
                (false, false, true) => Mission::EndsByLimit,
                (false, false, false) => Mission::NeverEnds,
            };
            let phase = phase(group, &graph.seen[before], trouble);
            if done[target] && !done_freely[target] {
                struck.caught.insert(phase.clone());
            }
            struck.phases.entry(phase).or_default().insert((mission.word(), !ended[target]));
        }
    }
    let after: Vec<usize> = (0..graph.seen.len()).filter(|&state| graph.seen[state].is_struck).collect();
    struck.holds = [
        after.iter().all(|&state| done[state]),
        !after.iter().any(|&state| is_done(&graph.seen[state])),
        !after.iter().any(|&state| is_failed(&graph.seen[state])),
    ];
    struck
}

fn is_done(seen: &Seen) -> bool {
    matches!(seen.ended, Some(Outcome::Done(_)))
}

fn is_failed(seen: &Seen) -> bool {
    seen.ended.is_some() && !is_done(seen)
}

/// Returns the state in which all stops are answered.
fn settled(graph: &Graph, mut state: usize) -> usize {
    while let Some(edge) = graph.edges[state].iter().find(|edge| matches!(edge.what, Move::Leaf(Event::Stopped(_)))) {
        state = edge.target;
    }
    state
}

/// Returns the steps that run beside the struck program, or `alone`, or `between two steps` while something stops.
fn phase(group: &Group, seen: &Seen, trouble: Trouble) -> BTreeSet<String> {
    let is_own = |member: u32| [Trouble::Crash(member), Trouble::Hang(member)].contains(&trouble);
    let is_step = |member: u32| !is_own(member) && !group.members[member as usize].service;
    let steps: BTreeSet<String> =
        seen.active.iter().filter(|member| is_step(**member)).map(|member| format!("m{member}")).collect();
    match (steps.is_empty(), seen.stopping.iter().all(|member| is_own(*member))) {
        (false, _) => steps,
        (true, true) => BTreeSet::from(["alone".to_owned()]),
        (true, false) => BTreeSet::from(["between two steps".to_owned()]),
    }
}

fn of_rows(trouble: Trouble, struck: &Struck, table: &Table) -> Vec<String> {
    let (program, fault) = match trouble {
        Trouble::Crash(member) => (format!("m{member}"), "crash"),
        Trouble::Hang(member) => (format!("m{member}"), "hang"),
        Trouble::None | Trouble::Any => unreachable!("only single faults are compared"),
    };
    let mut differences = Vec::new();
    let mut phases: BTreeSet<BTreeSet<String>> = BTreeSet::new();
    for row in table.rows.iter().filter(|row| row.program == program && row.fault == fault) {
        let cells = row.cells().join(" | ");
        let phase: BTreeSet<String> = row.phase.split(", ").map(str::to_owned).collect();
        let results = struck.phases.get(&phase);
        if !results.is_some_and(|results| results.iter().any(|(mission, _)| *mission == row.mission.word())) {
            differences.push(format!("{cells}: {results:?} by brute force"));
        }
        let may_stick = results.is_some_and(|all| all.iter().any(|(what, sticks)| *sticks || *what == "never ends"));
        if may_stick != (row.severity == Severity::Stuck) {
            differences.push(format!("{cells}: it may get stuck: {may_stick} by brute force"));
        }
        let can_only_fail = [Mission::Fails, Mission::EndsByLimit].contains(&row.mission);
        let is_wrong = match row.severity {
            Severity::Degraded => can_only_fail,
            Severity::FailsLater => !can_only_fail,
            Severity::Handled
            | Severity::Safe
            | Severity::Blind
            | Severity::Unconfirmed
            | Severity::Adrift
            | Severity::Stuck => false,
        };
        if is_wrong {
            differences.push(format!("{cells}: the verdict and the mission contradict each other"));
        }
        phases.insert(phase);
    }
    let missing = struck.phases.keys().filter(|phase| !phases.contains(*phase));
    differences.extend(missing.map(|phase| format!("{program} {fault}: no row while {phase:?}")));
    differences
}
