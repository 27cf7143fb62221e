//! The model: takes inputs in, and gives viewers the changes since their last look.

use crate::changes::{Changes, Gone, Position};
use crate::deployment::{End, Health, KnownPlan, LiveDeployment, Look, Moments, Process, Question, Taken, note_moment};
use crate::freshness::Freshness;
use crate::history::{History, PastChange};
use crate::identity::{Fleet, MissionId, RobotId};
use crate::input::{Input, Measured};
use crate::output::{Lines, OutputLine};
use crate::ring::Ring;
use crate::robot::{Presence, Robot};
use crate::sentence::{change_text, report_text};
use crate::text::{clean, is_name};
use crate::wires::Wire;
use comms::logic::time::Time;
use language::plan::Plan;
use node::logic::protocol::{Absent, Change, Ending, Event, NodeStatus, Report};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// How long a robot is shown that no node lists any more. A node that a link is lost to is left out for a moment before it is
/// listed as missing.
const GONE_AFTER: Duration = Duration::from_secs(10);
/// A deployment that has ended before a view begins is shown if it has ended within this time.
const RECENT: Duration = Duration::from_secs(600);
/// The most robots.
const ROBOTS_MAX: usize = 256;
/// The most deployments that run.
const DEPLOYMENTS_MAX: usize = 256;
/// The most deployments that are over.
const ENDED_MAX: usize = 20;
/// The most processes of all deployments.
const PROCESSES_MAX: usize = 20_000;
/// The most events.
const EVENTS_MAX: usize = 2000;
/// The most lines of output.
const LINES_MAX: usize = 2000;
/// The most items that are remembered as gone. A viewer that missed more gets the whole model.
const GONE_MAX: usize = 4000;

/// An event, for a person.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EventLine {
    /// Its place among all events, from 0 on, those that have left included.
    pub ordinal: u64,
    /// When it was, since 1970, by the calendar clock of its home. None for an event of the view itself.
    pub time: Option<Duration>,
    /// The robot that it is about.
    pub robot: RobotId,
    /// The deployment, if it is about one.
    pub mission: Option<MissionId>,
    /// The absolute path of the process, if it is about one.
    pub path: Option<String>,
    /// The event, in words that follow the process or the deployment.
    pub text: String,
    /// Whether something has failed.
    pub is_failure: bool,
}

/// The number of items that were left out: they found no room, or their names cannot be shown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Omitted {
    /// Robots, deployments, processes and wires without room.
    pub(crate) items: u64,
    /// Answers with a name that no spec can have.
    pub(crate) names: u64,
}

/// All that a view can show.
#[derive(Clone, Debug)]
pub struct Model {
    position: Position,
    heard: Option<Time>,
    robots: BTreeMap<RobotId, Robot>,
    deployments: BTreeMap<MissionId, LiveDeployment>,
    /// The last changes of processes, perhaps before any node has reported the processes.
    moments: BTreeMap<MissionId, Moments>,
    history: History,
    events: Ring<EventLine>,
    lines: Ring<OutputLine>,
    begun: Lines,
    gone: Ring<Gone>,
    omitted: Omitted,
}

impl Model {
    /// Returns an empty model. Each start of a view has another `number`, so that a viewer of the previous one notices.
    pub fn new(number: u64) -> Self {
        Self {
            position: Position { model: number, number: 0 },
            heard: None,
            robots: BTreeMap::new(),
            deployments: BTreeMap::new(),
            moments: BTreeMap::new(),
            history: History::new(),
            events: Ring::new(EVENTS_MAX),
            lines: Ring::new(LINES_MAX),
            begun: Lines::default(),
            gone: Ring::new(GONE_MAX),
            omitted: Omitted::default(),
        }
    }

