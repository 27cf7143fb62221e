//! Whether every stop ends.

use super::{Asked, Catalogue, blocking};
use crate::explore::{Graph, Limits, Nobody, explore, is_over, is_stopping};
use crate::finding::{Finding, diagnostic, help};
use crate::model::Seat;
use crate::story::story_to_the_end;
use crate::system::System;
use language::Code;
use language::plan::Expression;

/// Finds a state after a stop from which the end cannot be reached.
fn stop_without_end(system: &System<'_>, graph: &Graph, part: usize) -> Option<Finding> {
    let over = graph.which(system, is_over);
    let can = graph.can_reach(&over, &|label| system.is_natural(label));
    let stopping = graph.which(system, is_stopping);
    let state = (0..graph.store.count()).find(|&state| stopping[state as usize] && !can[state as usize])?;
    let name = system.model.group_name(system.model.parts[part].group);
    let span = blocking(system, graph, part, 0, state);
    let found = diagnostic(Code::E0813, span, format!("a stop of `{name}` may never end"));
    let found =
        help(found, "give the `shield` a bound, `shield(10 s) P`, or the part after `finally` a limit, `Q within 5 s`");
    Some(Finding::fails(found, Some(story_to_the_end(system, graph, state))))
}

/// Checks that every stop of a part ends. The operands of a `shield` or a `finally` are checked if they may run for
/// ever.
pub(super) fn judge(
    alone: &System<'_>,
    graph: &Graph,
    part: usize,
    limits: &Limits<'_>,
    catalogue: &mut Catalogue,
    asked: &mut Asked,
) {
    if let Some(finding) = stop_without_end(alone, graph, part) {
        asked.stops = true;
        catalogue.findings.push(finding);
        return;
    }
    let model = alone.model;
    let hangs = |seat: &Seat| matches!(seat, Seat::Part(inner) if model.parts[*inner].may_hang);
    if shields(alone, part).is_empty() || !model.parts[part].members.iter().any(hangs) {
        return;
    }
    let mut system = System::new(model, part, &|inner| model.parts[inner].may_hang);
    system.mode = alone.mode;
    let graph = explore(&system, limits, true, &Nobody).graph;
    if let Some(reached) = graph.reached {
        catalogue.unfinished.push((model.parts[part].group, reached));
    } else if let Some(finding) = stop_without_end(&system, &graph, part) {
        asked.stops = true;
        catalogue.findings.push(finding);
    }
}

/// Returns the nodes of a part that delay a stop.
pub(super) fn shields(system: &System<'_>, part: usize) -> Vec<usize> {
    let (mut nodes, mut node) = (Vec::new(), 0);
    crate::model::walk(&system.model.parts[part].expression, &mut |expression| {
        if matches!(expression, Expression::Shield { .. } | Expression::Finally(..)) {
            nodes.push(node);
        }
        node += 1;
    });
    nodes
}
