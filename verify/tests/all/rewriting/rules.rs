//! The written rules: the effects of a start, of a stop, and of an outcome on the surrounding operators. They rewrite
//! whole terms, and share nothing with `language::algebra::step`.
//!
//! They follow the study of the language, §2.4 with §2.5 and §2.11. For `finally`, `as`, `::` and `using`, they follow
//! the manual's page about operators.

use super::completion::Join;
use super::term::{Conf, Expr, Kind, Left, Outcome, Pool, Slots, Why, expression, is_endless};
use language::algebra::Value;
use language::automaton::Failure;
use language::plan::{DEADLINE, Group};
use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;
use std::time::Duration;

/// The next configuration, or the outcome.
pub(crate) type Next = Result<Conf, Outcome>;

/// The orders of the reference, as a sequence.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Order {
    Connect(u32),
    Disconnect(u32),
    Activate(u32, Left),
    Stop(u32),
    Arm(u32, Duration),
    Cancel(u32),
}

/// The events of one leaf or timer.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Event {
    Done(u32, Vec<u8>),
    Aborted(u32),
    /// The member failed for another reason than its own report.
    Failed(u32, Failure),
    Stopped(u32),
    Unconfirmed(u32),
    Elapsed(u32),
}

/// A group in execution.
#[derive(Clone, Debug)]
pub(crate) struct Reference {
    group: Rc<Group>,
    root: Rc<Expr>,
    /// The running configuration. None before the start and after the end.
    pub(crate) conf: Option<Conf>,
    /// The members that are active or stopping.
    pub(crate) busy: BTreeSet<u32>,
    /// The occupied resources, each with the `using` that occupies it.
    held: Vec<(usize, String)>,
    /// The values with names, by their numbers. The configuration of a running operand has the same value.
    kept: BTreeMap<usize, Left>,
    /// The waiting `using`s with the resources that they need, the earliest first.
    pub(crate) queue: Vec<(usize, Vec<String>)>,
    pub(crate) orders: Vec<Order>,
}

impl Reference {
    pub(crate) fn new(group: &Rc<Group>) -> Self {
        Self {
            root: expression(group),
            group: Rc::clone(group),
            conf: None,
            busy: BTreeSet::new(),
            held: Vec::new(),
            kept: BTreeMap::new(),
            queue: Vec::new(),
            orders: Vec::new(),
        }
    }

    /// Starts the group.
    pub(crate) fn begin(&mut self, value: Value) -> Option<Outcome> {
        let sets = self.group.sets_always.clone();
        self.orders.extend(sets.into_iter().map(Order::Connect));
        let root = Rc::clone(&self.root);
        let next = self.start(&root, Left::Value(value));
        self.settle(next)
    }

    /// Asks the group to stop.
    pub(crate) fn halt(&mut self) -> Option<Outcome> {
        let Some(conf) = self.conf.take() else { return Some(Outcome::Killed) };
        let next = self.stop(conf);
        self.settle(next)
    }

    /// Handles an event of one of its leaves or timers.
    pub(crate) fn happen(&mut self, event: &Event) -> Option<Outcome> {
        let conf = self.conf.take()?;
        let next = self.react(conf, event);
        self.settle(next)
    }

    /// Gives all free resources to waiting `using`s, and then returns the outcome of the whole.
    fn settle(&mut self, mut next: Next) -> Option<Outcome> {
        loop {
            match next {
                Err(outcome) => {
                    let sets = self.group.sets_always.clone();
                    self.orders.extend(sets.into_iter().map(Order::Disconnect));
                    return Some(outcome);
                }
                Ok(conf) => match self.grantable() {
                    None => {
                        self.conf = Some(conf);
                        return None;
                    }
                    Some(number) => next = self.grant(conf, number),
                },
            }
        }
    }

    /// Returns whether all requested resources are free and no earlier `using` waits for one of them.
    fn can_have(&self, wants: &[String], before: &[(usize, Vec<String>)]) -> bool {
        let is_free = |want: &String| self.held.iter().all(|(_, held)| held != want);
        let is_first = |want: &String| before.iter().all(|(_, wanted)| !wanted.contains(want));
        wants.iter().all(|want| is_free(want) && is_first(want))
    }

    fn grantable(&mut self) -> Option<usize> {
        let queue = self.queue.iter().enumerate();
        let at = queue.into_iter().position(|(at, (_, wants))| self.can_have(wants, &self.queue[..at]))?;
        let (number, wants) = self.queue.remove(at);
        self.held.extend(wants.into_iter().map(|want| (number, want)));
        Some(number)
    }

