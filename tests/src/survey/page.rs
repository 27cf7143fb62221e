//! The survey as one HTML page: the table, and a plot for each row with a range. The page contains no scripts, and loads
//! nothing from elsewhere.

use super::table::{Summary, degrees};
use super::{HIT_MAX, Outcome, PULL_MAX, Row};
use std::fmt::Write as _;

const STYLE: &str = "body{font:14px/1.5 sans-serif;margin:2em auto;max-width:80em;padding:0 1em;color:#222}\
table{border-collapse:collapse;width:100%}td,th{border-bottom:1px solid #ddd;padding:.2em .5em;text-align:right;vertical-align:top}\
td:first-child,td:last-child,th:first-child,th:last-child{text-align:left}.bad{color:#b00020;font-weight:bold}\
.group td{background:#f2f2f2;font-weight:bold}figure{display:inline-block;margin:0 1em 1em 0}figcaption{font-weight:bold}\
svg{background:#fafafa;border:1px solid #ddd}";
/// The width and height of a plot, and the space for its labels (px).
const SIZE: [f64; 2] = [380.0, 200.0];
const MARGIN: [f64; 2] = [40.0, 24.0];
/// The plot draws greater forces at the top (N).
const FORCE_MAX: f64 = 160.0;

/// Returns the page.
pub fn html(rows: &[(Row, Vec<Outcome>)], title: &str) -> String {
    let mut page = String::new();
    let mut put = |text: &str| page.push_str(text);
    let title = escaped(title);
    put("<!doctype html><html lang=\"en\"><head><meta charset=\"utf-8\">");
    put(&format!("<title>{title}</title><style>{STYLE}</style></head><body><h1>{title}</h1>"));
    put(
        "<p>Strict: done, the door really at 60° or more, at most 30 N when the hand meets the handle, at most 60 N while \
        the door opens. FALSE: done with the door below 60°; least: the smallest angle of all that are done. Forces are the largest of all runs of the row.</p>",
    );
    put(
        "<table><tr><th>row</th><th>worlds</th><th>success</th><th>strict</th><th>FALSE</th><th>least (°)</th><th>hit (N)</th>",
    );
    put("<th>opening (N)</th><th>worst (N)</th><th>time (s)</th><th>why the others ended</th></tr>");
    let mut group = None;
    for (row, outcomes) in rows {
        if group.replace(row.group) != Some(row.group) {
            put(&format!("<tr class=\"group\"><td colspan=\"11\">{}</td></tr>", row.group.name()));
        }
        put(&line(&row.name, &Summary::of(outcomes)));
    }
    let all = Summary { reasons: Vec::new(), ..Summary::of(rows.iter().flat_map(|(_, outcomes)| outcomes)) };
    put(&line("all", &all));
    put("</table><h2>Where in its range</h2><p>Each mission is a dot at its worst force: ");
    for kind in Kind::ALL {
        put(&format!("<span style=\"color:{}\">●</span> {} ", kind.colour(), kind.name()));
    }
    put("</p>");
    for (row, outcomes) in rows {
        put(&plot(row, outcomes));
    }
    put("</body></html>\n");
    page
}

fn line(name: &str, summary: &Summary) -> String {
    let Summary { worlds, success, strict, false_successes, angle_min, hit, pull, worst, seconds, reasons } = summary;
    let bad = |is_bad: bool| if is_bad { " class=\"bad\"" } else { "" };
    let reasons: Vec<String> = reasons.iter().map(|(why, count)| format!("{count} × {}", escaped(why))).collect();
    format!(
        "<tr><td>{}</td><td>{worlds}</td><td>{success}</td><td>{strict}</td><td{}>{false_successes}</td>\
        <td>{}</td><td>{hit:.0}</td><td>{pull:.0}</td><td{}>{worst:.0}</td><td>{seconds:.1}</td><td>{}</td></tr>",
        escaped(name),
        bad(*false_successes > 0),
        degrees(*angle_min),
        bad(*worst > 100.0),
        reasons.join("<br>")
    )
}

/// The drawing of a mission.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Strict,
    Rough,
    Aborted,
    False,
}

impl Kind {
    const ALL: [Self; 4] = [Self::Strict, Self::Rough, Self::Aborted, Self::False];

