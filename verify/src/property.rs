//! The sentences of `verify` blocks. Each is checked in the smallest system that contains the named processes.

mod formula;
mod loss;
pub(crate) mod monitor;
mod scope;
mod stops;
mod watch;

use crate::explore::{Found, Graph, Limits, WorkDone, explore};
use crate::finding::{Assumption, Finding, Verdict, diagnostic, help};
use crate::model::Model;
use crate::story::{seconds, story, tell};
use crate::system::MemberRef;
use crate::system::{FaultKind, Frame, Injection, Label, Mode, Phase, System, crashes};
use crate::times::Times;
use language::Code;
use language::plan::MemberKind;
use language::sites::{Consequence, Fault, Moment, ProcessRef, Property, Sentence};
use std::time::Duration;
use watch::{Forbidden, Goal, Watch};

/// Answers every sentence.
pub(crate) fn check(times: &Times<'_, '_>, limits: &Limits<'_>) -> Vec<Finding> {
    let of = times.model.sites.properties.len();
    let answer = |(done, property): (usize, &Property)| {
        limits.goes_on.hear(WorkDone::Jobs { what: "sentences", done, of });
        let found = Question { times, limits, property }.answer()?;
        Some(Finding { place: Some(property.span), ..found })
    };
    times.model.sites.properties.iter().enumerate().filter_map(answer).collect()
}

/// One sentence about one group.
struct Question<'q, 'm, 'a> {
    times: &'q Times<'m, 'a>,
    limits: &'q Limits<'q>,
    property: &'q Property,
}

