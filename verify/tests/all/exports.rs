//! Compares the exported models with the explorer. A reader of the model's language reads each model and explores it by the
//! semantics of that language.
//!
//! These readers are written from the rules in the manual, while the explorer calls `algebra::step`. `exports/storm.py` makes the
//! same comparison with Storm.

mod aut;
mod jani;
mod machine;
mod mcrl2;
mod specs;

use crate::rewriting::{random, text};
use language::plan::Plan;
use language::sites::Sites;
use std::ops::Range;
use verify::{Alone, Always, Detail, Limits};

const LIMITS: Limits<'static> = Limits { states: 2_000, memory: 64 << 20, threads: &Alone, goes_on: &Always };

/// Compares both exports of a plan with the explorer. Returns the number of states, or nothing if there are too many.
pub(crate) fn compare((plan, sites): &(Plan, Sites)) -> Result<Option<usize>, String> {
    let all = verify::transitions(plan, sites, &LIMITS);
    if all.reached.is_some() {
        return Ok(None);
    }
    let of_jani = jani::read(&verify::jani(plan, sites)).compare(&all, str::to_owned);
    let of_jani = of_jani.map_err(|how| format!("jani: {how}"))?;
    let (machine, words) = mcrl2::read(&verify::mcrl2(plan, sites));
    let action = |word: &str| {
        let known = words.iter().find(|(known, _)| known == word);
        known.map_or_else(|| format!("`{word}` without action"), |(_, action)| action.clone())
    };
    let of_mcrl2 = machine.compare(&all, action).map_err(|how| format!("mcrl2: {how}"))?;
    let flat = verify::flat(plan, sites, &LIMITS, Detail::AnyOrder);
    if plan.groups.len() == 1 {
        let of_aut = aut::check(&all.aut(), flat.states as usize, flat.gets_stuck || flat.stop_hangs);
        of_aut.map_err(|how| format!("aut: {how}"))?;
    }
    if of_jani == of_mcrl2 { Ok(Some(of_jani)) } else { Err("the exports differ".to_owned()) }
}

#[test]
fn exports_have_the_state_space_of_the_explorer() {
    compare_exports(0..300);
}

#[test]
#[ignore = "long: 1,700 specs"]
fn exports_of_more_specs_have_the_state_space_of_the_explorer() {
    compare_exports(300..2_000);
}

/// The check refuses one spec in a few, or the spec is too large.
fn compare_exports(seeds: Range<u64>) {
    let asked = usize::try_from(seeds.end - seeds.start).expect("few");
    let random = seeds.map(|seed| (format!("random {seed}"), specs::random(seed)));
    let (mut same, mut named, mut states, mut differences) = (0, 0, 0, Vec::new());
    for (name, text) in random.chain(specs::files()) {
        let Some(planned) = specs::planned("spec", &text) else { continue };
        match compare(&planned) {
            Ok(Some(of_spec)) => {
                (same, states) = (same + 1, states + of_spec);
                named += usize::from(text.contains(" with p0"));
            }
            Ok(None) => {}
            Err(how) => differences.push(format!("{name}: {how}\n{text}")),
        }
    }
    assert!(differences.is_empty(), "{} differences beside {same}:\n{}", differences.len(), differences.join("\n"));
    assert!(same * 2 >= asked, "only {same} specs were compared, of {states} states");
    assert!(named * 100 >= asked, "only {named} specs with a name for a result were compared");
}

#[test]
fn what_nothing_runs_does_not_keep_a_plan_from_being_exported() {
    let text = "module Step { done; }
        process Spare(){ host{c1} instantiated_processes{ a instof Step(c1); } internal_event_actions{ a } }
        process main(){
            host{c1}
            instantiated_processes{ a instof Step(c1); spare instof Spare(); }
            internal_event_actions{ a }
        }";
    let planned = specs::planned("spec", text).expect("it has a plan");
    assert!(compare(&planned).expect("no difference").is_some(), "all of it is exported");
}
