//! The catalogue: the questions that are checked for every spec, without any sentence in it.
//!
//! Each part is explored alone, with its members as black boxes. Any program may fail, and the whole may be stopped at any time.
//! A part is explored before the part that contains it, so the possible ends of each box are known.

mod outside;
mod stops;

use crate::explore::{Found, Graph, Limits, Nobody, Reached, WorkDone, explore, is_over};
use crate::finding::{Finding, diagnostic, help};
use crate::limits::late;
use crate::model::{Ends, Model, Seat, run_nodes};
use crate::story::inside::{self, Way};
use crate::story::{place, story_to_the_end};
use crate::system::MemberRef;
use crate::system::{Changed, Frame, Label, Phase, System, escalates, has_order};
use language::automaton::Failure;
use language::plan::Expression;
use language::{Code, Span};
use outside::Suspect;
use std::collections::BTreeSet;
use stops::shields;

/// The results of exploring all parts.
#[derive(Debug, Default)]
pub(crate) struct Catalogue {
    pub(crate) findings: Vec<Finding>,
    /// How many states were explored, in all parts.
    pub(crate) states: u64,
    /// How many transitions.
    pub(crate) transitions: u64,
    /// The most memory that the exploration of one part took, in bytes.
    pub(crate) memory: usize,
    /// The groups that were not explored completely, each with the limit that was reached.
    pub(crate) unfinished: Vec<(u32, Reached)>,
}

/// Which kinds of mistakes were searched, and whether one was found.
#[derive(Default)]
struct Asked {
    stuck: bool,
    unreached: bool,
    stops: bool,
    waits: bool,
    /// The parts that get stuck when they are explored alone.
    suspects: Vec<Suspect>,
    /// The processes that are never started because of the order of timers, each with its group.
    behind_timers: Vec<(u32, Finding)>,
}

/// Explores every part. Afterwards the model has the possible ends of each part.
pub(crate) fn explore_parts(model: &mut Model<'_>, limits: &Limits<'_>) -> Catalogue {
    let mut catalogue = Catalogue::default();
    let mut asked = Asked::default();
    let parts = inside_out(model);
    for (done, part) in parts.iter().enumerate() {
        limits.goes_on.hear(WorkDone::Jobs { what: "groups", done, of: parts.len() });
        explore_part(model, *part, limits, &mut catalogue, &mut asked);
    }
    let suspects = std::mem::take(&mut asked.suspects);
    outside::judge(model, suspects, limits, &mut catalogue, &mut asked);
    too_late(model, &mut catalogue, &mut asked);
    summary(model, &asked, &mut catalogue);
    catalogue
}

/// Returns the parts in an order in which each one comes after all parts inside it.
fn inside_out(model: &Model<'_>) -> Vec<usize> {
    let (mut order, mut open) = (Vec::new(), vec![0_usize]);
    while let Some(part) = open.pop() {
        order.push(part);
        open.extend(model.parts[part].members.iter().filter_map(|seat| match seat {
            Seat::Part(inner) => Some(*inner),
            Seat::Leaf(_) => None,
        }));
    }
    order.reverse();
    let mut seen = BTreeSet::new();
    order.retain(|part| seen.insert(*part));
    order
}

