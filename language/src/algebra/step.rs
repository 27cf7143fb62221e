//! The transition function: one function for each rule, in the order of the rules.
//!
//! # How a reaction runs
//! An event reaches one leaf through its seat (or one timer, or the root), the leaf yields an [`Outcome`], and the
//! outcome climbs along the parent links: at each operator its completion function either absorbs the outcome (the
//! operator continues, the reaction ends) or turns it into the operator's own. On the way, operators start and stop whole
//! operands, which descends by recursion, at most `DEPTH_MAX` deep. A `;;` loops in place. So a reaction costs the
//! depth of the leaf plus the number of nodes that it starts or stops, and terminates.
//!
//! [`Outcome::Stopped`] is the `killed` of the rules: only a drain consumes it.
//!
//! # The rules
//! `v |- E` starts `E` with the value `v`; `C` is a configuration, `o` an outcome, `S` a service.
//!
//! ```text
//! [s-leaf]   v |- i[L]     connect L, activate i with the next number and v
//! [s-busy]   v |- i[L]     aborted(Busy i), if i is not idle
//! [s-const]  skip = done(empty)   fail(r) = aborted(r)   never   wait(d) = arm
//! [s-par]    v |- E1,..,Em starts all, left to right, then PAR           same for & and any
//! [s-dis]    v |- E1#..#Em starts left to right up to the first outcome
//! SEQ        done -> empty |- F             aborted(r) -> aborted(r)
//! COND       done(u) -> u |- F              aborted(r) -> aborted(r)
//! REC        P done(u) -> u |- Q   Q done -> empty |- P   aborted(r) -> aborted(r)
//! ELSE       done(u) -> done(u)             aborted(r) -> r |- F
//! CATCH      done(u) -> done(u)             aborted(r) -> r |- the first arm of r; no such arm -> aborted(r)
//! DIS        o -> DRAIN(o, the others)
//! PAR        a service aborts -> DRAIN(its abort, the others)                                       (p-lost)
//!            all tasks have ended -> DRAIN(done(<u1..uk>) or the first abort, the services)        (p-join)
//!            otherwise wait                                                                        (p-wait)
//! FF         one aborts -> DRAIN(its abort, the others)       all done -> done(<u1..um>)
//! ANY        k are done -> DRAIN(done(<those k>), the others)
//!            fewer than k can still be done -> DRAIN(first abort, the others)
//! AT LEAST   all have ended: k are done -> done(empty); else the first abort
//! DRAIN      o, once all that is being stopped has confirmed
//! AREC       P done(u) -> u |- Q in the first free place of the pool, empty |- P;  none free -> once one is
//!            Q done -> its place is free             aborted(r) -> stop P, aborted(r) once every Q has ended
//! [s-match]  v |- match{t => E, ..}     the value behind the tag |- the first arm of that tag; `else` gets v
//!            no such arm -> aborted(NoMatch)
//! [s-using]  v |- using(res) E    v |- E if all of res are free and nothing that waits wants one of them, else wait
//! USING      o -> o, and res are free
//! [e-grant]  at the end of each reaction, the first that waits and can have all it wants starts
//! FIN        fin1: o -> empty |- F, then fin2(o)    fin2(o): done -> o, r -> o, but r if o is done; no unconfirmed stop is lost
//!            stop(fin1(C,F)) = fin1(stop(C),F)       stop(fin2(o,C)) = fin2(killed,C), unless o is an unconfirmed stop
//! REPEAT     done(t:v) -> done(t:v) if t ends it     any other done -> empty |- P     aborted(r) -> aborted(r)
//! TAG        done(v) -> done(t:v)                    any other o -> o
//! [s-with]   v |- E with u   u |- E               WITH  o -> o
//! [s-named]  v |- p => E     empty |- E, in which `with p` is `with v`           NAMED  o -> o
//! CHART      o -> the event of the automaton that the run has ended like this; its commands start and stop runs
//! SHIELD     o -> o; of a shield that holds up a stop, killed unless o is an unconfirmed stop
//! [e-done] [e-abort] [e-stopped] [e-unconf] [e-timer]         the leaf's part, which also disconnects L
//! [e-ctx]    climbs
//! [e-bound]  a shield has held up a stop for as long as it may: stop(C)
//! stop       forgets what has not started, drains what runs; a shield lets it wait
//! ```
//!
//! Seven points are settled here in addition to the study:
//! - **Unconfirmed stops are never swallowed.** If a stopping leaf cannot confirm its stop, it
//!   yields `aborted(StopUnconfirmed)`. A drain takes the first such outcome of its operands as its
//!   own outcome, and a later stop does not erase this outcome. So a
//!   group that is asked to stop never reports `Stopped` when one of the leaves it waited for did not
//!   confirm. Once such an abort is the outcome of an operand, it is treated like any other abort: an
//!   `else` may tolerate it, and a join may drop it.
//! - **`stop(P else Q)` forgets `Q` for good**, even when stopping `P` ends in such an abort.
//! - **A `;;` or `repeat` whose round takes no time aborts** ([rec-instant]) instead of turning for ever: in one reaction it
//!   enters each of its phases at most once. A spec with such a loop is refused before; a plan from elsewhere must not hang a
//!   node.
//! - **A member that stops without being asked has failed**: `Stopped` or `StopUnconfirmed` from an active member is
//!   its abort, since it will never end otherwise.
//! - **`::` goes at once too**: of an instantaneous source, `skip ::[n] Q`, as many Q run as there are places. If they
//!   are instantaneous too, [rec-instant] holds for it as for `;;`.
//! - **What `finally` runs is not stopped.** A stop that comes before or during this part waits for
//!   it, as for a `shield`. If the part may take too long, the spec can limit it:
//!   `P finally (Q within 5 s)`.
//! - **One reaction grants at most as many times as there are `using`s**, so that loops which hand something to each
//!   other in no time cannot hang a node; further grants wait for the next event. No checked spec reaches this limit.

