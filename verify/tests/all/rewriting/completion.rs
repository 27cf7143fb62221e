//! The completion functions: the effect of an operand's outcome on its operator, after a start and after an event
//! alike.

use super::rules::{Event, Next, Order, Reference, is_for, note, tagged};
use super::term::{CatchArms, Conf, Expr, Left, Outcome, Pool, Slots, Why};
use std::rc::Rc;

/// The operator: `,`, `&` or `any`.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Join {
    All,
    Each,
    Count(usize),
    Least(usize),
}

impl Reference {
    /// SEQ
    pub(crate) fn seq(&mut self, outcome: Outcome, q: &Rc<Expr>) -> Next {
        match outcome {
            Outcome::Done(_) => self.start(q, Left::NOTHING),
            Outcome::Aborted(_) | Outcome::Killed => Err(outcome),
        }
    }

    /// COND
    pub(crate) fn cond(&mut self, outcome: Outcome, q: &Rc<Expr>) -> Next {
        match outcome {
            Outcome::Done(value) => self.start(q, value),
            Outcome::Aborted(_) | Outcome::Killed => Err(outcome),
        }
    }

    /// ELSE
    pub(crate) fn otherwise(&mut self, outcome: Outcome, q: &Rc<Expr>) -> Next {
        match outcome {
            Outcome::Aborted(_) => self.start(q, Left::ReasonText),
            Outcome::Done(_) | Outcome::Killed => Err(outcome),
        }
    }

    /// REC1
    pub(crate) fn rec1(&mut self, next: Next, p: &Rc<Expr>, q: &Rc<Expr>) -> Next {
        match next {
            Ok(conf) => Ok(Conf::Rec1(conf.into(), Rc::clone(p), Rc::clone(q))),
            Err(Outcome::Done(value)) => {
                let next = self.start(q, value);
                self.rec2(next, p, q)
            }
            Err(outcome) => Err(outcome),
        }
    }

    /// REC2
    fn rec2(&mut self, next: Next, p: &Rc<Expr>, q: &Rc<Expr>) -> Next {
        match next {
            Ok(conf) => Ok(Conf::Rec2(conf.into(), Rc::clone(p), Rc::clone(q))),
            Err(Outcome::Done(_)) => {
                let next = self.start(p, Left::NOTHING);
                self.rec1(next, p, q)
            }
            Err(outcome) => Err(outcome),
        }
    }

    /// CATCH
    pub(crate) fn catch(&mut self, next: Next, arms: &CatchArms) -> Next {
        let why = match next {
            Ok(conf) => return Ok(Conf::Catch(conf.into(), arms.clone())),
            Err(Outcome::Aborted(why)) => why,
            Err(outcome) => return Err(outcome),
        };
        match arms.iter().find(|(failure, _)| failure.as_ref().is_none_or(|failure| is_for(failure, &why))) {
            Some((_, body)) => self.start(body, Left::ReasonText),
            None => Err(Outcome::Aborted(why)),
        }
    }

    /// REPEAT. The random expressions contain no loops that take no time.
    pub(crate) fn round(&mut self, next: Next, until: &[String], of: &Rc<Expr>) -> Next {
        match next {
            Ok(conf) => Ok(Conf::Repeat(until.to_vec(), conf.into(), Rc::clone(of))),
            Err(Outcome::Done(Left::Value(value)))
                if value.tag().is_some_and(|tag| until.iter().any(|it| it == tag)) =>
            {
                Err(Outcome::Done(Left::Value(value)))
            }
            Err(Outcome::Done(_)) => {
                let next = self.start(of, Left::NOTHING);
                self.round(next, until, of)
            }
            Err(outcome) => Err(outcome),
        }
    }

