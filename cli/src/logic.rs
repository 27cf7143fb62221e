//! The views of the command line. They are pure: the same reports give the same lines, summary and page.

pub mod checkup;
pub(crate) mod clock;
pub(crate) mod completion;
pub(crate) mod estimate;
pub(crate) mod externals;
pub(crate) mod foxglove;
pub(crate) mod http;
pub(crate) mod keys;
pub(crate) mod live_page;
mod locks;
pub mod mission;
pub mod names;
pub(crate) mod object;
pub mod page;
pub(crate) mod process_name;
pub(crate) mod queues;
pub mod record;
pub(crate) mod record_types;
pub(crate) mod replay;
pub(crate) mod ros;
mod routers;
pub(crate) mod story_test;
pub(crate) mod suggestion;
pub(crate) mod tap;
pub(crate) mod top;
pub(crate) mod trace;
pub mod tree;