impl<'m, 'a> Question<'_, 'm, 'a> {
    fn answer(&self) -> Option<Finding> {
        self.times.take_messages();
        let found = self.found()?;
        let is_timed = self.times.take_messages() && has_limit(&self.property.sentence);
        Some(match found.verdict {
            Verdict::Proved if is_timed => Finding { assumes: Some(no_time_for_messages()), ..found },
            Verdict::Proved | Verdict::Fails | Verdict::Open => found,
        })
    }

    fn found(&self) -> Option<Finding> {
        let calm = Mode::default();
        let rough = Mode { aborts: true, crashes: true, stops: true, ..Mode::default() };
        Some(match &self.property.sentence {
            Sentence::Assume(..) => return None,
            Sentence::NeverTogether(all) => self.never_together(rough, None, all),
            Sentence::Implies(a, b) => self.safe(rough, &[*a, *b], &Goal::Never(None, Forbidden::Without(*a, *b))),
            Sentence::Once(first, sentence) => self.once(rough, *first, sentence)?,
            Sentence::OnlyAfter(who, event) => self.safe(rough, &[*who, event.who], &Goal::Before(*who, event.clone())),
            Sentence::AtMost(who, times) => self.safe(rough, &[*who], &Goal::Often(*who, *times)),
            Sentence::After(moment, consequence) => self.after(rough, moment, consequence),
            Sentence::Eventually(event) => self.live(calm, &[event.who], &Goal::Sometime(event.clone())),
            Sentence::CanFinish => self.can_finish(calm),
            Sentence::FinishesWithin(limit) => self.finishes(*limit),
            Sentence::StopsWithin(limit) => self.stops(*limit).unwrap_or_else(|| self.proved()),
            Sentence::On(fault, consequence) => self.on(fault, consequence),
            Sentence::Holds(formula) => self.holds(formula),
        })
    }

    fn proved(&self) -> Finding {
        Finding::proved(format!("{}: {}", self.group(), self.property.text))
    }

    fn group(&self) -> String {
        self.times.model.group_name(self.property.group)
    }

    fn fails(&self, why: &str, found: Option<(&System<'_>, &Graph, u32)>) -> Finding {
        let message = format!("does not hold of `{}`: {}", self.group(), self.property.text);
        let mut diagnostic = diagnostic(Code::E0817, self.property.span, message);
        if !why.is_empty() {
            diagnostic = help(diagnostic, why);
        }
        let told = |(system, graph, state): (&System<'_>, &Graph, u32)| match state {
            // The goal was never possible, so the story is any run.
            0 => tell(system, &a_run(system, graph)),
            state => story(system, graph, state),
        };
        Finding::fails(diagnostic, found.map(told))
    }

    fn open(&self, why: &str) -> Finding {
        Finding::open(format!("{}: {}: {why}", self.group(), self.property.text))
    }

    /// Returns the smallest system around the named processes.
    fn system(&self, whom: &[ProcessRef], mode: Mode) -> System<'m> {
        self.system_in(self.property.group, whom, mode, Opened::Hanging)
    }

    /// Returns the same system with another group as its whole.
    fn system_in(&self, root: u32, whom: &[ProcessRef], mode: Mode, opened: Opened) -> System<'m> {
        let named: Vec<(u32, u32)> = whom.iter().filter_map(|who| Some((who.group, who.member?))).collect();
        let mut system = around(self.times.model, root, &named, opened);
        system.mode = mode;
        system.notes = 1;
        let seats: Vec<_> = named.iter().filter_map(|&(group, slot)| system.find(group, slot)).collect();
        let is_group = |&MemberRef { unit, member }: &MemberRef| system.is_group(MemberRef { unit, member });
        system.follow_messages(&seats.iter().copied().filter(is_group).collect::<Vec<_>>());
        if mode.crashes {
            system.follow_restarts(&seats);
        }
        system
    }

    /// Checks that no transition is a violation.
    fn safe(&self, mode: Mode, whom: &[ProcessRef], goal: &Goal) -> Finding {
        self.holds_in_some(whom, goal, &|root| self.safe_in(root, mode, whom, goal))
    }

    /// Returns nothing if a check proves the goal in some group. Otherwise, returns the violation in the group of the sentence.
    fn holds_in_some(&self, whom: &[ProcessRef], goal: &Goal, check: &dyn Fn(u32) -> Option<Finding>) -> Finding {
        let mut inner = scope::inner_groups(self.times.model, self.property.group, whom, goal).into_iter();
        match inner.any(|group| check(group).is_none()) {
            true => self.proved(),
            false => check(self.property.group).unwrap_or_else(|| self.proved()),
        }
    }

    fn safe_in(&self, root: u32, mode: Mode, whom: &[ProcessRef], goal: &Goal) -> Option<Finding> {
        // Only a stop has to end. A violation is the same, whether or not another group may hang.
        let opened = if matches!(goal, Goal::StillRuns(..)) { Opened::Hanging } else { Opened::Named };
        let mut system = self.system_in(root, whom, mode, opened);
        system.notes = goal.notes();
        follow_events(&mut system, goal);
        if let Goal::Never(_, Forbidden::Without(_, guard)) = goal
            && let Some(seat) = guard.member.and_then(|slot| system.find(guard.group, slot))
        {
            system.follow_link(seat);
        }
        self.is_safe(&system, goal)
    }

    fn is_safe(&self, system: &System<'_>, goal: &Goal) -> Option<Finding> {
        let Found { graph, stopped_at } = explore(system, self.limits, false, &Watch::new(system, goal));
        if let Some(state) = stopped_at {
            return Some(self.fails("", Some((system, &graph, state))));
        }
        if let Some(reached) = graph.reached {
            return Some(self.open(reached.words()));
        }
        // A process whose stop is delayed still has to stop in the end.
        matches!(goal, Goal::StillRuns(..)).then(|| self.is_live(system, goal, &|_| true))?
    }

    /// Checks that the goal can still be reached, without a failure, from every state in which it is owed.
    fn live(&self, mode: Mode, whom: &[ProcessRef], goal: &Goal) -> Finding {
        self.holds_in_some(whom, goal, &|root| {
            let mut system = self.system_in(root, whom, mode, Opened::Hanging);
            system.notes = goal.notes();
            follow_events(&mut system, goal);
            self.is_live(&system, goal, &|_| true)
        })
    }

    /// The same check over the transitions for which `counts` is true.
    fn is_live(&self, system: &System<'_>, goal: &Goal, counts: &dyn Fn(Label) -> bool) -> Option<Finding> {
        let Found { graph, .. } = explore(system, self.limits, true, &Watch::new(system, goal));
        if let Some(reached) = graph.reached {
            return Some(self.open(reached.words()));
        }
        let paid = graph.which(system, |frame| !goal.is_owed(frame));
        // If programs do not fail by themselves, a reported failure comes from a lost host, and has to happen.
        let is_forced = |label| matches!(label, Label::Aborted(..)) && !system.mode.aborts;
        let can = graph.can_reach(&paid, &|label| (system.is_natural(label) || is_forced(label)) && counts(label));
        let state = (0..graph.store.count()).find(|&state| !can[state as usize])?;
        Some(self.fails("from here on it can never happen", Some((system, &graph, state))))
    }

    fn can_finish(&self, mode: Mode) -> Finding {
        let system = self.system(&[], mode);
        let Found { graph, .. } = explore(&system, self.limits, true, &crate::explore::Nobody);
        if let Some(reached) = graph.reached {
            return self.open(reached.words());
        }
        let done = graph.which(&system, |frame| frame.phase == Phase::Done);
        if !done.contains(&true) {
            return self.fails("it is never done in any order of events", Some((&system, &graph, 0)));
        }
        let over = graph.which(&system, |frame| frame.phase.is_over());
        let can = graph.can_reach(&over, &|label| system.is_natural(label));
        match (0..graph.store.count()).find(|&state| !can[state as usize]) {
            None => self.proved(),
            Some(state) => self.fails("from here it can never end", Some((&system, &graph, state))),
        }
    }

    fn finishes(&self, limit: Duration) -> Finding {
        match self.times.of_group(self.property.group).end {
            Some(end) if end <= limit => {
                Finding::proved(format!("{}: {} (it takes at most {})", self.group(), self.property.text, seconds(end)))
            }
            Some(end) => self.fails(&format!("it may take {}", seconds(end)), None),
            None => self.fails(&self.times.without_limit(self.property.group), None),
        }
    }

    /// Returns a finding if a stop of the group may take longer than the limit.
    fn stops(&self, limit: Duration) -> Option<Finding> {
        self.is_slow(self.times.of_group(self.property.group).stop, limit)
    }

    /// Returns a finding if the time from an event of one process until another has stopped may exceed the limit.
    fn stops_after(&self, cause: ProcessRef, who: ProcessRef, limit: Duration) -> Option<Finding> {
        self.is_slow(self.times.stop_after(cause, who), limit)
    }

    fn is_slow(&self, stop: Option<Duration>, limit: Duration) -> Option<Finding> {
        match stop {
            Some(stop) if stop <= limit => None,
            Some(stop) => Some(self.fails(&format!("a stop may take {}", seconds(stop)), None)),
            None => Some(self.fails("a `shield` or a `finally` may delay a stop for ever: give it a bound", None)),
        }
    }

    /// Checks that some processes are never active at the same time, or only before the first start of another process.
    fn never_together(&self, mode: Mode, first: Option<ProcessRef>, all: &[ProcessRef]) -> Finding {
        let whom: Vec<ProcessRef> = first.into_iter().chain(all.iter().copied()).collect();
        let found = self.safe(mode, &whom, &Goal::Never(first, Forbidden::Together(all.to_vec())));
        self.unless_lost(found, first, all)
    }

    /// Checks a sentence from the first start of a process on.
    fn once(&self, mode: Mode, first: ProcessRef, sentence: &Sentence) -> Option<Finding> {
        match sentence {
            Sentence::NeverTogether(all) => Some(self.never_together(mode, Some(first), all)),
            Sentence::Implies(a, b) => {
                let goal = Goal::Never(Some(first), Forbidden::Without(*a, *b));
                Some(self.safe(mode, &[first, *a, *b], &goal))
            }
            Sentence::OnlyAfter(..)
            | Sentence::After(..)
            | Sentence::Once(..)
            | Sentence::On(..)
            | Sentence::Eventually(_)
            | Sentence::CanFinish
            | Sentence::FinishesWithin(_)
            | Sentence::StopsWithin(_)
            | Sentence::AtMost(..)
            | Sentence::Assume(..)
            | Sentence::Holds(_) => None,
        }
    }

    fn after(&self, mode: Mode, moment: &Moment, consequence: &Consequence) -> Finding {
        let cause = moment.event.who;
        match consequence {
            Consequence::Stopped(who, limit) => {
                if let Some(found) = limit.and_then(|limit| self.stops_after(cause, *who, limit)) {
                    return found;
                }
                self.safe(mode, &[cause, *who], &Goal::StillRuns(Some(moment.clone()), *who))
            }
            Consequence::Never(other) => {
                self.safe(mode, &[cause, other.who], &Goal::Then(Some(moment.clone()), other.clone()))
            }
            Consequence::Eventually(other) => {
                self.live(mode, &[cause, other.who], &Goal::Owed(Some(moment.clone()), other.clone()))
            }
        }
    }

    fn on(&self, fault: &Fault, consequence: &Consequence) -> Finding {
        let (kind, struck) = match fault {
            Fault::Crash(who) => (FaultKind::Crash, self.struck(*who)),
            Fault::Hang(who) => (FaultKind::Hang, self.struck(*who)),
            Fault::HostLoss(host) => return self.on_loss(host, consequence),
        };
        for (group, slot) in struck {
            let member = ProcessRef { group, member: Some(slot) };
            let kinds = match self.times.model.plan.groups[group as usize].members[slot as usize].kind {
                MemberKind::Leaf(leaf) if kind == FaultKind::Crash => crashes(self.times.model, group, leaf),
                MemberKind::Leaf(_) | MemberKind::Group(_) => vec![kind],
            };
            if let Some(found) = kinds.into_iter().find_map(|kind| self.on_fault(kind, member, consequence)) {
                return found;
            }
        }
        self.proved()
    }

    /// Returns the violation of a sentence about a fault of one program.
    fn on_fault(&self, kind: FaultKind, struck: ProcessRef, consequence: &Consequence) -> Option<Finding> {
        let (goal, other) = match consequence {
            // A hanging program is not noticed, but something else may end it.
            Consequence::Stopped(who, limit) if kind == FaultKind::Hang => {
                return self.ends_beside_a_hang(struck, *who, *limit);
            }
            Consequence::Stopped(who, limit) => {
                // A dead program takes no time to stop. Whether it is restarted is checked separately.
                if let Some(found) =
                    limit.filter(|_| *who != struck).and_then(|limit| self.stops_after(struck, *who, limit))
                {
                    return Some(found);
                }
                (Goal::StillRuns(None, *who), *who)
            }
            Consequence::Never(other) => (Goal::Then(None, other.clone()), other.who),
            Consequence::Eventually(other) => (Goal::Owed(None, other.clone()), other.who),
        };
        let mut system = self.faulty(kind, struck, other)?;
        follow_events(&mut system, &goal);
        match consequence {
            Consequence::Eventually(_) => self.is_live(&system, &goal, &|_| true),
            Consequence::Stopped(..) | Consequence::Never(_) => self.is_safe(&system, &goal),
        }
    }

    /// Returns the smallest system in which a fault may strike a program and another process is visible.
    fn faulty(&self, kind: FaultKind, struck: ProcessRef, other: ProcessRef) -> Option<System<'m>> {
        let mut system = self.system(&[struck, other], Mode::default());
        let MemberRef { unit, member } = system.find(struck.group, struck.member?)?;
        system.mode.fault = Some(Injection { unit, member, kind });
        system.follow_fault(MemberRef { unit, member }, kind);
        let other = other.member.and_then(|slot| system.find(other.group, slot));
        if kind == FaultKind::Crash
            && let Some(other) = other
        {
            system.follow_restarts(&[other]);
        }
        Some(system)
    }

    /// Checks that something else ends a process while a program hangs. An end of the process by
    /// itself is not included, because it may never happen.
    fn ends_beside_a_hang(&self, hung: ProcessRef, who: ProcessRef, limit: Option<Duration>) -> Option<Finding> {
        let times = self.times.without_end(&self.leaves_of(hung), &self.leaves_of(who));
        let span = match who.member {
            Some(slot) => times.of_member(who.group, slot),
            None => times.of_group(who.group),
        };
        let system = self.faulty(FaultKind::Hang, hung, who)?;
        let counts = |label: Label| {
            let Label::Done(unit, member, _) = label else { return true };
            span.end.is_some()
                || !system.is_below(MemberRef { unit: usize::from(unit), member: u32::from(member) }, who)
        };
        if let Some(found) = self.is_live(&system, &Goal::Ending(hung, who), &counts) {
            return Some(found);
        }
        let limit = limit?;
        let most = match who.member {
            Some(slot) => times.until_ended(who.group, slot),
            None => span.end,
        };
        match most {
            Some(most) if most <= limit => None,
            Some(most) => Some(self.fails(&format!("it may take {} until it has stopped", seconds(most)), None)),
            None => {
                let name = |process: ProcessRef| match process.member {
                    Some(slot) => self.times.model.name(process.group, slot),
                    None => self.times.model.group_name(process.group),
                };
                let (hung, who) = (name(hung), name(who));
                Some(self.fails(
                    &format!("no limit ends `{who}` while `{hung}` hangs: write `P within 5 s` around both"),
                    None,
                ))
            }
        }
    }

    /// The programs at and below a process.
    fn leaves_of(&self, who: ProcessRef) -> Vec<u32> {
        let model = self.times.model;
        match who.member {
            Some(slot) => model.leaves_below(who.group, slot),
            None => model.leaves_of_group(who.group),
        }
    }

    /// Returns the programs at and below a process, or of the whole group.
    fn struck(&self, who: Option<ProcessRef>) -> Vec<(u32, u32)> {
        let model = self.times.model;
        let leaves: Vec<u32> = match who.and_then(|who| Some((who.group, who.member?))) {
            Some((group, slot)) => model.leaves_below(group, slot),
            None => model.leaves_of_group(self.property.group),
        };
        leaves.into_iter().filter_map(|leaf| place_of(model, leaf)).collect()
    }
}

