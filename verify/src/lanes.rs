//! Draws a story: a lane for each process, grouped by host, and a column for each step.

use crate::story::{Became, Story};
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// The most lanes and the most steps that are drawn.
const LANES_MAX: usize = 200;
const STEPS_MAX: usize = 200;
/// The sizes of names, steps, lanes, lines of text, and the margin.
const NAMES: usize = 200;
const STEP: usize = 48;
const LANE: usize = 22;
const LINE: usize = 17;
const MARGIN: usize = 16;
/// The approximate width of a letter.
const LETTER: usize = 7;

const ACTIVE: &str = "#7fb2e5";
const STOPPING: &str = "#f0b25c";
const WRONG: &str = "#c81e1e";

/// A part of a lane, from its first step to its last.
struct Bar {
    became: Became,
    from: usize,
    to: usize,
    /// How the part ends. None if another part follows at once, or if the story ends before.
    end: Option<Became>,
}

impl Story {
    /// Returns the story as an SVG picture; the same story always gives the same bytes. The line at the end marks the
    /// moment that `title` describes.
    pub fn svg(&self, title: &str) -> String {
        let steps = self.steps.len().min(STEPS_MAX);
        let lanes = self.lanes(steps);
        let hosts = lanes.keys().map(|(host, _)| host).collect::<std::collections::BTreeSet<_>>().len();
        let lines = self.lines();
        let top = MARGIN + 2 * LINE;
        let bottom = top + LINE + (lanes.len() + hosts) * LANE;
        let height = bottom + (lines.len() + 1) * LINE + 2 * MARGIN;
        let longest = lines.iter().map(|line| line.chars().count()).chain([title.chars().count()]).max().unwrap_or(0);
        let width = (NAMES + (steps + 1) * STEP).max(longest * LETTER) + 2 * MARGIN;
        let mut out = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} {height}\" \
             font-family=\"Helvetica, Arial, sans-serif\" font-size=\"12\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n"
        );
        text(&mut out, MARGIN, MARGIN + LINE / 2, "font-weight=\"bold\"", title);
        for step in 0..steps {
            text(&mut out, at(step) - LETTER / 2, top, "fill=\"#555555\"", &(step + 1).to_string());
            line(&mut out, at(step), top + 4, at(step), bottom, "stroke=\"#dddddd\"");
        }
        let mut y = top + LINE;
        let mut last = None;
        for ((host, process), bars) in &lanes {
            if last != Some(host) {
                text(&mut out, MARGIN, y + LINE - 4, "font-weight=\"bold\" fill=\"#555555\"", host);
                y += LANE;
                last = Some(host);
            }
            text(&mut out, MARGIN + 12, y + LINE - 4, "", process);
            bars.iter().for_each(|bar| draw(&mut out, bar, y));
            y += LANE;
        }
        self.mark(&mut out, top + 4, bottom, steps);
        for (number, told) in (1..).zip(&lines) {
            text(&mut out, MARGIN, bottom + MARGIN + number * LINE, "xml:space=\"preserve\"", told);
        }
        out + "</svg>\n"
    }

    /// Returns the activity of each process, by its host and its name.
    fn lanes(&self, steps: usize) -> BTreeMap<(&str, &str), Vec<Bar>> {
        let mut lanes: BTreeMap<(&str, &str), Vec<Bar>> = BTreeMap::new();
        for (step, moves) in self.steps.iter().take(steps).enumerate().map(|(number, step)| (number, &step.moves)) {
            for one in moves {
                let bars = lanes.entry((&one.host, &one.process)).or_default();
                let is_over = !matches!(one.became, Became::Active | Became::Stopping);
                if let Some(bar) = bars.last_mut().filter(|bar| bar.end.is_none() && bar.to == steps) {
                    (bar.to, bar.end) = (step, is_over.then_some(one.became));
                }
                if !is_over {
                    bars.push(Bar { became: one.became, from: step, to: steps, end: None });
                }
            }
        }
        lanes.into_iter().take(LANES_MAX).collect()
    }

    /// Marks the moment of the violation, or the steps that repeat for ever.
    fn mark(&self, out: &mut String, top: usize, bottom: usize, steps: usize) {
        match self.again.filter(|again| *again < steps) {
            Some(again) => {
                let (from, to) = (at(again) - STEP / 2, at(steps) - STEP / 2);
                line(out, from, bottom, to, bottom, &format!("stroke=\"{WRONG}\" stroke-width=\"3\""));
                text(out, from, bottom + LINE - 3, &format!("fill=\"{WRONG}\""), "and so on for ever");
            }
            None => {
                let x = at(steps) - STEP / 2;
                line(out, x, top, x, bottom, &format!("stroke=\"{WRONG}\" stroke-width=\"2\""));
            }
        }
    }
}

/// Returns the position of a step.
fn at(step: usize) -> usize {
    MARGIN + NAMES + STEP / 2 + step * STEP
}

fn draw(out: &mut String, bar: &Bar, y: usize) {
    let fill = if bar.became == Became::Stopping { STOPPING } else { ACTIVE };
    let is_open = bar.end.is_none() && bar.became == Became::Active;
    let right = if is_open || bar.to > bar.from { at(bar.to) } else { at(bar.to) + 2 };
    let x = at(bar.from);
    let width = right - x;
    let height = LANE - 6;
    let top = y + 2;
    let _infallible =
        writeln!(out, "<rect x=\"{x}\" y=\"{top}\" width=\"{width}\" height=\"{height}\" fill=\"{fill}\"/>");
    let sign = match bar.end {
        Some(Became::Done) => "done",
        Some(Became::Failed) => "fails",
        Some(Became::Stopped) => "stopped",
        Some(Became::Active | Became::Stopping) | None => return,
    };
    let colour = if bar.end == Some(Became::Failed) { WRONG } else { "#555555" };
    text(out, right + 3, y + LINE - 4, &format!("font-size=\"10\" fill=\"{colour}\""), sign);
}

fn line(out: &mut String, x1: usize, y1: usize, x2: usize, y2: usize, style: &str) {
    let _infallible = writeln!(out, "<line x1=\"{x1}\" y1=\"{y1}\" x2=\"{x2}\" y2=\"{y2}\" {style}/>");
}

fn text(out: &mut String, x: usize, y: usize, style: &str, text: &str) {
    let text = text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
    let _infallible = writeln!(out, "<text x=\"{x}\" y=\"{y}\" {style}>{text}</text>");
}
