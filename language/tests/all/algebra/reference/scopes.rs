//! MATCH, SHIELD, USING, AREC, FIN, TAG, REPEAT, CATCH.

use super::World;
use super::completion::{collect, is_unconfirmed, words};
use super::term::{Asked, Command, Config, Event, Held, Outcome, R, Reason, Term, Value};

impl World {
    /// [s-match]
    pub(super) fn start_match(&mut self, arms: &[(Option<String>, Term)], v: Value) -> R {
        let (tag, rest) = split(&v);
        match arms.iter().find(|(t, _)| t.is_none() || *t == tag) {
            Some((Some(_), e)) => self.start(e, rest),
            Some((None, e)) => self.start(e, v),
            None => R::O(Outcome::Aborted(Reason::NoMatch)),
        }
    }

    /// [s-using]
    pub(super) fn start_using(&mut self, u: u32, res: &[String], e: &Term, v: Value) -> R {
        if self.may_have(res, self.queue.len()) {
            return self.acquired(res.to_vec(), e, v);
        }
        self.queue.push((u, res.to_vec()));
        R::C(Config::Acquiring(u, res.to_vec(), e.clone(), v))
    }

    fn may_have(&self, res: &[String], before: usize) -> bool {
        let is_wanted = |r: &String| self.queue.iter().take(before).any(|(_, wanted)| wanted.contains(r));
        res.iter().all(|r| !self.held.contains(r) && !is_wanted(r))
    }

    /// The `using` that is next.
    pub(super) fn next(&self) -> Option<u32> {
        let mut waiting = self.queue.iter().enumerate();
        waiting.find(|(place, (_, res))| self.may_have(res, *place)).map(|(_, (u, _))| *u)
    }

    /// [e-grant]
    pub(super) fn granted(&mut self, u: u32, res: Vec<String>, e: &Term, v: Value) -> R {
        self.queue.retain(|(other, _)| *other != u);
        self.acquired(res, e, v)
    }

    fn acquired(&mut self, res: Vec<String>, e: &Term, v: Value) -> R {
        self.held.extend(res.iter().cloned());
        let r = self.start(e, v);
        self.holding(res, r)
    }

    /// USING
    pub(super) fn holding(&mut self, res: Vec<String>, r: R) -> R {
        match r {
            R::C(c) => R::C(Config::Holding(res, Box::new(c))),
            R::O(o) => {
                self.held.retain(|r| !res.contains(r));
                R::O(o)
            }
        }
    }

    /// A shield that holds up a stop.
    pub(super) fn react_held_up(&mut self, t: Option<(u32, u32)>, c: Config, e: &Event) -> R {
        // [e-bound]
        if let Some((timer, n)) = t
            && *e == Event::Elapsed(timer, n)
        {
            return self.stop(c);
        }
        match self.react(c, e) {
            R::C(c) => R::C(Config::ShieldK(t, Box::new(c))),
            R::O(o) => {
                self.commands.extend(t.map(|(timer, n)| Command::Cancel(timer, n)));
                R::O(if is_unconfirmed(&o) { o } else { Outcome::Killed })
            }
        }
    }

    pub(super) fn react_arec(
        &mut self,
        k: Held,
        mut cs: Vec<Option<Config>>,
        (p, qs): (&Term, &[Term]),
        e: &Event,
    ) -> R {
        for j in 0..cs.len() {
            let Some(c) = cs[j].take() else { continue };
            match self.react(c, e) {
                R::C(c) => cs[j] = Some(c),
                R::O(Outcome::Done(_)) => {}
                R::O(o) => return self.arec_ending(o, Some(k), cs),
            }
        }
        match k {
            Held::Runs(c) => {
                let r = self.react(c, e);
                self.arec(r, cs, p, qs)
            }
            Held::Done(u) => self.arec(R::O(Outcome::Done(u)), cs, p, qs),
            Held::Aborted(..) => panic!("an abort of the source ends the loop"),
        }
    }