/// The assumption for a time limit across hosts.
fn no_time_for_messages() -> Assumption {
    let text = "messages between hosts take no time: their real times are not counted, and must be added";
    Assumption { text: text.to_owned(), story: None }
}

/// Whether a sentence limits a time.
fn has_limit(sentence: &Sentence) -> bool {
    matches!(
        sentence,
        Sentence::FinishesWithin(_)
            | Sentence::StopsWithin(_)
            | Sentence::After(_, Consequence::Stopped(_, Some(_)))
            | Sentence::On(_, Consequence::Stopped(_, Some(_)))
    )
}

/// Makes the events of a goal take place on the hosts of its processes, and not at their supervisors.
fn follow_events(system: &mut System<'_>, goal: &Goal) {
    follow_starts(system, &goal.begun());
    follow_failures(system, &goal.failing());
}

/// Lets these processes fail while an order to stop is on its way to them.
fn follow_failures(system: &mut System<'_>, whom: &[ProcessRef]) {
    let seats = whom.iter().filter_map(|who| system.find(who.group, who.member?)).collect();
    system.follow_failures(seats);
}

/// Makes the orders to start these programs take time as well, if the programs run on other hosts than their
/// supervisors.
fn follow_starts(system: &mut System<'_>, whom: &[ProcessRef]) {
    let seats: Vec<_> = whom.iter().filter_map(|who| system.find(who.group, who.member?)).collect();
    system.follow_messages(&seats);
}

