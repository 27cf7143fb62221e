//! Compares the reference with `step`: both give the same commands and outcomes along the same random words of
//! events.

use super::random::{Dice, TAGS, Taste, group};
use super::rules::{Event, Order, Reference};
use super::term::{Left, Outcome, Why};
use language::algebra::{self, Activation, Activity, Cause, Command, Program, State, Value, step};
use language::automaton::Failure;
use language::plan::Group;
use std::collections::BTreeMap;
use std::rc::Rc;

/// The length of the longest word of events of one group.
const EVENTS: u32 = 24;

/// The reference and `step`, and the numbers of activations that `step` has to give.
struct Pair {
    program: Program,
    state: State,
    reference: Reference,
    members: BTreeMap<u32, u32>,
    timers: BTreeMap<u32, u32>,
    word: Vec<String>,
}

/// Runs one random group on one random word, and returns the difference between both.
pub(crate) fn compare(seed: u64) -> Result<(), String> {
    let mut dice = Dice::new(seed);
    let source = Rc::new(group(&mut dice, Taste::Anything));
    let program = Program::compile(&source);
    let mut pair = Pair {
        state: State::new(&program),
        program,
        reference: Reference::new(&source),
        members: BTreeMap::new(),
        timers: BTreeMap::new(),
        word: Vec::new(),
    };
    let services: Vec<u32> =
        (0..).zip(&source.members).filter(|(_, member)| member.service).map(|(slot, _)| slot).collect();
    let told = |pair: &Pair, what: String| {
        let word = pair.word.join(" · ");
        format!("seed {seed}: {:?}\n  services {services:?}\n  {word}\n  {what}", source.expression)
    };
    if pair.program.is_service() != super::term::expression(&source).is_service {
        return Err(told(&pair, "one of them takes it for a service".to_owned()));
    }
    for _ in 0..EVENTS {
        pair.turn(&mut dice, &source).map_err(|what| told(&pair, what))?;
    }
    Ok(())
}

impl Pair {
    fn turn(&mut self, dice: &mut Dice, source: &Group) -> Result<(), String> {
        if self.reference.conf.is_none() {
            let value = value(dice);
            self.word.push("start".to_owned());
            let ended = self.reference.begin(value.clone());
            return self.both(algebra::Event::Start(value), ended);
        }
        if dice.one_in(12) {
            self.word.push("stop".to_owned());
            let ended = self.reference.halt();
            return self.both(algebra::Event::Stop, ended);
        }
        let Some(event) = self.event(dice, source) else { return Ok(()) };
        self.word.push(format!("{event:?}"));
        let ended = self.reference.happen(&event);
        let number = |of: &BTreeMap<u32, u32>, which: u32| Activation(of.get(&which).copied().unwrap_or(0));
        let told = match event {
            Event::Done(member, bytes) => {
                algebra::Event::Done { member, activation: number(&self.members, member), value: Value::new(&bytes) }
            }
            Event::Aborted(member) => {
                algebra::Event::Aborted { member, activation: number(&self.members, member), report: Value::EMPTY }
            }
            Event::Failed(member, reason) => {
                let report = reason.report();
                algebra::Event::Aborted { member, activation: number(&self.members, member), report }
            }
            Event::Stopped(member) => algebra::Event::Stopped { member, activation: number(&self.members, member) },
            Event::Unconfirmed(member) => {
                algebra::Event::StopUnconfirmed { member, activation: number(&self.members, member) }
            }
            Event::Elapsed(timer) => algebra::Event::Elapsed { timer, activation: number(&self.timers, timer) },
        };
        self.both(told, ended)
    }

    /// Returns an event that is possible now, and rarely one that is not.
    fn event(&self, dice: &mut Dice, source: &Group) -> Option<Event> {
        let members = u32::try_from(source.members.len()).expect("few members");
        let mut all = Vec::new();
        for member in 0..members {
            let fails = if dice.one_in(3) { Event::Failed(member, Failure::Crash) } else { Event::Aborted(member) };
            let answers = [Event::Done(member, value(dice).bytes().to_vec()), fails];
            match self.state.activity(member) {
                Activity::Active if dice.one_in(12) => all.extend([Event::Stopped(member), Event::Unconfirmed(member)]),
                Activity::Active => all.extend(answers),
                Activity::Stopping if dice.one_in(4) => all.extend(answers),
                Activity::Stopping if dice.one_in(4) => all.push(Event::Unconfirmed(member)),
                Activity::Stopping => all.push(Event::Stopped(member)),
                Activity::Idle => {}
            }
        }
        let armed = |timer: &u32| self.state.timer(&self.program, *timer).1;
        all.extend((0..self.program.timers()).filter(armed).map(Event::Elapsed));
        (!all.is_empty()).then(|| dice.pick(&all).clone())
    }

