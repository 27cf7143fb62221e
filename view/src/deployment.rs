//! A deployment as all its hosts report it, and its processes.

use crate::identity::MissionId;
use crate::mark::{LastEnd, Mark};
use crate::text::{clean, is_name};
use crate::wires::Wires;
use comms::logic::time::Time;
use language::plan::Plan;
use node::logic::protocol::{AbsentProcess, ActivityStatus, Change, DeploymentStatus, OpenQuestion, ProcessStatus};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// How many questions, and states of an activity, are kept with a process.
pub(crate) const DETAILS_MAX: usize = 32;
/// The most groups and leaves of a plan that is kept for pictures.
const PLAN_MAX: usize = 2000;
/// The state of a process that no node has reported.
const UNKNOWN: &str = "unknown";

/// When something has begun.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Since {
    /// The moment, by the clock of the view.
    pub at: Time,
    /// Whether an event has told the moment. Otherwise it happened at this time or earlier.
    pub is_exact: bool,
}

/// How a process is, in one word for colours.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Health {
    /// It runs.
    Running,
    /// It waits to be activated, or has ended as it should.
    Quiet,
    /// It is on its way from one state to another.
    Changing,
    /// It has failed.
    Failed,
    /// Its host does not answer.
    Unknown,
}

/// A process of a deployment.
#[derive(Clone, Debug)]
pub struct Process {
    /// Its absolute path.
    pub path: String,
    /// Its type.
    pub kind: String,
    /// The host that it runs on.
    pub host: String,
    /// Its state, as its host reports it.
    pub state: String,
    /// When it came into this state.
    pub since: Since,
    /// The process id of its program.
    pub pid: Option<u32>,
    /// How often its program was started again, according to events.
    pub restarts: u32,
    /// The states of an activity that runs.
    pub states: Vec<String>,
    /// Its questions to people.
    pub questions: Vec<OpenQuestion>,
    /// How its last activation has ended, until the next one.
    pub last: Option<LastEnd>,
    pub(crate) changed: u64,
}

/// The plan of a deployment, for pictures.
#[derive(Clone, Debug)]
pub struct KnownPlan {
    /// The number of the input that brought it: no other plan has this number.
    pub number: u64,
    /// The plan; none if it is too large to be kept.
    pub plan: Option<Arc<Plan>>,
}

impl KnownPlan {
    pub(crate) fn new(number: u64, plan: Box<Plan>) -> Self {
        let is_kept = plan.groups.len() + plan.leaves.len() <= PLAN_MAX;
        Self { number, plan: is_kept.then(|| Arc::from(plan)) }
    }
}

/// A question of an activity to people.
#[derive(Clone, Debug)]
pub struct Question<'a> {
    /// The deployment of the activity. Its home takes the answer.
    pub mission: &'a MissionId,
    /// The absolute path of the activity.
    pub path: &'a str,
    /// The question.
    pub question: &'a OpenQuestion,
}

/// How a deployment has ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct End {
    /// When, by the clock of the view.
    pub at: Time,
    /// How, for a person.
    pub text: String,
    /// Whether it has failed.
    pub is_failed: bool,
    /// Whether an event has reported it. Otherwise no host has a part of it any more.
    pub is_told: bool,
}

/// The last change of a process, according to events.
#[derive(Clone, Debug)]
pub(crate) struct Moment {
    pub(crate) at: Time,
    pub(crate) restarts: u32,
    pub(crate) last: Option<LastEnd>,
}

/// The moments of a deployment, as events tell them, perhaps before any node has reported it.
#[derive(Clone, Debug, Default)]
pub(crate) struct Moments {
    /// When the whole deployment was confirmed and began to run.
    pub(crate) began: Option<Time>,
    /// The last changes of its processes, by path.
    pub(crate) processes: BTreeMap<String, Moment>,
}

/// The circumstances of a status.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Look<'a> {
    pub(crate) now: Time,
    pub(crate) number: u64,
    /// The host that reports.
    pub(crate) host: &'a str,
    /// When it has reported before.
    pub(crate) before: Option<Time>,
    /// How many more processes there may be.
    pub(crate) room: usize,
}

/// The effect of a status on a deployment.
#[derive(Debug, Default)]
pub(crate) struct Taken {
    /// Paths of processes that are gone.
    pub(crate) gone: Vec<String>,
    /// How many processes and wires found no room.
    pub(crate) omitted: u64,
}