/// The group and slot of a leaf.
pub(crate) fn place_of(model: &Model<'_>, leaf: u32) -> Option<(u32, u32)> {
    (0_u32..).zip(&model.plan.groups).find_map(|(group, source)| {
        let slot = source.members.iter().position(|member| member.kind == MemberKind::Leaf(leaf))?;
        Some((group, u32::try_from(slot).ok()?))
    })
}

/// The groups that are not black boxes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Opened {
    /// The groups around the named members.
    Named,
    /// The groups around the named members, and all groups that may never end.
    Hanging,
}

/// Returns the smallest system with group `root` as its whole in which these members are visible.
pub(crate) fn around<'a>(model: &'a Model<'a>, root: u32, named: &[(u32, u32)], opened: Opened) -> System<'a> {
    let mut needed: Vec<(u32, u32)> = Vec::new();
    for &(group, slot) in named {
        let mut at = Some((group, slot));
        while let Some((group, slot)) = at {
            needed.push((group, slot));
            at = if group == root { None } else { model.around[group as usize] };
        }
    }
    let is_open = |part: usize| {
        let source = &model.parts[part];
        match source.is_piece {
            _ if source.may_hang && opened == Opened::Hanging => true,
            true => needed.iter().any(|&(group, slot)| group == source.group && model.holds(part, slot)),
            false => needed.iter().any(|&(group, _)| group == source.group),
        }
    };
    System::new(model, root as usize, &is_open)
}

/// Returns whether a member runs in a frame, and neither it nor a group around it is being stopped.
pub(crate) fn is_running(system: &System<'_>, frame: &Frame, who: ProcessRef) -> bool {
    let Some(slot) = who.member else { return frame.phase == Phase::Running && !system.is_silent(frame, 0) };
    let seat = system.find(who.group, slot).filter(|_| frame.phase == Phase::Running || system.is_split(frame));
    seat.is_some_and(|seat| system.is_running(frame, seat))
}

/// Returns a run that ends or comes to a standstill. If every run is endless, returns the beginning of an endless run.
fn a_run(system: &System<'_>, graph: &Graph) -> Vec<Label> {
    let way = graph.dead_end(system, 0);
    if way.is_empty() { graph.way(graph.store.count() - 1) } else { way }
}
