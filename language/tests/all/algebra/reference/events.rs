//! `C --e--> R` and `stop(C) = R`, and the observable part of a configuration.

use super::World;
use super::completion::{drain, hold, is_unconfirmed, least, running};
use super::scopes::{ending, fin2, shield, tag};
use super::term::{Command, Config, Declared, Event, Held, Outcome, R, Reason, Slot};

impl World {
    /// `C --e--> R`; a part without this event is unchanged.
    pub(super) fn react(&mut self, c: Config, e: &Event) -> R {
        match c {
            Config::Active(i, n, l) => self.react_active(i, n, l, e),
            Config::Stopping(i, n, l) => self.react_stopping(i, n, l, e),
            // [e-timer]
            Config::Armed(t, n) if *e == Event::Elapsed(t, n) => R::O(Outcome::Done(vec![])),
            Config::Armed(..) | Config::Never => R::C(c),
            // [e-ctx]
            Config::Seq(c, f) => {
                let r = self.react(*c, e);
                self.seq(r, &f)
            }
            Config::Cond(c, f) => {
                let r = self.react(*c, e);
                self.cond(r, &f)
            }
            Config::Else(c, f) => {
                let r = self.react(*c, e);
                self.or_else(r, &f)
            }
            Config::Rec1(c, p, q) => {
                let r = self.react(*c, e);
                self.rec1(r, &p, &q, &[])
            }
            Config::Rec2(c, p, q) => {
                let r = self.react(*c, e);
                self.rec2(r, &p, &q, &[])
            }
            Config::Dis(cs) => {
                let rs = self.react_all(cs, e);
                self.dis(rs)
            }
            Config::Drain(o, cs) => drain(o, self.react_all(cs, e)),
            Config::Par(ks) => {
                let ks = self.react_slots(ks, e);
                self.par(ks)
            }
            Config::Ff(ks) => {
                let ks = self.react_slots(ks, e);
                self.ff(ks)
            }
            Config::Any(k, ks) => {
                let ks = self.react_slots(ks, e);
                self.any(k, ks)
            }
            Config::Least(k, ks) => least(k, self.react_slots(ks, e)),
            Config::Shield(t, c) => shield(t, self.react(*c, e)),
            Config::ShieldK(t, c) => self.react_held_up(t, *c, e),
            Config::Fin1(c, f) => {
                let r = self.react(*c, e);
                self.fin1(r, &f)
            }
            Config::Fin2(o, c) => fin2(o, self.react(*c, e)),
            Config::Tag(t, c) => tag(&t, self.react(*c, e)),
            Config::Catch(c, arms) => {
                let r = self.react(*c, e);
                self.catch(r, &arms)
            }
            Config::Repeat(c, p, ts) => {
                let r = self.react(*c, e);
                self.repeat(r, &p, &ts, 1)
            }
            Config::Acquiring(u, res, f, v) if *e == Event::Granted(u) => self.granted(u, res, &f, v),
            Config::Acquiring(..) => R::C(c),
            Config::Holding(res, c) => {
                let r = self.react(*c, e);
                self.holding(res, r)
            }
            Config::Arec(k, cs, p, qs) => self.react_arec(*k, cs, (&p, &qs), e),
            Config::Ending(o, cs) => ending(o, self.react_all(cs, e)),
        }
    }

    fn react_all(&mut self, cs: Vec<Config>, e: &Event) -> Vec<R> {
        cs.into_iter().map(|c| self.react(c, e)).collect()
    }

    fn react_slots(&mut self, mut ks: Vec<Slot>, e: &Event) -> Vec<Slot> {
        for j in 0..ks.len() {
            if let Held::Runs(c) = ks[j].held.clone() {
                ks[j].held = match self.react(c, e) {
                    R::C(c) => Held::Runs(c),
                    R::O(o) => hold(o, &ks),
                };
            }
        }
        ks
    }

    fn react_active(&mut self, i: u32, n: u32, l: Vec<u32>, e: &Event) -> R {
        if concerns(e) != Some((i, n)) {
            return R::C(Config::Active(i, n, l));
        }
        self.disconnect(i, &l);
        R::O(match e {
            // [e-done], L7
            Event::Done(_, _, v) => match self.declared[i as usize] {
                Declared::Service => Outcome::Aborted(Reason::ServiceEnded(i)),
                Declared::Task | Declared::ServiceGroup => Outcome::Done(v.clone()),
            },
            // [e-abort]
            Event::Aborted(_, _, r) => Outcome::Aborted(Reason::Reported(i, r.clone())),
            // It stopped without an order: it failed.
            Event::Stopped(..) => Outcome::Aborted(Reason::Reported(i, vec![])),
            Event::Unconfirmed(..) => Outcome::Aborted(Reason::Unconfirmed(i)),
            Event::Start(_) | Event::Stop | Event::Elapsed(..) | Event::Granted(_) => {
                unreachable!("no event of a leaf")
            }
        })
    }

