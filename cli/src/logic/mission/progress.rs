//! The progress lines of a running mission.

use crate::logic::mission::{Mission, Note, Phase};
use std::time::Duration;

/// How often a file or a pipe gets a line while nothing changes.
const PLAIN_EVERY: Duration = Duration::from_secs(2);
/// The most routine notes that are shown within [`ROUTINE_WITHIN`]; the rest are counted.
const ROUTINE_MAX: usize = 20;
const ROUTINE_WITHIN: Duration = Duration::from_secs(1);
/// The widest column of phase names.
const NAME_MAX: usize = 40;
/// The most programs inside groups that are named.
const INNER_MAX: usize = 3;

/// Where the lines go.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Style {
    /// A terminal of this many columns. Its last line can be drawn again.
    Terminal(usize),
    /// A file or a pipe.
    Plain,
}

/// One line for a person.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Line {
    /// A line that stays on the screen.
    Kept(String),
    /// A line that replaces the previous live line on a terminal. In the plain style, it stays.
    Live(String),
}

/// Remembers which lines have been shown.
#[derive(Debug, Default)]
pub struct Progress {
    start: String,
    going: bool,
    begun: usize,
    ended: usize,
    /// The number of the next note.
    notes: usize,
    routine: Routine,
    last: Duration,
}

/// The routine notes within the last [`ROUTINE_WITHIN`].
#[derive(Debug, Default)]
struct Routine {
    began: Duration,
    shown: usize,
    left_out: usize,
}

impl Routine {
    /// Returns whether to show a note.
    fn shows(&mut self, note: &Note, lines: &mut Vec<Line>) -> bool {
        self.pass(note.at, lines);
        if !note.is_routine || self.shown < ROUTINE_MAX {
            self.shown += usize::from(note.is_routine);
            return true;
        }
        self.left_out += 1;
        false
    }

    /// If the time is over, reports how many notes were left out, and begins a new period.
    fn pass(&mut self, now: Duration, lines: &mut Vec<Line>) {
        if now >= self.began + ROUTINE_WITHIN {
            self.tell(lines);
            *self = Self { began: now, ..Self::default() };
        }
    }

    fn tell(&mut self, lines: &mut Vec<Line>) {
        match std::mem::take(&mut self.left_out) {
            0 => {}
            1 => lines.push(Line::Kept(format!("{:10}… 1 more line", ""))),
            more => lines.push(Line::Kept(format!("{:10}… {more} more lines", ""))),
        }
    }
}

impl Progress {
    /// Returns the new lines since the last call. Has to be called after each report, and also about every 100 ms.
    pub fn lines(&mut self, mission: &Mission, style: Style) -> Vec<Line> {
        let mut lines = Vec::new();
        if !mission.start().is_running() {
            let line = mission.start().line();
            if line != self.start && mission.verdict().is_none() {
                self.start.clone_from(&line);
                lines.push(Line::Live(line));
            }
            return fitted(lines, style);
        }
        if !self.going {
            self.going = true;
            lines.extend(mission.start().done().map(Line::Kept));
        }
        for note in mission.notes().iter().filter(|note| note.number >= self.notes) {
            if !self.routine.shows(note, &mut lines) {
                continue;
            }
            lines.push(Line::Kept(format!("{:>6.1} s  ! {} {}", note.at.as_secs_f64(), note.process, note.text)));
            lines.extend(note.output.iter().map(|line| Line::Kept(format!("{:10}| {line}", ""))));
        }
        self.notes = mission.notes_dropped() + mission.notes().len();
        self.routine.pass(mission.now(), &mut lines);
        if mission.verdict().is_some() {
            self.routine.tell(&mut lines);
        }
        self.phases(mission, style, &mut lines);
        fitted(lines, style)
    }

    fn phases(&mut self, mission: &Mission, style: Style, lines: &mut Vec<Line>) {
        let dropped = mission.phases_dropped();
        let ended = mission.phases().iter().skip(self.ended.saturating_sub(dropped));
        for phase in ended.take_while(|phase| phase.end.is_some()) {
            lines.push(Line::Kept(end_line(mission, phase)));
            self.ended = self.ended.max(dropped) + 1;
        }
        let begun = dropped + mission.phases().len();
        let now = mission.now();
        let due = match style {
            Style::Terminal(_) => true,
            Style::Plain => begun != self.begun || now >= self.last + PLAIN_EVERY,
        };
        if due && mission.verdict().is_none() {
            (self.begun, self.last) = (begun, now);
            lines.push(Line::Live(live_line(mission)));
        }
    }
}

fn fitted(mut lines: Vec<Line>, style: Style) -> Vec<Line> {
    if let Style::Terminal(width) = style {
        for line in &mut lines {
            // A live line must not wrap, because a wrapped line cannot be drawn again. Other lines may wrap.
            if let Line::Live(text) = line {
                *text = cut(text, width.saturating_sub(1));
            }
        }
    }
    lines
}