    /// PAR, FF and ANY.
    pub(crate) fn join(&mut self, join: Join, slots: Slots) -> Next {
        match join {
            Join::All => self.par(slots),
            Join::Each => match (slots.aborts.first(), slots.dones.len() == slots.slots.len()) {
                (Some(&first), _) => self.drain_slots(first, slots),
                (None, true) => Err(Outcome::Done(values(&slots, &slots.dones))),
                (None, false) => Ok(Conf::And(slots)),
            },
            Join::Count(count) => match slots.aborts.first() {
                _ if slots.dones.len() >= count => {
                    let outcome = Outcome::Done(values(&slots, &slots.dones[..count]));
                    self.drain(outcome, running(slots))
                }
                Some(&first) if slots.slots.len() - slots.aborts.len() < count => self.drain_slots(first, slots),
                Some(_) | None => Ok(Conf::Any(count, slots)),
            },
            Join::Least(least) if slots.slots.iter().any(Result::is_ok) => Ok(Conf::Least(least, slots)),
            Join::Least(count) if slots.dones.len() >= count => Err(Outcome::Done(Left::NOTHING)),
            Join::Least(_) => self.drain_slots(slots.aborts[0], slots),
        }
    }

    fn par(&mut self, slots: Slots) -> Next {
        if let Some(&lost) = slots.aborts.iter().find(|&&at| slots.services[at]) {
            return self.drain_slots(lost, slots);
        }
        let mut tasks: Vec<usize> = (0..slots.slots.len()).filter(|&at| !slots.services[at]).collect();
        if tasks.is_empty() {
            tasks = (0..slots.slots.len()).collect();
        }
        if tasks.iter().any(|&at| slots.slots[at].is_ok()) {
            return Ok(Conf::Par(slots));
        }
        match slots.aborts.first() {
            Some(&first) => self.drain_slots(first, slots),
            None => {
                let outcome = Outcome::Done(values(&slots, &tasks));
                self.drain(outcome, running(slots))
            }
        }
    }

    /// `DRAIN(outcome of one operand, stop of all operands that run)`
    fn drain_slots(&mut self, of: usize, slots: Slots) -> Next {
        let outcome = slots.slots[of].clone().expect_err("an operand that has ended");
        self.drain(outcome, running(slots))
    }

    /// `DRAIN(o, stop of these configurations)`
    pub(crate) fn drain(&mut self, outcome: Outcome, others: Vec<Conf>) -> Next {
        let stopped = others.into_iter().map(|conf| self.stop(conf)).collect();
        drained(outcome, stopped)
    }

    /// USING: an outcome frees the resources.
    pub(crate) fn using(&mut self, number: usize, next: Next) -> Next {
        match next {
            Ok(conf) => Ok(Conf::Using(number, conf.into())),
            Err(outcome) => {
                self.release(number);
                Err(outcome)
            }
        }
    }

    /// FIN, first part: P has ended, in any way.
    pub(crate) fn fin1(&mut self, outcome: Outcome, q: &Rc<Expr>) -> Next {
        match self.start(q, Left::NOTHING) {
            Ok(conf) => Ok(Conf::Fin2(outcome, conf.into())),
            Err(of_q) => Err(fin2(outcome, of_q)),
        }
    }

    /// AREC, after P has been started or has reacted.
    pub(crate) fn source_went(&mut self, mut pool: Pool, mut next: Next) -> Next {
        loop {
            match next {
                Ok(conf) => {
                    pool.running = Some(conf);
                    return Ok(Conf::Pool(pool.into()));
                }
                Err(Outcome::Done(value)) => {
                    let Some(at) = pool.places.iter().position(Option::is_none) else {
                        pool.owed = Some(value);
                        return Ok(Conf::Pool(pool.into()));
                    };
                    match self.start(&Rc::clone(&pool.bodies[at]), value) {
                        Ok(conf) => pool.places[at] = Some(conf),
                        Err(Outcome::Aborted(why)) => return self.pool_failed(pool, why),
                        Err(Outcome::Done(_) | Outcome::Killed) => {}
                    }
                    next = self.start(&Rc::clone(&pool.source), Left::NOTHING);
                }
                Err(Outcome::Aborted(why)) => return self.pool_failed(pool, why),
                Err(Outcome::Killed) => panic!("a source that nobody stopped was killed"),
            }
        }
    }