    /// `v |- E ~> R`
    pub(crate) fn start(&mut self, expr: &Rc<Expr>, value: Left) -> Next {
        match &expr.kind {
            Kind::Run(member, sets) => {
                if !self.busy.insert(*member) {
                    return Err(Outcome::Aborted(Why::Busy(*member)));
                }
                self.orders.extend(sets.iter().map(|&set| Order::Connect(set)));
                self.orders.push(Order::Activate(*member, value));
                Ok(Conf::Active(*member, sets.clone()))
            }
            Kind::Skip => Err(Outcome::Done(Left::NOTHING)),
            Kind::Never => Ok(Conf::Never),
            Kind::Fail(why) => Err(Outcome::Aborted(Why::Failed(why.clone()))),
            Kind::Wait(timer, after) => {
                self.orders.push(Order::Arm(*timer, *after));
                Ok(Conf::Timer(*timer))
            }
            Kind::Par(of) => self.start_all(of, &value, Join::All),
            Kind::And(of) => self.start_all(of, &value, Join::Each),
            Kind::Any(count, of) => self.start_all(of, &value, Join::Count(*count)),
            Kind::Least(count, of) => self.start_all(of, &value, Join::Least(*count)),
            Kind::Dis(of) => self.start_dis(of, &value),
            Kind::Seq(p, q) => {
                self.start(p, value).map_or_else(|o| self.seq(o, q), |c| Ok(Conf::Seq(c.into(), Rc::clone(q))))
            }
            Kind::Cond(p, q) => {
                self.start(p, value).map_or_else(|o| self.cond(o, q), |c| Ok(Conf::Cond(c.into(), Rc::clone(q))))
            }
            Kind::Rec(p, q) => {
                let next = self.start(p, value);
                self.rec1(next, p, q)
            }
            Kind::Else(p, q) => {
                self.start(p, value).map_or_else(|o| self.otherwise(o, q), |c| Ok(Conf::Else(c.into(), Rc::clone(q))))
            }
            Kind::Finally(p, q) => {
                self.start(p, value).map_or_else(|o| self.fin1(o, q), |c| Ok(Conf::Fin1(c.into(), Rc::clone(q))))
            }
            Kind::Match(arms) => self.start_match(arms, value),
            Kind::Shield(bound, of) => self.start(of, value).map(|c| Conf::Shield(*bound, c.into())),
            Kind::Using(number, wants, of) => self.start_using((*number, wants), of, value),
            Kind::Pool(source, bodies) => self.start_pool(source, bodies, value),
            // The outcome is that of P, so `with` is no longer needed once P runs.
            Kind::With(value, of) => self.start(of, Left::Value(value.clone())),
            // A value is written before anything inside starts, and again when the whole starts again.
            Kind::Named(number, of) => {
                self.kept.insert(*number, value.clone());
                self.start(of, Left::NOTHING).map(|c| Conf::Named(*number, value, c.into()))
            }
            Kind::WithKept(number, of) => {
                let value = self.kept[number].clone();
                self.start(of, value)
            }
            Kind::Catch(of, arms) => {
                let next = self.start(of, value);
                self.catch(next, arms)
            }
            Kind::Repeat(until, of) => {
                let next = self.start(of, value);
                self.round(next, until, of)
            }
            Kind::As(tag, of) => match self.start(of, value) {
                Ok(conf) => Ok(Conf::As(tag.clone(), conf.into())),
                Err(outcome) => Err(tagged(tag, outcome)),
            },
        }
    }

    /// `[s-par]`: all operands start, left to right. Only then do their outcomes count.
    fn start_all(&mut self, of: &[Rc<Expr>], value: &Left, join: Join) -> Next {
        let started: Vec<Next> = of.iter().map(|operand| self.start(operand, value.clone())).collect();
        let mut slots = Slots {
            services: of.iter().map(|operand| operand.is_service).collect(),
            aborts: Vec::new(),
            dones: Vec::new(),
            slots: started,
        };
        for at in 0..slots.slots.len() {
            note(&mut slots, at);
        }
        self.join(join, slots)
    }

    /// `[s-dis]`: the operands start from left to right. The first immediate outcome ends the operator.
    fn start_dis(&mut self, of: &[Rc<Expr>], value: &Left) -> Next {
        let mut running = Vec::new();
        for operand in of {
            match self.start(operand, value.clone()) {
                Ok(conf) => running.push(conf),
                Err(outcome) => return self.drain(outcome, running),
            }
        }
        Ok(Conf::Dis(running))
    }

