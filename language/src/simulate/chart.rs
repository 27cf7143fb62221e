//! Draws a run: one line for each process, one bar for each activation.

use crate::plan::{MemberKind, Plan};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::time::Duration;

use super::Transition;

/// The largest number of bars of a chart. Later bars are not drawn.
const BARS_MAX: usize = 10_000;
/// The height of a line, and of a bar in it.
const LINE: f64 = 24.0;
const BAR: f64 = 14.0;
/// The width of the time axis.
const PLOT: f64 = 460.0;
/// The space around the chart, and the width of a letter.
const MARGIN: f64 = 12.0;
const LETTER: f64 = 6.6;
/// The indentation of a name for each level of groups, in pixels.
const INDENT: f64 = 14.0;
/// The approximate number of times on the time axis.
const TICKS: f64 = 8.0;

const DONE: &str = "#2b7a3d";
const ABORTED: &str = "#c81e1e";
const STOPPED: &str = "#555555";

/// All bars, in the order in which they began.
#[derive(Clone, Debug, Default)]
pub(super) struct Timeline {
    bars: Vec<Bar>,
    /// The bars without an end, by the name of their line.
    open: BTreeMap<String, usize>,
}

#[derive(Clone, Debug)]
struct Bar {
    /// The path of the process. For a wait or a limit, the path of the group with the wait or limit.
    line: String,
    from: Duration,
    end: Option<(Duration, Transition)>,
}

impl Timeline {
    /// Notes a start or an end on a line. The line is a process, or a wait or limit: `path/wait(5 s)` or `path/within 5 s`.
    pub(super) fn note(&mut self, line: &str, at: Duration, transition: &Transition) {
        match transition {
            Transition::Started if self.bars.len() < BARS_MAX => {
                self.open.insert(line.to_owned(), self.bars.len());
                self.bars.push(Bar { line: line.to_owned(), from: at, end: None });
            }
            Transition::Done | Transition::Aborted(_) | Transition::Stopped => {
                if let Some(bar) = self.open.remove(line) {
                    self.bars[bar].end = Some((at, transition.clone()));
                }
            }
            Transition::Started
            | Transition::Stopping
            | Transition::Waits(_)
            | Transition::Limited(_)
            | Transition::Says(_) => {}
        }
    }

    /// Returns the picture of the time until `now`, as SVG.
    pub(super) fn svg(&self, plan: &Plan, now: Duration) -> String {
        let lines = self.lines(plan);
        let names = lines.iter().map(|line| line.indent + letters(&line.name)).fold(0.0, f64::max);
        // A run of less than a second is drawn as if the axis were a second, so that it stays visible.
        let seconds = now.as_secs_f64().max(1.0);
        let page = Page { left: MARGIN + names + 14.0, scale: PLOT / seconds, now };
        let reasons = self.bars.iter().filter_map(reason).map(letters).fold(40.0, f64::max);
        let bottom = MARGIN + row(lines.len());
        let (width, height) = (page.left + PLOT + reasons + 24.0, bottom + 44.0);
        let mut out = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width:.0}\" height=\"{height:.0}\" viewBox=\"0 0 \
             {width:.0} {height:.0}\" font-family=\"Helvetica, Arial, sans-serif\" font-size=\"12\">\n\
             <rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n"
        );
        page.axis(&mut out, seconds, bottom);
        for (index, line) in lines.iter().enumerate() {
            let y = MARGIN + row(index);
            let (x, weight) =
                (MARGIN + line.indent, if line.kind == Kind::Group { " font-weight=\"bold\"" } else { "" });
            text(&mut out, x, y + BAR - 2.0, weight, &line.name);
            let bars = || self.bars.iter().filter(|bar| bar.line == line.path);
            bars().for_each(|bar| page.bar(&mut out, bar, line.kind, y));
            // The next bar may begin where the previous bar has ended, so the marks are drawn on top.
            bars().for_each(|bar| page.end(&mut out, bar, y));
        }
        legend(&mut out, &self.bars, page.left, bottom + 36.0);
        out + "</svg>\n"
    }

    /// Returns the lines: a group, then its waits and members, in the order in which they began.
    fn lines(&self, plan: &Plan) -> Vec<Line> {
        let mut began: BTreeMap<&str, usize> = BTreeMap::new();
        for (index, bar) in self.bars.iter().enumerate() {
            began.entry(&bar.line).or_insert(index);
        }
        let order = |path: &str| -> Vec<usize> {
            let ends = path.match_indices('/').map(|(end, _)| end).chain([path.len()]);
            ends.filter_map(|end| began.get(&path[..end]).copied()).collect()
        };
        let services = services(plan);
        let line = |path: &&str| {
            let (name, depth) = (path.rsplit('/').next().unwrap_or(path), path.matches('/').count());
            let kind = match () {
                () if path.ends_with(')') || name.starts_with("within ") => Kind::Wait,
                () if plan.groups.iter().any(|group| group.path == **path) => Kind::Group,
                () if services.contains(path) => Kind::Service,
                () => Kind::Task,
            };
            Line { path: (*path).to_owned(), name: name.to_owned(), indent: INDENT * small(depth), kind }
        };
        let mut lines: Vec<Line> = began.keys().map(line).collect();
        lines.sort_by_key(|line| order(&line.path));
        lines
    }
}