/// A deployment.
#[derive(Clone, Debug)]
pub struct LiveDeployment {
    /// Its name, its home and its nodes.
    pub id: MissionId,
    /// The phase of each host that has a part of it.
    pub phases: BTreeMap<String, String>,
    /// When the whole deployment was confirmed and began to run. None if no event has reported this.
    pub began: Option<Time>,
    /// Its end, once it is over.
    pub end: Option<End>,
    /// Its processes, by path.
    pub processes: BTreeMap<String, Process>,
    /// The plan, once a node has reported it.
    pub plan: Option<KnownPlan>,
    /// How each process has ended, once it is over and an event has reported the end.
    pub ends: BTreeMap<String, LastEnd>,
    pub(crate) wires: Wires,
    pub(crate) changed: u64,
}

impl Process {
    /// Returns the word for its state, without the reason behind it.
    pub fn word(&self) -> &str {
        let end = self.state.find([';', ':']).unwrap_or(self.state.len());
        &self.state[..end]
    }

    /// Returns its state in a few words. `health` is its health in the model.
    pub fn state_text(&self, health: Health) -> String {
        match (health, self.states.is_empty(), self.questions.is_empty()) {
            (Health::Unknown, _, _) => UNKNOWN.to_owned(),
            (Health::Running, _, false) => "asks a question".to_owned(),
            (Health::Running, false, true) => self.states.join(", "),
            (Health::Running, true, true) => self.word().to_owned(),
            (Health::Quiet | Health::Changing | Health::Failed, _, _) => self.state.clone(),
        }
    }

    /// Returns how it is, as its host reports it.
    pub fn health(&self) -> Health {
        let state = self.state.as_str();
        let begins = |words: &[&str]| words.iter().any(|word| state.starts_with(word));
        if begins(&["dead", "refused", "unconfirmed"]) || state.contains("aborted") {
            Health::Failed
        } else if begins(&["running"]) {
            Health::Running
        } else if begins(&[UNKNOWN]) {
            Health::Unknown
        } else if begins(&["idle", "ended"]) {
            Health::Quiet
        } else {
            Health::Changing
        }
    }

    /// Returns its mark in a picture. `health` is its health in the model.
    pub fn mark(&self, health: Health) -> Mark {
        Mark::new(health, self.last.as_ref())
    }

    /// Returns the words for its mark in a picture.
    pub fn mark_text(&self, health: Health) -> String {
        match (health, &self.last) {
            (Health::Quiet, Some(last)) => last.text.clone(),
            // `idle, aborted: SIGSEGV`: the reason is used.
            (Health::Failed, _) => {
                let reason = ["idle, ", "ended, "].into_iter().find_map(|word| self.state.strip_prefix(word));
                reason.unwrap_or(&self.state).to_owned()
            }
            (Health::Quiet, None) | (Health::Running | Health::Changing | Health::Unknown, _) => {
                self.state_text(health)
            }
        }
    }

    fn new(look: Look<'_>, status: &ProcessStatus, moment: Option<&Moment>) -> Self {
        let ActivityStatus { states, questions, .. } = status.activity.clone().unwrap_or_default();
        let questions = questions.into_iter().take(DETAILS_MAX).map(|question| OpenQuestion {
            number: question.number,
            text: clean(&question.text),
            options: question.options.into_iter().filter(|option| is_name(option)).take(DETAILS_MAX).collect(),
        });
        let since =
            moment.map_or(Since { at: look.now, is_exact: false }, |moment| Since { at: moment.at, is_exact: true });
        Self {
            path: status.path.clone(),
            kind: clean(&status.kind),
            host: look.host.to_owned(),
            state: clean(&status.state),
            since,
            pid: status.pid,
            restarts: moment.map_or(0, |moment| moment.restarts),
            states: states.iter().take(DETAILS_MAX).map(|state| clean(state)).collect(),
            questions: questions.collect(),
            last: moment.and_then(|moment| moment.last.clone()),
            changed: look.number,
        }
    }

    /// Returns whether everything except the time is equal.
    fn is_like(&self, other: &Self) -> bool {
        (&self.state, &self.kind, &self.host, self.pid, self.restarts)
            == (&other.state, &other.kind, &other.host, other.pid, other.restarts)
            && self.states == other.states
            && self.questions == other.questions
            && self.last == other.last
    }
}

