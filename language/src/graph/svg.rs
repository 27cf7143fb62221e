//! Writes the picture as SVG.
//!
//! In a picture of a running mission, the parts have classes, and a page colours them. Its style sheet is stronger than the colours
//! here.
//! Each box has the key of its process or state, and each arrow has the numbers of its wires. Boxes and arrows have an
//! empty text, which the page fills.

use super::font;
use super::layout::{BAND, Placed, labels, layout, plate, plate_width, text_width};
use super::model::{Link, Unit};
use crate::check::spec::Direction;
use std::fmt::Write as _;

/// The room around the whole.
const MARGIN: i32 = 16;
/// The line with the hosts below the whole.
const LEGEND: i32 = 26;
/// Bands of hosts: a strong colour, and a light one for the boxes inside.
const HOSTS: [(&str, &str); 6] = [
    ("#b9d3ee", "#f3f8fd"),
    ("#f6d5a8", "#fdf8f0"),
    ("#c3e3b5", "#f5fbf2"),
    ("#e3c6e8", "#fbf5fc"),
    ("#f0c2c2", "#fdf4f4"),
    ("#c9d8d6", "#f4f8f7"),
];
/// Colours of connection sets.
const SETS: [&str; 8] = ["#1f5fa8", "#b3541e", "#2b7a3d", "#7d3c98", "#a8781f", "#1f8a8a", "#a83260", "#4a5568"];
/// Arrows from and to the ports that a group exports.
const EXPORT: &str = "#666666";
/// Plates of resources.
const PLATE: &str = "#fdf3b8";
/// The colour of mistakes.
const WRONG: &str = "#c81e1e";

pub(super) fn svg(root: &Unit, hosts: &[String]) -> String {
    let (placed, is_live) = (layout(root, hosts), root.key.is_some());
    // In a picture of a running mission, the boxes have the colours of states.
    let keys = (0..hosts.len()).map(Key::Host).filter(|_| !is_live);
    let keys: Vec<Key> = keys.chain(marks(root)).collect();
    let legend = keys.iter().map(|key| key.width(hosts)).sum::<i32>();
    let below = if keys.is_empty() { 0 } else { LEGEND };
    let (width, height) = (placed.width.max(legend) + 2 * MARGIN, placed.height + 2 * MARGIN + below);
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\"{} width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} {height}\" \
         font-family=\"Helvetica, Arial, sans-serif\" font-size=\"12\">\n",
        class(is_live, "picture")
    );
    if !is_live {
        out.push_str("<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n");
    }
    draw(&mut out, root, &placed, MARGIN, MARGIN, hosts);
    let mut x = MARGIN;
    for key in keys {
        key.draw(&mut out, x, height - below, hosts);
        x += key.width(hosts);
    }
    out + "</svg>\n"
}

/// An entry of the legend. A mark is explained where it occurs.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Key {
    /// The colour of a host.
    Host(usize),
    Service,
    Unused,
    Cut,
    Pull,
    Resource,
}

/// The marks that occur in a picture.
fn marks(root: &Unit) -> impl Iterator<Item = Key> {
    let has = |key: &Key| {
        any(root, &|unit| match key {
            Key::Host(_) => false,
            Key::Service => unit.is_service,
            Key::Unused => unit.ports.iter().any(|port| !port.is_used),
            Key::Cut => unit.links.iter().any(|link| link.is_cut),
            Key::Resource => !unit.resources.is_empty(),
            Key::Pull => unit.links.iter().any(|link| link.is_pull && !link.is_cut),
        })
    };
    [Key::Service, Key::Unused, Key::Cut, Key::Pull, Key::Resource]
        .into_iter()
        .filter(has)
        .collect::<Vec<_>>()
        .into_iter()
}

/// Whether something holds for a process or for one inside it.
fn any(unit: &Unit, holds: &dyn Fn(&Unit) -> bool) -> bool {
    holds(unit) || unit.units.iter().any(|inner| any(inner, holds))
}

impl Key {
    fn word(self, hosts: &[String]) -> &str {
        match self {
            Self::Host(host) => hosts.get(host).map_or("", String::as_str),
            Self::Service => "never ends by itself",
            Self::Unused => "connected to nothing",
            Self::Cut => "never open",
            Self::Pull => "fetched by the consumer",
            Self::Resource => "has it alone",
        }
    }

    fn width(self, hosts: &[String]) -> i32 {
        text_width(self.word(hosts)) + 40
    }