fn explore_part(model: &mut Model<'_>, part: usize, limits: &Limits<'_>, catalogue: &mut Catalogue, asked: &mut Asked) {
    let (mut ends, mut is_whole) = ([Ends::default(), Ends::default()], true);
    let holds = |seat: &Seat| matches!(seat, Seat::Part(inner) if model.parts[*inner].may_hang);
    let mut may_hang = model.parts[part].members.iter().any(holds);
    let (has_activity, mut ends_at_once) = (inside::has_activity(&model.parts, part), false);
    let mut ways = [Vec::new(), Vec::new()];
    for (index, aborts) in [true, false].into_iter().enumerate() {
        let mut system = System::new(model, part, &|_| false);
        system.mode = inside::mode(aborts);
        let Found { graph, .. } = explore(&system, limits, true, &Nobody);
        catalogue.states += u64::from(graph.store.count());
        catalogue.transitions += graph.transitions;
        catalogue.memory = catalogue.memory.max(graph.memory());
        is_whole &= graph.reached.is_none();
        if graph.reached == Some(Reached::Time) {
            // The exploration stops here, so the ends of this part are not needed.
            if aborts {
                catalogue.unfinished.push((model.parts[part].group, Reached::Time));
            }
            continue;
        }
        let over = graph.which(&system, is_over);
        (ends[index], ways[index]) = ends_of(&system, &graph, &over, has_activity);
        if has_activity {
            ends_at_once = graph.from(0).any(|(_, started)| over[started as usize]);
        }
        // The part can end from its start, but there are other states from which it cannot end.
        let can = graph.can_reach(&over, &|label| system.is_natural(label));
        may_hang |= can.first() == Some(&true) && can.contains(&false);
        if aborts {
            if let Some(reached) = graph.reached {
                catalogue.unfinished.push((model.parts[part].group, reached));
            } else {
                judge(&system, &graph, part, limits, catalogue, asked);
            }
        }
    }
    let values = System::new(model, part, &|_| false);
    for report in taken_down(model, part).map(|reason| values.value(values.report(&reason))) {
        if !ends[0].aborted.contains(&report) {
            ends[0].aborted.push(report);
        }
    }
    let own = &mut model.parts[part];
    (own.ends, own.is_whole, own.may_hang) = (ends, is_whole, may_hang);
    (own.ways, own.ends_at_once) = (ways, ends_at_once);
}

/// Returns why a group can fail although its expression does not: its programs die too often, or the supervisor around it is on
/// another host and loses contact.
fn taken_down(model: &Model<'_>, part: usize) -> impl Iterator<Item = Failure> {
    let source = &model.parts[part];
    let groups = &model.plan.groups;
    let host = |group: u32| groups[group as usize].host;
    let is_away = model.around[source.group as usize].is_some_and(|(around, _)| host(around) != host(source.group));
    let reasons = [(is_away, Failure::HostLost), (escalates(model, source.group), Failure::Crash)];
    let is_piece = source.is_piece;
    reasons.into_iter().filter(move |(may, _)| *may && !is_piece).map(|(_, reason)| reason)
}

/// Returns the ends of the whole in a system. If `wants_ways`, also a way to each end that is not caused by a stop.
fn ends_of(system: &System<'_>, graph: &Graph, over: &[bool], wants_ways: bool) -> (Ends, Vec<Way>) {
    let (mut ends, mut ways) = (Ends::default(), Vec::<Way>::new());
    let (mut frame, mut changes) = (system.initial(), Vec::new());
    let mut stepper = system.stepper();
    for state in 0..graph.store.count() {
        for (label, _) in graph.from(state).filter(|(_, target)| over[*target as usize]) {
            system.unpack(graph.store.get(state), &mut frame);
            let is_asked = frame.phase == Phase::Stopping;
            stepper.apply(&mut frame, label, Some(&mut changes));
            for change in changes.drain(..).filter(|change| change.member.is_none()) {
                let (is_done, value) = match change.what {
                    Changed::Done(value) => (true, value),
                    // Among all reasons that no expression distinguishes, one is enough.
                    Changed::Aborted(report) => (false, system.value(system.report(&Failure::of_report(&report)))),
                    Changed::Started | Changed::Sent | Changed::Stopping | Changed::Stopped | Changed::Away => continue,
                };
                let is_same = |way: &Way| (way.is_done, &way.value) == (is_done, &value);
                if wants_ways && !is_asked && !ways.iter().any(is_same) {
                    let labels = graph.way(state).into_iter().chain([label]).collect();
                    ways.push(Way { is_done, value: value.clone(), labels });
                }
                let known = if is_done { &mut ends.done } else { &mut ends.aborted };
                if !known.contains(&value) {
                    known.push(value);
                }
            }
        }
    }
    (ends, ways)
}