fn live_line(mission: &Mission) -> String {
    let now = mission.now();
    let (name, took) = match mission.phase() {
        Some(phase) => (phase.name.as_str(), phase.took(now)),
        None => ("…", Duration::ZERO),
    };
    let values = mission.headlines().map(|(_, track)| {
        let unit = if track.unit.is_empty() { String::new() } else { format!(" {}", track.unit) };
        format!("{} {}{unit}", mission.title(track), track.text(track.last))
    });
    let inner = Some(inner(mission)).filter(|inner| !inner.is_empty());
    let values = inner.into_iter().chain(values).collect::<Vec<_>>().join(" · ");
    line(mission, now, '▸', name, took, &values)
}

/// Returns the programs that run inside groups of the current step: `hit/force, hit/arm and 2 more`.
fn inner(mission: &Mission) -> String {
    let running: Vec<&str> = mission.inner().collect();
    let shown = running.iter().take(INNER_MAX).copied().collect::<Vec<_>>().join(", ");
    let more = running.len().saturating_sub(INNER_MAX);
    if more > 0 { format!("{shown} and {more} more") } else { shown }
}

fn end_line(mission: &Mission, phase: &Phase) -> String {
    let mark = match &phase.decided {
        Some(_) if phase.failed() => '✗',
        Some(_) => '✓',
        None => '■',
    };
    let end = phase.end.unwrap_or(phase.begin);
    line(mission, end, mark, &phase.name, phase.took(end), &phase.ended())
}

fn line(mission: &Mission, at: Duration, mark: char, name: &str, took: Duration, rest: &str) -> String {
    let width = mission.phase_width().min(NAME_MAX);
    let name = cut(name, width.max(1));
    let text = format!("{:>6.1} s  {mark} {name:<width$}  {:>5.1} s  {rest}", at.as_secs_f64(), took.as_secs_f64());
    text.trim_end().to_owned()
}