mod carry;
mod chart;
mod completion;
mod drain;
mod finish;
mod leaf;
mod pool;
mod scope;
mod start;

use super::event::{Command, Event, Outcome, Value};
use super::phase::Phase;
use super::program::{Kind, Program};
use super::state::{Cell, MemberState, State};
pub use carry::{Carried, Misfit, carry};
use std::ops::IndexMut;

/// Takes one event, appends the supervisor's reactions to `commands` in order, and returns the outcome of the group if
/// it ended.
///
/// `state` must have been made for `program`. After an outcome the same state can be started again; the numbers of
/// activations continue. Harmless: an event with a number that is not current (dropped), `Start` of a group that runs
/// (dropped), `Stop` of a group that is stopping (dropped), `Stop` of an idle group (`Stopped` at once).
///
/// Allocates only for tuples of values that are not all empty, for tags that `as` gives, and for the texts of reasons that
/// become values.
///
/// # Panics
/// If `state` was made for another program.
pub fn step(program: &Program, state: &mut State, event: Event, commands: &mut Vec<Command>) -> Option<Outcome> {
    step_in(program, state, event, commands, None)
}

/// [`step`], for any storage of the state. Tells an observer which operands end on the way, including those that
/// restart.
pub(super) fn step_in<C: Cells, S: Seats>(
    program: &Program,
    state: &mut State<C, S>,
    event: Event,
    commands: &mut Vec<Command>,
    ended: Option<&mut Vec<usize>>,
) -> Option<Outcome> {
    let mut reaction = Reaction { program, state, commands, ended, notice: None };
    let outcome = match event {
        Event::Start(_) if !reaction.is_idle() => return None,
        Event::Start(value) => reaction.begin(value),
        Event::Stop => reaction.halt(),
        Event::Done { member, activation, value } => {
            let node = reaction.seated(member, activation)?;
            let outcome = reaction.e_done(node, value);
            reaction.e_member(member, node, outcome)
        }
        Event::Aborted { member, activation, report } => {
            let node = reaction.seated(member, activation)?;
            let outcome = reaction.e_abort(node, report);
            reaction.e_member(member, node, outcome)
        }
        Event::Stopped { member, activation } => {
            let node = reaction.seated(member, activation)?;
            let outcome = reaction.e_stopped(node);
            reaction.e_member(member, node, outcome)
        }
        Event::StopUnconfirmed { member, activation } => {
            let node = reaction.seated(member, activation)?;
            let outcome = reaction.e_unconfirmed(node);
            reaction.e_member(member, node, outcome)
        }
        Event::Elapsed { timer, activation } => {
            let node = reaction.armed(timer, activation)?;
            reaction.e_timer(node, timer).and_then(|outcome| reaction.e_ctx(node, outcome))
        }
        Event::Message { .. } | Event::Notice(_) => event.told().and_then(|told| reaction.e_chart(told)),
    };
    outcome.or_else(|| reaction.e_grant())
}

/// Cells by the numbers of their nodes.
pub(super) trait Cells: IndexMut<usize, Output = Cell> {}
impl<C: IndexMut<usize, Output = Cell>> Cells for C {}

/// Seats by the numbers of their members.
pub(super) trait Seats: IndexMut<usize, Output = MemberState> {}
impl<S: IndexMut<usize, Output = MemberState>> Seats for S {}