    /// AREC, with the result of P.
    pub(super) fn arec(&mut self, mut r: R, mut cs: Vec<Option<Config>>, p: &Term, qs: &[Term]) -> R {
        let mut rounds = 0;
        loop {
            let u = match r {
                R::C(c) => return R::C(Config::Arec(Box::new(Held::Runs(c)), cs, p.clone(), qs.to_vec())),
                R::O(Outcome::Done(u)) => u,
                R::O(o) => return self.arec_ending(o, None, cs),
            };
            // A pool that is not full after this many rounds never will be.
            if rounds > qs.len() {
                return self.arec_ending(Outcome::Aborted(Reason::Instant), None, cs);
            }
            let Some(j) = cs.iter().position(Option::is_none) else {
                return R::C(Config::Arec(Box::new(Held::Done(u)), cs, p.clone(), qs.to_vec()));
            };
            match self.start(&qs[j], u) {
                R::C(c) => cs[j] = Some(c),
                R::O(Outcome::Done(_)) => {}
                R::O(o) => return self.arec_ending(o, None, cs),
            }
            r = self.start(p, vec![]);
            rounds += 1;
        }
    }

    fn arec_ending(&mut self, o: Outcome, k: Option<Held>, cs: Vec<Option<Config>>) -> R {
        let mut rs = vec![];
        if let Some(Held::Runs(c)) = k {
            rs.push(self.stop(c));
        }
        rs.extend(cs.into_iter().flatten().map(R::C));
        ending(o, rs)
    }
}

impl World {
    /// CATCH
    pub(super) fn catch(&mut self, r: R, arms: &[(Option<Asked>, Term)]) -> R {
        let r = match r {
            R::C(c) => return R::C(Config::Catch(Box::new(c), arms.to_vec())),
            R::O(Outcome::Aborted(r)) => r,
            R::O(o) => return R::O(o),
        };
        match arms.iter().find(|(asked, _)| asked.as_ref().is_none_or(|asked| is_for(asked, &r))) {
            Some((_, f)) => self.start(f, words(r)),
            None => R::O(Outcome::Aborted(r)),
        }
    }

    /// REPEAT; `rounds` may still begin in this reaction.
    pub(super) fn repeat(&mut self, r: R, e: &Term, ts: &[String], rounds: usize) -> R {
        match r {
            R::C(c) => R::C(Config::Repeat(Box::new(c), e.clone(), ts.to_vec())),
            R::O(Outcome::Done(v)) if split(&v).0.is_none_or(|t| !ts.contains(&t)) => match rounds {
                0 => R::O(Outcome::Aborted(Reason::Instant)),
                left => {
                    let r = self.start(e, vec![]);
                    self.repeat(r, e, ts, left - 1)
                }
            },
            R::O(o) => R::O(o),
        }
    }

    /// FIN1
    pub(super) fn fin1(&mut self, r: R, f: &Term) -> R {
        match r {
            R::C(c) => R::C(Config::Fin1(Box::new(c), f.clone())),
            R::O(o) => {
                let r = self.start(f, vec![]);
                fin2(o, r)
            }
        }
    }
}

/// FIN2: the first failure counts, and no unconfirmed stop is lost.
pub(super) fn fin2(o: Outcome, r: R) -> R {
    match r {
        R::C(c) => R::C(Config::Fin2(o, Box::new(c))),
        R::O(last) if is_unconfirmed(&last) && !is_unconfirmed(&o) => R::O(last),
        R::O(Outcome::Aborted(r)) if matches!(o, Outcome::Done(_)) => R::O(Outcome::Aborted(r)),
        R::O(_) => R::O(o),
    }
}

/// TAG
pub(super) fn tag(t: &str, r: R) -> R {
    match r {
        R::C(c) => R::C(Config::Tag(t.to_owned(), Box::new(c))),
        R::O(Outcome::Done(v)) => {
            let length = u8::try_from(t.len()).expect("a tag of a test is short");
            R::O(Outcome::Done([&[length], t.as_bytes(), &v].concat()))
        }
        R::O(o) => R::O(o),
    }
}

pub(super) fn shield(t: Option<u32>, r: R) -> R {
    match r {
        R::C(c) => R::C(Config::Shield(t, Box::new(c))),
        R::O(o) => R::O(o),
    }
}

pub(super) fn ending(o: Outcome, rs: Vec<R>) -> R {
    match collect(o, rs) {
        (o, cs) if cs.is_empty() => R::O(o),
        (o, cs) => R::C(Config::Ending(o, cs)),
    }
}

