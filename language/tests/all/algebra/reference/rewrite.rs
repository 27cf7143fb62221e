//! A second interpreter of the process algebra, for tests alone: configurations are terms, rules rewrite them.
//!
//! It shares nothing with `language::algebra`: it has separate terms, values, commands and reasons, no arrays, no
//! phases, no parent links, and is not optimised. Each rule is written as in the paper, so that a reader can compare it
//! with the paper page:
//!
//! ```text
//! R ::= C | o        o ::= done(v) | aborted(r) | killed
//! v |- E ~> R        `start`          C --e--> R    `react`          stop(C) = R    `stop`
//! ```

mod completion;
mod events;
mod scopes;
mod start;
mod term;

use self::events::{forget, leaves};
use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;

use self::term::R;
pub(crate) use self::term::{Asked, Command, Config, Declared, Event, Outcome, Reason, Term};

/// A group: its expression, its members, and its configuration.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Machine {
    expression: Rc<Term>,
    always: Rc<[u32]>,
    root: Option<Config>,
    world: World,
}

#[derive(Clone, Debug, PartialEq, Eq)]
struct World {
    declared: Rc<[Declared]>,
    epochs: BTreeMap<u32, u32>,
    arms: BTreeMap<u32, u32>,
    busy: BTreeSet<u32>,
    /// The resources that some `using` holds.
    held: BTreeSet<String>,
    /// The waiting `using`s with the resources they want, the earliest first.
    queue: Vec<(u32, Vec<String>)>,
    commands: Vec<Command>,
}

impl Machine {
    /// Returns an idle group.
    pub(crate) fn new(expression: Term, declared: Vec<Declared>, always: Vec<u32>) -> Self {
        let world = World {
            declared: declared.into(),
            epochs: BTreeMap::new(),
            arms: BTreeMap::new(),
            busy: BTreeSet::new(),
            held: BTreeSet::new(),
            queue: Vec::new(),
            commands: Vec::new(),
        };
        Self { expression: expression.into(), always: always.into(), root: None, world }
    }

    /// Takes an event.
    pub(crate) fn handle(&mut self, event: &Event) -> (Vec<Command>, Option<Outcome>) {
        let outcome = match (self.root.take(), event) {
            (None, Event::Start(v)) => {
                self.world.commands.extend(self.always.iter().map(|&set| Command::Connect(set)));
                let r = self.world.start(&self.expression, v.clone());
                let r = self.grant(r);
                self.settle(r)
            }
            (None, Event::Stop) => Some(Outcome::Killed),
            (None, _) => None,
            (Some(c), Event::Start(_)) => self.settle(R::C(c)),
            (Some(c), Event::Stop) => {
                let r = self.world.stop(c);
                let r = self.grant(r);
                self.settle(r)
            }
            (Some(c), event) => {
                let r = self.world.react(c.clone(), event);
                // An event that no rule speaks of.
                let r = if r == R::C(c) { r } else { self.grant(r) };
                self.settle(r)
            }
        };
        (std::mem::take(&mut self.world.commands), outcome)
    }

    /// [e-grant], as many times as there are `using`s at most.
    fn grant(&mut self, mut r: R) -> R {
        for _ in 0..self.expression.usings() {
            match (r, self.world.next()) {
                (R::C(c), Some(using)) => r = self.world.react(c, &Event::Granted(using)),
                (other, _) => return other,
            }
        }
        r
    }

    fn settle(&mut self, r: R) -> Option<Outcome> {
        match r {
            R::C(c) => {
                self.root = Some(c);
                None
            }
            R::O(o) => {
                self.world.commands.extend(self.always.iter().map(|&set| Command::Disconnect(set)));
                Some(o)
            }
        }
    }

    /// Returns the configuration with all activation numbers set to 0, and which `using`s wait, the first to come first.
    pub(crate) fn shape(&self) -> Option<(Config, Vec<u32>)> {
        let waiting = self.world.queue.iter().map(|(using, _)| *using);
        self.root.clone().map(|c| (forget(c), waiting.collect()))
    }

    /// Returns the active members and the stopping ones.
    pub(crate) fn members(&self) -> (BTreeSet<u32>, BTreeSet<u32>) {
        let (mut active, mut stopping) = (BTreeSet::new(), BTreeSet::new());
        if let Some(root) = &self.root {
            leaves(root, &mut |c| {
                if let Config::Active(i, ..) = c {
                    active.insert(*i);
                }
                if let Config::Stopping(i, ..) = c {
                    stopping.insert(*i);
                }
            });
        }
        (active, stopping)
    }

    /// Returns the timers that are armed.
    pub(crate) fn timers(&self) -> BTreeSet<u32> {
        let mut armed = BTreeSet::new();
        if let Some(root) = &self.root {
            leaves(root, &mut |c| {
                if let Config::Armed(t, _) | Config::ShieldK(Some((t, _)), _) = c {
                    armed.insert(*t);
                }
            });
        }
        armed
    }

    /// Returns the timers of shields that hold up a stop.
    pub(crate) fn bounds(&self) -> BTreeSet<u32> {
        let mut bounds = BTreeSet::new();
        if let Some(root) = &self.root {
            leaves(root, &mut |c| {
                if let Config::ShieldK(Some((t, _)), _) = c {
                    bounds.insert(*t);
                }
            });
        }
        bounds
    }

    /// Returns the number of a member's latest activation.
    pub(crate) fn epoch(&self, member: u32) -> u32 {
        self.world.epochs.get(&member).copied().unwrap_or(0)
    }

    /// Returns the number of a timer's latest arm.
    pub(crate) fn arm(&self, timer: u32) -> u32 {
        self.world.arms.get(&timer).copied().unwrap_or(0)
    }

    /// Returns whether no fault-free run of the group ends.
    pub(crate) fn is_service(&self) -> bool {
        self.world.service(&self.expression)
    }
}
