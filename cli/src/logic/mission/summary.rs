//! The summary of a mission: one screen at its end.

use crate::logic::mission::progress::cut;
use crate::logic::mission::{Mission, Note, Outcome, Phase, Track, seconds, short};
use node::logic::table::counted;
use std::time::Duration;

/// The most phases in the table; a screen has about 24 lines.
const ROWS_MAX: usize = 14;
/// The most signals that have a column.
const COLUMNS_MAX: usize = 6;
/// The most notes shown.
const NOTES_MAX: usize = 6;
/// The most programs whose lost values are shown.
const LOSSES_MAX: usize = 6;
/// The most programs whose output is shown.
const OUTPUTS_MAX: usize = 3;
/// The widest cell.
const CELL_MAX: usize = 40;
/// The smallest width to which a cell is cut, so that other cells fit.
const CELL_MIN: usize = 16;

/// The files with the complete information.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Files {
    /// Path of the record.
    pub record: Option<String>,
    /// Path of the report.
    pub report: Option<String>,
    /// How many samples the recorder has left out.
    pub dropped: u64,
    /// A sentence for each wire some of whose values are not in the record.
    pub missing: Vec<String>,
}

/// Returns the summary of a mission that has ended, on one screen, with a line feed at its end. No line is wider than
/// `columns`, except for a single word that is wider.
pub fn summary(mission: &Mission, files: &Files, columns: Option<usize>) -> String {
    let columns = columns.unwrap_or(usize::MAX);
    let text = text(mission, files, columns);
    text.lines().map(|line| wrapped(line, columns) + "\n").collect()
}

fn text(mission: &Mission, files: &Files, columns: usize) -> String {
    let mut text = title(mission);
    text.push('\n');
    if let Some(chain) = failure_chain(mission) {
        text.push_str(&format!("  {chain}\n"));
    }
    for (whose, output) in failure_output(mission) {
        text.push_str(&format!("  {whose}:\n"));
        output.iter().for_each(|line| text.push_str(&format!("    | {line}\n")));
    }
    match mission.verdict().map(|verdict| &verdict.outcome) {
        Some(Outcome::Refused(reasons)) => {
            reasons.iter().for_each(|reason| text.push_str(&format!("  {}\n", reason.replace('\n', "\n    | "))));
        }
        Some(Outcome::Done | Outcome::Aborted(_) | Outcome::Stopped | Outcome::Unconfirmed) | None => {}
    }
    let hosts = mission.verdict().map_or(&[][..], |verdict| &verdict.unconfirmed);
    if !hosts.is_empty() {
        text.push_str(&format!("  not confirmed that nothing is left on: {}\n", hosts.join(", ")));
        text.push_str("    programs may still run there; `dca status` says when they have ended\n");
    }
    notes(mission, &mut text);
    losses(mission, &mut text);
    if mission.start().is_running() {
        text.push('\n');
        table(mission, columns, &mut text);
    }
    let dropped = match files.dropped {
        0 => String::new(),
        count => format!(" ({} left out: the disk was too slow)", counted(count, "sample")),
    };
    let missing = files.missing.iter().map(|sentence| format!("          {sentence}\n"));
    let record = files.record.iter().map(|path| format!("  record  {path}{dropped}\n"));
    let report = files.report.iter().map(|path| format!("  report  {path}\n"));
    let lines: String = record.chain(missing).chain(report).collect();
    if !lines.is_empty() {
        text.push_str(&format!("\n{lines}"));
    }
    text
}

/// Returns the chain from `main` to the process where a failure began; nothing if the mission did not fail.
pub fn failure_chain(mission: &Mission) -> Option<String> {
    match &mission.verdict()?.outcome {
        Outcome::Aborted(failure) => Some(failure.to_string()),
        Outcome::Done | Outcome::Stopped | Outcome::Unconfirmed | Outcome::Refused(_) => None,
    }
}

