//! A plan as text, for tests that compare the plans of two writings of one spec.

use language::plan::{DEADLINE, Plan};

/// Returns a plan as text, without the places of its deadlines, which move with the text.
pub(crate) fn shown(plan: &Plan) -> String {
    let text = format!("{plan:?}");
    let mut pieces = text.split(DEADLINE);
    let first = pieces.next().unwrap_or_default().to_owned();
    pieces.fold(first, |shown, piece| shown + piece.split_once("has passed").map_or(piece, |(_, rest)| rest))
}