    /// Takes an input in, which has come at `now`.
    pub fn apply(&mut self, now: Time, input: Input) {
        self.position.number += 1;
        match input {
            Input::Status { fleet, status } => self.status(now, fleet, &status),
            Input::Silent { robot, why } => self.presence(&robot, Presence::Silent(clean(&why))),
            Input::Absent { teller, absent } => self.absent(now, &teller, &absent),
            Input::Known { fleet, hosts } => self.known(now, fleet, &hosts),
            Input::Event { home, event } => self.event(now, home, *event),
            Input::Note { robot, text } => self.note(robot, &text),
            Input::Plan { mission, plan } => self.plan(&mission, plan),
            Input::OutputBegins { mission, path } => {
                self.begun.forget(&mission, &path);
                self.lines.retain(|line| line.mission != mission || line.path != path);
            }
            Input::Output { mission, path, bytes } => {
                for text in self.begun.push(&mission, &path, &bytes) {
                    let (ordinal, mission, path) = (self.lines.count(), mission.clone(), path.clone());
                    self.lines.push(self.position.number, OutputLine { ordinal, mission, path, text });
                }
            }
            Input::Measured(measured) => self.measured(now, &measured),
            Input::Database { fleet, status } => {
                let id = RobotId { host: status.robot.clone(), fleet };
                if let Some(robot) = self.robots.get_mut(&id)
                    && robot.take_database(&status)
                {
                    robot.changed = self.position.number;
                }
            }
        }
    }

    /// Returns the position after the last input.
    #[cfg(test)]
    pub(crate) fn position(&self) -> Position {
        self.position
    }

    /// Returns whether the model as a whole is live: a node has answered recently.
    pub fn freshness(&self, now: Time) -> Freshness {
        Freshness::of(self.heard, now)
    }

    /// Returns the robots, by host.
    pub fn robots(&self) -> impl Iterator<Item = &Robot> {
        self.robots.values()
    }

    /// Returns the deployments, by name and epoch.
    pub fn deployments(&self) -> impl Iterator<Item = &LiveDeployment> {
        self.deployments.values()
    }

    /// Returns the wires of a deployment, by name.
    pub fn wires<'a>(&'a self, deployment: &'a LiveDeployment) -> impl Iterator<Item = &'a Wire> {
        deployment.wires.all.values()
    }

    /// Returns the deployments that run and whose present plan is not known.
    pub fn without_plan(&self) -> impl Iterator<Item = &LiveDeployment> {
        self.deployments.values().filter(|live| !live.wires.is_planned && live.end.is_none())
    }

    /// Returns the deployment whose plan has this number.
    pub fn planned(&self, number: u64) -> Option<&LiveDeployment> {
        self.deployments.values().find(|live| live.plan.as_ref().is_some_and(|plan| plan.number == number))
    }

    /// Returns the changes of the processes of a deployment, in the order in which they were reported.
    pub fn history(&self, mission: &MissionId) -> impl Iterator<Item = &PastChange> {
        self.history.of(mission)
    }

    /// Returns the time up to which the history may lack changes.
    pub fn history_left(&self) -> Time {
        self.history.left()
    }

    /// Returns the events, the oldest first.
    pub fn events(&self) -> impl DoubleEndedIterator<Item = &EventLine> + ExactSizeIterator {
        self.events.iter()
    }

    /// Returns the lines of output, the oldest first.
    pub fn lines(&self) -> impl DoubleEndedIterator<Item = &OutputLine> + ExactSizeIterator {
        self.lines.iter()
    }