/// Whether an arm takes a failure: of a text, also of one that a group or an activity inside reports.
fn is_for(asked: &Asked, r: &Reason) -> bool {
    let text = |why: &str| if why.starts_with("the deadline `") { Asked::Timeout } else { Asked::Text(why.to_owned()) };
    let reason = match r {
        Reason::Failed(why) => text(why),
        Reason::Instant => text("a round of a loop took no time"),
        Reason::Reported(_, v) => match (v.as_slice(), text_of(v)) {
            (_, Some(why)) => text(why),
            ([0, 1], _) => Asked::Busy,
            ([0, 2], _) => Asked::ServiceEnded,
            ([0, 3], _) => Asked::NoMatch,
            ([0, 4], _) => Asked::Crash,
            ([0, 5], _) => Asked::HostLost,
            (_, None) => Asked::Reported,
        },
        Reason::Busy(_) => Asked::Busy,
        Reason::Unconfirmed(_) => Asked::Unconfirmed,
        Reason::ServiceEnded(_) => Asked::ServiceEnded,
        Reason::NoMatch => Asked::NoMatch,
    };
    reason == *asked
}

/// The text of a report: its length, and its bytes.
fn text_of(v: &Value) -> Option<&str> {
    let (&length, rest) = v.split_first()?;
    let is_short = length < 128 && usize::from(length) == rest.len();
    std::str::from_utf8(rest).ok().filter(|_| is_short)
}

/// The tag of a value, and the value behind it.
fn split(v: &Value) -> (Option<String>, Value) {
    let length = usize::from(v.first().copied().unwrap_or(0));
    match v.get(1..=length).map(|tag| String::from_utf8(tag.to_vec())) {
        Some(Ok(tag)) if (1..=64).contains(&length) => (Some(tag), v[1 + length..].to_vec()),
        Some(Ok(_) | Err(_)) | None => (None, vec![]),
    }
}

impl Term {
    /// The term in which a value stands for a name.
    pub(super) fn replaced(&self, name: &str, value: &Value) -> Self {
        let mut term = self.clone();
        if let Self::WithName(known, e) = self
            && known == name
        {
            term = Self::With(value.clone(), e.clone());
        }
        term.parts_mut().into_iter().for_each(|part| *part = part.replaced(name, value));
        term
    }

    /// Counts the `using`s.
    pub(super) fn usings(&self) -> usize {
        let own = usize::from(matches!(self, Self::Using(..)));
        own + self.parts().into_iter().map(Self::usings).sum::<usize>()
    }

    /// The direct parts, left to right.
    pub(crate) fn parts(&self) -> Vec<&Self> {
        match self {
            Self::Leaf(..) | Self::Skip | Self::Never | Self::Fail(_) | Self::Wait(_) => vec![],
            Self::Seq(e, f) | Self::Cond(e, f) | Self::Rec(e, f) | Self::Else(e, f) | Self::Fin(e, f) => vec![e, f],
            Self::Par(es) | Self::Ff(es) | Self::Any(_, es) | Self::Least(_, es) | Self::Dis(es) => es.iter().collect(),
            Self::Match(arms) => arms.iter().map(|(_, e)| e).collect(),
            Self::Shield(_, e)
            | Self::Using(_, _, e)
            | Self::Tag(_, e)
            | Self::With(_, e)
            | Self::Named(_, e)
            | Self::WithName(_, e)
            | Self::Repeat(_, e) => vec![e],
            Self::Arec(e, fs) => std::iter::once(&**e).chain(fs).collect(),
            Self::Catch(e, arms) => std::iter::once(&**e).chain(arms.iter().map(|(_, f)| f)).collect(),
        }
    }

    /// The direct parts, left to right.
    pub(crate) fn parts_mut(&mut self) -> Vec<&mut Self> {
        match self {
            Self::Leaf(..) | Self::Skip | Self::Never | Self::Fail(_) | Self::Wait(_) => vec![],
            Self::Seq(e, f) | Self::Cond(e, f) | Self::Rec(e, f) | Self::Else(e, f) | Self::Fin(e, f) => vec![e, f],
            Self::Par(es) | Self::Ff(es) | Self::Any(_, es) | Self::Least(_, es) | Self::Dis(es) => {
                es.iter_mut().collect()
            }
            Self::Match(arms) => arms.iter_mut().map(|(_, e)| e).collect(),
            Self::Shield(_, e)
            | Self::Using(_, _, e)
            | Self::Tag(_, e)
            | Self::With(_, e)
            | Self::Named(_, e)
            | Self::WithName(_, e)
            | Self::Repeat(_, e) => vec![e],
            Self::Arec(e, fs) => std::iter::once(&mut **e).chain(fs).collect(),
            Self::Catch(e, arms) => std::iter::once(&mut **e).chain(arms.iter_mut().map(|(_, f)| f)).collect(),
        }
    }
}