struct Line {
    path: String,
    name: String,
    indent: f64,
    kind: Kind,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Group,
    Task,
    Service,
    Wait,
}

fn services(plan: &Plan) -> Vec<&str> {
    let members = plan.groups.iter().flat_map(|group| &group.members).filter(|member| member.service);
    let paths = members.filter_map(|member| match member.kind {
        MemberKind::Leaf(leaf) => Some(plan.leaves[leaf as usize].path.as_str()),
        MemberKind::Group(_) => None,
    });
    paths.collect()
}

/// The position of times on the page.
struct Page {
    left: f64,
    /// The width of a second.
    scale: f64,
    now: Duration,
}

impl Page {
    fn x(&self, at: Duration) -> f64 {
        self.left + at.as_secs_f64() * self.scale
    }

    fn axis(&self, out: &mut String, seconds: f64, bottom: f64) {
        let step = [1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 60.0, 120.0, 300.0, 600.0, 3600.0];
        let step = step.into_iter().find(|step| seconds / step <= TICKS).unwrap_or(seconds / TICKS);
        let mut tick = 0.0;
        while tick <= seconds {
            let x = self.left + tick * self.scale;
            draw(out, format_args!("<path d=\"M{x:.1} {MARGIN} V{bottom:.1}\" stroke=\"#dddddd\"/>"));
            let style = " text-anchor=\"middle\" font-size=\"10\" fill=\"#666\"";
            text(out, x, bottom + 13.0, style, &format!("{tick} s"));
            tick += step;
        }
    }

    fn bar(&self, out: &mut String, bar: &Bar, kind: Kind, y: f64) {
        let start = self.x(bar.from);
        let width = (self.x(bar.end.as_ref().map_or(self.now, |(at, _)| *at)) - start).max(1.0);
        let style = match kind {
            Kind::Group => "fill=\"#eef1f5\" stroke=\"#333\"",
            Kind::Task => "fill=\"#b9d3ee\" stroke=\"#333\"",
            Kind::Service => "fill=\"#dbe8f5\" stroke=\"#333\" stroke-width=\"2\"",
            Kind::Wait => "fill=\"white\" stroke=\"#888\" stroke-dasharray=\"4 3\"",
        };
        draw(
            out,
            format_args!(
                "<rect x=\"{start:.1}\" y=\"{y:.1}\" width=\"{width:.1}\" height=\"{BAR}\" rx=\"2\" {style}/>"
            ),
        );
    }

    fn end(&self, out: &mut String, bar: &Bar, y: f64) {
        let Some((at, transition)) = &bar.end else { return };
        let end = self.x(*at);
        mark(out, transition, end, y + BAR / 2.0);
        if let Some(why) = reason(bar) {
            text(out, end + 9.0, y + BAR - 3.0, &format!(" font-size=\"10\" fill=\"{ABORTED}\""), why);
        }
    }
}