fn judge(
    system: &System<'_>,
    graph: &Graph,
    part: usize,
    limits: &Limits<'_>,
    catalogue: &mut Catalogue,
    asked: &mut Asked,
) {
    unreached(system, graph, part, limits, catalogue, asked);
    stops::judge(system, graph, part, limits, catalogue, asked);
    let has_usings = !usings(system, part).is_empty();
    let place = catalogue.findings.len();
    let mut suspect = |node: usize, waits: bool, finding: Option<Finding>| {
        let suspect = |finding| Suspect { part, node, waits, has_usings, place, finding };
        asked.suspects.extend(finding.map(suspect));
    };
    for node in promises(system, part) {
        suspect(node, false, stuck(system, graph, part, node));
    }
    for node in usings(system, part) {
        suspect(node, true, waits_for_ever(system, graph, part, node));
    }
}

/// Finds the processes of a part that no order of events starts.
fn unreached(
    system: &System<'_>,
    graph: &Graph,
    part: usize,
    limits: &Limits<'_>,
    catalogue: &mut Catalogue,
    asked: &mut Asked,
) {
    let runs = run_nodes(&system.model.parts[part].expression);
    let reached = reached(system, graph, &runs);
    if !reached.contains(&false) {
        return;
    }
    let never = |reached: &[bool]| {
        let nodes = runs.iter().zip(reached).filter(|(_, reached)| !**reached);
        nodes.map(|(run, _)| *run).collect::<Vec<_>>()
    };
    let advice = "the operand before it never ends in the way that would start it";
    if !has_order(&system.model.parts[part].expression) {
        asked.unreached = true;
        return catalogue.findings.extend(never_started(system, graph, part, &never(&reached), advice));
    }
    // A limit explains a process that only the order of timers excludes, if the limit is too short.
    let mut free = System::new(system.model, part, &|_| false);
    free.mode = system.mode;
    free.forget_order();
    let free_graph = explore(&free, limits, true, &Nobody).graph;
    let free_reached = self::reached(&free, &free_graph, &runs);
    let found = never_started(&free, &free_graph, part, &never(&free_reached), advice);
    asked.unreached |= !found.is_empty();
    catalogue.findings.extend(found);
    let behind: Vec<bool> = reached.iter().zip(&free_reached).map(|(reached, free)| *reached || !*free).collect();
    let advice = "a shorter timer, which begins earlier or together with a longer one, always runs out first";
    let group = system.model.parts[part].group;
    let found = never_started(system, graph, part, &never(&behind), advice);
    asked.behind_timers.extend(found.into_iter().map(|found| (group, found)));
}

/// Returns for each node that runs a member whether some run reaches it.
fn reached(system: &System<'_>, graph: &Graph, runs: &[(usize, u32)]) -> Vec<bool> {
    let mut reached = vec![false; runs.len()];
    graph.which(system, |frame| {
        for (reached, (node, _)) in reached.iter_mut().zip(runs) {
            *reached |= frame.states[0].is_node_active(*node);
        }
        false
    });
    reached
}

/// Reports nodes that run members and are never reached.
fn never_started(
    system: &System<'_>,
    graph: &Graph,
    part: usize,
    nodes: &[(usize, u32)],
    advice: &str,
) -> Vec<Finding> {
    let group = system.model.parts[part].group;
    let (mut places, mut found) = (BTreeSet::new(), Vec::new());
    for (node, member) in nodes {
        for (at, member) in system.model.held_at((part, *node), *member) {
            let span = place(system.model, at.0, at.1);
            if !places.insert(span) {
                continue;
            }
            let name = system.model.name(group, member);
            let diagnostic = diagnostic(Code::E0812, span, format!("`{name}` is never started here"));
            // A group that ends at once is not active in any state: the story consists of its end.
            let state = nearest(system, graph, part, *node).unwrap_or(1).min(graph.store.count() - 1);
            found.push(Finding::fails(help(diagnostic, advice), Some(story_to_the_end(system, graph, state))));
        }
    }
    found
}

