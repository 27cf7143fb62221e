//! The rules of the language as rewriting of terms, without values: `done`, `aborted` and `killed` are all that counts.

#[path = "universe.rs"]
mod universe;

use language::plan::Expression;
use std::time::Duration;
pub(crate) use universe::Universe;

/// An expression.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Expr {
    Leaf(usize),
    Skip,
    Never,
    Fail,
    /// Each has its number, so that two that run side by side are two.
    Wait(u32),
    Seq(Box<Self>, Box<Self>),
    Else(Box<Self>, Box<Self>),
    Rec(Box<Self>, Box<Self>),
    Finally(Box<Self>, Box<Self>),
    Shield(Box<Self>),
    Par(Vec<Self>),
    FailFast(Vec<Self>),
    Disable(Vec<Self>),
    Any(u32, Vec<Self>),
}

/// How something ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum End {
    Done,
    Aborted,
    Killed,
}

/// A slot of something that runs side by side.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Slot {
    Runs(Box<Config>),
    Done,
    Aborted,
    /// A service that has ended without harm: nobody waits for it.
    Gone,
}

/// An expression that runs.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Config {
    Active(usize),
    Stopping(usize),
    Timer(u32),
    Never,
    Seq(Box<Self>, Expr),
    Else(Box<Self>, Expr),
    RecP(Box<Self>, Expr, Expr),
    RecQ(Box<Self>, Expr, Expr),
    Fin1(Box<Self>, Expr),
    Fin2(End, Box<Self>),
    Shield(Box<Self>),
    Held(Box<Self>),
    Par(Vec<Slot>, Vec<Expr>),
    FailFast(Vec<Slot>),
    Any(u32, Vec<Slot>),
    Disable(Vec<Self>),
    Drain(End, Vec<Self>),
    /// What was stopped of `P ; Q` and the like: `Q` is forgotten.
    Only(Box<Self>),
}

/// What a step leads to.
enum Then {
    Goes(Config),
    Ends(End),
}

use Then::{Ends, Goes};

/// Where the whole is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Phase {
    Idle,
    Running,
    Stopping,
    Done,
    Aborted,
    Stopped,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Event {
    Done(usize),
    Aborted(usize),
    Stopped(usize),
    Elapsed(u32),
}

impl Expr {
    /// The expression of a plan.
    pub(crate) fn lower(&self) -> Expression {
        let one = |expr: &Self| Box::new(expr.lower());
        let all = |of: &[Self]| of.iter().map(Self::lower).collect();
        match self {
            Self::Leaf(leaf) => Expression::Run { member: u32::try_from(*leaf).unwrap_or(u32::MAX), sets: Vec::new() },
            Self::Skip => Expression::Skip,
            Self::Never => Expression::Never,
            Self::Fail => Expression::Fail("no".to_owned()),
            Self::Wait(_) => Expression::Wait(Duration::from_secs(1)),
            Self::Seq(p, q) => Expression::Sequence(one(p), one(q)),
            Self::Else(p, q) => Expression::Otherwise(one(p), one(q)),
            Self::Rec(p, q) => Expression::Recurrent(one(p), one(q)),
            Self::Finally(p, q) => Expression::Finally(one(p), one(q)),
            Self::Shield(p) => Expression::Shield { bound: None, of: one(p) },
            Self::Par(of) => Expression::Concurrent(all(of)),
            Self::FailFast(of) => Expression::FailFast(all(of)),
            Self::Disable(of) => Expression::Disable(all(of)),
            Self::Any(count, of) => Expression::AnyOf { count: *count, of: all(of) },
        }
    }

    /// Whether no run of it without failures ends.
    fn is_service(&self, services: &[bool]) -> bool {
        let of = |expr: &Self| expr.is_service(services);
        match self {
            Self::Leaf(leaf) => services[*leaf],
            Self::Skip | Self::Fail | Self::Wait(_) => false,
            Self::Never | Self::Rec(..) => true,
            Self::Seq(p, q) | Self::Finally(p, q) => of(p) || of(q),
            Self::Else(p, _) | Self::Shield(p) => of(p),
            Self::Par(parts) | Self::Disable(parts) => parts.iter().all(of),
            Self::FailFast(parts) => parts.iter().any(of),
            Self::Any(count, parts) => parts.iter().filter(|part| !of(part)).count() < *count as usize,
        }
    }
}