/// Cuts `text` to at most `width` characters; `…` replaces the rest.
pub(super) fn cut(text: &str, width: usize) -> String {
    if text.chars().count() <= width {
        return text.to_owned();
    }
    text.chars().take(width.saturating_sub(1)).chain(['…']).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::mission::tests::{OPENING, door, feed, seconds};
    use expect_test::{Expect, expect};
    use language::{Options, Source, compile};
    use node::logic::protocol::{Change, Ending, Failure, FailureCause, Report};

    fn check(style: Style, expect: &Expect) {
        let mut mission = Mission::new(&door());
        let mut progress = Progress::default();
        let mut text = String::new();
        let mut tell = |mission: &Mission| {
            for line in progress.lines(mission, style) {
                let (mark, line) = match &line {
                    Line::Kept(line) => ('=', line),
                    Line::Live(line) => ('~', line),
                };
                text.push_str(&format!("{mark} {line}\n"));
            }
        };
        tell(&mission);
        mission.report(&Report::Prepared { host: "c1".to_owned(), leaves: 4 });
        tell(&mission);
        mission.report(&Report::Connected { host: "c1".to_owned() });
        tell(&mission);
        for line in OPENING.lines() {
            feed(&mut mission, line);
            if line.contains("activated") || line.contains(" N") {
                tell(&mission);
            }
        }
        mission.tick(seconds(22.5));
        tell(&mission);
        mission.report(&Report::Finished { ending: Ending::Stopped, at: seconds(22.6), unconfirmed: Vec::new() });
        tell(&mission);
        expect.assert_eq(&text);
    }

    #[test]
    fn a_terminal_gets_the_ended_phases_and_a_live_line() {
        check(
            Style::Terminal(80),
            &expect![[r#"
                ~ starting 8 programs: c1 … · c2 …
                ~ starting 8 programs: c1 4 up · c2 …
                ~ starting 8 programs: c1 linked · c2 …
                = 8 programs on 2 hosts, started in 0.8 s
                ~    0.0 s  ▸ …                         0.0 s
                ~    0.0 s  ▸ servo # near              0.0 s
                ~    0.0 s  ▸ servo # near              0.0 s
                ~    1.0 s  ▸ servo # near              1.0 s  force 3.00 N
                =    6.9 s  ✓ servo # near              6.9 s  near done
                ~    6.9 s  ▸ (open, approach) # hit    0.0 s  force 3.00 N
                ~    6.9 s  ▸ (open, approach) # hit    0.0 s  force 3.00 N
                ~    6.9 s  ▸ (open, approach) # hit    0.0 s  force 3.00 N
                ~    8.0 s  ▸ (open, approach) # hit    1.1 s  force -16.0 N
                ~    8.0 s  ▸ (open, approach) # hit    1.1 s  force -16.0 N
                =   11.8 s  ✓ (open, approach) # hit    4.9 s  hit done
                ~   11.8 s  ▸ close                     0.0 s  force -16.0 N
                =   12.4 s  ✓ close                     0.6 s  done
                ~   12.5 s  ▸ pull                      0.0 s  force -16.0 N
                ~   14.0 s  ▸ pull                      1.5 s  force 28.8 N · angle 0.500 deg
                =   22.0 s  ✓ pull                      9.5 s  done
                ~   22.5 s  ▸ …                         0.0 s  force 28.8 N · angle 74.0 deg
            "#]],
        );
    }

    /// If there are very many notes, some are left out. But each is shown or counted, and questions and failures are always shown.
    #[test]
    fn a_flood_hides_no_question_and_no_failure() {
        let (mut mission, mut progress, mut lines) = (Mission::new(&door()), Progress::default(), Vec::new());
        feed(&mut mission, OPENING.lines().next().unwrap());
        let mut tell = |change: Change, millis: u64| {
            mission.report(&Report::Process { path: "main/sys".to_owned(), change, at: Duration::from_millis(millis) });
            lines.extend(progress.lines(&mission, Style::Plain));
        };
        let says = |text: &str, is_routine| Change::Says { text: text.to_owned(), is_routine };
        for number in 0..1000 {
            tell(says(&format!("says: {number}"), true), number * 10);
            if number % 100 == 99 {
                tell(says(&format!("asks, as question {number}: go on?"), false), number * 10);
                let cause = FailureCause::Failed(format!("host `c{number}` could not be reached"));
                let failure = Failure { origin: "main/sys".to_owned(), cause, at: Duration::ZERO };
                tell(Change::Ended(Ending::Aborted(failure)), number * 10);
            }
        }
        mission.report(&Report::Finished { ending: Ending::Stopped, at: seconds(10.0), unconfirmed: Vec::new() });
        lines.extend(progress.lines(&mission, Style::Plain));
        let kept: Vec<&str> = lines
            .iter()
            .filter_map(|line| if let Line::Kept(line) = line { Some(line.as_str()) } else { None })
            .collect();
        let count = |what: &str| kept.iter().filter(|line| line.contains(what)).count();
        assert_eq!((count("asks, as question"), count("could not be reached")), (10, 10));
        let more =
            kept.iter().filter_map(|line| line.trim().strip_prefix("… ")?.split(' ').next()?.parse::<usize>().ok());
        assert_eq!(more.sum::<usize>() + count("says: "), 1000);
        assert!(count("says: ") <= 20 * 11, "{}", count("says: "));
        assert!(mission.notes().len() <= crate::logic::mission::NOTES_MAX);
    }

    #[test]
    fn the_programs_inside_a_group_are_named() {
        let text = "module Step(host) { done; }
            process Patrol(){
                instantiated_processes{ drive instof Step(c1); look instof Step(c1); }
                internal_event_actions{ drive , look }
            }
            process main(){
                host{c1}
                instantiated_processes{ patrol instof Patrol(); home instof Step(c1); }
                internal_event_actions{ patrol ; home }
            }";
        let plan = compile(&Source::new("a.dca", text), &[], &Options::named("a")).plan.unwrap();
        let mut mission = Mission::new(&plan);
        mission.report(&Report::Go { took: seconds(0.1), signals: Vec::new() });
        let mut shown = |path: &str, change: Change| {
            mission.report(&Report::Process { path: path.to_owned(), change, at: seconds(1.0) });
            live_line(&mission)
        };
        let done = || Change::Ended(Ending::Done(Vec::new()));
        shown("main/patrol", Change::Activated);
        shown("main/patrol/drive", Change::Activated);
        let both = shown("main/patrol/look", Change::Activated);
        assert!(both.ends_with("s  patrol/drive, patrol/look"), "{both}");
        let one = shown("main/patrol/drive", done());
        assert!(one.ends_with("s  patrol/look"), "{one}");
        shown("main/patrol/look", done());
        shown("main/patrol", done());
        let home = shown("main/home", Change::Activated);
        assert!(home.ends_with(" s") && home.contains("▸ home"), "a step that is a program names itself: {home}");
    }

    #[test]
    fn a_log_gets_a_line_per_change_and_one_every_two_seconds() {
        check(
            Style::Plain,
            &expect![[r#"
                ~ starting 8 programs: c1 … · c2 …
                ~ starting 8 programs: c1 4 up · c2 …
                ~ starting 8 programs: c1 linked · c2 …
                = 8 programs on 2 hosts, started in 0.8 s
                ~    0.0 s  ▸ servo # near              0.0 s
                =    6.9 s  ✓ servo # near              6.9 s  near done
                ~    6.9 s  ▸ (open, approach) # hit    0.0 s  force 3.00 N
                =   11.8 s  ✓ (open, approach) # hit    4.9 s  hit done
                ~   11.8 s  ▸ close                     0.0 s  force -16.0 N
                =   12.4 s  ✓ close                     0.6 s  done
                ~   12.5 s  ▸ pull                      0.0 s  force -16.0 N
                =   22.0 s  ✓ pull                      9.5 s  done
                ~   22.5 s  ▸ …                         0.0 s  force 28.8 N · angle 74.0 deg
            "#]],
        );
    }
}