    /// A Q has reacted.
    pub(crate) fn place_went(&mut self, mut pool: Pool, at: usize, next: Next) -> Next {
        match next {
            Ok(conf) => {
                pool.places[at] = Some(conf);
                return Ok(Conf::Pool(pool.into()));
            }
            Err(Outcome::Aborted(why)) if pool.failed.is_none() => return self.pool_failed(pool, why),
            // The rules leave this open: a Q may report an unconfirmed stop although it has no order to stop. Such an
            // end is never lost.
            Err(outcome) if pool.failed.is_some() => take_over(&mut pool, outcome),
            Err(_) => {}
        }
        if pool.failed.is_some() {
            return pool_over(pool);
        }
        match pool.owed.take() {
            Some(value) => self.source_went(pool, Err(Outcome::Done(value))),
            None => Ok(Conf::Pool(pool.into())),
        }
    }

    /// `P or Q aborted(r)`: P is stopped, and the running Qs continue until they end.
    fn pool_failed(&mut self, mut pool: Pool, why: Why) -> Next {
        pool.failed = Some(why);
        pool.owed = None;
        if let Some(conf) = pool.running.take() {
            match self.stop(conf) {
                Ok(conf) => pool.running = Some(conf),
                Err(outcome) => take_over(&mut pool, outcome),
            }
        }
        pool_over(pool)
    }

    /// `C --e--> R`: the event reaches its leaf. From there, the outcomes move up through the operators.
    pub(crate) fn react(&mut self, conf: Conf, event: &Event) -> Next {
        if !concerns(&conf, event) {
            return Ok(conf);
        }
        if let Conf::ShieldK(Some(timer), inner) = conf {
            if *event == Event::Elapsed(timer) {
                let next = self.stop(*inner);
                return held_up(None, next);
            }
            return self.react_inside(Conf::ShieldK(Some(timer), inner), event);
        }
        if let Conf::Active(member, sets) = conf {
            return self.leaf(false, (member, sets), event);
        }
        if let Conf::Stopping(member, sets) = conf {
            return self.leaf(true, (member, sets), event);
        }
        if let Conf::Timer(_) = conf {
            return Err(Outcome::Done(Left::NOTHING));
        }
        self.react_inside(conf, event)
    }

    fn react_inside(&mut self, conf: Conf, event: &Event) -> Next {
        self.inside(conf, &mut |this, inner| this.react(inner, event), &|conf| concerns(conf, event))
    }

    /// A waiting `using` receives its resources.
    pub(crate) fn grant(&mut self, conf: Conf, number: usize) -> Next {
        if !waits(&conf, number) {
            return Ok(conf);
        }
        if let Conf::Waiting(number, expr, value) = conf {
            let next = self.start(&expr, value);
            return self.using(number, next);
        }
        self.inside(conf, &mut |this, inner| this.grant(inner, number), &|conf| waits(conf, number))
    }

    /// The same for `#`: the outcome of one operand ends all other operands.
    fn in_operands(
        &mut self,
        mut of: Vec<Conf>,
        act: &mut dyn FnMut(&mut Self, Conf) -> Next,
        is_it: &dyn Fn(&Conf) -> bool,
    ) -> Next {
        let at = of.iter().position(is_it).expect("the part is in one operand");
        let part = of.remove(at);
        match act(self, part) {
            Ok(part) => {
                of.insert(at, part);
                Ok(Conf::Dis(of))
            }
            Err(outcome) => self.drain(outcome, of),
        }
    }

