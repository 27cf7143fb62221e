//! Draws a spec: `dca graph`.
//!
//! Boxes are processes, boxes in boxes are groups, and ports sit on the borders: inputs on the left, outputs on the
//! right. The band at the top of a box has the colour of its host. Arrows of one connection set have one colour and
//! carry its label. Special marks show a service (double border), a port without a connection (hollow, red), a
//! connection whose set is never open (dotted, crossed), a connection that is fetched (dashed), and the resources that
//! a process holds while it runs (a plate on the lower border).
//!
//! The layout is layered from left to right, and depends only on the spec. The same text gives the
//! same picture, and a small change of the text gives a small change of the picture.

mod column;
mod dot;
mod font;
mod layout;
mod model;
mod place;
mod plan;
mod route;
mod states;
mod svg;
mod words;

use crate::check;
use crate::check::spec::ExprKind;
use crate::diagnostic::Diagnostic;
use crate::plan::{Expression, Plan, PlanError};
use crate::source::Source;
use crate::{Compiled, Options};
use model::Unit;

/// The most processes, or states of an activity, in the picture of a plan: in a larger one, a person sees nothing.
const BOXES_MAX: usize = 200;
/// The most wires, or transitions of an activity, in the picture of a plan.
const ARROWS_MAX: usize = 1000;

/// A drawing of a spec or of a plan: its boxes, wires and size.
#[derive(Clone, Debug)]
pub struct Graph {
    root: Unit,
    hosts: Vec<String>,
}

/// The reason why a plan has no picture.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NoPicture {
    /// It has too many boxes.
    #[error("{boxes} boxes are too many for a picture, which has at most {BOXES_MAX}")]
    Boxes {
        /// The processes, or the states.
        boxes: usize,
    },
    /// It has too many arrows.
    #[error("{arrows} arrows are too many for a picture, which has at most {ARROWS_MAX}")]
    Arrows {
        /// The wires, or the transitions.
        arrows: usize,
    },
    /// It is not sound.
    #[error("the plan is not sound: {0}")]
    Unsound(PlanError),
}

/// Returns the picture of a spec, absent when there is an error, and all diagnostics.
///
/// ```
/// use language::{Options, Source, graph};
///
/// let spec = Source::new("blink.dca", "process main() {
///     instantiated_processes { lamp instof Lamp(c1); switch instof Switch(c2); }
///     internal_connections(switch, on) { switch, Out -> lamp, In; }
///     internal_event_actions { lamp, switch[on] }
/// }");
/// let (graph, _) = graph(&spec, &[], &Options::named("blink"));
/// let graph = graph.unwrap();
/// assert!(graph.svg().starts_with("<svg "));
/// assert!(graph.dot().contains("u1:o0 -> u0:i0"));
/// ```
pub fn graph(spec: &Source, interfaces: &[Source], options: &Options) -> (Option<Graph>, Vec<Diagnostic>) {
    let (Compiled { plan, diagnostics, .. }, model, root) = check::compile_with_model(spec, interfaces, options);
    let graph = plan.zip(root).map(|(plan, root)| {
        let root = model::unit(&model, root, &plan);
        Graph { root, hosts: plan.hosts }
    });
    (graph, diagnostics)
}

/// Returns the states of an activity as a picture, and all diagnostics. The activity is named by its type, or by its path or the
/// end of it. The picture is absent when there is an error, or no such activity.
pub fn graph_states(
    spec: &Source,
    interfaces: &[Source],
    options: &Options,
    activity: &str,
) -> (Option<Graph>, Vec<Diagnostic>) {
    let (Compiled { plan, diagnostics, .. }, model, _) = check::compile_with_model(spec, interfaces, options);
    let end = format!("/{activity}");
    let graph = plan.and_then(|plan| {
        let is_meant = |path: &str, kind: &str| kind == activity || path == activity || path.ends_with(&end);
        let mut groups = plan.groups.iter().filter(|group| is_meant(&group.path, &group.process));
        groups.find_map(|group| {
            let mut processes = model.processes.iter().filter(|process| process.name.text == group.process);
            let actions = processes.find_map(|process| process.actions.as_ref())?;
            let ExprKind::Chart(chart) = &actions.kind else { return None };
            Some(Graph { root: states::unit(chart, group.host as usize), hosts: plan.hosts.clone() })
        })
    });
    (graph, diagnostics)
}

/// Returns the picture of a plan, for a page that colours it: each box has the path of its process, and each arrow the numbers of
/// its wires.
///
/// # Errors
/// If the plan is too large or not sound.
pub fn graph_of_plan(plan: &Plan) -> Result<Graph, NoPicture> {
    fits(plan.live_groups().len() + plan.live_leaves().len(), plan::sets(plan).len())?;
    plan.validate().map_err(NoPicture::Unsound)?;
    Ok(Graph { root: plan::unit(plan), hosts: plan.hosts.clone() })
}

/// Returns the activities of a plan that were not taken away while it ran: their groups and paths.
pub fn activities_of_plan(plan: &Plan) -> impl Iterator<Item = (usize, &str)> {
    let live = plan.live_groups();
    let groups = (0_u32..).zip(&plan.groups).filter(move |(number, _)| live.contains(number));
    groups.filter_map(|(number, group)| {
        matches!(group.expression, Expression::Chart(_)).then_some((number as usize, group.path.as_str()))
    })
}

/// Returns the states of an activity of a plan as a picture, for a page that colours it: each box has the name of its state. None if
/// this group is not an activity.
///
/// # Errors
/// If the activity is too large, or the plan is not sound.
pub fn graph_of_activity(plan: &Plan, group: usize) -> Result<Option<Graph>, NoPicture> {
    let Some(group) = plan.groups.get(group) else { return Ok(None) };
    let Expression::Chart(chart) = &group.expression else { return Ok(None) };
    fits(chart.chart.states.len(), chart.chart.transitions.len())?;
    plan.validate().map_err(NoPicture::Unsound)?;
    Ok(Some(Graph { root: states::live_unit(chart, group), hosts: Vec::new() }))
}

fn fits(boxes: usize, arrows: usize) -> Result<(), NoPicture> {
    if boxes > BOXES_MAX {
        return Err(NoPicture::Boxes { boxes });
    }
    if arrows > ARROWS_MAX { Err(NoPicture::Arrows { arrows }) } else { Ok(()) }
}

impl Graph {
    /// Returns the picture as SVG.
    pub fn svg(&self) -> String {
        svg::svg(&self.root, &self.hosts)
    }

    /// Returns the picture in the language of Graphviz, for other layouts.
    pub fn dot(&self) -> String {
        dot::dot(&self.root, &self.hosts)
    }
}
