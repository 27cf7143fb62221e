//! Executable content of SCXML: the actions of transitions and of states.

use super::event::sent_to_self;
use super::expression::{self, Sort};
use super::model::Kind;
use super::timer::Clock;
use super::{Writer, timer};
use crate::name::{plain, quoted};
use crate::remark::RemarkKind;
use crate::xml::{Node, elements, tag};

/// Returns the actions of a block.
///
/// An event that the chart sends to itself at once waits behind the events that it raises, so it stands behind them.
/// A delayed one keeps its place: it begins a timer, which a later `<cancel>` of the same block ends.
pub(super) fn actions(writer: &mut Writer<'_>, block: Node<'_>) -> String {
    let (mut text, mut behind) = (String::new(), String::new());
    for node in block.children() {
        if node.is_comment() {
            text += &super::state::comment(node);
        }
        if !node.is_element() {
            continue;
        }
        text += &match tag(node) {
            "raise" => raise(writer, node, node.attribute("event").unwrap_or_default()),
            "send" if node.attribute("target") != Some("#_internal") && timer::clock_of(node).is_none() => {
                behind += &send(writer, node);
                String::new()
            }
            "send" => send(writer, node),
            "assign" => assign(writer, node),
            "log" => log(writer, node),
            "cancel" => cancel(writer, node),
            "script" => script(writer, node),
            other => {
                let source = &node.document().input_text()[node.range()];
                let why = format!("<{other}> is left out: {}", plain(source));
                writer.remark(node, RemarkKind::Missing, why)
            }
        };
    }
    text + &behind
}

/// The assignments of a script, if it has nothing else.
fn script(writer: &mut Writer<'_>, node: Node<'_>) -> String {
    let code = node.text().unwrap_or_default();
    let statements = code.split([';', '\n']).map(str::trim).filter(|statement| !statement.is_empty());
    let written: Option<String> = statements.map(|statement| statement_of(writer, statement)).collect();
    written.filter(|written| !written.is_empty()).unwrap_or_else(|| {
        let code = plain(node.text().or(node.attribute("src")).unwrap_or_default());
        writer.remark(node, RemarkKind::Missing, format!("<script> is left out: {code}"))
    })
}

/// A statement of a script that is an assignment.
fn statement_of(writer: &Writer<'_>, statement: &str) -> Option<String> {
    if let Some(id) = statement.strip_suffix("++").map(str::trim) {
        return assigned(writer, id, &format!("{id} + 1"));
    }
    let (left, right) = statement.split_once('=')?;
    match left.strip_suffix(['+', '-', '*']) {
        None => assigned(writer, left.trim(), right),
        Some(id) => assigned(writer, id.trim(), &format!("{left} ({right})")),
    }
}

/// An action that ends the time of a delayed event. The last `<send>` or `<cancel>` is valid, so it also takes back a start.
fn cancel(writer: &mut Writer<'_>, node: Node<'_>) -> String {
    let Some(id) = node.attribute("sendid") else {
        return writer.remark(node, RemarkKind::Missing, "<cancel> without a fixed `sendid` is left out");
    };
    if writer.model.timers.values().any(|timer| timer.id.as_deref() == Some(id)) {
        // The state of the timer is left here, and the timer ends with its state.
        return String::new();
    }
    let clocks = writer.model.clocks.iter().filter(|(key, _)| key.id.as_deref() == Some(id));
    let cancels = clocks.filter_map(|(_, Clock { start, cancel })| Some((start, cancel.as_ref()?)));
    let text: String = cancels.map(|(start, cancel)| format!("{cancel} = true;\n{start} = false;\n")).collect();
    if !text.is_empty() {
        return text;
    }
    let why = format!("<cancel> is left out: no timer here has the id `{}`", plain(id));
    writer.remark(node, RemarkKind::Differs, why)
}

fn raise(writer: &mut Writer<'_>, node: Node<'_>, event: &str) -> String {
    let is_awaited = writer.model.is_awaited(event, None);
    let signal = writer.model.events.get(event).and_then(|known| known.signal.clone());
    match signal.filter(|_| is_awaited || writer.model.has_any) {
        Some(signal) => format!("raise {signal};\n"),
        None => {
            let why = format!("no transition waits for the event `{event}`, so it is not raised");
            writer.remark(node, RemarkKind::Differs, why)
        }
    }
}