/// Finds the processes that never start in time because of a limit. Processes that no order of events starts are already
/// reported.
fn too_late(model: &Model<'_>, catalogue: &mut Catalogue, asked: &mut Asked) {
    let told: BTreeSet<Span> =
        catalogue.findings.iter().filter_map(|found| Some(found.diagnostic.as_ref()?.primary.span)).collect();
    let is_new = |found: &Finding| found.diagnostic.as_ref().is_some_and(|it| !told.contains(&it.primary.span));
    let mut found: Vec<Finding> = late::check(&crate::times(model)).into_iter().filter(is_new).collect();
    // Steps after a step that comes too late have the same cause.
    let is_inside = |group: u32, found: &Finding| {
        let nodes = &model.sites.groups[group as usize].nodes;
        found.diagnostic.as_ref().is_some_and(|it| nodes.contains(&it.primary.span))
    };
    let behind = std::mem::take(&mut asked.behind_timers).into_iter();
    let behind: Vec<_> = behind.filter(|(group, _)| !found.iter().any(|late| is_inside(*group, late))).collect();
    found.extend(behind.into_iter().map(|(_, found)| found));
    let is_never = |found: &Finding| found.diagnostic.as_ref().is_some_and(|it| it.code == Code::E0812);
    asked.unreached |= found.iter().any(is_never);
    catalogue.findings.extend(found);
}

/// Returns the state in which a run comes nearest to a node that is never reached. Some operators around the node are active in
/// some run; this is the first state in which the innermost of them is active.
fn nearest(system: &System<'_>, graph: &Graph, part: usize, node: usize) -> Option<u32> {
    let mut around = Vec::new();
    let mut next = 0;
    crate::model::walk(&system.model.parts[part].expression, &mut |expression| {
        if (next..next + crate::model::count(expression) as usize).contains(&node) {
            around.push(next);
        }
        next += 1;
    });
    around.into_iter().rev().find_map(|node| graph.first(system, |frame| frame.states[0].is_node_active(node)))
}

/// Returns the nodes of a part that should end and are not inside another such node: the whole
/// part, or the operands of a service.
fn promises(system: &System<'_>, part: usize) -> Vec<usize> {
    let source = &system.model.parts[part];
    if !source.program.is_service() {
        return vec![0];
    }
    let (mut nodes, mut next) = (Vec::new(), 0);
    promised(system, part, &source.expression, &mut next, &mut nodes);
    nodes
}

fn promised(system: &System<'_>, part: usize, expression: &Expression, next: &mut usize, nodes: &mut Vec<usize>) {
    let own = *next;
    if !system.model.parts[part].program.is_service_node(own) {
        nodes.push(own);
        *next += crate::model::count(expression) as usize;
        return;
    }
    *next += 1;
    for operand in expression.operands() {
        promised(system, part, operand, next, nodes);
    }
}

/// Finds a state from which a node that promises to end cannot end, although no program fails.
fn stuck(system: &System<'_>, graph: &Graph, part: usize, node: usize) -> Option<Finding> {
    let running = graph.which(system, |frame| waits_or_is_active(frame, 0, node, false));
    let is_active = |frame: &Frame| frame.states[0].is_node_active(node);
    let mut ended = graph.which(system, |frame| frame.phase != Phase::Idle && !is_active(frame));
    let first = |ended: &[bool]| {
        let can = graph.can_reach(ended, &|label| system.is_natural(label));
        (0..graph.store.count()).find(|&state| running[state as usize] && !can[state as usize])
    };
    first(&ended)?;
    // A round of a loop that restarts at once has also ended, although the loop is inactive in no state.
    ends_round(system, graph, 0, node, &running, &mut ended);
    let state = first(&ended)?;
    let name = system.model.group_name(system.model.parts[part].group);
    let span = blocking(system, graph, part, node, state);
    let message = match node {
        0 => format!("`{name}` can get stuck: from here it never ends"),
        _ => format!("a part of `{name}` can get stuck: from here it never ends"),
    };
    let found = diagnostic(Code::E0811, span, message);
    Some(Finding::fails(with_advice(system, graph, state, found), Some(story_to_the_end(system, graph, state))))
}

