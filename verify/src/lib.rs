//! Proves the properties of a spec for every order of events, before it runs.
//!
//! [`verify`] takes a plan with its places. It answers the questions of a catalogue, and those in the `verify` blocks of the
//! spec. The transitions come from `language::algebra::step`, the same function that runs the robot.
//!
//! The modules: `model` divides a plan into parts. `system` combines some parts with all possible events. `explore` explores
//! the combination. `catalogue` has the questions. `story` describes how a property fails. The crate is pure: no clock and no
//! files; the caller sets the limits.

mod catalogue;
mod conform;
mod explore;
mod export;
mod fault;
mod finding;
mod flat;
mod lanes;
mod limits;
mod machine;
mod model;
mod property;
mod repair;
mod report;
mod script;
mod store;
mod story;
mod system;
mod threads;
mod times;
mod values;
mod wires;

pub use conform::{Conformance, Coverage, Steps, conform};
pub use explore::{Always, GoesOn, Limits, Reached, WorkDone};
pub use export::{Transitions, transitions, transitions_in_order};
pub use fault::{COLUMNS, Mission, Row, Severity, Table};
pub use finding::{Assumption, Finding, Verdict};
pub use flat::{Detail, Ending, Flat, flat};
pub use machine::{jani, mcrl2};
pub use model::Model;
pub use repair::{Repair, Verified, applied, repairs};
pub use report::told;
pub use script::{PlayResult, Played, Script, ScriptError};
pub use story::{Became, Move, Step, Story, seconds};
pub use system::FaultKind;
pub use threads::{Alone, Threads};

use catalogue::Catalogue;
use language::plan::{Expression, Plan};
use language::sites::{Sentence, Sites};
use std::collections::BTreeMap;
use std::time::Duration;

/// The result of verifying a spec.
#[derive(Debug)]
pub struct Report {
    /// The answers, in the order of the questions.
    pub findings: Vec<Finding>,
    /// How many states were looked at.
    pub states: u64,
    /// How many transitions were taken.
    pub transitions: u64,
    /// The most memory that one exploration used, in bytes.
    pub memory: usize,
    /// Whether a limit was reached, so that a part was left out.
    pub is_limited: bool,
    /// The assumptions of all answers.
    pub assumptions: Vec<String>,
}

/// Answers all questions about a spec.
pub fn verify(plan: &Plan, sites: &Sites, limits: &Limits<'_>) -> Report {
    report(Model::new(plan, sites), limits)
}

/// Verifies like [`verify`], but divides groups of more than `whole` configurations. For comparisons: the answers are the same.
#[doc(hidden)]
pub fn verify_in_pieces(plan: &Plan, sites: &Sites, limits: &Limits<'_>, whole: u64) -> Report {
    report(Model::with(plan, sites, whole), limits)
}

fn report(mut model: Model<'_>, limits: &Limits<'_>) -> Report {
    let mut catalogue = catalogue::explore_parts(&mut model, limits);
    let mut findings = std::mem::take(&mut catalogue.findings);
    let times = times(&model);
    findings.extend(wires::check(&model, limits));
    findings.extend(limits::check(&times, limits));
    findings.extend(property::check(&times, limits));
    let is_limited = findings.iter().any(|finding| finding.verdict == Verdict::Open);
    let mut assumptions = vec![
        "a program that is asked to stop stops, or is killed".to_owned(),
        "a program that can end ends at some time, unless `service;` says that it never ends".to_owned(),
        timers(&model),
    ];
    if model.plan.hosts.len() > 1 {
        let lost = "no host is lost, unless a sentence says so: `on loss of host(c1): ...`, and `dca fmea`";
        assumptions.push(lost.to_owned());
    }
    let Catalogue { states, transitions, memory, .. } = catalogue;
    Report { findings, states, transitions, memory, is_limited, assumptions }
}

/// The assumption about timers.
fn timers(model: &Model<'_>) -> String {
    let has_activities = model.plan.groups.iter().any(|group| matches!(group.expression, Expression::Chart(_)));
    let has_order = model.parts.iter().any(|part| system::has_order(&part.expression));
    let order = has_order.then_some("a timer runs out before a longer one that begins together with it or later");
    let activities = has_activities.then_some("timers of one activity run out in the order of their times");
    let exceptions: Vec<&str> = order.into_iter().chain(activities).collect();
    let but = if exceptions.is_empty() { "" } else { ", but " };
    format!("timers may run out in any order{but}{}", exceptions.join(", and "))
}

/// Answers only the sentences of `verify` blocks.
pub fn sentences(plan: &Plan, sites: &Sites, limits: &Limits<'_>) -> Vec<Finding> {
    let mut model = Model::new(plan, sites);
    // The possible ends of an inner group are found by exploring it.
    catalogue::explore_parts(&mut model, limits);
    property::check(&times(&model), limits)
}

fn times<'m, 'a>(model: &'m Model<'a>) -> times::Times<'m, 'a> {
    times::Times::new(model, assumed(model.sites))
}

/// Returns how long members take, according to the spec.
fn assumed(sites: &Sites) -> BTreeMap<(u32, u32), (Duration, Duration)> {
    let mut assumed = BTreeMap::new();
    for property in &sites.properties {
        if let Sentence::Assume(who, least, most) = &property.sentence
            && let Some(slot) = who.member
        {
            assumed.insert((who.group, slot), (*least, *most));
        }
    }
    assumed
}

/// How many faults may happen in one run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Faults {
    /// One.
    #[default]
    One,
    /// Two, at any time and in either order.
    Two,
}

/// Returns the effects of each single fault of each program, host and link, or of each pair of faults that is worse than either
/// fault alone.
pub fn fmea(plan: &Plan, sites: &Sites, limits: &Limits<'_>, faults: Faults) -> Table {
    let mut model = Model::new(plan, sites);
    let catalogue = catalogue::explore_parts(&mut model, limits);
    let times = times(&model);
    let mut table = match faults {
        Faults::One => fault::table(&times, limits),
        Faults::Two => fault::pairs(&times, limits),
    };
    table.states += catalogue.states;
    table
}