    fn react_stopping(&mut self, i: u32, n: u32, l: Vec<u32>, e: &Event) -> R {
        if concerns(e) != Some((i, n)) {
            return R::C(Config::Stopping(i, n, l));
        }
        self.disconnect(i, &l);
        R::O(match e {
            // [e-stopped]
            Event::Done(..) | Event::Aborted(..) | Event::Stopped(..) => Outcome::Killed,
            // [e-unconf]
            Event::Unconfirmed(..) => Outcome::Aborted(Reason::Unconfirmed(i)),
            Event::Start(_) | Event::Stop | Event::Elapsed(..) | Event::Granted(_) => {
                unreachable!("no event of a leaf")
            }
        })
    }

    fn disconnect(&mut self, i: u32, l: &[u32]) {
        self.busy.remove(&i);
        self.commands.extend(l.iter().map(|&set| Command::Disconnect(set)));
    }
}

impl World {
    pub(super) fn stop(&mut self, c: Config) -> R {
        match c {
            Config::Active(i, n, l) => {
                self.commands.push(Command::Stop(i, n));
                R::C(Config::Stopping(i, n, l))
            }
            Config::Stopping(..) => R::C(c),
            Config::Armed(t, n) => {
                self.commands.push(Command::Cancel(t, n));
                R::O(Outcome::Killed)
            }
            Config::Never => R::O(Outcome::Killed),
            Config::Seq(c, _) | Config::Cond(c, _) | Config::Else(c, _) | Config::Rec1(c, ..) | Config::Rec2(c, ..) => {
                self.stop(*c)
            }
            Config::Par(ks) | Config::Ff(ks) | Config::Any(_, ks) | Config::Least(_, ks) => {
                self.drain_stopping(Outcome::Killed, running(ks))
            }
            Config::Dis(cs) => self.drain_stopping(Outcome::Killed, cs),
            Config::Drain(o, cs) if is_unconfirmed(&o) => R::C(Config::Drain(o, cs)),
            Config::Drain(_, cs) => R::C(Config::Drain(Outcome::Killed, cs)),
            Config::Shield(t, c) => R::C(Config::ShieldK(t.map(|t| (t, self.arm(t))), c)),
            Config::ShieldK(..) => R::C(c),
            Config::Fin1(c, f) => {
                let r = self.stop(*c);
                self.fin1(r, &f)
            }
            Config::Fin2(o, c) if is_unconfirmed(&o) => R::C(Config::Fin2(o, c)),
            Config::Fin2(_, c) => R::C(Config::Fin2(Outcome::Killed, c)),
            Config::Tag(_, c) | Config::Repeat(c, ..) | Config::Catch(c, _) => self.stop(*c),
            Config::Acquiring(u, ..) => {
                self.queue.retain(|(other, _)| *other != u);
                R::O(Outcome::Killed)
            }
            Config::Holding(res, c) => {
                let r = self.stop(*c);
                self.holding(res, r)
            }
            Config::Arec(k, cs, ..) => {
                let p = if let Held::Runs(c) = *k { Some(c) } else { None };
                let rs = p.into_iter().chain(cs.into_iter().flatten()).map(|c| self.stop(c)).collect();
                ending(Outcome::Killed, rs)
            }
            Config::Ending(o, cs) => {
                let o = if is_unconfirmed(&o) { o } else { Outcome::Killed };
                ending(o, cs.into_iter().map(|c| self.stop(c)).collect())
            }
        }
    }
}

/// Returns the activation that an event is of.
fn concerns(e: &Event) -> Option<(u32, u32)> {
    match *e {
        Event::Done(i, n, _) | Event::Aborted(i, n, _) | Event::Stopped(i, n) | Event::Unconfirmed(i, n) => {
            Some((i, n))
        }
        Event::Start(_) | Event::Stop | Event::Elapsed(..) | Event::Granted(_) => None,
    }
}

