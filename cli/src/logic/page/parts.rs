//! The words and numbers of the page.

use crate::logic::mission::{Mission, Outcome, Track, failure_chain, failure_output, seconds};
use crate::logic::page::text::escape;
use crate::logic::record::{Entry, Run};
use dbmanager::logic::view::date;
use node::logic::output_lines::plain;
use node::logic::protocol::Report;
use node::logic::table::counted;
use std::time::Duration;
use view::sentence::{change_text, report_text};

/// The most events listed.
const EVENTS_MAX: usize = 2_000;
/// How much of one program's output is on the page, in bytes; the rest is in the record.
const OUTPUT_MAX: usize = 1 << 20;
/// The most columns of signals in the table of phases.
const COLUMNS_MAX: usize = 8;

/// Returns title, verdict, and the cause of a failure.
pub(super) fn head(run: &Run, mission: &Mission) -> String {
    let (class, sign, word) = match mission.verdict().map(|verdict| &verdict.outcome) {
        Some(Outcome::Done) => ("good", "✓", "done"),
        Some(outcome @ Outcome::Stopped) => ("plain", "■", outcome.word()),
        Some(outcome @ (Outcome::Aborted(_) | Outcome::Unconfirmed | Outcome::Refused(_))) => {
            ("bad", "✕", outcome.word())
        }
        None => ("bad", "?", "no end was recorded"),
    };
    let name = mission.deployment().map_or_else(|| mission.name().to_owned(), ToString::to_string);
    let mut facts = vec![escape(&run.header.file)];
    facts.extend(run.header.started.map(|at| format!("{} UTC", date::text(at.as_secs() * 1000))));
    facts.extend(mission.start().done().map(|start| escape(&start)));
    let mut text = format!(
        "<header>\n<h1>{} <span class=\"badge {class}\">{sign} {word}</span></h1>\n<p class=\"quiet\">{}</p>\n</header>\n",
        escape(&name),
        facts.join(" · ")
    );
    let mut alarm = |line: &str| text.push_str(&format!("<p class=\"alarm\">{}</p>\n", escape(line)));
    if let Some(chain) = failure_chain(mission) {
        alarm(&chain);
    }
    for (whose, output) in failure_output(mission) {
        alarm(&format!("{whose}:\n{}", output.join("\n")));
    }
    if let Some(verdict) = mission.verdict() {
        if let Outcome::Refused(reasons) = &verdict.outcome {
            reasons.iter().for_each(|reason| alarm(reason));
        }
        if !verdict.unconfirmed.is_empty() {
            alarm(&format!("not confirmed that nothing is left on: {}", verdict.unconfirmed.join(", ")));
        }
    }
    if let Some(damage) = &run.damage {
        alarm(&format!("the record is not complete: {damage}"));
    }
    run.missing().iter().for_each(|sentence| alarm(sentence));
    text
}

/// Returns the numbers that a person asks for first.
pub(super) fn cards(mission: &Mission) -> String {
    let took = mission.verdict().map_or(mission.now(), |verdict| verdict.at);
    let mut text = String::from("<ul class=\"cards\">\n");
    let mut card = |title: &str, value: &str, more: &str| {
        let (title, value, more) = (escape(title), escape(value), escape(more));
        text.push_str(&format!("<li><span>{title}</span><b>{value}</b><small>{more}</small></li>\n"));
    };
    card("mission time", &seconds(took), "since GO");
    for (_, track) in mission.headlines().take(COLUMNS_MAX) {
        let with_unit = |value| format!("{} {}", track.text(value), track.unit).trim_end().to_owned();
        let peak = format!("at the end; peak {} at {}", with_unit(track.peak), seconds(track.peak_at));
        card(&mission.title(track), &with_unit(track.last), &peak);
    }
    text.push_str("</ul>\n");
    text
}

