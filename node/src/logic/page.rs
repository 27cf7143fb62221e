//! The page that shows a run.

use crate::logic::mission::{Files, summary};
use crate::logic::record::Run;

/// Returns a run as one HTML page that needs nothing else.
pub fn page(run: &Run) -> String {
    format!("<!doctype html><pre>{}</pre>", summary(&run.mission(), &Files::default()))
}