pub(super) fn leaves(c: &Config, see: &mut impl FnMut(&Config)) {
    match c {
        Config::Active(..) | Config::Stopping(..) | Config::Armed(..) | Config::Never => see(c),
        Config::ShieldK(_, inner) => {
            see(c);
            leaves(inner, see);
        }
        Config::Shield(_, c)
        | Config::Holding(_, c)
        | Config::Fin1(c, _)
        | Config::Fin2(_, c)
        | Config::Tag(_, c)
        | Config::Repeat(c, ..)
        | Config::Catch(c, _) => leaves(c, see),
        Config::Acquiring(..) => {}
        Config::Arec(k, cs, ..) => {
            if let Held::Runs(c) = &**k {
                leaves(c, see);
            }
            cs.iter().flatten().for_each(|c| leaves(c, see));
        }
        Config::Seq(c, _) | Config::Cond(c, _) | Config::Else(c, _) | Config::Rec1(c, ..) | Config::Rec2(c, ..) => {
            leaves(c, see);
        }
        Config::Par(ks) | Config::Ff(ks) | Config::Any(_, ks) | Config::Least(_, ks) => {
            for k in ks {
                if let Held::Runs(c) = &k.held {
                    leaves(c, see);
                }
            }
        }
        Config::Dis(cs) | Config::Drain(_, cs) | Config::Ending(_, cs) => cs.iter().for_each(|c| leaves(c, see)),
    }
}

/// Removes everything that no longer matters: activation numbers, all aborts of a join but the first, and the value of
/// a service that `,` does not wait for.
pub(super) fn forget(c: Config) -> Config {
    let boxed = |c: Box<Config>| Box::new(forget(*c));
    let slots = |ks: Vec<Slot>| {
        let held = |held| match held {
            Held::Runs(c) => Held::Runs(forget(c)),
            Held::Aborted(1.., _) => Held::Aborted(1, Reason::Instant),
            Held::Done(_) | Held::Aborted(0, _) => held,
        };
        ks.into_iter().map(|k| Slot { held: held(k.held), ..k }).collect()
    };
    match c {
        Config::Active(i, _, l) => Config::Active(i, 0, l),
        Config::Stopping(i, _, l) => Config::Stopping(i, 0, l),
        Config::Armed(t, _) => Config::Armed(t, 0),
        Config::Never => Config::Never,
        Config::Seq(c, f) => Config::Seq(boxed(c), f),
        Config::Cond(c, f) => Config::Cond(boxed(c), f),
        Config::Else(c, f) => Config::Else(boxed(c), f),
        Config::Rec1(c, e, f) => Config::Rec1(boxed(c), e, f),
        Config::Rec2(c, e, f) => Config::Rec2(boxed(c), e, f),
        Config::Par(mut ks) => {
            let tasks = ks.iter().any(|k| !k.service);
            for k in ks.iter_mut().filter(|k| tasks && k.service) {
                if let Held::Done(u) = &mut k.held {
                    u.clear();
                }
            }
            Config::Par(slots(ks))
        }
        Config::Ff(ks) => Config::Ff(slots(ks)),
        Config::Any(k, ks) => Config::Any(k, slots(ks)),
        Config::Least(k, ks) => Config::Least(k, slots(ks)),
        Config::Dis(cs) => Config::Dis(cs.into_iter().map(forget).collect()),
        Config::Drain(o, cs) => Config::Drain(o, cs.into_iter().map(forget).collect()),
        Config::Ending(o, cs) => Config::Ending(o, cs.into_iter().map(forget).collect()),
        Config::Shield(t, c) => Config::Shield(t, boxed(c)),
        Config::Fin1(c, f) => Config::Fin1(boxed(c), f),
        Config::Fin2(o, c) => Config::Fin2(o, boxed(c)),
        Config::Tag(t, c) => Config::Tag(t, boxed(c)),
        Config::Repeat(c, e, ts) => Config::Repeat(boxed(c), e, ts),
        Config::Catch(c, arms) => Config::Catch(boxed(c), arms),
        Config::ShieldK(t, c) => Config::ShieldK(t.map(|(t, _)| (t, 0)), boxed(c)),
        Config::Acquiring(..) => c,
        Config::Holding(res, c) => Config::Holding(res, boxed(c)),
        Config::Arec(k, cs, p, qs) => {
            let k = match *k {
                Held::Runs(c) => Held::Runs(forget(c)),
                held @ (Held::Done(_) | Held::Aborted(..)) => held,
            };
            Config::Arec(Box::new(k), cs.into_iter().map(|c| c.map(forget)).collect(), p, qs)
        }
    }
}
