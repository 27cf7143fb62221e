//! `dca verify --fix`: edits that were verified to repair a mistake, as a difference or in the file.

use super::Loaded;
use crate::check;
use crate::io::whole_file;
use anyhow::{Context as _, anyhow};
use language::{Source, compile_with_sites};
use node::console::{self, Failure};
use std::path::Path;
use verify::{Limits, Repair, Report, Verified, applied, repairs};

/// One repair may bring another mistake to light, but not for ever.
const ROUNDS_MAX: usize = 16;

/// Shows the repairs of a spec.
pub(super) fn show(file: &Path, loaded: &Loaded, report: &Report, limits: &Limits<'_>) {
    let Loaded { spec, interfaces, plan, sites } = loaded;
    let found = repairs(&Verified { spec, plan, sites, report }, interfaces, &check::options(file, false), limits);
    if found.is_empty() {
        console::say("no repair is known that could be verified\n");
    }
    for repair in &found {
        let changed = applied(&loaded.spec, &repair.fix);
        console::say(&format!("{}{}\n", title(repair), difference(&loaded.spec, &changed)));
    }
}

/// Writes the repairs into the file, one after the other: each is verified with those before it. Returns whether there were any.
///
/// # Errors
/// The file is standard input, or cannot be written.
pub(super) fn write(file: &Path, loaded: &Loaded, report: &Report, limits: &Limits<'_>) -> Result<bool, Failure> {
    if check::is_standard_input(file) {
        return Err(anyhow!("standard input cannot be rewritten; give a file").into());
    }
    let (options, mut spec) = (check::options(file, false), loaded.spec.clone());
    let before = Verified { spec: &loaded.spec, plan: &loaded.plan, sites: &loaded.sites, report };
    let mut found = repairs(&before, &loaded.interfaces, &options, limits);
    for _ in 0..ROUNDS_MAX {
        let Some(repair) = found.first() else { break };
        let changed = applied(&spec, &repair.fix);
        console::say(&format!("{}{}\n", title(repair), difference(&spec, &changed)));
        spec = changed;
        let (compiled, sites) = compile_with_sites(&spec, &loaded.interfaces, &options);
        let Some((plan, sites)) = compiled.plan.zip(sites) else { break };
        let report = verify::verify(&plan, &sites, limits);
        let before = Verified { spec: &spec, plan: &plan, sites: &sites, report: &report };
        found = repairs(&before, &loaded.interfaces, &options, limits);
    }
    let is_changed = spec.text != loaded.spec.text;
    if is_changed {
        whole_file::put(file, spec.text.as_bytes()).context("writing the spec")?;
    }
    Ok(is_changed)
}

fn title(repair: &Repair) -> String {
    format!("verified: {}\n  instead of: {}\n", repair.fix.title, repair.sentence)
}

/// A difference as `patch` takes it, of texts that have as many lines.
fn difference(old: &Source, new: &Source) -> String {
    let mut text = format!("--- {}\n+++ {}\n", old.name, new.name);
    for (number, (before, after)) in (1..).zip(old.text.lines().zip(new.text.lines())) {
        if before != after {
            text += &format!("@@ -{number} +{number} @@\n-{before}\n+{after}\n");
        }
    }
    text
}
