//! Writes the picture for Graphviz: groups are clusters, leaves are records with ports.

use super::layout::plate;
use super::model::{End, Link, Unit};
use crate::check::spec::Direction;
use std::fmt::Write as _;

pub(super) fn dot(root: &Unit, hosts: &[String]) -> String {
    let mut out = "digraph dca {\n    rankdir=LR;\n    node [shape=record, fontname=Helvetica];\n".to_owned();
    let mut paths = Vec::new();
    group(&mut out, root, hosts, &mut paths);
    out + "}\n"
}

/// `u0_2`: the third member of the first member.
fn id(path: &[usize]) -> String {
    let path: Vec<String> = path.iter().map(usize::to_string).collect();
    format!("u{}", path.join("_"))
}

fn escape(text: &str) -> String {
    text.chars().flat_map(|c| if "\\\"{}|<> ".contains(c) { vec!['\\', c] } else { vec![c] }).collect()
}

fn line(out: &mut String, path: &[usize], text: std::fmt::Arguments<'_>) {
    out.push_str(&"    ".repeat(path.len() + 1));
    // Writing to a string cannot fail.
    let written = out.write_fmt(text);
    debug_assert!(written.is_ok());
    out.push('\n');
}

fn group(out: &mut String, unit: &Unit, hosts: &[String], path: &mut Vec<usize>) {
    let host = hosts.get(unit.host).map_or("", String::as_str);
    let border = if unit.is_service { "peripheries=2" } else { "peripheries=1" };
    let plate = plate(unit).map_or(String::new(), |plate| format!(", {}", escape(&plate)));
    line(out, path, format_args!("subgraph cluster_{} {{", id(path)));
    line(
        out,
        path,
        format_args!(
            "    label=\"{} : {} on {}{plate}\"; {border};",
            escape(&unit.name),
            escape(&unit.kind),
            escape(host)
        ),
    );
    for (index, port) in unit.ports.iter().enumerate() {
        let style = if port.is_used { "" } else { ", color=red" };
        line(
            out,
            path,
            format_args!("    {}_p{index} [shape=cds, label=\"{}\"{style}];", id(path), escape(&port.name)),
        );
    }
    for (slot, inner) in unit.units.iter().enumerate() {
        path.push(slot);
        if inner.is_group {
            group(out, inner, hosts, path);
        } else {
            leaf(out, inner, hosts, path);
        }
        path.pop();
    }
    for link in &unit.links {
        let (from, to) = (end(unit, path, link.from), end(unit, path, link.to));
        line(out, path, format_args!("    {from} -> {to}{};", style(link)));
    }
    line(out, path, format_args!("}}"));
}

fn leaf(out: &mut String, unit: &Unit, hosts: &[String], path: &[usize]) {
    let side = |direction: Direction| {
        let ports = unit.ports.iter().enumerate().filter(|(_, port)| port.direction == direction);
        let letter = if direction == Direction::In { 'i' } else { 'o' };
        let ports: Vec<String> =
            ports.map(|(index, port)| format!("<{letter}{index}> {}", escape(&port.name))).collect();
        ports.join("|")
    };
    let host = hosts.get(unit.host).map_or("", String::as_str);
    let plate = plate(unit).map_or(String::new(), |plate| format!("\\n{}", escape(&plate)));
    let name = format!("{}\\n{}\\non {}{plate}", escape(&unit.name), escape(&unit.kind), escape(host));
    let (ins, outs) = (side(Direction::In), side(Direction::Out));
    let border = if unit.is_service { ", peripheries=2" } else { "" };
    line(out, path, format_args!("{} [label=\"{{{{{ins}}}|{name}|{{{outs}}}}}\"{border}];", id(path)));
}

fn end(unit: &Unit, path: &[usize], end: End) -> String {
    let Some(slot) = end.unit else { return format!("{}_p{}", id(path), end.port) };
    let mut path = path.to_vec();
    path.push(slot);
    let inner = &unit.units[slot];
    if inner.is_group {
        return format!("{}_p{}", id(&path), end.port);
    }
    let letter = if inner.ports[end.port].direction == Direction::In { 'i' } else { 'o' };
    format!("{}:{letter}{}", id(&path), end.port)
}

fn style(link: &Link) -> String {
    let mut style = Vec::new();
    if !link.label.is_empty() {
        style.push(format!("label=\"{}\"", escape(&link.label)));
    }
    if link.is_cut {
        style.push("style=dotted, color=red".to_owned());
    } else if link.is_pull {
        style.push("style=dashed".to_owned());
    }
    if style.is_empty() { String::new() } else { format!(" [{}]", style.join(", ")) }
}