/// One event being processed to completion.
struct Reaction<'a, C, S> {
    program: &'a Program,
    state: &'a mut State<C, S>,
    commands: &'a mut Vec<Command>,
    ended: Option<&'a mut Vec<usize>>,
    /// The end of a member that an activity does not know yet.
    notice: Option<usize>,
}

impl<C: Cells, S: Seats> Reaction<'_, C, S> {
    /// Whether the group has not been started since its last outcome.
    fn is_idle(&self) -> bool {
        !self.state.cells[0].phase.is_active()
    }

    /// The group is started: the sets without owner first.
    fn begin(&mut self, value: Value) -> Option<Outcome> {
        self.commands.extend(self.program.sets_always.iter().map(|&set| Command::Connect { set }));
        let outcome = self.start(0, value)?;
        Some(self.finish(outcome))
    }

    /// The group is asked to stop: `stop(root)`.
    fn halt(&mut self) -> Option<Outcome> {
        if self.is_idle() {
            return Some(Outcome::Stopped);
        }
        let outcome = self.stop(0)?;
        Some(self.finish(outcome))
    }

    /// The root has an outcome: it is the group's.
    fn finish(&mut self, outcome: Outcome) -> Outcome {
        self.commands.extend(self.program.sets_always.iter().map(|&set| Command::Disconnect { set }));
        outcome
    }

    /// The outcome of a member, at its node. An activity may wait for it.
    fn e_member(&mut self, member: u32, node: usize, outcome: Outcome) -> Option<Outcome> {
        self.notice = self.program.chart.as_deref().and_then(|chart| match outcome {
            Outcome::Done(_) => chart.notice_of(member, true),
            Outcome::Aborted(_) => chart.notice_of(member, false),
            Outcome::Stopped => None,
        });
        self.e_ctx(node, outcome).or_else(|| self.e_notice())
    }

    /// [e-ctx]: the outcome of `node` climbs until an operator absorbs it.
    fn e_ctx(&mut self, mut node: usize, mut outcome: Outcome) -> Option<Outcome> {
        while let Some(parent) = self.program.nodes[node].parent {
            outcome = self.complete(parent, node, outcome)?;
            node = parent;
        }
        Some(self.finish(outcome))
    }

    /// An operand of the active operator `node` has ended; returns the outcome of `node`, if that is one.
    fn complete(&mut self, node: usize, operand: usize, outcome: Outcome) -> Option<Outcome> {
        if let Some(ended) = &mut self.ended {
            ended.push(operand);
        }
        let is_named = matches!(self.program.nodes[node].kind, Kind::Named(_));
        if self.state.cells[node].phase == Phase::Draining && !is_named {
            return self.drained(node, outcome);
        }
        match self.program.nodes[node].kind {
            Kind::Sequence => self.seq(node, outcome),
            Kind::Conditional => self.cond(node, outcome),
            Kind::Recurrent => self.rec(node, outcome, 2),
            Kind::Repeat { .. } => self.repeat(node, outcome, 1),
            Kind::Catch { .. } => self.catch(node, outcome),
            Kind::Otherwise => self.or_else(node, outcome),
            Kind::Disable => self.dis(node, outcome),
            Kind::Concurrent { .. } => {
                let lost = self.slot_service(node, operand, outcome);
                self.par(node, lost)
            }
            Kind::FailFast { .. } => {
                self.slot(node, operand, outcome);
                self.ff(node)
            }
            Kind::AnyOf { count, .. } => {
                self.slot(node, operand, outcome);
                self.any(node, count)
            }
            Kind::AtLeast { count, .. } => {
                self.slot(node, operand, outcome);
                self.at_least(node, count)
            }
            Kind::Match { .. } | Kind::With(_) | Kind::Named(_) => self.pass(node, outcome),
            Kind::Shield { .. } => Some(self.shield(node, outcome)),
            Kind::Using { .. } => Some(self.using(node, outcome)),
            Kind::Asynchronous => self.asynchronous(node, operand, outcome),
            Kind::Finally => self.finally(node, outcome),
            Kind::Tagged(_) => Some(self.tagged(node, outcome)),
            Kind::Chart => self.chart(node, operand, outcome),
            Kind::Run { .. } | Kind::Skip | Kind::Never | Kind::Fail(_) | Kind::Wait { .. } => {
                unreachable!("a node without operands has no operand that ends")
            }
        }
    }

    fn cell(&mut self, node: usize) -> &mut Cell {
        &mut self.state.cells[node]
    }

    /// Empties the cell of a node that yields an outcome.
    fn clear(&mut self, node: usize) {
        *self.cell(node) = Cell::default();
    }

    fn enter(&mut self, node: usize, phase: Phase) {
        self.cell(node).phase = phase;
    }
}
