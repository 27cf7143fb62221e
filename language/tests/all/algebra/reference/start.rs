//! `v |- E ~> R`: the start rules.

use super::World;
use super::completion::{Phase, hold, least};
use super::scopes::{shield, tag};
use super::term::{Command, Config, Declared, Held, Outcome, R, Reason, Slot, Term, Value};

impl World {
    /// `v |- E ~> R`
    #[expect(clippy::too_many_lines, reason = "one arm for each operator")]
    pub(super) fn start(&mut self, e: &Term, v: Value) -> R {
        match e {
            // [s-busy]
            Term::Leaf(i, _) if self.busy.contains(i) => R::O(Outcome::Aborted(Reason::Busy(*i))),
            // [s-leaf]
            Term::Leaf(i, l) => {
                let n = self.epochs.get(i).copied().unwrap_or(0) + 1;
                self.epochs.insert(*i, n);
                self.busy.insert(*i);
                self.commands.extend(l.iter().map(|&set| Command::Connect(set)));
                self.commands.push(Command::Activate(*i, n, v));
                R::C(Config::Active(*i, n, l.clone()))
            }
            // [s-const]
            Term::Skip => R::O(Outcome::Done(vec![])),
            Term::Fail(r) => R::O(Outcome::Aborted(Reason::Failed(r.clone()))),
            Term::Never => R::C(Config::Never),
            Term::Wait(t) => {
                let n = self.arm(*t);
                R::C(Config::Armed(*t, n))
            }
            // [s-seq] [s-cond] [s-rec]
            Term::Seq(e, f) => {
                let r = self.start(e, v);
                self.seq(r, f)
            }
            Term::Cond(e, f) => {
                let r = self.start(e, v);
                self.cond(r, f)
            }
            Term::Else(e, f) => {
                let r = self.start(e, v);
                self.or_else(r, f)
            }
            Term::Rec(e, f) => {
                let r = self.start(e, v);
                self.rec1(r, e, f, &[Phase::P])
            }
            // [s-par]
            Term::Par(es) => {
                let ks = self.start_all(es, &v);
                self.par(ks)
            }
            Term::Ff(es) => {
                let ks = self.start_all(es, &v);
                self.ff(ks)
            }
            Term::Match(arms) => self.start_match(arms, v),
            Term::Shield(t, e) => {
                let r = self.start(e, v);
                shield(*t, r)
            }
            Term::Using(u, res, e) => self.start_using(*u, res, e, v),
            Term::Arec(e, fs) => {
                let r = self.start(e, v);
                self.arec(r, vec![None; fs.len()], e, fs)
            }
            Term::Fin(e, f) => {
                let r = self.start(e, v);
                self.fin1(r, f)
            }
            Term::Tag(t, e) => {
                let r = self.start(e, v);
                tag(t, r)
            }
            // [s-with]: the outcome is that of E, so nothing of it is left.
            Term::With(u, e) => self.start(e, u.clone()),
            // [s-named]: the value takes the place of its name, so nothing has to keep it.
            Term::Named(p, e) => self.start(&e.replaced(p, &v), vec![]),
            Term::WithName(p, _) => unreachable!("`{p}` is replaced before it is started"),
            Term::Catch(e, arms) => {
                let r = self.start(e, v);
                self.catch(r, arms)
            }
            Term::Repeat(ts, e) => {
                let r = self.start(e, v);
                self.repeat(r, e, ts, 0)
            }
            Term::Any(k, es) => {
                let ks = self.start_all(es, &v);
                self.any(*k, ks)
            }
            Term::Least(k, es) => {
                let ks = self.start_all(es, &v);
                least(*k, ks)
            }
            // [s-dis]
            Term::Dis(es) => {
                let rs = self.start_until_one_ends(es, &v);
                self.dis(rs)
            }
        }
    }

    fn start_until_one_ends(&mut self, es: &[Term], v: &Value) -> Vec<R> {
        let mut rs = Vec::new();
        for e in es {
            let r = self.start(e, v.clone());
            let ended = matches!(r, R::O(_));
            rs.push(r);
            if ended {
                break;
            }
        }
        rs
    }

    pub(super) fn arm(&mut self, t: u32) -> u32 {
        let n = self.arms.get(&t).copied().unwrap_or(0) + 1;
        self.arms.insert(t, n);
        self.commands.push(Command::Arm(t, n));
        n
    }

    fn start_all(&mut self, es: &[Term], v: &Value) -> Vec<Slot> {
        let mut ks: Vec<Slot> = Vec::new();
        for e in es {
            let held = match self.start(e, v.clone()) {
                R::C(c) => Held::Runs(c),
                R::O(o) => hold(o, &ks),
            };
            ks.push(Slot { service: self.service(e), held });
        }
        ks
    }

    /// service(E): no fault-free run of E ends.
    pub(super) fn service(&self, e: &Term) -> bool {
        match e {
            Term::Leaf(i, _) => self.declared[*i as usize] != Declared::Task,
            Term::Never | Term::Rec(..) | Term::Arec(..) => true,
            Term::Skip | Term::Fail(_) | Term::Wait(_) => false,
            Term::Seq(e, f) | Term::Cond(e, f) | Term::Fin(e, f) => self.service(e) || self.service(f),
            Term::Else(e, _)
            | Term::Shield(_, e)
            | Term::Using(_, _, e)
            | Term::Tag(_, e)
            | Term::With(_, e)
            | Term::Named(_, e)
            | Term::WithName(_, e)
            | Term::Repeat(_, e)
            | Term::Catch(e, _) => self.service(e),
            Term::Match(arms) => arms.iter().all(|(_, e)| self.service(e)),
            Term::Par(es) | Term::Dis(es) => es.iter().all(|e| self.service(e)),
            Term::Ff(es) | Term::Least(_, es) => es.iter().any(|e| self.service(e)),
            Term::Any(k, es) => es.iter().filter(|e| !self.service(e)).count() < *k,
        }
    }
}
