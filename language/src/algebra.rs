//! The process algebra: [`step`] turns an event into commands by the rules of the operators.
//!
//! One pure function, [`step`], is called by the supervisor (one event at a time), by the verifier
//! (all events), by the simulator and by the log checker. It reads no clock, does no I/O and is
//! deterministic. The rules are in the documentation of the `step` module's source, where each rule
//! is one function.
//!
//! ```
//! use language::algebra::{Activation, Command, Event, Outcome, Program, State, Value, step};
//! use language::plan::{Expression, Group, Member, MemberKind, Supervision};
//!
//! let run = |member| Expression::Run { member, sets: vec![] };
//! let leaf = |name: &str, index| Member { name: name.into(), kind: MemberKind::Leaf(index), service: false };
//! let group = Group {
//!     path: "main".into(),
//!     process: "main".into(),
//!     host: 0,
//!     members: vec![leaf("hit", 0), leaf("approach", 1)],
//!     sets: vec![],
//!     sets_always: vec![],
//!     expression: Expression::Disable(vec![run(0), run(1)]),
//!     supervision: Supervision::default(),
//! };
//! let program = Program::compile(&group);
//! let (mut state, mut commands, first) = (State::new(&program), vec![], Activation(1));
//!
//! assert_eq!(step(&program, &mut state, Event::Start(Value::EMPTY), &mut commands), None);
//! commands.clear();
//! let hit = Event::Done { member: 0, activation: first, value: Value::new(b"12 N") };
//! assert_eq!(step(&program, &mut state, hit, &mut commands), None);
//! assert_eq!(commands, [Command::Stop { member: 1, activation: first }]);
//! let stopped = Event::Stopped { member: 1, activation: first };
//! assert_eq!(step(&program, &mut state, stopped, &mut commands), Some(Outcome::Done(Value::new(b"12 N"))));
//! ```

mod charts;
mod event;
mod memo;
mod packed;
mod phase;
mod program;
mod record;
mod state;
mod step;

pub use event::{Activation, Cause, Command, Event, Outcome, Reason, TAG_MAX, Value};
pub use memo::{Effect, Steps};
pub use packed::{Packing, Words};
pub use program::Program;
pub use record::StepRecord;
pub use state::{Activity, Cell, State};
pub use step::{Carried, Misfit, carry, step};