fn send(writer: &mut Writer<'_>, node: Node<'_>) -> String {
    let mut text = String::new();
    let unusual = ["namelist", "idlocation", "typeexpr", "targetexpr", "eventexpr"];
    for name in unusual.iter().filter(|name| node.attribute(**name).is_some()) {
        text += &writer.remark(node, RemarkKind::Missing, format!("`{name}` of <send> has no counterpart"));
    }
    if elements(node).next().is_some() {
        text += &writer.remark(node, RemarkKind::Missing, "the data of <send> are left out");
    }
    let Some(event) = node.attribute("event") else {
        return text + &writer.remark(node, RemarkKind::Missing, "<send> without a fixed event is left out");
    };
    let Some(own) = sent_to_self(node) else {
        let target = node.attribute("target").or(node.attribute("type")).unwrap_or("outside");
        let port = writer.output(target);
        let why = format!("`{port}` gives the event to people; `{}` does not receive it", plain(target));
        return text + &writer.remark(node, RemarkKind::Missing, why) + &format!("{port}.send({});\n", quoted(event));
    };
    if let Some(time) = timer::delay(node).filter(|time| (1..timer::LEAST).contains(time)) {
        let why = format!("`{}` comes after {} ms here, in the chart after {time} ms", plain(own), timer::LEAST);
        text += &writer.remark(node, RemarkKind::Differs, why);
    }
    if writer.model.timers.contains_key(own) {
        let why = format!(
            "`{}` is the timer of the state that waits for it, and ends with that state; it cannot come from outside here",
            plain(own)
        );
        return text + &writer.remark(node, RemarkKind::Differs, why);
    }
    match timer::delay(node) {
        Some(0) => {
            if node.attribute("target") != Some("#_internal") {
                let why = format!("`{}` is a signal here, which is handled before waiting messages", plain(own));
                text += &writer.remark(node, RemarkKind::Differs, why);
            }
            text + &raise(writer, node, own)
        }
        Some(_) => {
            let clock = timer::clock_of(node).and_then(|key| writer.model.clocks.get(&key));
            let Some(Clock { start, cancel }) = clock else {
                return text + &raise(writer, node, own);
            };
            let cancel = cancel.as_ref().map_or_else(String::new, |cancel| format!("{cancel} = false;\n"));
            let start = format!("{start} = true;\n{cancel}");
            let why = format!("if `{}` is sent again while it waits, its time begins again", plain(own));
            text + &writer.remark(node, RemarkKind::Differs, why) + &start
        }
        None => {
            let time = match node.attribute("delay") {
                Some(delay) => format!("its delay `{}` is not a time that a timer can have", plain(delay)),
                None => "its delay is computed".to_owned(),
            };
            let why = format!("`{}` comes from outside here, to its port, since {time}", plain(own));
            text + &writer.remark(node, RemarkKind::Missing, why)
        }
    }
}

fn assign(writer: &mut Writer<'_>, node: Node<'_>) -> String {
    let id = node.attribute("location").unwrap_or_default();
    let expression = node.attribute("expr").unwrap_or_default();
    assigned(writer, id, expression).unwrap_or_else(|| {
        let why = format!("this assignment is left out: {} = {}", plain(id), plain(expression));
        writer.remark(node, RemarkKind::Missing, why)
    })
}

/// An assignment, if the variable can have the value.
fn assigned(writer: &Writer<'_>, id: &str, expression: &str) -> Option<String> {
    let variable = writer.model.variables.get(id)?;
    let formula = expression::parse(expression, &writer.model)?;
    let value = match (&variable.kind, &formula.sort) {
        (Kind::Number(_), Sort::Number) | (Kind::Truth(_), Sort::Truth) => Some(formula.text),
        (Kind::Named { .. }, Sort::Text(text)) => expression::value_name(&writer.model, id, text),
        (Kind::Named { .. }, Sort::Value(other)) if other == id => Some(formula.text),
        (Kind::Number(_) | Kind::Truth(_) | Kind::Named { .. } | Kind::Unknown, _) => None,
    }?;
    Some(format!("{} = {};\n", variable.name, outer(&value)))
}

/// Without the parentheses around the whole.
pub(super) fn outer(formula: &str) -> &str {
    let Some(inner) = formula.strip_prefix('(').and_then(|rest| rest.strip_suffix(')')) else { return formula };
    let mut depth = 0_i32;
    for character in inner.chars() {
        depth += match character {
            '(' => 1,
            ')' => -1,
            _ => 0,
        };
        if depth < 0 {
            return formula;
        }
    }
    inner
}

fn log(writer: &mut Writer<'_>, node: Node<'_>) -> String {
    let label = node.attribute("label").unwrap_or_default();
    let expression = node.attribute("expr").unwrap_or_default().trim();
    let label = if label.is_empty() || expression.is_empty() { label.to_owned() } else { format!("{label}: ") };
    if let Some(text) = expression::text_of(expression) {
        return format!("log({});\n", quoted(&format!("{label}{text}")));
    }
    if expression.is_empty() {
        return format!("log({});\n", quoted(&label));
    }
    match expression::parse(expression, &writer.model).filter(|formula| !matches!(formula.sort, Sort::Text(_))) {
        Some(formula) => format!("log({} + {});\n", quoted(&label), formula.text),
        None => {
            let why = format!("the line in the log shows the expression, not its value: {}", plain(expression));
            let written = format!("log({});\n", quoted(&format!("{label}{}", plain(expression))));
            writer.remark(node, RemarkKind::Differs, why) + &written
        }
    }
}
