//! A verification report for people.

use crate::finding::{Finding, Verdict};
use crate::{Report, Story};
use language::{Source, Style, render};

impl Report {
    /// Returns the complete report as text: each answer with its reason and its story, the assumptions, and the
    /// totals.
    pub fn text(&self, spec: &Source, interfaces: &[Source], style: Style) -> String {
        let mut text: String = self.findings.iter().map(|finding| told(finding, spec, interfaces, style)).collect();
        let count = |verdict| self.findings.iter().filter(|finding| finding.verdict == verdict).count();
        text += "\nassumed:\n";
        self.assumptions.iter().for_each(|assumption| text += &format!("  {assumption}\n"));
        let (proved, fails, open) = (count(Verdict::Proved), count(Verdict::Fails), count(Verdict::Open));
        let states = if self.states == 1 { "1 state".to_owned() } else { format!("{} states", self.states) };
        text += &format!("{}: {proved} proved, {fails} failed, {open} not decided, over {states}\n", spec.name);
        text
    }
}

/// Returns an answer with its reason and its story.
pub fn told(finding: &Finding, spec: &Source, interfaces: &[Source], style: Style) -> String {
    let Some(diagnostic) = &finding.diagnostic else {
        let word = if finding.verdict == Verdict::Proved { "proved" } else { "NOT DECIDED" };
        let assumes = finding.assumes.as_ref().map(|assumes| format!("  as long as {}\n", assumes.text));
        return format!("{word}: {}\n{}", finding.sentence, assumes.unwrap_or_default());
    };
    let found = std::slice::from_ref(diagnostic);
    let mut text = format!("\n{}\n", render(found, spec, interfaces, style).trim_end());
    if let Some(story) = &finding.story {
        text += "  how it comes to that:\n";
        Story::lines(story).iter().for_each(|line| text += &format!("  {line}\n"));
    }
    text + "\n"
}
