//! The page that shows a run: one HTML file with inline SVG, to be opened anywhere and years later.
//!
//! It loads nothing from the network. The same run gives the same bytes. Every picture shares one axis of time, with
//! the phases as bands behind it. A small script moves one cursor through all of them, and shows
//! the values of the curves. Without the script, only the cursor is missing. Nothing is shown by
//! colour alone.

pub(crate) mod axis;
mod curves;
pub(crate) mod lanes;
mod panels;
mod parts;
pub(crate) mod text;

use crate::logic::mission::Mission;
use crate::logic::record::Run;
use axis::TimeAxis;

const STYLE: &str = include_str!("page/style.css");
/// The style of the lanes, which the page of a live view has as well.
pub(crate) const LANES: &str = include_str!("page/lanes.css");
const SCRIPT: &str = include_str!("page/script.js");

/// Returns a run as one HTML page that needs nothing else.
pub fn page(run: &Run) -> String {
    let mission = run.mission();
    let axis = TimeAxis::new(&mission);
    let mut body = parts::head(run, &mission);
    if mission.start().is_running() {
        body.push_str(&parts::cards(&mission));
        body.push_str(&parts::table(&mission));
        body.push_str(&pictures(run, &mission, &axis));
    }
    body.push_str(&parts::details(run));
    let name = text::escape(mission.name());
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <meta name=\"color-scheme\" content=\"light dark\">\n<title>{name}</title>\n<style>\n{STYLE}{LANES}</style>\n</head>\n\
         <body>\n<main>\n{body}</main>\n<script>\n{SCRIPT}</script>\n</body>\n</html>\n"
    )
}

fn pictures(run: &Run, mission: &Mission, axis: &TimeAxis) -> String {
    let mut text = String::from("<section id=\"pictures\">\n<h2>What happened when</h2>\n");
    text.push_str(&format!(
        "<p id=\"cursor\" hidden aria-live=\"off\"><b id=\"cursor-time\"></b> <span id=\"cursor-phase\"></span></p>\n{}",
        axis.strip()
    ));
    let (panels, constants) = panels::panels(run, mission);
    let (first, rest): (Vec<_>, Vec<_>) = panels.iter().partition(|panel| panel.headline);
    first.iter().for_each(|panel| text.push_str(&curves::figure(panel, axis)));
    text.push_str(&lanes::figure(run, mission, axis));
    rest.iter().for_each(|panel| text.push_str(&curves::figure(panel, axis)));
    if !constants.is_empty() {
        text.push_str(&format!("<p class=\"quiet\">Never changed: {}.</p>\n", text::escape(&constants.join(", "))));
    }
    text.push_str("</section>\n");
    text
}

#[cfg(test)]
mod tests;
