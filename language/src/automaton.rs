//! The automaton of activities: [`step`] turns an event into commands by the rules of statecharts.
//!
//! A [`Chart`] has the states and transitions, and [`Automaton::new`] checks it. A [`Configuration`] says which states
//! of one activity are active. [`step`] is pure, as is [`algebra::step`](crate::algebra::step): it has no clock and no
//! I/O, and the same input always gives the same commands. Timers are orders to the caller, so the caller may use
//! virtual time. The rules have numbers in `docs/src/inside/automaton.md`, and comments here name these numbers.
//!
//! ```
//! use language::automaton::{Automaton, Chart, ChartState, Configuration, Event, Target, Transition, Trigger, step};
//!
//! let ringing = Trigger::Message { port: 0, filter: None };
//! let chart = Chart {
//!     states: vec![
//!         ChartState::compound("lamp", None, 1),
//!         ChartState::atomic("dark", 0),
//!         ChartState::atomic("bright", 0),
//!     ],
//!     transitions: vec![Transition::new(1, ringing, Target::States(vec![2]))],
//!     ports: vec![8],
//!     ..Chart::default()
//! };
//! let lamp = Automaton::new(chart).unwrap();
//! let (mut place, mut commands) = (Configuration::new(&lamp), vec![]);
//! step(&lamp, &mut place, Event::Start(Default::default()), &mut commands);
//! assert!(place.is_active(1));
//! step(&lamp, &mut place, Event::message(0), &mut commands);
//! assert!(place.is_active(2) && !place.is_active(1));
//! ```

mod action;
mod carry;
mod chart;
mod configuration;
mod enter;
mod event;
mod failure;
mod formula;
mod leave;
mod select;
mod shape;
mod step;

pub(crate) use carry::carry;
pub use chart::{
    Action, Chart, ChartState, Fragment, History, StateKind, Target, Transition, Trigger, ValueSource, Variable,
};
pub use configuration::Configuration;
pub use event::{Command, Event};
pub use failure::Failure;
pub use formula::{Formula, Relation};
pub use shape::{Automaton, ChartError, ChartPlace, STATES_MAX, Scripts};
pub use step::step;