/// Returns whether a node of a unit waits for a resource (or is active) in a state in which the whole has not been stopped.
fn waits_or_is_active(frame: &Frame, unit: usize, node: usize, waits: bool) -> bool {
    let state = &frame.states[unit];
    frame.phase == Phase::Running && if waits { state.is_node_waiting(node) } else { state.is_node_active(node) }
}

/// Adds the states from which an event that happens by itself ends a node of a unit.
fn ends_round(system: &System<'_>, graph: &Graph, unit: usize, node: usize, running: &[bool], ended: &mut [bool]) {
    let (mut frame, mut stepper) = (system.initial(), system.stepper());
    let mut changes = Vec::new();
    for state in (0..graph.store.count()).filter(|&state| running[state as usize]) {
        system.unpack(graph.store.get(state), &mut frame);
        for (label, _) in graph.from(state).filter(|(label, _)| system.is_natural(*label)) {
            let is_own = unit_of(label) == Some(unit);
            ended[state as usize] |= is_own && stepper.ended(&frame, label).contains(&node);
            // The part that contains this one may restart it as a whole.
            if let Some(MemberRef { unit: around, member }) = system.units[unit].parent {
                stepper.apply(&mut frame, label, Some(&mut changes));
                ended[state as usize] |= changes.iter().any(|change| {
                    let is_end = matches!(change.what, Changed::Done(_) | Changed::Aborted(_) | Changed::Stopped);
                    is_end && (change.unit, change.member) == (around, Some(member))
                });
                stepper.undo(&mut frame);
            }
        }
    }
}

/// Returns the unit of the event.
fn unit_of(label: Label) -> Option<usize> {
    match label {
        Label::Start | Label::StartWith(_) | Label::Stop => Some(0),
        Label::Done(unit, ..)
        | Label::Aborted(unit, ..)
        | Label::Stopped(unit, _)
        | Label::Elapsed(unit, _)
        | Label::Told(unit, _)
        | Label::Reached(unit)
        | Label::Heard(unit, _) => Some(usize::from(unit)),
        Label::Arrived(..)
        | Label::Fault(..)
        | Label::Second(..)
        | Label::Lost
        | Label::Noted(_)
        | Label::Died(..)
        | Label::Back(..)
        | Label::Script(..)
        | Label::TooMany(_) => None,
    }
}

/// Returns the frame of a state after which no event happens.
fn at_the_end(system: &System<'_>, graph: &Graph, state: u32) -> Frame {
    let mut frame = system.initial();
    system.unpack(graph.store.get(state), &mut frame);
    let (mut changes, mut stepper) = (Vec::new(), system.stepper());
    for label in graph.dead_end(system, state) {
        stepper.apply(&mut frame, label, Some(&mut changes));
    }
    frame
}

fn with_advice(system: &System<'_>, graph: &Graph, state: u32, found: language::Diagnostic) -> language::Diagnostic {
    let frame = at_the_end(system, graph, state);
    let waits = usings(system, system.units[0].part).into_iter().any(|node| frame.states[0].is_node_waiting(node));
    help(
        found,
        match waits {
            true => {
                "a process that waits here for a resource never gets it: take both resources at once, `using(a, b)`, or always in the \
                 same order"
            }
            false => "give it a limit, `P within 30 s`, or let something else end it, `P # Q`",
        },
    )
}