    fn draw(self, out: &mut String, x: i32, y: i32, hosts: &[String]) {
        let (left, middle) = (x, y + 7);
        match self {
            Self::Host(host) => {
                let (band, _) = HOSTS[host % HOSTS.len()];
                let place = format!("x=\"{x}\" y=\"{y}\" width=\"14\" height=\"14\"");
                line(out, format_args!("<rect {place} fill=\"{band}\" stroke=\"#555\"/>"));
            }
            Self::Service => text(out, x, y + 12, BOLD, "∞"),
            Self::Unused => {
                line(
                    out,
                    format_args!("<path d=\"M{left} {y} m3 2 l9 5 l-9 5 z\" fill=\"white\" stroke=\"{WRONG}\"/>"),
                );
            }
            Self::Cut => {
                let style = format!("stroke=\"{WRONG}\" stroke-width=\"1.5\" stroke-dasharray=\"2 4\"");
                line(out, format_args!("<path d=\"M{left} {middle} h16\" {style}/>"));
            }
            Self::Resource => {
                let place = format!("x=\"{x}\" y=\"{}\" width=\"16\" height=\"10\" rx=\"5\"", y + 2);
                line(out, format_args!("<rect {place} fill=\"{PLATE}\" stroke=\"#333\" stroke-width=\"0.8\"/>"));
            }
            Self::Pull => {
                let style = format!("stroke=\"{EXPORT}\" stroke-width=\"1.5\" stroke-dasharray=\"7 3\"");
                line(out, format_args!("<path d=\"M{left} {middle} h17\" {style}/>"));
            }
        }
        text(out, x + 20, y + 11, PLAIN, self.word(hosts));
    }
}

/// Draws the names of the devices that a process claims, on its lower border.
fn draw_plate(out: &mut String, plate: &str, middle: i32, bottom: i32, class: &str) {
    let width = plate_width(plate);
    let place = format!("x=\"{}\" y=\"{}\" width=\"{width}\" height=\"14\"", middle - width / 2, bottom - 7);
    line(out, format_args!("<rect {place} rx=\"7\"{class} fill=\"{PLATE}\" stroke=\"#333\" stroke-width=\"0.8\"/>"));
    text(out, middle, bottom + 4, Face { size: 10, is_bold: false, more: " text-anchor=\"middle\"" }, plate);
}

fn line(out: &mut String, text: std::fmt::Arguments<'_>) {
    // Writing to a string cannot fail.
    let written = out.write_fmt(text);
    debug_assert!(written.is_ok());
    out.push('\n');
}

/// How a text looks.
#[derive(Clone, Copy)]
struct Face<'a> {
    size: i32,
    is_bold: bool,
    /// More attributes.
    more: &'a str,
}

const PLAIN: Face<'_> = Face { size: 12, is_bold: false, more: "" };
const BOLD: Face<'_> = Face { size: 12, is_bold: true, more: "" };

impl Face<'_> {
    /// The columns that a text takes, in any font: a viewer stretches or squeezes its letters to that width.
    fn width(self, text: &str) -> i32 {
        font::width(text, self.size, self.is_bold).min(text_width(text) * self.size / 12).max(1)
    }
}

fn text(out: &mut String, x: i32, y: i32, face: Face<'_>, text: &str) {
    let size = if face.size == PLAIN.size { String::new() } else { format!(" font-size=\"{}\"", face.size) };
    let weight = if face.is_bold { " font-weight=\"bold\"" } else { "" };
    let width = format!(" textLength=\"{}\" lengthAdjust=\"spacingAndGlyphs\"", face.width(text));
    line(out, format_args!("<text x=\"{x}\" y=\"{y}\"{weight}{size}{width}{}>{}</text>", face.more, escape(text)));
}

/// Returns a class of a part, in a picture that a page colours.
fn class(is_live: bool, name: &str) -> String {
    if is_live { format!(" class=\"{name}\"") } else { String::new() }
}

/// Writes a text that stays a text. Characters that XML forbids, or that would reorder other letters, are replaced.
fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            '\n' => escaped.push('\n'),
            '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}' => {
                escaped.push('\u{fffd}');
            }
            '\u{fffe}' | '\u{ffff}' => escaped.push('\u{fffd}'),
            other if other.is_control() => escaped.push('\u{fffd}'),
            other => escaped.push(other),
        }
    }
    escaped
}