    /// Returns the open questions to people.
    pub fn questions(&self) -> impl Iterator<Item = Question<'_>> {
        self.deployments.values().flat_map(|live| {
            live.processes.values().flat_map(move |process| {
                let (mission, path) = (&live.id, process.path.as_str());
                process.questions.iter().map(move |question| Question { mission, path, question })
            })
        })
    }

    /// Returns the health of a process of a deployment. The state of a process on a host that does not answer is unknown.
    pub fn health(&self, mission: &MissionId, process: &Process) -> Health {
        let is_here =
            self.robots.get(&mission.robot(&process.host)).is_some_and(|robot| robot.presence == Presence::Here);
        if is_here { process.health() } else { Health::Unknown }
    }

    /// Returns how much was left out.
    #[cfg(test)]
    pub(crate) fn omitted(&self) -> Omitted {
        self.omitted
    }

    /// Returns the changes since a viewer has looked. Returns everything if the position belongs to another model, or is too old.
    pub fn since(&self, position: Position) -> Changes<'_> {
        let is_ours = position.model == self.position.model && position.number <= self.position.number;
        let is_whole = !is_ours || self.gone.has_gap_since(position.number);
        let number = if is_whole { 0 } else { position.number };
        let is_new = |changed: u64| is_whole || changed > number;
        let live = || self.deployments.values();
        let processes = live().flat_map(|one| one.processes.values().map(move |process| (&one.id, process)));
        let wires = live().flat_map(|one| one.wires.all.values().map(move |wire| (&one.id, wire)));
        Changes {
            position: self.position,
            is_whole,
            robots: self.robots.values().filter(|robot| is_new(robot.changed)).collect(),
            deployments: live().filter(|one| is_new(one.changed)).collect(),
            processes: processes.filter(|(_, process)| is_new(process.changed)).collect(),
            wires: wires.filter(|(_, wire)| is_new(wire.changed)).collect(),
            events: self.events.since(number).collect(),
            gone: if is_whole { Vec::new() } else { self.gone.since(number).collect() },
        }
    }

    /// Returns a robot, if there is room for it.
    fn robot(&mut self, id: &RobotId) -> Option<&mut Robot> {
        if !is_name(&id.host) {
            self.omitted.names += 1;
            return None;
        }
        if !self.robots.contains_key(id) {
            if self.robots.len() >= ROBOTS_MAX {
                self.omitted.items += 1;
                return None;
            }
            let presence = Presence::Silent("it has not answered yet".to_owned());
            self.robots.insert(id.clone(), Robot::new(id.clone(), presence, self.position.number));
        }
        self.robots.get_mut(id)
    }

    fn status(&mut self, now: Time, fleet: Fleet, status: &NodeStatus) {
        let number = self.position.number;
        let id = RobotId { host: status.host.clone(), fleet };
        let Some(robot) = self.robot(&id) else { return };
        let before = robot.heard;
        if robot.take(now, status) {
            robot.changed = number;
        }
        self.heard = Some(now);
        let mut there = BTreeSet::new();
        for part in &status.deployments {
            let id = MissionId { deployment: part.deployment.clone(), home: part.home.clone(), fleet };
            let Some(room) = self.room_for(&id) else { continue };
            let look = Look { now, number, host: &status.host, before, room };
            let Some(live) = self.deployments.get_mut(&id) else { continue };
            let Taken { gone, omitted } = live.take(look, part, self.moments.get(&id));
            self.omitted.items += omitted;
            self.forget(&id, gone);
            there.insert(id);
        }
        for left in self.on(&id).filter(|left| !there.contains(left)).cloned().collect::<Vec<_>>() {
            self.leave(now, &left, &status.host, "over");
        }
    }

    /// Returns the deployments of which a robot has, or may have, a part.
    fn on(&self, robot: &RobotId) -> impl Iterator<Item = &MissionId> {
        let is_there = |live: &&LiveDeployment| live.id.fleet == robot.fleet && live.is_on(&robot.host);
        self.deployments.values().filter(is_there).map(|live| &live.id)
    }

    /// Makes sure that a deployment is there; returns how many more processes there may be.
    fn room_for(&mut self, id: &MissionId) -> Option<usize> {
        if !is_name(&id.deployment.name) || !is_name(&id.home) {
            self.omitted.names += 1;
            return None;
        }
        let running = self.deployments.values().filter(|live| live.end.is_none()).count();
        if !self.deployments.contains_key(id) {
            if running >= DEPLOYMENTS_MAX {
                self.omitted.items += 1;
                return None;
            }
            let began = self.moments.get(id).and_then(|moments| moments.began);
            let new = LiveDeployment { began, ..LiveDeployment::new(id.clone(), self.position.number) };
            self.deployments.insert(id.clone(), new);
        }
        let processes: usize = self.deployments.values().map(|live| live.processes.len()).sum();
        Some(PROCESSES_MAX.saturating_sub(processes))
    }

    fn forget(&mut self, id: &MissionId, gone: Vec<String>) {
        for path in gone {
            self.gone.push(self.position.number, Gone::Process(id.clone(), path));
        }
    }

    /// Takes note that a host has no part of a deployment any more. A deployment without a host has ended in this way.
    fn leave(&mut self, now: Time, id: &MissionId, host: &str, end: &str) {
        let number = self.position.number;
        let Some(live) = self.deployments.get_mut(id) else { return };
        let gone = live.leave(host, number);
        if live.phases.is_empty() && live.end.is_none() {
            live.end = Some(End { at: now, text: end.to_owned(), is_failed: false, is_told: false });
        }
        self.forget(id, gone);
        self.limit_ended();
    }

    /// Drops the deployments that have been over for longest, if there are many.
    fn limit_ended(&mut self) {
        let over = self.deployments.values().filter(|live| live.phases.is_empty());
        let mut over: Vec<(Time, MissionId)> =
            over.filter_map(|live| Some((live.end.as_ref()?.at, live.id.clone()))).collect();
        over.sort();
        for (_, id) in over.iter().take(over.len().saturating_sub(ENDED_MAX)) {
            self.deployments.remove(id);
            self.moments.remove(id);
            self.gone.push(self.position.number, Gone::Deployment(id.clone()));
        }
    }

    fn presence(&mut self, id: &RobotId, presence: Presence) {
        let number = self.position.number;
        let Some(robot) = self.robot(id) else { return };
        // It is asked again and again, and stays lost until it answers.
        if robot.presence == Presence::Lost && matches!(presence, Presence::Silent(_)) {
            return;
        }
        if robot.presence != presence {
            (robot.presence, robot.changed) = (presence, number);
        }
    }

    fn absent(&mut self, now: Time, teller: &RobotId, absent: &Absent) {
        for one in absent.hosts.iter().filter(|one| one.lost) {
            let id = RobotId { host: one.host.clone(), fleet: teller.fleet };
            let is_live = self.robots.get(&id).is_some_and(|robot| robot.freshness(now).is_live());
            if !is_live {
                self.presence(&id, Presence::Lost);
            }
        }
        for one in &absent.processes {
            // A node reports the deployments of which it has a part.
            let Some(id) = self.on(teller).find(|id| id.deployment == one.deployment).cloned() else { continue };
            let Some(room) = self.room_for(&id) else { continue };
            let (number, before) = (self.position.number, None);
            let look = Look { now, number, host: &one.host, before, room };
            let taken = self.deployments.get_mut(&id).map(|live| live.take_absent(look, one));
            self.omitted.items += u64::from(taken == Some(false));
        }
    }

    fn known(&mut self, now: Time, fleet: Fleet, hosts: &BTreeSet<String>) {
        // The nodes of a command end with it.
        let is_over = fleet != Fleet::Standing && hosts.is_empty();
        let of_fleet = self.robots.keys().filter(|id| id.fleet == fleet);
        for id in of_fleet.cloned().collect::<Vec<_>>() {
            let Some(robot) = self.robots.get_mut(&id) else { continue };
            if hosts.contains(&id.host) {
                robot.unlisted = None;
                continue;
            }
            let since = *robot.unlisted.get_or_insert(now);
            if now.since(since) < GONE_AFTER && !is_over {
                self.presence(&id, Presence::Silent("no node that answers reaches it".to_owned()));
                continue;
            }
            self.robots.remove(&id);
            for part in self.on(&id).cloned().collect::<Vec<_>>() {
                self.leave(now, &part, &id.host, "not known: its hosts have left");
            }
            self.gone.push(self.position.number, Gone::Robot(id));
        }
        for host in hosts {
            self.robot(&RobotId { host: host.clone(), fleet });
        }
    }

    fn note(&mut self, robot: RobotId, text: &str) {
        let (time, mission, path, text) = (None, None, None, clean(text));
        let (ordinal, robot) = (self.events.count(), RobotId { host: clean(&robot.host), ..robot });
        let event = EventLine { ordinal, time, robot, mission, path, text, is_failure: true };
        self.events.push(self.position.number, event);
    }

    fn event(&mut self, now: Time, home: RobotId, event: Event) {
        let Event { deployment, host, ago, report, time, .. } = event;
        let at = now.before(ago);
        if [&deployment.name, &host, &home.host].into_iter().any(|name| !is_name(name)) {
            self.omitted.names += 1;
            return;
        }
        let id = MissionId { deployment, home: home.host, fleet: home.fleet };
        let is_failure = is_failure(&report);
        let (path, text) = if let Report::Process { path, change, .. } = &report {
            let path = Some(path).filter(|path| is_name(path));
            path.into_iter().for_each(|path| self.process_event(&id, path, change, at));
            (path.cloned(), clean(&change_text(change)))
        } else {
            self.deployment_event(now, &id, &report, at);
            (None, clean(&report_text(&report)))
        };
        // These are for programs that record a mission.
        if !matches!(report, Report::Programs { .. } | Report::Stepped { .. }) {
            let (ordinal, time, robot) = (self.events.count(), Some(time), id.robot(&host));
            let event = EventLine { ordinal, time, robot, mission: Some(id), path, text, is_failure };
            self.events.push(self.position.number, event);
        }
    }

    fn process_event(&mut self, id: &MissionId, path: &str, change: &Change, at: Time) {
        self.history.push(self.position.number, id, path, change, at);
        if let Some(moments) = self.moments(id)
            && (moments.processes.len() < PROCESSES_MAX || moments.processes.contains_key(path))
        {
            note_moment(moments, path, change, at);
        }
    }

    /// Returns the moments of a deployment, if there is room for them.
    fn moments(&mut self, id: &MissionId) -> Option<&mut Moments> {
        let has_room = self.moments.len() < DEPLOYMENTS_MAX || self.moments.contains_key(id);
        has_room.then(|| self.moments.entry(id.clone()).or_default())
    }

    fn deployment_event(&mut self, now: Time, id: &MissionId, report: &Report, at: Time) {
        if matches!(report, Report::Finished { .. } | Report::Refused { .. }) {
            // A person who begins to look now wants to know what has just failed.
            if now.since(at) < RECENT {
                self.room_for(id);
            }
            let moments = self.moments.remove(id).unwrap_or_default().processes;
            let ends = moments.into_iter().filter_map(|(path, moment)| Some((path, moment.last?))).collect();
            let end = End { at, text: clean(&report_text(report)), is_failed: is_failure(report), is_told: true };
            self.mend(id, |live| (live.end, live.ends) = (Some(end), ends));
            self.limit_ended();
        } else if matches!(report, Report::Go { .. }) {
            self.moments(id).into_iter().for_each(|moments| moments.began = Some(at));
            self.mend(id, |live| live.began = Some(at));
        } else if matches!(report, Report::Changed { .. }) {
            self.mend(id, |live| live.wires.is_planned = false);
        }
    }

    fn mend(&mut self, id: &MissionId, change: impl FnOnce(&mut LiveDeployment)) {
        if let Some(live) = self.deployments.get_mut(id) {
            change(live);
            live.changed = self.position.number;
        }
    }

    fn plan(&mut self, id: &MissionId, plan: Box<Plan>) {
        let number = self.position.number;
        let Some(live) = self.deployments.get_mut(id) else { return };
        let (gone, omitted) = live.wires.plan(&plan, number);
        (live.plan, live.changed) = (Some(KnownPlan::new(number, plan)), number);
        self.omitted.items += omitted;
        for wire in gone {
            self.gone.push(number, Gone::Wire(id.clone(), wire));
        }
    }

    fn measured(&mut self, now: Time, measured: &Measured) {
        let number = self.position.number;
        if let Some(live) = self.deployments.get_mut(&measured.mission) {
            live.wires.measured(now, number, measured);
        }
    }
}

/// Returns whether a report is about a failure.
fn is_failure(report: &Report) -> bool {
    let is_bad_end = |ending: &Ending| matches!(ending, Ending::Aborted(_) | Ending::Unconfirmed);
    if let Report::Process { change, .. } = report {
        let is_bad = matches!(
            change,
            Change::Died(_) | Change::Restarting { .. } | Change::Reverting { .. } | Change::Renewing { .. }
        );
        return is_bad || matches!(change, Change::Ended(ending) if is_bad_end(ending));
    }
    matches!(report, Report::Refused { .. } | Report::Unchanged { .. })
        || matches!(report, Report::Finished { ending, .. } if is_bad_end(ending))
}
