//! A picture of curves.

use crate::logic::page::axis::{LEFT, RIGHT, TimeAxis, ValueAxis, svg};
use crate::logic::page::panels::{Curve, Panel};
use crate::logic::page::text::escape;
use std::time::Duration;

/// Height of the curves in a picture that matters most.
const HEIGHT: f64 = 150.0;
/// Height of the curves in any other.
const HEIGHT_SMALL: f64 = 105.0;
/// The height of the room over and under the curves, in pixels.
const TOP: f64 = 6.0;
const BOTTOM: f64 = 20.0;
/// A longer silence of a program breaks its curve.
const GAP: Duration = Duration::from_secs(1);

/// Returns a picture with its title and its legend.
pub(super) fn figure(panel: &Panel, axis: &TimeAxis) -> String {
    let values = || panel.curves.iter().flat_map(|curve| curve.points.iter().map(|(_, value)| *value));
    let (low, high) = (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max));
    if values().next().is_none() {
        return String::new();
    }
    let height = if panel.headline { HEIGHT } else { HEIGHT_SMALL };
    let scale = ValueAxis::new(low, high, height);
    let (title, unit) = (escape(&panel.title), escape(&panel.unit));
    let in_unit = if unit.is_empty() { String::new() } else { format!(" <span class=\"unit\">{unit}</span>") };
    let mut text = format!("<figure>\n<figcaption><b>{title}</b>{in_unit}\n<span class=\"legend\">\n");
    for (index, curve) in panel.curves.iter().enumerate() {
        text.push_str(&format!(
            "<span class=\"key\"><svg viewBox=\"0 0 24 8\"><line class=\"c{index}\" x1=\"0\" x2=\"24\" y1=\"4\" y2=\"4\"/>\
             </svg>{}<output></output></span>\n",
            if curve.title == panel.title { String::new() } else { escape(&curve.title) + "&nbsp;" }
        ));
    }
    text.push_str("</span></figcaption>\n");
    let (top, per_unit) = scale.reading();
    let mut picture = svg("plot", TOP + height + BOTTOM, &format!("{} over time", panel.title));
    picture.insert_str(
        picture.len() - 2,
        &format!(" data-left=\"{LEFT}\" data-right=\"{RIGHT}\" data-end=\"{:.3}\" data-top=\"{top}\" data-per=\"{per_unit}\"", axis.end()),
    );
    text.push_str(&picture);
    text.push_str(&format!("<g transform=\"translate(0 {TOP})\">\n"));
    text.push_str(&axis.behind(height));
    text.push_str(&axis.ticks(height));
    text.push_str(&scale.ticks());
    for (index, curve) in panel.curves.iter().enumerate() {
        text.push_str(&format!("<g class=\"curve c{index}\">\n{}</g>\n", lines(curve, axis, &scale)));
    }
    text.push_str(&axis.cursor(height));
    text.push_str("</g>\n</svg>\n</figure>\n");
    text
}

/// Returns a curve as lines: at most a low and a high point for each unit of width, so that no spike is lost.
fn lines(curve: &Curve, axis: &TimeAxis, scale: &ValueAxis) -> String {
    let mut text = String::new();
    for run in curve.points.chunk_by(|(before, _), (after, _)| *after <= *before + GAP) {
        let mut line: Vec<String> = Vec::new();
        for column in run.chunk_by(|(before, _), (after, _)| same_column(axis.x(*before), axis.x(*after))) {
            let at = |(time, value): &(Duration, f64)| format!("{:.1},{:.1}", axis.x(*time), scale.y(*value));
            let low = column.iter().enumerate().min_by(|(_, one), (_, other)| one.1.total_cmp(&other.1));
            let high = column.iter().enumerate().max_by(|(_, one), (_, other)| one.1.total_cmp(&other.1));
            let mut pair = [low, high];
            pair.sort_by_key(|point| point.map(|(index, _)| index));
            line.extend(pair.into_iter().flatten().map(|(_, point)| at(point)));
        }
        line.dedup();
        if line.len() == 1 {
            // A line of one point would not be seen.
            line.push(line[0].clone());
        }
        text.push_str(&format!("<polyline points=\"{}\"/>\n", line.join(" ")));
    }
    text
}

fn same_column(one: f64, other: f64) -> bool {
    one.floor().total_cmp(&other.floor()).is_eq()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::mission::Mission;
    use crate::logic::mission::tests::{OPENING, door, feed, seconds};

    #[test]
    fn no_spike_is_lost_and_the_page_stays_small() {
        let mut mission = Mission::new(&door());
        feed(&mut mission, OPENING);
        let (axis, scale) = (TimeAxis::new(&mission), ValueAxis::new(0.0, 100.0, HEIGHT));
        let spike = |number: u32| (seconds(f64::from(number) / 1000.0), if number == 12_345 { 100.0 } else { 1.0 });
        let curve = Curve { title: "x".to_owned(), points: (0..22_000).map(spike).collect() };
        let text = lines(&curve, &axis, &scale);
        assert!(text.contains(",0.0 "), "the spike is at the top");
        assert!(text.split(' ').count() < 2_100, "{}", text.split(' ').count());
    }

    #[test]
    fn a_silence_breaks_the_curve() {
        let mut mission = Mission::new(&door());
        feed(&mut mission, OPENING);
        let (axis, scale) = (TimeAxis::new(&mission), ValueAxis::new(0.0, 1.0, HEIGHT));
        let points = [0.0, 0.5, 5.0, 5.5, 9.0].map(|at| (seconds(at), 1.0)).to_vec();
        let text = lines(&Curve { title: "x".to_owned(), points }, &axis, &scale);
        assert_eq!(text.matches("<polyline").count(), 3);
    }
}
