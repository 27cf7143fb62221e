//! The one screen at the end of a mission.

use crate::logic::mission::progress::cut;
use crate::logic::mission::{Mission, Note, Outcome, Phase, Track, seconds, short};
use crate::logic::table::counted;
use std::time::Duration;

/// The most rows of phases; a screen has about 24.
const ROWS_MAX: usize = 14;
/// The most signals with a column of their own.
const COLUMNS_MAX: usize = 6;
/// The most notes shown.
const NOTES_MAX: usize = 6;
/// The widest cell.
const CELL_MAX: usize = 40;

/// Where a person finds the rest.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Files {
    /// Path of the record.
    pub record: Option<String>,
    /// Path of the report.
    pub report: Option<String>,
    /// Samples that the recorder had to leave out.
    pub dropped: u64,
}

/// Returns the one-screen summary of a mission that is over, with a line feed at its end.
pub fn summary(mission: &Mission, files: &Files) -> String {
    let mut text = title(mission);
    text.push('\n');
    if let Some(chain) = failure_chain(mission) {
        text.push_str(&format!("  {chain}\n"));
    }
    match mission.verdict().map(|verdict| &verdict.outcome) {
        Some(Outcome::Refused(reasons)) => reasons.iter().for_each(|reason| text.push_str(&format!("  {reason}\n"))),
        Some(Outcome::Done | Outcome::Aborted(_) | Outcome::Stopped | Outcome::Unconfirmed) | None => {}
    }
    let hosts = mission.verdict().map_or(&[][..], |verdict| &verdict.unconfirmed);
    if !hosts.is_empty() {
        text.push_str(&format!("  not confirmed that nothing is left on: {}\n", hosts.join(", ")));
    }
    notes(mission, &mut text);
    if mission.start().is_running() {
        text.push('\n');
        table(mission, &mut text);
    }
    let dropped = match files.dropped {
        0 => String::new(),
        count => format!(" ({} left out: the disk was too slow)", counted(count, "sample")),
    };
    let record = files.record.iter().map(|path| format!("  record  {path}{dropped}\n"));
    let report = files.report.iter().map(|path| format!("  report  {path}\n"));
    let lines: String = record.chain(report).collect();
    if !lines.is_empty() {
        text.push_str(&format!("\n{lines}"));
    }
    text
}

/// Returns the chain from `main` to the process where a failure began, if there was one.
pub fn failure_chain(mission: &Mission) -> Option<String> {
    match &mission.verdict()?.outcome {
        Outcome::Aborted(failure) => Some(failure.to_string()),
        Outcome::Done | Outcome::Stopped | Outcome::Unconfirmed | Outcome::Refused(_) => None,
    }
}

fn title(mission: &Mission) -> String {
    let name = mission.name();
    let Some(end) = mission.verdict() else { return format!("{name}: no end was reported") };
    match (mission.start().done(), end.outcome.word()) {
        (Some(start), word) => format!("{name}: {word} after {:.1} s ({start})", end.at.as_secs_f64()),
        (None, word) => format!("{name}: {word}"),
    }
}

fn notes(mission: &Mission, text: &mut String) {
    // The failure that ended it all stands above as a chain.
    let told = match mission.verdict().map(|verdict| &verdict.outcome) {
        Some(Outcome::Aborted(failure)) => short(&failure.origin),
        Some(Outcome::Done | Outcome::Stopped | Outcome::Unconfirmed | Outcome::Refused(_)) | None => "",
    };
    let notes: Vec<&Note> = mission.notes().iter().filter(|note| note.process != told).collect();
    for note in notes.iter().take(NOTES_MAX) {
        text.push_str(&format!("  {:.1} s  {} {}\n", note.at.as_secs_f64(), note.process, note.text));
    }
    let more = notes.len().saturating_sub(NOTES_MAX) + mission.notes_dropped();
    if more > 0 {
        text.push_str(&format!("  and {more} more\n"));
    }
}

/// One row of a table: its first four cells, then one cell for each headline signal.
type Row = (Vec<String>, Vec<String>);

fn table(mission: &Mission, text: &mut String) {
    let signals: Vec<(usize, &Track)> = mission.headlines().take(COLUMNS_MAX).collect();
    let now = mission.now();
    let hidden = mission.phases().len().saturating_sub(ROWS_MAX);
    let cells = |cells: [&str; 4]| cells.iter().map(|cell| cut(cell, CELL_MAX)).collect::<Vec<_>>();
    let mut rows: Vec<Row> = Vec::new();
    let names = signals.iter().map(|(_, track)| cut(&mission.title(track), CELL_MAX)).collect();
    rows.push((cells(["phase", "from", "took", "ended by"]), names));
    let units = signals.iter().map(|(_, track)| format!("peak {}", track.unit).trim_end().to_owned()).collect();
    if !signals.is_empty() {
        rows.push((cells(["", "", "", ""]), units));
    }
    for phase in &mission.phases()[hidden..] {
        rows.push((phase_cells(phase, now, &cells), peaks(phase, &signals)));
    }
    let whole = signals.iter().map(|(_, track)| track.text(track.peak)).collect();
    rows.push((cells(["whole run", "", &seconds(now), ""]), whole));
    let last = signals.iter().map(|(_, track)| track.text(track.last)).collect();
    if !signals.is_empty() {
        rows.push((cells(["at the end", "", "", ""]), last));
    }
    text.push_str(&aligned(&rows));
    let hidden = hidden + mission.phases_dropped();
    if hidden > 0 {
        text.push_str(&format!("  ({hidden} earlier phases are not shown)\n"));
    }
}