/// Returns the last lines of the program whose failure ended the mission, or of the programs that a deadline has
/// stopped. Each program has a heading.
pub fn failure_output(mission: &Mission) -> Vec<(String, &[String])> {
    let Some(Outcome::Aborted(failure)) = mission.verdict().map(|verdict| &verdict.outcome) else { return Vec::new() };
    if !failure.cause.output().is_empty() {
        return vec![("the end of its output".to_owned(), failure.cause.output())];
    }
    let late = mission.late.of(failure).into_iter().take(OUTPUTS_MAX);
    late.map(|(path, output)| (format!("the end of the output of `{}`", short(path)), output)).collect()
}

/// Breaks a line between words into several lines. The further lines are indented to its beginning.
fn wrapped(line: &str, columns: usize) -> String {
    if line.chars().count() <= columns {
        return line.to_owned();
    }
    let indent = line.chars().take_while(|c| *c == ' ').count();
    let mut text = " ".repeat(indent);
    let mut used = indent;
    for word in line.split_whitespace() {
        let length = word.chars().count();
        if used > indent && used + 1 + length > columns {
            text.push('\n');
            text.push_str(&" ".repeat(indent + 2));
            used = indent + 2;
        } else if used > indent {
            text.push(' ');
            used += 1;
        }
        text.push_str(word);
        used += length;
    }
    text
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
    // The failure that ended the mission is already shown above, as a chain.
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

fn losses(mission: &Mission, text: &mut String) {
    for (process, counts) in mission.losses().take(LOSSES_MAX) {
        text.push_str(&format!("  {process}: {counts}\n"));
    }
    let more = mission.losses().skip(LOSSES_MAX).count();
    if more > 0 {
        text.push_str(&format!("  {} lost values as well\n", counted(more, "other program")));
    }
}

/// One row of a table: its first four cells, then one cell for each headline signal.
type Row = (Vec<String>, Vec<String>);

fn table(mission: &Mission, columns: usize, text: &mut String) {
    let all: Vec<(usize, &Track)> = mission.headlines().take(COLUMNS_MAX).collect();
    // If the table is too wide, first names are shortened. Then signals are left out, beginning with the last one.
    let sizes = [CELL_MAX, CELL_MIN].map(|cell| (cell, all.len()));
    let fewer = (0..all.len()).rev().map(|count| (CELL_MIN, count));
    let mut rows = String::new();
    for (cell_max, count) in sizes.into_iter().chain(fewer) {
        rows = table_of(mission, &all[..count], cell_max);
        if rows.lines().all(|line| line.chars().count() <= columns) {
            if count < all.len() {
                rows.push_str(&format!("  ({} more in the report)\n", counted(all.len() - count, "signal")));
            }
            break;
        }
    }
    text.push_str(&rows);
    let hidden = mission.phases().len().saturating_sub(ROWS_MAX) + mission.phases_dropped();
    if hidden > 0 {
        text.push_str(&format!("  ({hidden} earlier phases are not shown)\n"));
    }
}

fn table_of(mission: &Mission, signals: &[(usize, &Track)], cell_max: usize) -> String {
    let now = mission.now();
    let hidden = mission.phases().len().saturating_sub(ROWS_MAX);
    let cells = |cells: [&str; 4]| cells.iter().map(|cell| cut(cell, cell_max)).collect::<Vec<_>>();
    let mut rows: Vec<Row> = Vec::new();
    let names = signals.iter().map(|(_, track)| cut(&mission.title(track), cell_max)).collect();
    rows.push((cells(["phase", "from", "took", "ended by"]), names));
    let units = signals.iter().map(|(_, track)| format!("peak {}", track.unit).trim_end().to_owned()).collect();
    if !signals.is_empty() {
        rows.push((cells(["", "", "", ""]), units));
    }
    for phase in &mission.phases()[hidden..] {
        rows.push((phase_cells(phase, now, &cells), peaks(phase, signals)));
    }
    let whole = signals.iter().map(|(_, track)| track.text(track.peak)).collect();
    rows.push((cells(["whole run", "", &seconds(now), ""]), whole));
    let last = signals.iter().map(|(_, track)| track.text(track.last)).collect();
    if !signals.is_empty() {
        rows.push((cells(["at the end", "", "", ""]), last));
    }
    aligned(&rows)
}

fn phase_cells(phase: &Phase, now: Duration, cells: &dyn Fn([&str; 4]) -> Vec<String>) -> Vec<String> {
    let ended = phase.ended();
    // The full reason of a failure is already shown above the table.
    let ended = ended.split(": ").next().unwrap_or_default();
    cells([&phase.name, &seconds(phase.begin), &seconds(phase.took(now)), ended])
}

fn peaks(phase: &Phase, signals: &[(usize, &Track)]) -> Vec<String> {
    let peak = |(index, track): &(usize, &Track)| phase.peak(*index).map_or("·".to_owned(), |peak| track.text(peak));
    signals.iter().map(peak).collect()
}

/// Returns the rows as text. Names are aligned left, numbers right.
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
    use crate::logic::mission::tests::{OPENING, door, feed, feed_more, plan, run, seconds as at};
    use expect_test::{Expect, expect};
    use language::plan::Expression as E;
    use node::logic::protocol::{Ending, Failure, FailureCause, Report};

    fn check(table: &str, end: Report, expect: &Expect) {
        let mut mission = Mission::new(&door());
        if !table.is_empty() {
            feed(&mut mission, table);
        }
        mission.report(&end);
        let record = Some("runs/test-1/run.mcap".to_owned());
        let report = Some("runs/test-1/report.html".to_owned());
        expect.assert_eq(&summary(&mission, &Files { record, report, ..Files::default() }, None));
    }

    #[test]
    fn no_line_is_wider_than_the_terminal_and_nothing_of_a_failure_is_cut() {
        let mut mission = Mission::new(&door());
        let names = ["left_finger_force", "right_finger_force", "door_angle_of_hinge", "temperature_of_motor"];
        let lines = (1..).zip(names).map(|(second, name)| format!("{second} motion {name} 12.5 N\n"));
        feed(&mut mission, &format!("{OPENING}{}", lines.collect::<String>()));
        let why = "no gripper answers on the serial port that the parameter `device` of its interface names";
        let failure =
            Failure { origin: "main/sys/hit".to_owned(), cause: FailureCause::Reported(why.to_owned()), at: at(1.0) };
        mission.report(&Report::Finished { ending: Ending::Aborted(failure), at: at(23.0), unconfirmed: Vec::new() });
        for columns in [40, 60, 80, 120] {
            let text = summary(&mission, &Files::default(), Some(columns));
            let widest = text.lines().map(|line| line.chars().count()).max();
            assert!(widest <= Some(columns.max(46)), "{columns}: {widest:?}\n{text}");
            let words = text.split_whitespace().collect::<Vec<_>>().join(" ");
            assert!(words.contains(why) && words.contains("whole run"), "{text}");
        }
        let text = summary(&mission, &Files::default(), Some(80));
        assert!(text.contains("more in the report)"), "{text}");
    }

    #[test]
    fn a_failure_shows_the_end_of_the_programs_output() {
        let output = vec!["Traceback (most recent call last):".to_owned(), "ValueError: no lens".to_owned()];
        let cause = FailureCause::Exit(1).of_program(0, output);
        let failure = Failure { origin: "main/sys/near".to_owned(), cause, at: at(1.0) };
        let table = "0 servo activated \n 0 near activated \n";
        check(
            table,
            Report::Finished { ending: Ending::Aborted(failure), at: at(1.2), unconfirmed: Vec::new() },
            &expect![[r#"
                test: aborted after 1.2 s (8 programs on 2 hosts, started in 0.8 s)
                  main ← sys ← near: left with exit code 1 before it was done at 1.0 s
                  the end of its output:
                    | Traceback (most recent call last):
                    | ValueError: no lens

                  phase          from   took  ended by
                  servo # near  0.0 s  1.2 s  stopped
                  whole run            1.2 s

                  record  runs/test-1/run.mcap
                  report  runs/test-1/report.html
            "#]],
        );
        let reasons = vec!["`main/a` cannot take part: left; the end of its output:\nTraceback\nValueError".to_owned()];
        check(
            "",
            Report::Refused { reasons },
            &expect![[r#"
                test: refused
                  `main/a` cannot take part: left; the end of its output:
                    | Traceback
                    | ValueError

                  record  runs/test-1/run.mcap
                  report  runs/test-1/report.html
            "#]],
        );
    }

    #[test]
    fn a_deadline_shows_the_end_of_what_its_programs_wrote() {
        let why = "the deadline `slow within 5 s` in line 3 has passed";
        let clock = E::Sequence(Box::new(E::Wait(at(5.0))), Box::new(E::Fail(why.to_owned())));
        let late = E::Disable(vec![run(1), clock]);
        let plan = plan(&["cam", "slow"], E::Disable(vec![run(0), late]));
        let mut mission = Mission::new(&plan);
        feed(&mut mission, "0 cam activated \n 0 slow activated \n 5 slow stopping \n 5 cam stopping");
        mission.wrote("main/sys/cam", "a picture");
        mission.wrote("main/sys/slow", &"waiting\n".repeat(40));
        let failure =
            Failure { origin: "main/sys".to_owned(), cause: FailureCause::Failed(why.to_owned()), at: at(5.1) };
        let end = Report::Finished { ending: Ending::Aborted(failure), at: at(5.2), unconfirmed: Vec::new() };
        let mut running = mission.clone();
        feed_more(&mut mission, "5.1 slow stopped \n 5.1 cam stopped");
        for mission in [&mut mission, &mut running] {
            // Output that is still in transit at the end arrives later.
            mission.report(&end);
            mission.wrote("main/sys/slow", "waiting\n\x1b[1mno answer from the lens");
        }
        let text = summary(&mission, &Files::default(), None);
        let shown = format!("  the end of the output of `sys/slow`:\n{}    | no answer", "    | waiting\n".repeat(19));
        assert!(text.contains(&shown) && !text.contains("picture"), "{text}");
        let text = summary(&running, &Files::default(), None);
        assert!(!text.contains("wrote"), "it was not stopped: {text}");
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

    /// Counts restart with each activation, and the last sample may arrive after the end.
    #[test]
    fn lost_values_are_in_the_summary() {
        let table = format!(
            "{OPENING} 1 near lost_values 0 - \n 2 near lost_values 600 - \n 3 near lost_values 30 - \n \
             3 hit refused_values 1 - \n 3 servo lost_values 0 - \n 4 hit undelivered_values 50 - \n \
             5 hit undelivered_values 0 - \n 6 servo undelivered_values 20 - \n 7 servo undelivered_values 30 - \n \
             4 open undelivered_values 5 - \n 5 open undelivered_values 0 -"
        );
        let mut mission = Mission::new(&door());
        feed(&mut mission, &table);
        mission.report(&Report::Finished { ending: Ending::Done(Vec::new()), at: at(22.1), unconfirmed: Vec::new() });
        feed_more(&mut mission, "22.2 near lost_values 37 -");
        let text = summary(&mission, &Files::default(), None);
        let lines: Vec<&str> = text.lines().filter(|line| line.starts_with("  sys/")).collect();
        let servo = "  sys/servo: 30 values not delivered";
        assert_eq!(lines, ["  sys/hit: 1 value refused", "  sys/near: 637 values lost", servo]);
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
                  main ← sys ← near ← laser: SIGKILL (external) at 1.0 s
                  not confirmed that nothing is left on: c2
                    programs may still run there; `dca status` says when they have ended
                  1.0 s  sys/near aborted: SIGKILL (external)

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