/// Draws a box, its content, and its ports on top.
fn draw(out: &mut String, unit: &Unit, placed: &Placed, x: i32, y: i32, hosts: &[String]) {
    let Placed { width, height, .. } = placed;
    let (is_live, (band, fill)) = (unit.key.is_some(), HOSTS[unit.host % HOSTS.len()]);
    let host = hosts.get(unit.host).map_or("", String::as_str);
    let title = format!("{}: {}{}, on {host}", unit.name, unit.kind, if unit.is_service { ", a service" } else { "" });
    let doc = if unit.doc.is_empty() { String::new() } else { format!("\n{}", unit.doc) };
    let key = unit.key.as_ref().map(|key| format!("{} data-key=\"{}\"", class(true, "unit"), escape(key)));
    line(out, format_args!("<g{}><title>{}</title>", key.unwrap_or_default(), escape(&(title + &doc))));
    let stroke = if unit.is_group { 1.6 } else { 1.0 };
    let place = format!("x=\"{x}\" y=\"{y}\" width=\"{width}\" height=\"{height}\" rx=\"3\"{}", class(is_live, "box"));
    line(out, format_args!("<rect {place} fill=\"{fill}\" stroke=\"#333\" stroke-width=\"{stroke}\"/>"));
    line(
        out,
        format_args!(
            "<path d=\"M{x} {} v-{BAND} h{width} v{BAND} z\"{} fill=\"{band}\" stroke=\"#333\" stroke-width=\"0.6\"/>",
            y + BAND,
            class(is_live, "band")
        ),
    );
    if unit.is_service {
        let (x, y, width, height) = (x - 3, y - 3, width + 6, height + 6);
        line(
            out,
            format_args!(
                "<rect x=\"{x}\" y=\"{y}\" width=\"{width}\" height=\"{height}\" rx=\"5\"{} fill=\"none\" stroke=\"#333\" stroke-width=\"0.8\"/>",
                class(is_live, "outline")
            ),
        );
    }
    head(out, unit, placed, x, y, host);
    for (link, points) in unit.links.iter().zip(&placed.lines) {
        arrow(out, link, points, Corner { x, y, is_live });
    }
    for (net, indent) in labels(unit) {
        let link = &unit.links[net];
        let Some(start) = placed.lines[net].first() else { continue };
        let more = format!("{} fill=\"{}\"", set_class(is_live, "label", link), colour(link));
        let face = Face { size: 9, is_bold: false, more: &more };
        text(out, x + start.0 + 8 + indent, y + start.1 - 3, face, &link.label);
    }
    for (inner, place) in unit.units.iter().zip(&placed.inner) {
        draw(out, inner, place, x + place.x, y + place.y, hosts);
    }
    for (port, &(port_x, port_y)) in unit.ports.iter().zip(&placed.ports) {
        // The arrows of a group's own ports continue inside: its names are above them.
        let above = if unit.is_group { 5 } else { -4 };
        port_mark(out, port, Corner { x: x + port_x, y: y + port_y, is_live }, above);
    }
    for (link, points) in unit.links.iter().zip(&placed.lines).filter(|(link, _)| is_live && link.set.is_some()) {
        let start = points.first().copied().unwrap_or_default();
        loss(out, link, x + start.0, y + start.1);
    }
    if let Some(plate) = plate(unit) {
        draw_plate(out, &plate, x + width / 2, y + height, &class(is_live, "plate"));
    }
    line(out, format_args!("</g>"));
}

fn head(out: &mut String, unit: &Unit, placed: &Placed, x: i32, y: i32, host: &str) {
    let name = if unit.is_service { format!("{} ∞", unit.name) } else { unit.name.clone() };
    text(out, x + 8, y + 15, BOLD, &name);
    let face = Face { size: 10, is_bold: false, more: " text-anchor=\"end\" fill=\"#444\"" };
    text(out, x + placed.width - 8, y + 15, face, host);
    if unit.is_group {
        text(out, x + 8 + BOLD.width(&name) + 8, y + 15, Face { more: " fill=\"#444\"", ..PLAIN }, &unit.kind);
    } else {
        let face = Face { size: 11, is_bold: false, more: " text-anchor=\"middle\" fill=\"#555\"" };
        text(out, x + placed.width / 2, y + BAND + 13, face, &unit.kind);
    }
    let state = match (&unit.key, unit.is_group) {
        (None, _) => return,
        (Some(_), true) => {
            format!("x=\"{}\" y=\"{}\" text-anchor=\"end\"", x + placed.width - 18 - text_width(host), y + 15)
        }
        (Some(_), false) => format!("x=\"{}\" y=\"{}\" text-anchor=\"middle\"", x + placed.width / 2, y + BAND + 29),
    };
    line(out, format_args!("<text class=\"state\" {state} font-size=\"11\"></text>"));
}