    fn both(&mut self, event: algebra::Event, ended: Option<Outcome>) -> Result<(), String> {
        let mut commands = Vec::new();
        let of_step = step(&self.program, &mut self.state, event, &mut commands);
        let orders = std::mem::take(&mut self.reference.orders);
        let is_same = orders.len() == commands.len()
            && orders.iter().zip(&commands).all(|(order, command)| self.is_order(order, command));
        if !is_same {
            return Err(format!("the reference orders {orders:?}\n  but step {commands:?}"));
        }
        let is_same = match (&ended, &of_step) {
            (None, None) => true,
            (Some(ours), Some(theirs)) => is_outcome(ours, theirs),
            (_, _) => false,
        };
        if !is_same {
            return Err(format!("the reference ends {ended:?}\n  but step {of_step:?}"));
        }
        if self.reference.conf.is_none() != self.state.is_idle() {
            return Err("one of them is idle, the other not".to_owned());
        }
        Ok(())
    }

    /// Returns whether a command is the order of the reference, with the next number.
    fn is_order(&mut self, order: &Order, command: &Command) -> bool {
        match (order, command) {
            (Order::Connect(ours), Command::Connect { set }) => ours == set,
            (Order::Disconnect(ours), Command::Disconnect { set }) => ours == set,
            (Order::Activate(ours, left), Command::Activate { member, activation, value }) => {
                let number = self.members.entry(*ours).or_default();
                *number += 1;
                ours == member && activation.0 == *number && is_left(left, value)
            }
            (Order::Stop(ours), Command::Stop { member, activation }) => {
                ours == member && self.members.get(ours) == Some(&activation.0)
            }
            (Order::Arm(ours, time), Command::Arm { timer, activation, after }) => {
                let number = self.timers.entry(*ours).or_default();
                *number += 1;
                ours == timer && activation.0 == *number && time == after
            }
            (Order::Cancel(ours), Command::Cancel { timer, activation }) => {
                ours == timer && self.timers.get(ours) == Some(&activation.0)
            }
            (_, _) => false,
        }
    }
}

fn value(dice: &mut Dice) -> Value {
    match dice.below(4) {
        0 => Value::new(b"7"),
        1 => Value::EMPTY,
        2 => Value::tagged(TAGS[0], b"here").expect("a short tag"),
        _ => Value::tagged(TAGS[1], &[]).expect("a short tag"),
    }
}

fn is_left(left: &Left, value: &Value) -> bool {
    match left {
        Left::Value(ours) => ours == value,
        Left::ReasonText => true,
    }
}

fn is_outcome(ours: &Outcome, theirs: &algebra::Outcome) -> bool {
    match (ours, theirs) {
        (Outcome::Done(left), algebra::Outcome::Done(value)) => is_left(left, value),
        (Outcome::Killed, algebra::Outcome::Stopped) => true,
        (Outcome::Aborted(why), algebra::Outcome::Aborted(reason)) => match (why, &reason.cause) {
            (Why::Reported(member, report), Cause::Reported(of_step)) => reason.member == *member && report == of_step,
            (Why::Given(member, given), Cause::Reported(of_step)) => {
                reason.member == Some(*member) && *of_step == given.report()
            }
            (Why::Busy(member), Cause::Busy)
            | (Why::Unconfirmed(member), Cause::StopUnconfirmed)
            | (Why::ServiceEnded(member), Cause::ServiceEnded)
            | (Why::Left(member), _) => reason.member == Some(*member),
            (Why::Failed(why), Cause::Failed(of_step)) => reason.member.is_none() && **of_step == **why,
            (Why::NoMatch, Cause::NoMatch) => true,
            (_, _) => false,
        },
        (_, _) => false,
    }
}