fn phase_cells(phase: &Phase, now: Duration, cells: &dyn Fn([&str; 4]) -> Vec<String>) -> Vec<String> {
    let ended = phase.ended();
    // The reason of a failure stands above the table, in full.
    let ended = ended.split(": ").next().unwrap_or_default();
    cells([&phase.name, &seconds(phase.begin), &seconds(phase.took(now)), ended])
}

fn peaks(phase: &Phase, signals: &[(usize, &Track)]) -> Vec<String> {
    let peak = |(index, track): &(usize, &Track)| phase.peak(*index).map_or("·".to_owned(), |peak| track.text(peak));
    signals.iter().map(peak).collect()
}

/// Returns the rows with names to the left and numbers to the right of their columns.
fn aligned(rows: &[Row]) -> String {
    let columns = rows.first().map_or(0, |(left, right)| left.len() + right.len());
    let all = |row: &Row| row.0.iter().chain(&row.1).cloned().collect::<Vec<_>>();
    let width = |column: usize| rows.iter().map(|row| all(row)[column].chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..columns).map(width).collect();
    let mut text = String::new();
    for row in rows {
        let mut line = String::new();
        for (column, (cell, width)) in all(row).iter().zip(&widths).enumerate() {
            line.push_str("  ");
            if column == 0 || column == 3 {
                line.push_str(&format!("{cell:<width$}"));
            } else {
                line.push_str(&format!("{cell:>width$}"));
            }
        }
        text.push_str(line.trim_end());
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::mission::tests::{OPENING, door, feed, seconds as at};
    use crate::logic::protocol::{Ending, Failure, FailureCause, Report};
    use expect_test::{Expect, expect};

    fn check(table: &str, end: Report, expect: &Expect) {
        let mut mission = Mission::new(&door());
        if !table.is_empty() {
            feed(&mut mission, table);
        }
        mission.report(&end);
        let record = Some("runs/test-1/run.mcap".to_owned());
        let report = Some("runs/test-1/report.html".to_owned());
        expect.assert_eq(&summary(&mission, &Files { record, report, dropped: 0 }));
    }

    #[test]
    fn a_mission_that_is_done() {
        let end = Report::Finished { ending: Ending::Done(Vec::new()), at: at(22.1), unconfirmed: Vec::new() };
        check(
            OPENING,
            end,
            &expect![[r#"
                test: done after 22.1 s (8 programs on 2 hosts, started in 0.8 s)

                  phase                     from    took  ended by    force     angle
                                                                     peak N  peak deg
                  servo # near             0.0 s   6.9 s  near done     3.0         ·
                  (open, approach) # hit   6.9 s   4.9 s  hit done     16.0         ·
                  close                   11.8 s   0.6 s  done            ·         ·
                  pull                    12.5 s   9.5 s  done         28.8      74.0
                  whole run                       22.1 s               28.8      74.0
                  at the end                                           28.8      74.0

                  record  runs/test-1/run.mcap
                  report  runs/test-1/report.html
            "#]],
        );
    }

    #[test]
    fn a_mission_that_failed() {
        let table = "0 servo activated \n 0 near activated \n 1 near killed \n 1 servo stopping \n 1.1 servo stopped";
        let cause = FailureCause::Signal(9);
        let failure = Failure { origin: "main/sys/near/laser".to_owned(), cause, at: at(1.0) };
        let unconfirmed = vec!["c2".to_owned()];
        let end = Report::Finished { ending: Ending::Aborted(failure), at: at(1.2), unconfirmed };
        check(
            table,
            end,
            &expect![[r#"
                test: aborted after 1.2 s (8 programs on 2 hosts, started in 0.8 s)
                  main ← sys ← near ← laser: SIGKILL at 1.0 s
                  not confirmed that nothing is left on: c2
                  1.0 s  sys/near aborted: SIGKILL

                  phase          from   took  ended by
                  servo # near  0.0 s  1.1 s  near aborted
                  whole run            1.2 s

                  record  runs/test-1/run.mcap
                  report  runs/test-1/report.html
            "#]],
        );
    }

    #[test]
    fn a_mission_that_was_refused() {
        let reasons =
            vec!["host `c3` could not be reached".to_owned(), "no controller `Laser` on host `c2`".to_owned()];
        check(
            "",
            Report::Refused { reasons },
            &expect![[r#"
                test: refused
                  host `c3` could not be reached
                  no controller `Laser` on host `c2`

                  record  runs/test-1/run.mcap
                  report  runs/test-1/report.html
            "#]],
        );
    }
}
