//! Specs to export: random specs, and those of this repository.

use super::random::{Dice, Taste, group};
use super::text::text;
use language::plan::{Expression, Plan};
use language::sites::Sites;
use language::{Options, Source, compile_with_sites};
use std::fs;
use std::path::{Path, PathBuf};

/// Returns a random spec. Every other spec has a group in it, and half of these groups are on another host.
pub(crate) fn random(seed: u64) -> String {
    let mut dice = Dice::new(seed);
    let (outer, _) = text(&group(&mut dice, Taste::Text), "");
    if seed.is_multiple_of(2) {
        return outer;
    }
    // The first member whose module has one end becomes a group.
    let (inner, _) = text(&group(&mut dice, Taste::Text), "");
    let module = |slot: u32| format!("module M{slot}(host: Host) {{ init start; done; }}\n");
    let Some(slot) = (0..5).find(|slot| outer.contains(&module(*slot))) else { return outer };
    let mut inner = inner.replace("process main()", "process Inner()");
    for slot in 0..5 {
        inner =
            inner.replace(&format!("M{slot}"), &format!("N{slot}")).replace(&format!("m{slot}"), &format!("n{slot}"));
    }
    let instance = format!("m{slot} instof M{slot}(c1);");
    let outer = outer.replace(&module(slot), "").replace(&instance, &format!("m{slot} instof Inner();"));
    // Every fourth spec has two hosts.
    if seed % 4 == 1 {
        inner = inner.replace("host{c1}", "host{c2}").replace("(c1)", "(c2)");
    }
    format!("{inner}\n{outer}")
}

/// Returns the specs of the corpus and of the repository, each with its name.
pub(crate) fn files() -> Vec<(String, String)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let folders = ["verify/tests/corpus/good", "verify/tests/corpus/bad", "specs"].map(|folder| root.join(folder));
    let entries = folders.iter().flat_map(|folder| fs::read_dir(folder).expect("the folder of specs is there"));
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.expect("it can be read").path()).collect();
    files.retain(|file| file.extension().is_some_and(|kind| kind == "dca"));
    files.sort();
    let name = |file: &PathBuf| file.file_stem().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    files.iter().map(|file| (name(file), fs::read_to_string(file).expect("the spec can be read"))).collect()
}

fn catches(expression: &Expression) -> bool {
    matches!(expression, Expression::Catch { .. }) || expression.operands().into_iter().any(catches)
}

/// Returns the plan of a text, unless the check refuses it.
pub(crate) fn planned(name: &str, text: &str) -> Option<(Plan, Sites)> {
    let library = Path::new(env!("CARGO_MANIFEST_DIR")).join("../language/tests/graph/door_opening.interface");
    let library = Source::new("library", fs::read_to_string(library).expect("the interface can be read"));
    let (compiled, sites) = compile_with_sites(&Source::new("spec.dca", text), &[library], &Options::named(name));
    // Models for other tools have no `else match`.
    let has_catch = |plan: &Plan| plan.groups.iter().any(|group| catches(&group.expression));
    compiled.plan.filter(|plan| !has_catch(plan)).zip(sites)
}