    fn of(outcome: &Outcome) -> Self {
        if outcome.is_strict() {
            Self::Strict
        } else if outcome.is_success() {
            Self::Rough
        } else if outcome.is_false() {
            Self::False
        } else {
            Self::Aborted
        }
    }

    fn colour(self) -> &'static str {
        match self {
            Self::Strict => "#2e7d32",
            Self::Rough => "#f9a825",
            Self::Aborted => "#607d8b",
            Self::False => "#b00020",
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Strict => "strict",
            Self::Rough => "open, but with too much force",
            Self::Aborted => "not open, and says so",
            Self::False => "FALSE",
        }
    }
}

/// Plots the worst force over the row's value. Returns nothing if the row has no values.
fn plot(row: &Row, outcomes: &[Outcome]) -> String {
    let dots: Vec<(f64, &Outcome)> =
        row.missions.iter().zip(outcomes).filter_map(|(mission, outcome)| Some((mission.value?, outcome))).collect();
    let (low, high) = dots.iter().fold((f64::MAX, f64::MIN), |(low, high), (x, _)| (low.min(*x), high.max(*x)));
    if dots.is_empty() || high <= low {
        return String::new();
    }
    let [width, height] = SIZE;
    let x = |value: f64| MARGIN[0] + (value - low) / (high - low) * (width - MARGIN[0] - 10.0);
    let y = |force: f64| (height - MARGIN[1]) - force.min(FORCE_MAX) / FORCE_MAX * (height - MARGIN[1] - 10.0);
    let mut svg = format!(
        "<figure><figcaption>{}</figcaption><svg width=\"{width}\" height=\"{height}\" role=\"img\" font-size=\"11\">",
        escaped(&row.name)
    );
    let mut put = |text: std::fmt::Arguments<'_>| svg.write_fmt(text).expect("a text takes what is written");
    for force in [0.0, HIT_MAX, PULL_MAX, 100.0, FORCE_MAX] {
        let at = y(force);
        put(format_args!("<line x1=\"{}\" x2=\"{width}\" y1=\"{at:.1}\" y2=\"{at:.1}\" stroke=\"#ddd\"/>", MARGIN[0]));
        put(format_args!("<text x=\"4\" y=\"{:.1}\">{force:.0} N</text>", at + 4.0));
    }
    for (value, anchor) in [(low, "start"), (high, "end")] {
        let at = x(value);
        put(format_args!(
            "<text x=\"{at:.1}\" y=\"{}\" text-anchor=\"{anchor}\">{value:.3} {}</text>",
            height - 6.0,
            row.unit
        ));
    }
    for (value, outcome) in dots {
        let (at, force, colour) = (x(value), y(outcome.worst), Kind::of(outcome).colour());
        let told = escaped(&format!("{value:.4} {}: {}, {:.1} deg", row.unit, outcome.reason(), outcome.angle));
        put(format_args!(
            "<circle cx=\"{at:.1}\" cy=\"{force:.1}\" r=\"3.5\" fill=\"{colour}\"><title>{told}</title></circle>"
        ));
    }
    svg.push_str("</svg></figure>");
    svg
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulation::Finish;

    #[test]
    fn a_page_has_each_row_and_each_dot_and_no_script() {
        let rows = super::super::rows(3, 1, &[]);
        let outcome = Outcome {
            finish: Finish::Aborted("a < b".to_owned()),
            beyond: None,
            angle: 3.0,
            hit: 1.0,
            pull: 2.0,
            worst: 500.0,
            wrong: 0.0,
            seconds: 4.0,
        };
        let flown = |row: Row| (row.missions.len(), row);
        let rows: Vec<_> =
            rows.into_iter().map(flown).map(|(count, row)| (row, vec![outcome.clone(); count])).collect();
        let page = html(&rows, "Doors");
        let dots: usize =
            rows.iter().flat_map(|(row, _)| &row.missions).filter(|mission| mission.value.is_some()).count();
        assert_eq!(page.matches("<circle").count(), dots);
        for (row, _) in &rows {
            assert!(page.contains(&format!("{} × a &lt; b", row.missions.len())), "{}", row.name);
        }
        assert_eq!(page.matches(" × a &lt; b").count(), rows.len());
        assert!(!page.contains("<script") && !page.contains("http"));
        assert!(!page.contains("NaN"));
    }
}