/// The rules, for processes of which some are services.
struct Rules<'r> {
    services: &'r [bool],
}

impl Rules<'_> {
    /// `E` starts.
    fn start(&self, expr: &Expr) -> Then {
        match expr {
            Expr::Leaf(leaf) => Goes(Config::Active(*leaf)),
            Expr::Skip => Ends(End::Done),
            Expr::Never => Goes(Config::Never),
            Expr::Fail => Ends(End::Aborted),
            Expr::Wait(number) => Goes(Config::Timer(*number)),
            Expr::Seq(p, q) => self.seq(self.start(p), q),
            Expr::Else(p, q) => self.or_else(self.start(p), q),
            Expr::Rec(p, q) => self.rec_p(self.start(p), p, q),
            Expr::Finally(p, q) => self.fin1(self.start(p), q),
            Expr::Shield(p) => shield(self.start(p)),
            Expr::Par(of) => {
                let ended: Vec<Then> = of.iter().map(|part| self.start(part)).collect();
                let slots = ended.into_iter().map(Some).collect();
                self.par(vec![Slot::Gone; of.len()], slots, of)
            }
            Expr::FailFast(of) => fail_fast(of.iter().map(|part| slot(self.start(part))).collect()).then_stop(self),
            Expr::Any(count, of) => any(*count, of.iter().map(|part| slot(self.start(part))).collect()).then_stop(self),
            Expr::Disable(of) => {
                let mut started = Vec::new();
                for part in of {
                    match self.start(part) {
                        Goes(config) => started.push(config),
                        Ends(end) => return self.drain(end, started),
                    }
                }
                Goes(Config::Disable(started))
            }
        }
    }

    fn seq(&self, first: Then, next: &Expr) -> Then {
        match first {
            Goes(config) => Goes(Config::Seq(Box::new(config), next.clone())),
            Ends(End::Done) => self.start(next),
            Ends(end) => Ends(end),
        }
    }

    fn or_else(&self, first: Then, next: &Expr) -> Then {
        match first {
            Goes(config) => Goes(Config::Else(Box::new(config), next.clone())),
            Ends(End::Aborted) => self.start(next),
            Ends(end) => Ends(end),
        }
    }

    fn rec_p(&self, first: Then, p: &Expr, q: &Expr) -> Then {
        match first {
            Goes(config) => Goes(Config::RecP(Box::new(config), p.clone(), q.clone())),
            Ends(End::Done) => self.rec_q(self.start(q), p, q),
            Ends(end) => Ends(end),
        }
    }

    fn rec_q(&self, second: Then, p: &Expr, q: &Expr) -> Then {
        match second {
            Goes(config) => Goes(Config::RecQ(Box::new(config), p.clone(), q.clone())),
            Ends(End::Done) => self.rec_p(self.start(p), p, q),
            Ends(end) => Ends(end),
        }
    }

    fn fin1(&self, first: Then, last: &Expr) -> Then {
        match first {
            Goes(config) => Goes(Config::Fin1(Box::new(config), last.clone())),
            Ends(end) => fin2(end, self.start(last)),
        }
    }

    /// `,` after some of its parts have moved: a lost service fails it, and it ends with its last task.
    fn par(&self, mut slots: Vec<Slot>, moved: Vec<Option<Then>>, of: &[Expr]) -> Then {
        let services: Vec<bool> = of.iter().map(|part| part.is_service(self.services)).collect();
        let all = services.iter().all(|service| *service);
        let mut is_lost = false;
        for (index, then) in moved.into_iter().enumerate() {
            match then {
                None => {}
                Some(Goes(config)) => slots[index] = Slot::Runs(Box::new(config)),
                Some(Ends(End::Aborted)) if services[index] => {
                    slots[index] = Slot::Gone;
                    is_lost = true;
                }
                Some(Ends(_)) if services[index] && !all => slots[index] = Slot::Gone,
                Some(Ends(End::Done | End::Killed)) => slots[index] = Slot::Done,
                Some(Ends(End::Aborted)) => slots[index] = Slot::Aborted,
            }
        }
        if is_lost {
            return self.drain(End::Aborted, configs(slots));
        }
        let waits = |(index, slot): (usize, &Slot)| matches!(slot, Slot::Runs(_)) && (all || !services[index]);
        if slots.iter().enumerate().any(waits) {
            return Goes(Config::Par(slots, of.to_vec()));
        }
        let end = if slots.contains(&Slot::Aborted) { End::Aborted } else { End::Done };
        self.drain(end, configs(slots))
    }

    /// Everything that runs is stopped; the end is decided.
    fn drain(&self, end: End, parts: Vec<Config>) -> Then {
        let left = parts.into_iter().filter_map(|part| match self.stop(part) {
            Goes(config) => Some(config),
            Ends(_) => None,
        });
        drained(end, left.collect())
    }

    fn stop(&self, config: Config) -> Then {
        match config {
            Config::Active(leaf) | Config::Stopping(leaf) => Goes(Config::Stopping(leaf)),
            Config::Timer(_) | Config::Never => Ends(End::Killed),
            Config::Seq(first, _)
            | Config::Else(first, _)
            | Config::RecP(first, ..)
            | Config::RecQ(first, ..)
            | Config::Only(first) => only(self.stop(*first)),
            Config::Fin1(first, last) => self.fin1(self.stop(*first), &last),
            Config::Fin2(_, second) => Goes(Config::Fin2(End::Killed, second)),
            Config::Shield(inner) | Config::Held(inner) => Goes(Config::Held(inner)),
            Config::Par(slots, _) | Config::FailFast(slots) | Config::Any(_, slots) => {
                self.drain(End::Killed, configs(slots))
            }
            Config::Disable(parts) => self.drain(End::Killed, parts),
            Config::Drain(_, parts) => Goes(Config::Drain(End::Killed, parts)),
        }
    }

    /// One event; nothing if it does not concern this part.
    fn react(&self, config: &Config, event: Event) -> Option<Then> {
        Some(match config {
            Config::Active(leaf) => match event {
                Event::Done(other) if other == *leaf => Ends(End::Done),
                Event::Aborted(other) if other == *leaf => Ends(End::Aborted),
                Event::Done(_) | Event::Aborted(_) | Event::Stopped(_) | Event::Elapsed(_) => return None,
            },
            Config::Stopping(leaf) if event == Event::Stopped(*leaf) => Ends(End::Killed),
            Config::Timer(number) if event == Event::Elapsed(*number) => Ends(End::Done),
            Config::Stopping(_) | Config::Timer(_) | Config::Never => return None,
            Config::Seq(first, next) => self.seq(self.react(first, event)?, next),
            Config::Else(first, next) => self.or_else(self.react(first, event)?, next),
            Config::RecP(first, p, q) => self.rec_p(self.react(first, event)?, p, q),
            Config::RecQ(second, p, q) => self.rec_q(self.react(second, event)?, p, q),
            Config::Fin1(first, last) => self.fin1(self.react(first, event)?, last),
            Config::Fin2(end, second) => fin2(*end, self.react(second, event)?),
            Config::Only(first) => only(self.react(first, event)?),
            Config::Shield(inner) => shield(self.react(inner, event)?),
            Config::Held(inner) => match self.react(inner, event)? {
                Goes(config) => Goes(Config::Held(Box::new(config))),
                Ends(_) => Ends(End::Killed),
            },
            Config::Par(slots, of) => {
                let (index, then) = self.react_in(slots, event)?;
                let mut moved: Vec<Option<Then>> = slots.iter().map(|_| None).collect();
                moved[index] = Some(then);
                self.par(slots.clone(), moved, of)
            }
            Config::FailFast(slots) => fail_fast(self.moved(slots, event)?).then_stop(self),
            Config::Any(count, slots) => any(*count, self.moved(slots, event)?).then_stop(self),
            Config::Disable(parts) => {
                let (index, then) = self.react_among(parts, event)?;
                let mut parts = parts.clone();
                match then {
                    Goes(config) => {
                        parts[index] = config;
                        Goes(Config::Disable(parts))
                    }
                    Ends(end) => {
                        parts.remove(index);
                        self.drain(end, parts)
                    }
                }
            }
            Config::Drain(end, parts) => {
                let (index, then) = self.react_among(parts, event)?;
                let mut parts = parts.clone();
                match then {
                    Goes(config) => parts[index] = config,
                    Ends(_) => drop(parts.remove(index)),
                }
                drained(*end, parts)
            }
        })
    }

    fn react_among(&self, parts: &[Config], event: Event) -> Option<(usize, Then)> {
        parts.iter().enumerate().find_map(|(index, part)| Some((index, self.react(part, event)?)))
    }

    fn react_in(&self, slots: &[Slot], event: Event) -> Option<(usize, Then)> {
        slots.iter().enumerate().find_map(|(index, slot)| match slot {
            Slot::Runs(config) => Some((index, self.react(config, event)?)),
            Slot::Done | Slot::Aborted | Slot::Gone => None,
        })
    }

    fn moved(&self, slots: &[Slot], event: Event) -> Option<Vec<Slot>> {
        let (index, then) = self.react_in(slots, event)?;
        let mut slots = slots.to_vec();
        slots[index] = slot(then);
        Some(slots)
    }
}

