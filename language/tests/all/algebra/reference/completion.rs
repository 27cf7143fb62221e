//! SEQ, COND, REC1, REC2, ELSE, DIS, PAR, FF, ANY, DRAIN.

use super::World;
use super::term::{Config, Held, Outcome, R, Reason, Slot, Term, Value};

/// The phase of a `;;`.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Phase {
    P,
    Q,
}

/// LEAST: nothing is decided before all have ended.
pub(super) fn least(k: usize, ks: Vec<Slot>) -> R {
    if ks.iter().any(|k| matches!(k.held, Held::Runs(_))) {
        return R::C(Config::Least(k, ks));
    }
    let all: Vec<&Slot> = ks.iter().collect();
    match first_abort(&all) {
        Some(r) if values(&all).len() < k => R::O(Outcome::Aborted(r)),
        _ => R::O(Outcome::Done(vec![])),
    }
}

impl World {
    pub(super) fn seq(&mut self, r: R, f: &Term) -> R {
        match r {
            R::C(c) => R::C(Config::Seq(Box::new(c), f.clone())),
            R::O(Outcome::Done(_)) => self.start(f, vec![]),
            R::O(o) => R::O(o),
        }
    }

    pub(super) fn cond(&mut self, r: R, f: &Term) -> R {
        match r {
            R::C(c) => R::C(Config::Cond(Box::new(c), f.clone())),
            R::O(Outcome::Done(u)) => self.start(f, u),
            R::O(o) => R::O(o),
        }
    }

    pub(super) fn or_else(&mut self, r: R, f: &Term) -> R {
        match r {
            R::C(c) => R::C(Config::Else(Box::new(c), f.clone())),
            R::O(Outcome::Aborted(r)) => self.start(f, words(r)),
            R::O(o) => R::O(o),
        }
    }

    /// REC1; `entered` are the phases that this loop has entered in this reaction.
    pub(super) fn rec1(&mut self, r: R, e: &Term, f: &Term, entered: &[Phase]) -> R {
        match r {
            R::C(c) => R::C(Config::Rec1(Box::new(c), e.clone(), f.clone())),
            R::O(Outcome::Done(_)) if entered.contains(&Phase::Q) => R::O(Outcome::Aborted(Reason::Instant)),
            R::O(Outcome::Done(u)) => {
                let r = self.start(f, u);
                self.rec2(r, e, f, &[entered, &[Phase::Q]].concat())
            }
            R::O(o) => R::O(o),
        }
    }

    pub(super) fn rec2(&mut self, r: R, e: &Term, f: &Term, entered: &[Phase]) -> R {
        match r {
            R::C(c) => R::C(Config::Rec2(Box::new(c), e.clone(), f.clone())),
            R::O(Outcome::Done(_)) if entered.contains(&Phase::P) => R::O(Outcome::Aborted(Reason::Instant)),
            R::O(Outcome::Done(_)) => {
                let r = self.start(e, vec![]);
                self.rec1(r, e, f, &[entered, &[Phase::P]].concat())
            }
            R::O(o) => R::O(o),
        }
    }

    pub(super) fn dis(&mut self, rs: Vec<R>) -> R {
        let first = rs.iter().find_map(|r| match r {
            R::O(o) => Some(o.clone()),
            R::C(_) => None,
        });
        let cs = rs.into_iter().filter_map(|r| match r {
            R::C(c) => Some(c),
            R::O(_) => None,
        });
        let cs = cs.collect();
        match first {
            Some(o) => self.drain_stopping(o, cs),
            None => R::C(Config::Dis(cs)),
        }
    }

    pub(super) fn par(&mut self, ks: Vec<Slot>) -> R {
        let all_services = ks.iter().all(|k| k.service);
        // p-lost
        let lost = ks.iter().find_map(|k| match &k.held {
            Held::Aborted(_, r) if k.service => Some(r.clone()),
            Held::Aborted(..) | Held::Done(_) | Held::Runs(_) => None,
        });
        if let Some(r) = lost {
            return self.drain_stopping(Outcome::Aborted(r), running(ks));
        }
        // p-join
        let tasks: Vec<&Slot> = ks.iter().filter(|k| all_services || !k.service).collect();
        if tasks.iter().all(|k| !matches!(k.held, Held::Runs(_))) {
            let o = match first_abort(&tasks) {
                Some(r) => Outcome::Aborted(r),
                None => Outcome::Done(tuple(&values(&tasks))),
            };
            return self.drain_stopping(o, running(ks));
        }
        // p-wait
        R::C(Config::Par(ks))
    }

