//! Reads the qualities of a connection: how data moves.

use crate::check::diagnostics::Diagnostics;
use crate::check::value::quantity;
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::{Quality, Retention};
use crate::syntax::SyntaxKind::{self, Number};
use crate::syntax::ast::Node;
use crate::unit::{self, Dimension};
use std::time::Duration;

/// The greatest length of a queue.
const QUEUE_MAX: u32 = 10_000;

/// Reads `latch`, `drop`, `queue 5` and `rate 10 Hz` of a connection.
pub(super) fn quality(connection: &Node, diagnostics: &mut Diagnostics) -> Quality {
    let mut quality = Quality::default();
    let mut retained = None;
    for node in connection.children_of(SyntaxKind::Quality) {
        let Some(word) = node.names().next() else { continue };
        match word.text.as_str() {
            "latch" | "drop" => {
                if retained.as_ref().is_some_and(|first: &String| *first != word.text) {
                    let message = "a connection either keeps its last value (`latch`) or not (`drop`)";
                    diagnostics.push(Diagnostic::new(Code::E0009, word.span, message));
                }
                quality.retention = if word.text == "latch" { Retention::Latch } else { Retention::Drop };
                retained = Some(word.text);
            }
            "queue" => quality.queue = queue(&node, diagnostics),
            "rate" => quality.period_min = period(&node, diagnostics),
            _ => {}
        }
    }
    quality
}

fn queue(node: &Node, diagnostics: &mut Diagnostics) -> Option<u32> {
    let length = node.token(Number).and_then(|number| number.text().parse().ok());
    let length = length.filter(|length| (1..=QUEUE_MAX).contains(length));
    if length.is_none() {
        let message = format!("expected the largest number of waiting values, from 1 to {QUEUE_MAX}");
        diagnostics.push(Diagnostic::new(Code::E0009, node.span(), message).help("write `queue 5`"));
    }
    length
}

/// Reads the shortest time between two values.
fn period(node: &Node, diagnostics: &mut Diagnostics) -> Option<Duration> {
    let frequency = unit::unit("Hz", None).map(|(_, dimension)| dimension);
    let found: Option<(f64, Option<Dimension>)> =
        node.child(SyntaxKind::Constant).and_then(|node| quantity(&node, diagnostics));
    let rate = found.filter(|(rate, dimension)| *dimension == frequency && *rate > 0.0);
    let period = rate.and_then(|(rate, _)| Duration::try_from_secs_f64(1.0 / rate).ok());
    if period.is_none() {
        let diagnostic = Diagnostic::new(Code::E0009, node.span(), "expected a rate above zero");
        diagnostics.push(diagnostic.help("write `rate 10 Hz`"));
    }
    period
}