impl Then {
    /// What `&` and `any` have decided is a drain whose parts still have to be stopped.
    fn then_stop(self, rules: &Rules<'_>) -> Self {
        if let Goes(Config::Drain(end, parts)) = self { rules.drain(end, parts) } else { self }
    }
}

fn slot(then: Then) -> Slot {
    match then {
        Goes(config) => Slot::Runs(Box::new(config)),
        Ends(End::Aborted) => Slot::Aborted,
        Ends(End::Done | End::Killed) => Slot::Done,
    }
}

fn configs(slots: Vec<Slot>) -> Vec<Config> {
    let running = slots.into_iter().filter_map(|slot| match slot {
        Slot::Runs(config) => Some(*config),
        Slot::Done | Slot::Aborted | Slot::Gone => None,
    });
    running.collect()
}

/// Decides; what runs is still to be stopped.
fn fail_fast(slots: Vec<Slot>) -> Then {
    if slots.contains(&Slot::Aborted) {
        return Goes(Config::Drain(End::Aborted, configs(slots)));
    }
    if slots.iter().all(|slot| *slot == Slot::Done) {
        return Ends(End::Done);
    }
    Goes(Config::FailFast(slots))
}

fn any(count: u32, slots: Vec<Slot>) -> Then {
    let of = |wanted: fn(&Slot) -> bool| slots.iter().filter(|slot| wanted(slot)).count();
    let (done, running) = (of(|slot| *slot == Slot::Done), of(|slot| matches!(slot, Slot::Runs(_))));
    if done >= count as usize {
        return Goes(Config::Drain(End::Done, configs(slots)));
    }
    if done + running < count as usize {
        return Goes(Config::Drain(End::Aborted, configs(slots)));
    }
    Goes(Config::Any(count, slots))
}

fn shield(inner: Then) -> Then {
    match inner {
        Goes(config) => Goes(Config::Shield(Box::new(config))),
        Ends(end) => Ends(end),
    }
}

fn only(first: Then) -> Then {
    match first {
        Goes(config) => Goes(Config::Only(Box::new(config))),
        Ends(_) => Ends(End::Killed),
    }
}

fn fin2(end: End, last: Then) -> Then {
    match last {
        Goes(config) => Goes(Config::Fin2(end, Box::new(config))),
        Ends(End::Aborted) if end == End::Done => Ends(End::Aborted),
        Ends(_) => Ends(end),
    }
}

fn drained(end: End, parts: Vec<Config>) -> Then {
    if parts.is_empty() { Ends(end) } else { Goes(Config::Drain(end, parts)) }
}
