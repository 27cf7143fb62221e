//! Suspects: nodes that may get stuck when their part is alone. This module checks whether the parts around them end
//! them, by a limit or another process.
//!
//! A group is first explored alone, without its surroundings. Each suspect found there is checked
//! again in the groups around it, from the nearest group outwards, until the suspect can always
//! continue in one of these groups.

use super::{Asked, Catalogue, ends_round, waits_or_is_active};
use crate::explore::{Limits, Nobody, Reached, explore};
use crate::finding::Finding;
use crate::model::{Model, Seat, runs};
use crate::story::{Story, story_to_the_end};
use crate::system::{Mode, System};

/// A node of a part that cannot continue when the part is alone.
#[derive(Debug)]
pub(super) struct Suspect {
    pub(super) part: usize,
    pub(super) node: usize,
    /// Whether the node waits for a resource, not only for its end.
    pub(super) waits: bool,
    /// Whether the part has a node that waits for a resource.
    pub(super) has_usings: bool,
    /// The number of earlier findings.
    pub(super) place: usize,
    pub(super) finding: Finding,
}

/// The result for a suspect, together with the parts around it.
enum Outside {
    /// Something ends it.
    Ends,
    /// Nothing ends it. The story is given if it differs from the story of the part alone.
    Stuck(Option<Story>),
    Open(Reached),
}

/// Adds a finding for each suspect that nothing around it ends: at most one for each part, at its place among the
/// findings.
pub(super) fn judge(
    model: &Model<'_>,
    suspects: Vec<Suspect>,
    limits: &Limits<'_>,
    catalogue: &mut Catalogue,
    asked: &mut Asked,
) {
    let around = around(model);
    let mut last = None;
    let mut found: Vec<(usize, Finding)> = Vec::new();
    for suspect in suspects {
        if last == Some(suspect.part) {
            continue;
        }
        let finding = match outside(model, &around, &suspect, limits) {
            Outside::Ends => continue,
            Outside::Stuck(story) => Finding { story: story.or(suspect.finding.story), ..suspect.finding },
            Outside::Open(reached) => {
                let name = model.group_name(model.parts[suspect.part].group);
                let words = reached.words();
                Finding::open(format!("whether something around `{name}` ends it where it gets stuck: {words}"))
            }
        };
        last = Some(suspect.part);
        asked.stuck |= !suspect.waits;
        // If a part is stuck, it is not also checked for nodes that wait for resources.
        asked.waits |= suspect.waits || suspect.has_usings;
        found.push((suspect.place, finding));
    }
    for (place, finding) in found.into_iter().rev() {
        catalogue.findings.insert(place, finding);
    }
}

/// Returns for each part the part around it.
fn around(model: &Model<'_>) -> Vec<Option<usize>> {
    let mut around = vec![None; model.parts.len()];
    for (part, source) in model.parts.iter().enumerate() {
        for slot in runs(&source.expression) {
            if let Some(Seat::Part(inner)) = source.members.get(slot as usize) {
                around[*inner] = Some(part);
            }
        }
    }
    around
}

fn outside(model: &Model<'_>, around: &[Option<usize>], suspect: &Suspect, limits: &Limits<'_>) -> Outside {
    if suspect.part != 0 && around[suspect.part].is_none() {
        // No other part runs this one.
        return Outside::Ends;
    }
    let mut stuck = Outside::Stuck(None);
    let mut inside = vec![suspect.part];
    while let Some(root) = around[inside[inside.len() - 1]] {
        // Other parts that may hang are explored as well, because two of them may need each other to end.
        let is_open = |part: usize| inside.contains(&part) || model.parts[part].may_hang;
        let mut system = System::new(model, root, &is_open);
        system.mode = Mode { aborts: true, stops: true, ..Mode::default() };
        match stuck_in(&system, suspect, limits) {
            Outside::Stuck(story) => stuck = Outside::Stuck(story),
            found @ (Outside::Ends | Outside::Open(_)) => return found,
        }
        inside.push(root);
    }
    stuck
}

fn stuck_in(system: &System<'_>, suspect: &Suspect, limits: &Limits<'_>) -> Outside {
    let Some(unit) = system.units.iter().position(|unit| unit.part == suspect.part) else {
        return Outside::Stuck(None);
    };
    let graph = explore(system, limits, true, &Nobody).graph;
    if let Some(reached) = graph.reached {
        return Outside::Open(reached);
    }
    let holds = graph.which(system, |frame| waits_or_is_active(frame, unit, suspect.node, suspect.waits));
    let mut ended: Vec<bool> = holds.iter().map(|holds| !holds).collect();
    if !suspect.waits {
        ends_round(system, &graph, unit, suspect.node, &holds, &mut ended);
    }
    let can = graph.can_reach(&ended, &|label| system.is_natural(label));
    match (0..graph.store.count()).find(|&state| !can[state as usize]) {
        Some(state) => Outside::Stuck(Some(story_to_the_end(system, &graph, state))),
        None => Outside::Ends,
    }
}