    /// `[e-ctx]`: applies `act` to the part for which `is_it` holds. Then it applies the rule of the surrounding
    /// operator.
    fn inside(
        &mut self,
        conf: Conf,
        act: &mut dyn FnMut(&mut Self, Conf) -> Next,
        is_it: &dyn Fn(&Conf) -> bool,
    ) -> Next {
        match conf {
            Conf::Seq(c, q) => {
                act(self, *c).map_or_else(|o| self.seq(o, &q), |c| Ok(Conf::Seq(c.into(), Rc::clone(&q))))
            }
            Conf::Cond(c, q) => {
                act(self, *c).map_or_else(|o| self.cond(o, &q), |c| Ok(Conf::Cond(c.into(), Rc::clone(&q))))
            }
            Conf::Else(c, q) => {
                act(self, *c).map_or_else(|o| self.otherwise(o, &q), |c| Ok(Conf::Else(c.into(), Rc::clone(&q))))
            }
            Conf::Fin1(c, q) => {
                act(self, *c).map_or_else(|o| self.fin1(o, &q), |c| Ok(Conf::Fin1(c.into(), Rc::clone(&q))))
            }
            Conf::Rec1(c, p, q) => {
                let next = act(self, *c);
                self.rec1(next, &p, &q)
            }
            Conf::Rec2(c, p, q) => {
                let next = act(self, *c);
                self.rec2(next, &p, &q)
            }
            Conf::Par(slots) => self.slot(slots, Join::All, act, is_it),
            Conf::And(slots) => self.slot(slots, Join::Each, act, is_it),
            Conf::Any(count, slots) => self.slot(slots, Join::Count(count), act, is_it),
            Conf::Least(count, slots) => self.slot(slots, Join::Least(count), act, is_it),
            Conf::Dis(of) => self.in_operands(of, act, is_it),
            Conf::Drain(outcome, of) => {
                let mut next = Vec::new();
                for part in of {
                    next.push(if is_it(&part) { act(self, part) } else { Ok(part) });
                }
                drained(outcome, next)
            }
            Conf::Shield(bound, c) => act(self, *c).map(|c| Conf::Shield(bound, c.into())),
            Conf::ShieldK(timer, c) => {
                let next = act(self, *c);
                if next.is_err() {
                    self.orders.extend(timer.map(Order::Cancel));
                }
                held_up(timer, next)
            }
            Conf::Using(number, c) => {
                let next = act(self, *c);
                self.using(number, next)
            }
            Conf::Fin2(outcome, c) => {
                let next = act(self, *c).map(|c| Conf::Fin2(outcome.clone(), c.into()));
                next.map_err(|of_q| fin2(outcome, of_q))
            }
            Conf::As(tag, c) => {
                let next = act(self, *c).map(|c| Conf::As(tag.clone(), c.into()));
                next.map_err(|outcome| tagged(&tag, outcome))
            }
            Conf::Named(number, value, c) => act(self, *c).map(|c| Conf::Named(number, value.clone(), c.into())),
            Conf::Catch(c, arms) => {
                let next = act(self, *c);
                self.catch(next, &arms)
            }
            Conf::Repeat(until, c, of) => {
                let next = act(self, *c);
                self.round(next, &until, &of)
            }
            Conf::Pool(pool) => self.in_pool(*pool, act, is_it),
            Conf::Active(..) | Conf::Stopping(..) | Conf::Never | Conf::Timer(_) | Conf::Waiting(..) => Ok(conf),
        }
    }

    fn slot(
        &mut self,
        mut slots: Slots,
        join: Join,
        act: &mut dyn FnMut(&mut Self, Conf) -> Next,
        is_it: &dyn Fn(&Conf) -> bool,
    ) -> Next {
        let at =
            slots.slots.iter().position(|slot| slot.as_ref().is_ok_and(is_it)).expect("the part is in one operand");
        let part = slots.slots[at].clone().expect("it is active");
        slots.slots[at] = act(self, part);
        note(&mut slots, at);
        self.join(join, slots)
    }

    fn in_pool(
        &mut self,
        mut pool: Pool,
        act: &mut dyn FnMut(&mut Self, Conf) -> Next,
        is_it: &dyn Fn(&Conf) -> bool,
    ) -> Next {
        if pool.running.as_ref().is_some_and(is_it) {
            let part = pool.running.take().expect("it was looked at");
            let next = act(self, part);
            if pool.failed.is_none() {
                return self.source_went(pool, next);
            }
            match next {
                Ok(conf) => pool.running = Some(conf),
                Err(outcome) => take_over(&mut pool, outcome),
            }
            return pool_over(pool);
        }
        let at =
            pool.places.iter().position(|place| place.as_ref().is_some_and(is_it)).expect("the part is in a place");
        let part = pool.places[at].take().expect("it was looked at");
        let next = act(self, part);
        self.place_went(pool, at, next)
    }
}