/// Takes note of an event about a process.
pub(crate) fn note_moment(moments: &mut Moments, path: &str, change: &Change, at: Time) {
    let moment = moments.processes.entry(path.to_owned()).or_insert(Moment { at, restarts: 0, last: None });
    if matches!(change, Change::Restarting { .. }) {
        moment.restarts += 1;
    }
    if !matches!(change, Change::Configured { .. } | Change::Switched(_)) {
        moment.at = at;
    }
    moment.last = LastEnd::after(change, moment.last.take());
}

impl LiveDeployment {
    pub(crate) fn new(id: MissionId, number: u64) -> Self {
        Self {
            id,
            phases: BTreeMap::new(),
            began: None,
            end: None,
            processes: BTreeMap::new(),
            plan: None,
            ends: BTreeMap::new(),
            wires: Wires::default(),
            changed: number,
        }
    }

    /// Returns its phases in words: `running`, `connecting/running`, or how it has ended.
    pub fn phase(&self) -> String {
        if let Some(end) = &self.end {
            return end.text.clone();
        }
        let phases: BTreeSet<&str> = self.phases.values().map(String::as_str).collect();
        Vec::from_iter(phases).join("/")
    }

    /// Returns whether a host has a part of it, or may have.
    pub(crate) fn is_on(&self, host: &str) -> bool {
        self.phases.contains_key(host) || self.processes.values().any(|process| process.host == host)
    }

    /// Takes in the report of a host.
    pub(crate) fn take(&mut self, look: Look<'_>, part: &DeploymentStatus, moments: Option<&Moments>) -> Taken {
        let mut taken = Taken::default();
        let phase = clean(&part.phase);
        if self.phases.get(look.host) != Some(&phase) {
            self.phases.insert(look.host.to_owned(), phase);
            self.changed = look.number;
        }
        // A host that has returned still has a part of the deployment.
        self.end = self.end.take().filter(|end| end.is_told);
        let mut there = BTreeSet::new();
        let mut room = look.room;
        for status in part.processes.iter().filter(|status| is_name(&status.path)) {
            there.insert(status.path.as_str());
            let moment = moments.and_then(|moments| moments.processes.get(&status.path));
            let new = Process::new(look, status, moment);
            let Some(old) = self.processes.get_mut(&status.path) else {
                if room == 0 {
                    taken.omitted += 1;
                } else {
                    room -= 1;
                    self.processes.insert(status.path.clone(), new);
                }
                continue;
            };
            if !old.is_like(&new) {
                let is_told = |moment: &&Moment| look.before.is_none_or(|before| moment.at > before);
                let since = match moment.filter(is_told) {
                    Some(moment) => Since { at: moment.at, is_exact: true },
                    None if old.state == new.state => old.since,
                    None => Since { at: look.now, is_exact: false },
                };
                *old = Process { since, ..new };
            }
        }
        taken.gone = self.paths_of(look.host, |path| !there.contains(path));
        taken.gone.iter().for_each(|path| drop(self.processes.remove(path)));
        taken.omitted += self.wires.take(look, part);
        taken
    }

    /// Adds a process on a host that does not answer; returns whether there was room.
    pub(crate) fn take_absent(&mut self, look: Look<'_>, absent: &AbsentProcess) -> bool {
        if self.processes.contains_key(&absent.path) || !is_name(&absent.path) {
            return true;
        }
        let (path, kind) = (absent.path.clone(), absent.kind.clone());
        let status = ProcessStatus { path, kind, state: UNKNOWN.to_owned(), pid: None, activity: None };
        if look.room > 0 {
            self.processes.insert(absent.path.clone(), Process::new(look, &status, None));
        }
        look.room > 0
    }

    /// Takes note that a host has no part of it any more; returns the paths that are gone.
    pub(crate) fn leave(&mut self, host: &str, number: u64) -> Vec<String> {
        if self.phases.remove(host).is_some() {
            self.changed = number;
        }
        let gone = self.paths_of(host, |_| true);
        gone.iter().for_each(|path| drop(self.processes.remove(path)));
        gone
    }

    fn paths_of(&self, host: &str, is_meant: impl Fn(&str) -> bool) -> Vec<String> {
        let of_host = self.processes.values().filter(|process| process.host == host && is_meant(&process.path));
        of_host.map(|process| process.path.clone()).collect()
    }
}