/// A place, in a picture that is coloured by a page or not.
#[derive(Clone, Copy)]
struct Corner {
    x: i32,
    y: i32,
    is_live: bool,
}

/// An input points into the box, an output out of it; a port without a connection is hollow.
fn port_mark(out: &mut String, port: &super::model::Port, Corner { x, y, is_live }: Corner, above: i32) {
    let (fill, stroke) = if port.is_used { ("#222", "#222") } else { ("white", WRONG) };
    let class = class(is_live, "port");
    line(
        out,
        format_args!("<path d=\"M{} {} l9 5 l-9 5 z\"{class} fill=\"{fill}\" stroke=\"{stroke}\"/>", x - 4, y - 5),
    );
    let colour = if port.is_used { "#222" } else { WRONG };
    let (x, anchor) = if port.direction == Direction::In { (x + 8, "start") } else { (x - 8, "end") };
    let more = format!(" text-anchor=\"{anchor}\" fill=\"{colour}\"");
    text(out, x, y - above, Face { size: 10, is_bold: false, more: &more }, &port.name);
}

fn arrow(out: &mut String, link: &Link, points: &[(i32, i32)], Corner { x, y, is_live }: Corner) {
    let (Some(&(end_x, end_y)), colour) = (points.last(), colour(link)) else { return };
    let dash = match (link.is_cut, link.is_pull) {
        (true, _) => " stroke-dasharray=\"2 4\"",
        (false, true) => " stroke-dasharray=\"7 3\"",
        (false, false) => "",
    };
    let corners: Vec<String> = points.iter().map(|(px, py)| format!("{} {}", x + px, y + py)).collect();
    let path = corners.join(" L");
    if is_live {
        line(out, format_args!("<g{} data-wires=\"{}\">", set_class(true, "wire", link), numbers(&link.wires)));
    }
    line(
        out,
        format_args!(
            "<path d=\"M{path}\"{} fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.5\" stroke-linejoin=\"round\"{dash}/>",
            class(is_live, "line")
        ),
    );
    let head = class(is_live, "head");
    line(out, format_args!("<path d=\"M{} {} l-8 -4 v8 z\"{head} fill=\"{colour}\"/>", x + end_x - 3, y + end_y));
    if link.is_cut && points.len() > 1 {
        let (a, b) = (points[points.len() / 2 - 1], points[points.len() / 2]);
        let (middle_x, middle_y) = (x + i32::midpoint(a.0, b.0), y + i32::midpoint(a.1, b.1));
        line(
            out,
            format_args!(
                "<path d=\"M{} {} l8 8 m0 -8 l-8 8\" stroke=\"{WRONG}\" stroke-width=\"2\"/>",
                middle_x - 4,
                middle_y - 4
            ),
        );
    }
    if is_live {
        line(out, format_args!("</g>"));
    }
}

/// Writes an empty text for the values that an arrow loses. It stands below the begin of the arrow, opposite its label, and above
/// the boxes.
fn loss(out: &mut String, link: &Link, x: i32, y: i32) {
    let place = format!("x=\"{}\" y=\"{}\" font-size=\"10\"", x + 8, y + 11);
    line(out, format_args!("<text class=\"loss\" data-wires=\"{}\" {place}></text>", numbers(&link.wires)));
}

fn numbers(wires: &[u32]) -> String {
    let wires: Vec<String> = wires.iter().map(u32::to_string).collect();
    wires.join(" ")
}

/// Returns the classes of a part of an arrow, in a picture that a page colours.
fn set_class(is_live: bool, name: &str, link: &Link) -> String {
    let set = link.set.map(|set| format!(" set{}", set % SETS.len()));
    class(is_live, &format!("{name}{}", set.unwrap_or_default()))
}

fn colour(link: &Link) -> &'static str {
    match link.set {
        _ if link.is_cut => WRONG,
        Some(set) => SETS[set % SETS.len()],
        None => EXPORT,
    }
}