    pub(super) fn ff(&mut self, ks: Vec<Slot>) -> R {
        let all: Vec<&Slot> = ks.iter().collect();
        if let Some(r) = first_abort(&all) {
            return self.drain_stopping(Outcome::Aborted(r), running(ks));
        }
        let us = values(&all);
        if us.len() == ks.len() { R::O(Outcome::Done(tuple(&us))) } else { R::C(Config::Ff(ks)) }
    }

    pub(super) fn any(&mut self, k: usize, ks: Vec<Slot>) -> R {
        let all: Vec<&Slot> = ks.iter().collect();
        let us = values(&all);
        if us.len() >= k {
            return self.drain_stopping(Outcome::Done(tuple(&us[..k])), running(ks));
        }
        let aborts = all.iter().filter(|k| matches!(k.held, Held::Aborted(..))).count();
        match first_abort(&all) {
            Some(r) if all.len() - aborts < k => self.drain_stopping(Outcome::Aborted(r), running(ks)),
            _ => R::C(Config::Any(k, ks)),
        }
    }

    /// DRAIN(o, stop of all Cs)
    pub(super) fn drain_stopping(&mut self, o: Outcome, cs: Vec<Config>) -> R {
        let rs = cs.into_iter().map(|c| self.stop(c)).collect();
        drain(o, rs)
    }
}

/// DRAIN: an unconfirmed stop becomes the outcome; the first one stays.
pub(super) fn drain(o: Outcome, rs: Vec<R>) -> R {
    match collect(o, rs) {
        (o, cs) if cs.is_empty() => R::O(o),
        (o, cs) => R::C(Config::Drain(o, cs)),
    }
}

/// Returns the rest of a drain, or of an `arec` that comes to its end.
pub(super) fn collect(o: Outcome, rs: Vec<R>) -> (Outcome, Vec<Config>) {
    let (mut o, mut cs) = (o, vec![]);
    for r in rs {
        match r {
            R::C(c) => cs.push(c),
            R::O(Outcome::Aborted(Reason::Unconfirmed(i))) if !is_unconfirmed(&o) => {
                o = Outcome::Aborted(Reason::Unconfirmed(i));
            }
            R::O(_) => {}
        }
    }
    (o, cs)
}

pub(super) fn is_unconfirmed(o: &Outcome) -> bool {
    matches!(o, Outcome::Aborted(Reason::Unconfirmed(_)))
}

pub(super) fn hold(o: Outcome, others: &[Slot]) -> Held {
    match o {
        Outcome::Done(u) => Held::Done(u),
        Outcome::Aborted(r) => Held::Aborted(others.iter().filter(|k| matches!(k.held, Held::Aborted(..))).count(), r),
        Outcome::Killed => panic!("an operand is killed in a drain only"),
    }
}

pub(super) fn running(ks: Vec<Slot>) -> Vec<Config> {
    ks.into_iter().filter_map(|k| if let Held::Runs(c) = k.held { Some(c) } else { None }).collect()
}

fn values(ks: &[&Slot]) -> Vec<Value> {
    ks.iter().filter_map(|k| if let Held::Done(u) = &k.held { Some(u.clone()) } else { None }).collect()
}

fn first_abort(ks: &[&Slot]) -> Option<Reason> {
    let aborts = ks.iter().filter_map(|k| if let Held::Aborted(n, r) = &k.held { Some((*n, r)) } else { None });
    aborts.min_by_key(|(n, _)| *n).map(|(_, r)| r.clone())
}

/// `<u1..uk>`
pub(crate) fn tuple(us: &[Value]) -> Value {
    match us {
        [u] => u.clone(),
        us if us.iter().all(Vec::is_empty) => vec![],
        us => us.iter().flat_map(|u| [&(u.len() as u64).to_le_bytes()[..], u].concat()).collect(),
    }
}

/// A reason as a value, for `else`.
pub(crate) fn words(r: Reason) -> Value {
    match r {
        Reason::Reported(i, v) => match v.as_slice() {
            [0, 1] => words(Reason::Busy(i)),
            [0, 2] => words(Reason::ServiceEnded(i)),
            [0, 3] => words(Reason::NoMatch),
            [0, 4] => b"crash".to_vec(),
            [0, 5] => b"host lost".to_vec(),
            _ => v,
        },
        Reason::Busy(_) => b"busy".to_vec(),
        Reason::Unconfirmed(_) => b"stop unconfirmed".to_vec(),
        Reason::ServiceEnded(_) => b"service ended".to_vec(),
        Reason::Failed(why) => why.into_bytes(),
        Reason::NoMatch => b"no arm for this outcome".to_vec(),
        Reason::Instant => b"a round of a loop took no time".to_vec(),
    }
}
