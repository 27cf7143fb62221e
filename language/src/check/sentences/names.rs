//! Finds the meaning of a sentence's names in the groups of a plan.

use super::words::Kind;
use super::{Read, Words, unreadable};
use crate::check::index;
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::{MemberKind, Plan};
use crate::similar;
use crate::sites::{Atom, EventKind, Occurrence, ProcessRef};
use crate::source::Span;

/// The words for the events of a process.
pub(crate) const EVENTS: [&str; 4] = ["done", "aborted", "started", "ended"];
/// The words for the states of a process, for formulas.
pub(crate) const STATES: [&str; 2] = ["running", "stopping"];

/// Returns the words that may follow the name of a process, or that refer to the group itself.
fn last_words<'w>(words: &Words) -> impl Iterator<Item = &'w str> + use<'w> {
    let states = if words.kind() == Kind::Formula { &STATES[..] } else { &[] };
    EVENTS.into_iter().chain(states.iter().copied())
}

/// A group of a plan, and the lookup of names in it.
pub(super) struct Names<'a> {
    pub(super) plan: &'a Plan,
    pub(super) group: u32,
}

impl Names<'_> {
    /// Reads `hit`, `hit.force` or `robot[2]`.
    pub(super) fn who(&self, words: &mut Words) -> Read<ProcessRef> {
        let (who, event) = self.path(words)?;
        match event {
            None => Ok(who),
            Some(_) => Err(unreadable(words.want("a process without an event"))),
        }
    }

    /// Reads a process, or a device whose claiming processes are returned.
    pub(super) fn who_or_device(&self, words: &mut Words) -> Read<Vec<ProcessRef>> {
        let mut look = words.peek();
        if let Some((name, _)) = look.name()
            && self.member(self.group, &name).is_none()
        {
            let owners = self.owners(&name);
            if !owners.is_empty() {
                *words = look;
                return Ok(owners);
            }
        }
        Ok(vec![self.who(words)?])
    }

    /// Returns the leaves below the group that claim a device.
    fn owners(&self, device: &str) -> Vec<ProcessRef> {
        let claims = self.plan.claims.iter().filter(|claim| claim.device == device);
        let leaves: Vec<u32> = claims.map(|claim| claim.leaf).collect();
        let mut owners = Vec::new();
        let mut open = vec![self.group];
        while let Some(group) = open.pop() {
            for (member, slot) in self.plan.groups[group as usize].members.iter().zip(0..) {
                match member.kind {
                    MemberKind::Group(inner) => open.push(inner),
                    MemberKind::Leaf(leaf) if leaves.contains(&leaf) => {
                        owners.push(ProcessRef { group, member: Some(slot) });
                    }
                    MemberKind::Leaf(_) => {}
                }
            }
        }
        owners
    }

    /// Reads `a.done`, `a.done.found` or `a`. The group itself is referred to by its own name, by `main`, or by no name.
    pub(super) fn occurrence(&self, words: &mut Words, otherwise: EventKind) -> Read<Occurrence> {
        let (who, event) = self.path(words)?;
        Ok(Occurrence { who, kind: self.kind(who, event.as_deref(), words)?.unwrap_or(otherwise) })
    }

    /// Reads `a`, `a.running` or `a.done.found`.
    pub(super) fn atom(&self, words: &mut Words) -> Read<Atom> {
        let (who, last) = self.path(words)?;
        Ok(match last.as_deref() {
            Some("running") => Atom::Running(who),
            Some("stopping") => Atom::Stopping(who),
            last => match self.kind(who, last, words)? {
                Some(kind) => Atom::Happens(Occurrence { who, kind }),
                None => Atom::Active(who),
            },
        })
    }

    /// Returns the event that a word names, with the outcome after it.
    fn kind(&self, who: ProcessRef, event: Option<&str>, words: &mut Words) -> Read<Option<EventKind>> {
        Ok(Some(match event {
            Some("done") if words.eat(".") => match words.name() {
                Some((name, span)) => EventKind::Done(Some(self.outcome(who, name, span)?)),
                None => return Err(unreadable(words.want("an outcome"))),
            },
            Some("done") => EventKind::Done(None),
            Some("aborted") => EventKind::Aborted,
            Some("started") => EventKind::Started,
            Some(_) => EventKind::Ended,
            None => return Ok(None),
        }))
    }

    /// Checks that a process may have this outcome. A module declares its outcomes. A group may have the outcomes of everything below it.
    fn outcome(&self, who: ProcessRef, name: String, span: Span) -> Read<String> {
        let group = &self.plan.groups[who.group as usize];
        let member = who.member.map(|slot| &group.members[slot as usize]);
        let mut known = Vec::new();
        self.outcomes(member.map_or(MemberKind::Group(who.group), |member| member.kind), &mut known);
        if known.contains(&name.as_str()) {
            return Ok(name);
        }
        let process = member.map_or(group.process.as_str(), |member| member.name.as_str());
        let found = Diagnostic::new(Code::E0802, span, format!("`{process}` has no outcome `{name}`"));
        if known.is_empty() {
            return Err(Box::new(
                found.help("its module declares no outcomes; an example is `done(found | missing);`"),
            ));
        }
        known.sort_unstable();
        known.dedup();
        let found = found.help(format!("its outcomes are {}", known.join(", ")));
        Err(Box::new(match similar::near(&name, known.iter().copied()) {
            Some(near) => found.rename(span, &near),
            None => found,
        }))
    }

    /// Adds the outcomes that a program declares, or that any part of a group may leave.
    fn outcomes<'p>(&'p self, of: MemberKind, known: &mut Vec<&'p str>) {
        match of {
            MemberKind::Leaf(leaf) => known.extend(self.plan.leaves[leaf as usize].outcomes.iter().map(String::as_str)),
            MemberKind::Group(group) => {
                let group = &self.plan.groups[group as usize];
                known.extend(group.expression.tags());
                group.members.iter().for_each(|member| self.outcomes(member.kind, known));
            }
        }
    }

    /// Reads a process, and the event after it if there is one.
    fn path(&self, words: &mut Words) -> Read<(ProcessRef, Option<String>)> {
        let mut who = ProcessRef { group: self.group, member: None };
        let mut inside = Some(self.group);
        let mut is_first = true;
        loop {
            let Some((mut name, span)) = words.name() else { return Err(unreadable(words.want("a process"))) };
            if let Some(at) = words.index()? {
                name = index::element(&name, at);
            }
            let found = inside.and_then(|group| Some((group, self.member(group, &name)?)));
            let own = &self.plan.groups[self.group as usize];
            if let Some((group, slot)) = found {
                who = ProcessRef { group, member: Some(slot) };
                inside = match self.plan.groups[group as usize].members[slot as usize].kind {
                    MemberKind::Group(inner) => Some(inner),
                    MemberKind::Leaf(_) => None,
                };
            } else if last_words(words).any(|word| word == name) {
                return Ok((who, Some(name)));
            } else if !(is_first && (name == own.process || name == "main" && self.group == 0)) {
                return Err(self.unknown(words, &name, span, inside));
            }
            is_first = false;
            if !words.eat(".") {
                return Ok((who, None));
            }
        }
    }

    fn member(&self, group: u32, name: &str) -> Option<u32> {
        let members = self.plan.groups[group as usize].members.iter();
        (0..).zip(members).find(|(_, member)| member.name == name).map(|(slot, _)| slot)
    }

    fn unknown(&self, words: &Words, name: &str, span: Span, inside: Option<u32>) -> Box<Diagnostic> {
        let Some(group) = inside else {
            let message = format!("`{name}` is not an event of a process");
            let mut all: Vec<String> = last_words(words).map(|word| format!("`{word}`")).collect();
            let last = all.pop().unwrap_or_default();
            let help = format!("{} or {last}", all.join(", "));
            let found = Diagnostic::new(Code::E0802, span, message).help(help);
            return Box::new(match similar::near(name, last_words(words)) {
                Some(near) => found.rename(span, &near),
                None => found,
            });
        };
        let group = &self.plan.groups[group as usize];
        let diagnostic = Diagnostic::new(Code::E0802, span, format!("`{}` has no process `{name}`", group.process));
        let members = group.members.iter().map(|member| member.name.as_str());
        Box::new(match similar::near(name, members.chain(last_words(words))) {
            Some(near) => diagnostic.rename(span, &near),
            None => diagnostic,
        })
    }

    /// Reads a host of the plan.
    pub(super) fn host(&self, words: &mut Words) -> Read<String> {
        let Some((name, span)) = words.name() else { return Err(unreadable(words.want("a host"))) };
        if self.plan.hosts.contains(&name) {
            return Ok(name);
        }
        let message = format!("no process of this plan is on a host `{name}`");
        let help = format!("its hosts are {}", self.plan.hosts.join(", "));
        Err(Box::new(Diagnostic::new(Code::E0802, span, message).help(help)))
    }
}

/// For an unknown name that resembles no process, offers a possible word that resembles it.
pub(super) fn or_word(unknown: Box<Diagnostic>, words: &Words, wanted: &[&'static str]) -> Box<Diagnostic> {
    let (name, place) = (words.next_name().unwrap_or_default(), words.place());
    let is_it = unknown.code == Code::E0802
        && unknown.primary.span == place
        && unknown.fix.is_none()
        && unknown.choices.is_empty();
    match similar::near(name, wanted.iter().copied()).filter(|near| is_it && near.name != name) {
        Some(near) => Box::new(unknown.rename(place, &near)),
        None => unknown,
    }
}