/// Returns whether an event is for a leaf or timer of a configuration.
fn concerns(conf: &Conf, event: &Event) -> bool {
    conf.any(&|part| match (part, event) {
        (Conf::Active(own, _) | Conf::Stopping(own, _), Event::Done(member, _)) => own == member,
        (
            Conf::Active(own, _) | Conf::Stopping(own, _),
            Event::Aborted(member) | Event::Failed(member, _) | Event::Stopped(member) | Event::Unconfirmed(member),
        ) => own == member,
        (Conf::Timer(own) | Conf::ShieldK(Some(own), _), Event::Elapsed(timer)) => own == timer,
        _ => false,
    })
}

fn waits(conf: &Conf, number: usize) -> bool {
    conf.any(&|part| matches!(part, Conf::Waiting(own, ..) if *own == number))
}

fn running(slots: Slots) -> Vec<Conf> {
    slots.slots.into_iter().filter_map(Result::ok).collect()
}

/// Returns the values of these operands, in the order of the text.
fn values(slots: &Slots, of: &[usize]) -> Left {
    let mut of = of.to_vec();
    of.sort_unstable();
    let left = of.iter().filter_map(|&at| match &slots.slots[at] {
        Err(Outcome::Done(left)) => Some(left.clone()),
        Err(Outcome::Aborted(_) | Outcome::Killed) | Ok(_) => None,
    });
    Left::tuple(&left.collect::<Vec<_>>())
}

/// DRAIN: the first unconfirmed stop becomes the outcome, and no other end does.
pub(crate) fn drained(mut outcome: Outcome, parts: Vec<Next>) -> Next {
    let mut left = Vec::new();
    for part in parts {
        match part {
            Ok(conf) => left.push(conf),
            Err(end) if end.is_unconfirmed() && !outcome.is_unconfirmed() => outcome = end,
            Err(_) => {}
        }
    }
    if left.is_empty() { Err(outcome) } else { Ok(Conf::Drain(outcome, left)) }
}

/// `shieldK(C) --e--> o` results in killed, unless a stop in it was not confirmed.
pub(crate) fn held_up(timer: Option<u32>, next: Next) -> Next {
    match next {
        Ok(conf) => Ok(Conf::ShieldK(timer, conf.into())),
        Err(outcome) if outcome.is_unconfirmed() => Err(outcome),
        Err(_) => Err(Outcome::Killed),
    }
}

/// FIN, second part: the outcome of P, or that of Q if P was done and Q aborted. No unconfirmed stop is lost.
pub(crate) fn fin2(of_p: Outcome, of_q: Outcome) -> Outcome {
    match (&of_p, &of_q) {
        (Outcome::Done(_), Outcome::Aborted(_)) => of_q,
        (Outcome::Aborted(_) | Outcome::Killed, Outcome::Aborted(_))
            if of_q.is_unconfirmed() && !of_p.is_unconfirmed() =>
        {
            of_q
        }
        _ => of_p,
    }
}

/// An unconfirmed stop of P replaces the failure.
fn take_over(pool: &mut Pool, outcome: Outcome) {
    if let Outcome::Aborted(why @ Why::Unconfirmed(_)) = outcome
        && !matches!(pool.failed, Some(Why::Unconfirmed(_)))
    {
        pool.failed = Some(why);
    }
}

fn pool_over(pool: Pool) -> Next {
    match (&pool.failed, pool.running.is_none() && pool.places.iter().all(Option::is_none)) {
        (Some(why), true) => Err(Outcome::Aborted(why.clone())),
        (Some(_) | None, _) => Ok(Conf::Pool(pool.into())),
    }
}
