//! `dca verify --fix`: finds edits that were verified to repair a mistake. Prints them as a difference, or writes them into the file.

use super::Loaded;
use crate::check;
use crate::io::whole_file;
use anyhow::{Context as _, anyhow};
use language::{Source, compile_with_sites};
use node::console::{self, Failure};
use std::path::Path;
use verify::{Limits, Repair, Report, Verified, applied, repairs};

/// The most rounds of repairs. A repair may reveal another mistake, but this has to end.
const ROUNDS_MAX: usize = 16;

/// Shows the repairs of a spec.
pub(super) fn show(file: &Path, loaded: &Loaded, report: &Report, limits: &Limits<'_>) {
    let Loaded { spec, interfaces, plan, sites, .. } = loaded;
    let found = repairs(&Verified { spec, plan, sites, report }, interfaces, &check::options(file, false), limits);
    if found.is_empty() {
        console::say("no repair is known that could be verified\n");
    }
    for repair in &found {
        let changed = applied(&loaded.spec, &repair.fix);
        console::say(&format!("{}{}\n", title(repair), difference(&loaded.spec, &changed)));
    }
}

/// Writes the repairs into the file, one after the other. Each is verified together with the earlier ones. Returns
/// whether there were any.
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

/// Returns the difference of two texts in the form of `patch`. Both texts have the same number of lines. Line ends stay, including CR LF.
fn difference(old: &Source, new: &Source) -> String {
    let mut text = format!("--- {}\n+++ {}\n", quoted(&old.name), quoted(&new.name));
    let lines = old.text.split_inclusive('\n').zip(new.text.split_inclusive('\n'));
    for (number, (before, after)) in (1..).zip(lines) {
        if before != after {
            text += &format!("@@ -{number} +{number} @@\n-{}+{}", whole_line(before), whole_line(after));
        }
    }
    text
}

/// Returns a line of a difference. A last line without a line end gets a mark.
fn whole_line(line: &str) -> String {
    if line.ends_with('\n') { line.to_owned() } else { format!("{line}\n\\ No newline at end of file\n") }
}

/// Returns the name of a file in the form that `patch` and `git apply` read: in quotes if it contains a blank or a special character.
fn quoted(name: &str) -> String {
    if name.chars().all(|sign| !sign.is_whitespace() && !sign.is_control() && sign != '"' && sign != '\\') {
        return name.to_owned();
    }
    let mut text = String::from("\"");
    for sign in name.chars() {
        match sign {
            '"' | '\\' => text.extend(['\\', sign]),
            '\n' => text += "\\n",
            '\t' => text += "\\t",
            sign => text.push(sign),
        }
    }
    text + "\""
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write as _;
    use std::process::{Command, Stdio};

    #[test]
    fn a_difference_says_where_nothing_ends_the_last_line() {
        let of = |text: &str| Source::new("a.dca".to_owned(), text.to_owned());
        let shown = difference(&of("a\r\nb"), &of("a\r\nc"));
        assert_eq!(
            shown,
            "--- a.dca\n+++ a.dca\n@@ -2 +2 @@\n-b\n\\ No newline at end of file\n+c\n\\ No newline at end of file\n"
        );
    }

    /// `patch` itself accepts the difference, with any line ends and any file name.
    #[test]
    fn patch_takes_a_difference() {
        if Command::new("patch").arg("--version").output().is_err() {
            println!("skipped: needs patch");
            return;
        }
        let folder = std::env::temp_dir().join(format!("dca-patch-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        for name in ["plain.dca", "two words.dca", "a \"quote\" \\ in it.dca", "größe.dca"] {
            for (old, new) in [("a\nb\nc\n", "a\nB\nc\n"), ("a\r\nb\r\n", "a\r\nB\r\n"), ("a\r\nb", "a\r\nB")] {
                std::fs::write(folder.join(name), old).unwrap();
                let of = |text: &str| Source::new(name.to_owned(), text.to_owned());
                let mut patch = Command::new("patch");
                let mut patch = patch.current_dir(&folder).stdin(Stdio::piped()).stdout(Stdio::null()).spawn().unwrap();
                patch.stdin.take().unwrap().write_all(difference(&of(old), &of(new)).as_bytes()).unwrap();
                assert!(patch.wait().unwrap().success(), "{name} {old:?}");
                assert_eq!(std::fs::read_to_string(folder.join(name)).unwrap(), new, "{name}");
            }
        }
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