    fn start_match(&mut self, arms: &[(Option<String>, Rc<Expr>)], value: Left) -> Next {
        let Left::Value(bytes) = value else { panic!("the generator gives no reasons to a match") };
        let tag = bytes.tag().map(str::to_owned);
        for (arm, body) in arms {
            match arm {
                None => return self.start(body, Left::Value(bytes)),
                Some(arm) if tag.as_ref() == Some(arm) => {
                    let rest = Value::new(&bytes.bytes()[1 + arm.len()..]);
                    return self.start(body, Left::Value(rest));
                }
                Some(_) => {}
            }
        }
        Err(Outcome::Aborted(Why::NoMatch))
    }

    fn start_using(&mut self, (number, wants): (usize, &[String]), of: &Rc<Expr>, value: Left) -> Next {
        let queue = self.queue.clone();
        if !self.can_have(wants, &queue) {
            self.queue.push((number, wants.to_vec()));
            return Ok(Conf::Waiting(number, Rc::clone(of), value));
        }
        self.held.extend(wants.iter().map(|want| (number, want.clone())));
        let next = self.start(of, value);
        self.using(number, next)
    }

    fn start_pool(&mut self, source: &Rc<Expr>, bodies: &[Rc<Expr>], value: Left) -> Next {
        let pool = Pool {
            source: Rc::clone(source),
            bodies: bodies.to_vec(),
            running: None,
            places: vec![None; bodies.len()],
            owed: None,
            failed: None,
        };
        let next = self.start(source, value);
        self.source_went(pool, next)
    }

    /// The rule of a leaf: its reaction to its event.
    pub(crate) fn leaf(&mut self, is_stopping: bool, (member, sets): (u32, Vec<u32>), event: &Event) -> Next {
        let outcome = match event {
            Event::Unconfirmed(_) => Outcome::Aborted(Why::Unconfirmed(member)),
            Event::Done(..) | Event::Aborted(_) | Event::Failed(..) | Event::Stopped(_) if is_stopping => {
                Outcome::Killed
            }
            Event::Done(..) if is_endless(&self.group, member) => Outcome::Aborted(Why::ServiceEnded(member)),
            Event::Done(_, bytes) => Outcome::Done(Left::Value(Value::new(bytes))),
            Event::Aborted(_) => Outcome::Aborted(Why::Reported(Some(member), Value::EMPTY)),
            Event::Failed(_, reason) => Outcome::Aborted(Why::Given(member, reason.clone())),
            Event::Stopped(_) => Outcome::Aborted(Why::Left(member)),
            Event::Elapsed(_) => panic!("the event of a timer at a leaf"),
        };
        self.busy.remove(&member);
        self.orders.extend(sets.into_iter().map(Order::Disconnect));
        Err(outcome)
    }

    pub(crate) fn release(&mut self, number: usize) {
        self.held.retain(|(holder, _)| *holder != number);
    }
}

/// Returns whether an arm of `else match` takes a failure.
pub(crate) fn is_for(failure: &Failure, why: &Why) -> bool {
    match (failure, why) {
        (Failure::Reported, Why::Reported(_, _) | Why::Left(_))
        | (Failure::Busy, Why::Busy(_))
        | (Failure::StopUnconfirmed, Why::Unconfirmed(_))
        | (Failure::ServiceEnded, Why::ServiceEnded(_))
        | (Failure::NoMatch, Why::NoMatch) => true,
        (failure, Why::Given(_, given)) => failure == given,
        (Failure::Failed(text), Why::Failed(why)) => text == why,
        (Failure::Timeout, Why::Failed(why)) => why.starts_with(DEADLINE),
        (_, _) => false,
    }
}

/// TAG: `done(v) -> done(t:v)`. Any other outcome stays unchanged.
pub(crate) fn tagged(tag: &str, outcome: Outcome) -> Outcome {
    match outcome {
        Outcome::Done(Left::Value(value)) => {
            let value = Value::tagged(tag, value.bytes()).expect("the tags of tests are short");
            Outcome::Done(Left::Value(value))
        }
        Outcome::Done(Left::ReasonText) | Outcome::Aborted(_) | Outcome::Killed => outcome,
    }
}

/// Notes the outcome of an operand, if it has ended.
pub(crate) fn note(slots: &mut Slots, at: usize) {
    match &slots.slots[at] {
        Err(Outcome::Done(_)) => slots.dones.push(at),
        Err(Outcome::Aborted(_)) => slots.aborts.push(at),
        Err(Outcome::Killed) => panic!("an operand that nobody stopped was killed"),
        Ok(_) => {}
    }
}