/// Returns the table of phases.
pub(super) fn table(mission: &Mission) -> String {
    let tracks: Vec<(usize, &Track)> = mission.headlines().take(COLUMNS_MAX).collect();
    let mut text = String::from("<section>\n<h2>Phases</h2>\n<div class=\"wide\"><table>\n<thead><tr><th></th>");
    text.push_str("<th>phase</th><th class=\"n\">from</th><th class=\"n\">took</th><th>ended by</th>");
    for (_, track) in &tracks {
        let (title, unit) = (escape(&mission.title(track)), escape(&track.unit));
        text.push_str(&format!("<th class=\"n\">{title}<small>peak {unit}</small></th>"));
    }
    text.push_str("</tr></thead>\n<tbody>\n");
    for (index, phase) in mission.phases().iter().enumerate() {
        let number = mission.phases_dropped() + index + 1;
        let class = if phase.failed() { " class=\"failed\"" } else { "" };
        text.push_str(&format!(
            "<tr{class}><td class=\"n\">{number}</td><td>{}</td><td class=\"n\">{}</td><td class=\"n\">{}</td><td>{}</td>",
            escape(&phase.name),
            seconds(phase.begin),
            seconds(phase.took(mission.now())),
            escape(&phase.ended())
        ));
        let peak =
            |(index, track): &(usize, &Track)| phase.peak(*index).map_or("·".to_owned(), |peak| track.text(peak));
        tracks.iter().for_each(|track| text.push_str(&format!("<td class=\"n\">{}</td>", peak(track))));
        text.push_str("</tr>\n");
    }
    text.push_str(&format!(
        "</tbody>\n<tfoot><tr><td></td><td>whole run</td><td></td><td class=\"n\">{}</td><td></td>",
        seconds(mission.now())
    ));
    for (_, track) in &tracks {
        text.push_str(&format!("<td class=\"n\">{}</td>", track.text(track.peak)));
    }
    text.push_str("</tr></tfoot>\n</table></div>\n</section>\n");
    text
}

/// Returns the folded parts: every event, and the spec.
pub(super) fn details(run: &Run) -> String {
    let mut events = Vec::new();
    let mut now = Duration::ZERO;
    for entry in &run.entries {
        let Entry::Report(report) = entry else { continue };
        if matches!(report, Report::Stepped { .. } | Report::Replanned { .. }) {
            continue;
        }
        let (process, what) = match report {
            Report::Process { path, change, at } => {
                now = *at;
                (path.as_str(), change_text(change))
            }
            Report::Accepted { .. }
            | Report::Prepared { .. }
            | Report::Connected { .. }
            | Report::Go { .. }
            | Report::Refused { .. }
            | Report::Programs { .. }
            | Report::Changed { .. }
            | Report::Stepped { .. }
            | Report::Unchanged { .. }
            | Report::Replanned { .. }
            | Report::Aligned { .. }
            | Report::BeganLate { .. }
            | Report::Omitted { .. }
            | Report::Finished { .. } => ("", report_text(report)),
        };
        events.push(format!(
            "<tr><td class=\"n\">{:.3} s</td><td>{}</td><td>{}</td></tr>\n",
            now.as_secs_f64(),
            escape(process),
            escape(&what)
        ));
    }
    let more = events.len().saturating_sub(EVENTS_MAX);
    let count = counted(events.len(), "event");
    events.truncate(EVENTS_MAX);
    let more = if more > 0 { format!("<p class=\"quiet\">{more} more are in the record.</p>") } else { String::new() };
    format!(
        "{}<details><summary>{count}</summary>\n<div class=\"wide\"><table>\n{}</table></div>\n{more}</details>\n\
         <details><summary>the spec, {}</summary>\n<pre>{}</pre>\n</details>\n",
        outputs(run),
        events.concat(),
        escape(&run.header.file),
        escape(&run.header.text)
    )
}

/// Returns the output of each program.
fn outputs(run: &Run) -> String {
    let mut text = String::new();
    for (path, chunks) in run.outputs() {
        let whole = chunks.join("\n");
        let from = whole.ceil_char_boundary(whole.len().saturating_sub(OUTPUT_MAX));
        let lines: Vec<String> = whole[from..].lines().map(plain).collect();
        let more = if from > 0 { format!("({from} bytes before are in the record)\n") } else { String::new() };
        let (path, lines, count) = (escape(path), escape(&lines.join("\n")), counted(lines.len(), "line"));
        text.push_str(&format!(
            "<details><summary>what {path} wrote, {count}</summary>\n<pre>{more}{lines}</pre>\n</details>\n"
        ));
    }
    text
}
