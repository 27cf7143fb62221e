//! What the command line works out: pure, so that the same reports give the same lines, summary and page.

pub mod mission;
pub mod page;
pub mod record;
pub mod tree;