/// Draws the mark for an end: a disc for done, a cross for failed, a square for stopped.
fn mark(out: &mut String, transition: &Transition, x: f64, y: f64) {
    match transition {
        Transition::Done => draw(out, format_args!("<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"5\" fill=\"{DONE}\"/>")),
        Transition::Aborted(_) => draw(
            out,
            format_args!(
                "<path d=\"M{:.1} {:.1} l9 9 m0 -9 l-9 9\" stroke=\"{ABORTED}\" stroke-width=\"3\"/>",
                x - 4.5,
                y - 4.5
            ),
        ),
        Transition::Stopped => draw(
            out,
            format_args!(
                "<rect x=\"{:.1}\" y=\"{:.1}\" width=\"9\" height=\"9\" fill=\"{STOPPED}\"/>",
                x - 4.5,
                y - 4.5
            ),
        ),
        Transition::Started
        | Transition::Stopping
        | Transition::Waits(_)
        | Transition::Limited(_)
        | Transition::Says(_) => {}
    }
}

/// Draws the meaning of each mark on the page.
fn legend(out: &mut String, bars: &[Bar], mut x: f64, y: f64) {
    let meanings =
        [(Transition::Done, "done"), (Transition::Aborted(String::new()), "aborted"), (Transition::Stopped, "stopped")];
    for (transition, word) in meanings {
        let is_kind = |bar: &&Bar| {
            let end = bar.end.as_ref().map(|(_, end)| std::mem::discriminant(end));
            end == Some(std::mem::discriminant(&transition))
        };
        if bars.iter().any(|bar| is_kind(&bar)) {
            mark(out, &transition, x + 5.0, y - 4.0);
            text(out, x + 16.0, y, " font-size=\"10\" fill=\"#666\"", word);
            x += 80.0;
        }
    }
}

/// Returns the reason of the failure, if the bar ended with one.
fn reason(bar: &Bar) -> Option<&str> {
    match &bar.end {
        Some((_, Transition::Aborted(why))) => Some(why),
        Some((
            _,
            Transition::Done
            | Transition::Stopped
            | Transition::Started
            | Transition::Stopping
            | Transition::Waits(_)
            | Transition::Limited(_)
            | Transition::Says(_),
        ))
        | None => None,
    }
}

fn row(index: usize) -> f64 {
    LINE * small(index)
}

/// Converts a count. A chart has far fewer lines than an `f64` can count exactly.
fn small(count: usize) -> f64 {
    u32::try_from(count).map_or(f64::from(u32::MAX), f64::from)
}

fn letters(text: &str) -> f64 {
    LETTER * small(text.chars().count())
}

fn draw(out: &mut String, shape: std::fmt::Arguments<'_>) {
    // Writing to a string cannot fail.
    let written = out.write_fmt(shape);
    debug_assert!(written.is_ok());
    out.push('\n');
}

fn text(out: &mut String, x: f64, y: f64, style: &str, text: &str) {
    let text = text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
    draw(out, format_args!("<text x=\"{x:.1}\" y=\"{y:.1}\"{style}>{text}</text>"));
}

#[cfg(test)]
mod tests {
    use crate::{Options, Simulation, Source, compile};

    #[test]
    fn every_end_has_its_mark() {
        let spec = "process main() {
            instantiated_processes { hit instof Hit(c1); arm instof Arm(c1); home instof Home(c1); }
            internal_event_actions { (hit # arm) ; (home within 5 s) }
        }";
        let plan = compile(&Source::new("a.dca", spec), &[], &Options::named("a")).plan.unwrap();
        let mut simulation = Simulation::start(&plan);
        for line in ["2 s", "hit", "1 s", "home abort <lost>"] {
            simulation.obey(line).unwrap();
        }
        let chart = simulation.chart();
        // `hit` is done, `arm` and the deadline are stopped, `home` and so `main` failed. The legend also has each mark.
        assert_eq!(chart.matches("<circle").count(), 2, "{chart}");
        assert_eq!(chart.matches("fill=\"#555555\"").count(), 3, "{chart}");
        assert_eq!(chart.matches("l9 9").count(), 3, "{chart}");
        assert!(chart.contains(">within 5 s<") && chart.contains("&lt;lost&gt;"), "{chart}");
    }
}
