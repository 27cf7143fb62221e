//! A configuration database with a copy on every robot. It can always be written to. It receives
//! the changes of the other robots as far as the links allow, and reports which changes are
//! unknown.
//!
//! The guarantee is *transactional causal+ consistency*. A transaction becomes visible at each replica as a whole, after
//! everything that its writer had seen. Replicas that hold the same transactions show the same state. Writes that did not
//! see each other are kept side by side until they are resolved. Nothing is ever refused because of its date, and nothing is
//! ever forgotten because time has passed.
//!
//! [`logic`] has everything except the disk, as state machines without I/O. Its page shows which module proves which
//! property. [`io`] has the disk.
//!
//! ```
//! use dbmanager::logic::version_vector::ReplicaId;
//! use dbmanager::logic::key::Key;
//! use dbmanager::logic::txn::{Condition, Draft};
//!
//! let key = Key::new("team/camera/gain")?;
//! let draft = Draft::new("new lens").require(key.clone(), Condition::Absent).put(key.clone(), b"1.5");
//! assert_eq!(draft.writes().count(), 1);
//! # let _ = ReplicaId::new(7);
//! # Ok::<(), dbmanager::logic::key::KeyError>(())
//! ```

pub mod io;
pub mod logic;