fn usings(system: &System<'_>, part: usize) -> Vec<usize> {
    let (mut nodes, mut node) = (Vec::new(), 0);
    crate::model::walk(&system.model.parts[part].expression, &mut |expression| {
        if matches!(expression, Expression::Using { .. }) {
            nodes.push(node);
        }
        node += 1;
    });
    nodes
}

/// Finds a `using` that waits and never gets its resources.
fn waits_for_ever(system: &System<'_>, graph: &Graph, part: usize, node: usize) -> Option<Finding> {
    let waits = graph.which(system, |frame| frame.phase == Phase::Running && frame.states[0].is_node_waiting(node));
    let goes_on: Vec<bool> = graph.which(system, |frame| !frame.states[0].is_node_waiting(node));
    let can = graph.can_reach(&goes_on, &|label| system.is_natural(label));
    let state = (0..graph.store.count()).find(|&state| waits[state as usize] && !can[state as usize])?;
    let name = system.model.group_name(system.model.parts[part].group);
    let found = diagnostic(Code::E0811, place(system.model, part, node), format!("`{name}` can wait here for ever"));
    Some(Finding::fails(with_advice(system, graph, state, found), Some(story_to_the_end(system, graph, state))))
}

/// Returns the place of the cause: the first waiting node, or the outermost active node.
fn blocking(system: &System<'_>, graph: &Graph, part: usize, node: usize, state: u32) -> Span {
    let frame = at_the_end(system, graph, state);
    let waiting = usings(system, part).into_iter().find(|&node| frame.states[0].is_node_waiting(node));
    let shields = shields(system, part).into_iter().find(|&node| frame.states[0].is_node_active(node));
    let shields = shields.filter(|_| frame.phase == Phase::Stopping);
    place(system.model, part, waiting.or(shields).unwrap_or(node))
}

/// Adds one sentence for each kind of mistake that was not found.
fn summary(model: &Model<'_>, asked: &Asked, catalogue: &mut Catalogue) {
    if !catalogue.unfinished.is_empty() {
        for (group, reached) in std::mem::take(&mut catalogue.unfinished) {
            let name = model.group_name(group);
            let sentence = format!("`{name}` was not examined completely: {}", reached.words());
            catalogue.findings.push(Finding::open(sentence));
            catalogue.unfinished.push((group, reached));
        }
        return;
    }
    let ends = model.parts[0].program.is_service();
    let mut proved = |is_wrong: bool, sentence: &str| {
        if !is_wrong {
            catalogue.findings.push(Finding::proved(sentence));
        }
    };
    proved(
        asked.stuck,
        match ends {
            true => "nothing gets stuck: after every order of events, each step that can end can still reach its end",
            false => "nothing gets stuck: after every order of events, `main` can still end",
        },
    );
    proved(asked.waits, "no process waits for a resource for ever");
    let unused = unused(model);
    let but =
        if unused.is_empty() { String::new() } else { format!(", but for {}, which nothing runs", unused.join(", ")) };
    proved(asked.unreached, &format!("every process is started in some order of events{but}"));
    proved(asked.stops, "every stop ends");
}

/// Returns the members of groups that no step names, with their names for people. The ports of an activity run without a step.
fn unused(model: &Model<'_>) -> Vec<String> {
    let mut unused = Vec::new();
    for (group, source) in (0_u32..).zip(&model.plan.groups) {
        let runs = crate::model::runs(&source.expression);
        let ports = model.plan.ports_of(group).map(|(slot, _)| slot);
        let slots = (0_u32..).zip(&source.members).map(|(slot, _)| slot);
        let slots = slots.filter(|slot| !runs.contains(slot) && ports != Some(*slot));
        unused.extend(slots.map(|slot| format!("`{}`", model.name(group, slot))));
    }
    unused
}
