//! Runs a plan with fake leaves: `dca sim`.
//!
//! Groups react by the same [`step`] as in a deployment. Leaves only begin, and they end when the script says so. Stopping takes no time.
//! The clock is virtual and moves when the script says so.

mod chart;
mod command;
mod random;
mod replay;
mod says;
mod trace;

use crate::algebra::{Activation, Cause, Command, Event, Outcome, Program, Reason, State, Value, step};
use crate::automaton::{Failure, Scripts};
use crate::plan::{DEADLINE, LEAVES_MAX, MemberKind, Plan, TIMER_LEAST, TimerKind};
use chart::Timeline;
use replay::Pending;
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

pub use command::SimulationError;
pub use random::RandomRun;
pub use replay::ReplayError;
pub use trace::{ProgramFault, TraceError, TraceEvent};

/// The largest number of events of one instant. The largest plan needs fewer to start everything and to stop it. More events mean that a
/// loop repeats without any time passing.
const INSTANT_MAX: usize = 10 * LEAVES_MAX;

/// An event of a simulation.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SimulationEvent {
    /// The time since the start.
    pub at: Duration,
    /// The path of the group or leaf.
    pub path: String,
    /// The new state of the process.
    pub transition: Transition,
}

/// A change of the state of a process.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Transition {
    /// The process starts.
    Started,
    /// The process has ended normally.
    Done,
    /// The process has failed, for this reason.
    Aborted(String),
    /// The process was stopped.
    Stopped,
    /// The process is asked to stop. This occurs only while a story is played.
    Stopping,
    /// A wait of this length begins.
    Waits(Duration),
    /// A part of a group begins that has this time limit: `P within 5 s`.
    Limited(Duration),
    /// An activity is in these states, or does something that is visible outside.
    Says(String),
}

/// The end of a leaf.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Ending {
    /// A normal end without an outcome.
    Done,
    /// A normal end with the outcome of this name.
    Outcome(String),
    /// A failure with this reason, which the program reports.
    Aborted(String),
    /// The end of a program that has died.
    Crashed,
    /// The loss of the leaf's host.
    HostLost,
}

/// The last end of a group.
#[derive(Clone, Debug)]
struct GroupEnd {
    transition: Transition,
    tag: Option<String>,
    failure: Option<Failure>,
}

/// An activation: the group, the member and the number.
#[derive(Clone, Copy, Debug)]
struct ActivationRef {
    group: usize,
    member: u32,
    activation: Activation,
}

/// A wait of a group.
#[derive(Clone, Copy, Debug)]
struct Timer {
    group: usize,
    timer: u32,
    activation: Activation,
    after: Duration,
}

/// A running plan.
#[derive(Clone, Debug)]
pub struct Simulation<'a> {
    plan: &'a Plan,
    programs: Vec<Program>,
    states: Vec<State>,
    clock: Clock,
    /// The leaves that run.
    leaves: BTreeMap<u32, ActivationRef>,
    /// For each running group below `main`, the activation that waits for its end.
    seats: BTreeMap<usize, ActivationRef>,
    queue: VecDeque<(usize, Event)>,
    record: Record,
    outcome: Option<Transition>,
    /// The open state of the story, while a story is played.
    pending: Option<Pending>,
}

/// The virtual time, and the timers that wait for it.
#[derive(Clone, Debug, Default)]
struct Clock {
    now: Duration,
    /// The waits, by the time when they end and then by their order of beginning.
    timers: BTreeMap<(Duration, u64), Timer>,
    /// How many waits have begun.
    begun: u64,
    /// How many events there were at the current instant.
    events: usize,
}

/// The past of a simulation, for its user.
#[derive(Clone, Debug, Default)]
struct Record {
    log: Vec<SimulationEvent>,
    timeline: Timeline,
    /// The states of each activity that were last noted.
    states: BTreeMap<usize, String>,
    /// The last end of each group.
    ends: BTreeMap<usize, GroupEnd>,
}

impl<'a> Simulation<'a> {
    /// Starts a valid plan.
    ///
    /// ```
    /// use language::{Ending, Options, Simulation, Source, Transition, compile};
    ///
    /// let spec = Source::new("a.dca", "process main() {
    ///     instantiated_processes { hit instof Hit(c1); arm instof Arm(c1); }
    ///     internal_event_actions { hit # arm }
    /// }");
    /// let plan = compile(&spec, &[], &Options::named("a")).plan.unwrap();
    /// let mut simulation = Simulation::start(&plan);
    /// assert_eq!(simulation.running(), ["main/hit", "main/arm"]);
    /// simulation.end("hit", Ending::Done).unwrap();
    /// assert_eq!(simulation.outcome(), Some(&Transition::Done));
    /// ```
    pub fn start(plan: &'a Plan) -> Self {
        let mut simulation = Self::idle(plan);
        simulation.queue.push_back((0, Event::Start(Value::EMPTY)));
        simulation.note(plan.groups[0].path.clone(), Transition::Started);
        simulation.react();
        simulation
    }

    /// Returns a simulation of a plan before anything has begun.
    fn idle(plan: &'a Plan) -> Self {
        let programs: Vec<Program> =
            plan.groups.iter().map(|group| Program::compile(group).with_scripts(Scripts::Known)).collect();
        let states = programs.iter().map(State::new).collect();
        Self {
            plan,
            programs,
            states,
            clock: Clock::default(),
            leaves: BTreeMap::new(),
            seats: BTreeMap::new(),
            queue: VecDeque::new(),
            record: Record::default(),
            outcome: None,
            pending: None,
        }
    }

    /// Returns the time since the start.
    pub fn now(&self) -> Duration {
        self.clock.now
    }

    /// Returns the outcome of `main`, if it has ended.
    pub fn outcome(&self) -> Option<&Transition> {
        self.outcome.as_ref()
    }

    /// Returns the paths of the running leaves, in the order of the plan.
    pub fn running(&self) -> Vec<&'a str> {
        self.leaves.keys().map(|&leaf| self.plan.leaves[leaf as usize].path.as_str()).collect()
    }

    /// Returns the time when the next wait ends.
    pub fn next_timer(&self) -> Option<Duration> {
        self.clock.timers.keys().next().map(|&(due, _)| due)
    }

    /// Returns the events since the last call.
    pub fn take_happenings(&mut self) -> Vec<SimulationEvent> {
        std::mem::take(&mut self.record.log)
    }

    /// Returns a chart of the run until now, as a picture (SVG).
    pub fn chart(&self) -> String {
        self.record.timeline.svg(self.plan, self.clock.now)
    }

    /// Lets a running leaf end. `name` is the path of the leaf, or a unique end of the path.
    ///
    /// # Errors
    /// If no running leaf has this name, or if several have it.
    pub fn end(&mut self, name: &str, ending: Ending) -> Result<(), SimulationError> {
        let leaf = self.find(name)?;
        self.end_leaf(leaf, ending);
        Ok(())
    }

    /// Asks `main` to stop.
    pub fn stop(&mut self) {
        self.queue.push_back((0, Event::Stop));
        self.react();
    }

    /// Lets time pass. Waits that end in this time end in their order.
    pub fn pass(&mut self, time: Duration) {
        let until = self.clock.now.saturating_add(time);
        while let Some((&(due, number), &ends)) = self.clock.timers.first_key_value() {
            if due > until || self.outcome.is_some() {
                break;
            }
            self.clock.timers.remove(&(due, number));
            self.set_now(due);
            self.note_wait(ends, &Transition::Done);
            let Timer { group, timer, activation, .. } = ends;
            self.queue.push_back((group, Event::Elapsed { timer, activation }));
            self.react();
        }
        self.set_now(until);
    }

    fn set_now(&mut self, now: Duration) {
        if now > self.clock.now {
            (self.clock.now, self.clock.events) = (now, 0);
        }
    }

    fn end_leaf(&mut self, leaf: u32, ending: Ending) {
        let Some(ActivationRef { group, member, activation }) = self.leaves.remove(&leaf) else { return };
        let path = self.plan.leaves[leaf as usize].path.clone();
        let event = match ending {
            Ending::Done => {
                self.note(path, Transition::Done);
                Event::Done { member, activation, value: Value::EMPTY }
            }
            Ending::Outcome(tag) => {
                self.note(path, Transition::Done);
                Event::Done { member, activation, value: Value::tagged(&tag, &[]).unwrap_or(Value::EMPTY) }
            }
            Ending::Aborted(why) => {
                self.note(path, Transition::Aborted(why.clone()));
                Event::Aborted { member, activation, report: Value::new(why.as_bytes()) }
            }
            Ending::Crashed => {
                self.note(path, Transition::Aborted("its program has died".to_owned()));
                Event::Aborted { member, activation, report: Failure::Crash.report() }
            }
            Ending::HostLost => {
                self.note(path, Transition::Aborted("its host was lost".to_owned()));
                Event::Aborted { member, activation, report: Failure::HostLost.report() }
            }
        };
        self.queue.push_back((group, event));
        self.react();
    }

    fn note(&mut self, path: String, transition: Transition) {
        self.record.timeline.note(&path, self.clock.now, &transition);
        self.record.log.push(SimulationEvent { at: self.clock.now, path, transition });
    }

    fn is_limit(&self, timer: Timer) -> bool {
        let kind = self.plan.groups[timer.group].expression.timers().get(timer.timer as usize).copied();
        kind == Some(TimerKind::Limit)
    }

    /// Notes the start or the end of a wait or of a limit. It has its own line in the chart.
    fn note_wait(&mut self, timer: Timer, transition: &Transition) {
        let (path, seconds) = (&self.plan.groups[timer.group].path, timer.after.as_secs_f64());
        let line = if self.is_limit(timer) {
            format!("{path}/within {seconds} s")
        } else {
            format!("{path}/wait({seconds} s)")
        };
        self.record.timeline.note(&line, self.clock.now, transition);
    }

    /// Reacts to the events in the queue until the queue is empty.
    fn react(&mut self) {
        let mut commands = Vec::new();
        while let Some((group, event)) = self.queue.pop_front() {
            self.clock.events += 1;
            if self.clock.events > INSTANT_MAX {
                return self.give_up();
            }
            let outcome = step(&self.programs[group], &mut self.states[group], event, &mut commands);
            for command in commands.drain(..) {
                self.obey_command(group, command);
            }
            match outcome {
                Some(outcome) => self.ended(group, outcome),
                None => self.note_states(group),
            }
        }
    }

    /// Gives the run up, because only the number of events would still grow.
    fn give_up(&mut self) {
        self.queue.clear();
        self.clock.timers.clear();
        self.leaves.clear();
        self.seats.clear();
        self.states = self.programs.iter().map(State::new).collect();
        let transition =
            Transition::Aborted(format!("more than {INSTANT_MAX} events at one instant: a loop takes no time"));
        self.note(self.plan.groups[0].path.clone(), transition.clone());
        self.outcome = Some(transition);
    }

    fn obey_command(&mut self, group: usize, command: Command) {
        match command {
            Command::Connect { .. } | Command::Disconnect { .. } => {}
            Command::Activate { member, activation, value } => {
                let seat = ActivationRef { group, member, activation };
                match self.plan.groups[group].members[member as usize].kind {
                    MemberKind::Leaf(leaf) if self.is_sent(&self.plan.leaves[leaf as usize].path, seat, &value) => {}
                    MemberKind::Group(inner) if self.is_sent(&self.plan.groups[inner as usize].path, seat, &value) => {}
                    MemberKind::Leaf(leaf) => {
                        if !self.pending.as_ref().is_some_and(|pending| pending.given_up.contains(&leaf)) {
                            self.note(self.plan.leaves[leaf as usize].path.clone(), Transition::Started);
                        }
                        self.leaves.insert(leaf, seat);
                    }
                    MemberKind::Group(inner) => {
                        self.note(self.plan.groups[inner as usize].path.clone(), Transition::Started);
                        self.seats.insert(inner as usize, seat);
                        self.queue.push_back((inner as usize, Event::Start(value)));
                    }
                }
            }
            Command::Stop { member, activation } => match self.plan.groups[group].members[member as usize].kind {
                MemberKind::Leaf(leaf) if self.pending.is_some() => self.is_asked(leaf),
                MemberKind::Group(inner) if self.pending.is_some() => self.is_ordered(inner as usize),
                MemberKind::Leaf(leaf) => {
                    if self.leaves.remove(&leaf).is_some() {
                        self.note(self.plan.leaves[leaf as usize].path.clone(), Transition::Stopped);
                    }
                    self.queue.push_back((group, Event::Stopped { member, activation }));
                }
                MemberKind::Group(inner) => self.queue.push_back((inner as usize, Event::Stop)),
            },
            Command::Arm { timer, activation, after } => {
                self.clock.begun += 1;
                let timer = Timer { group, timer, activation, after };
                let transition =
                    if self.is_limit(timer) { Transition::Limited(after) } else { Transition::Waits(after) };
                self.note(self.plan.groups[group].path.clone(), transition);
                // The order of an activity's timers matters, so each timer is at least as long as on a robot.
                let least = if self.chart_of(group).is_some() { TIMER_LEAST } else { Duration::ZERO };
                let due = self.clock.now.saturating_add(after.max(least));
                self.note_wait(timer, &Transition::Started);
                self.clock.timers.insert((due, self.clock.begun), timer);
            }
            Command::Cancel { timer, activation } => {
                let is_it = |armed: &Timer| (armed.group, armed.timer, armed.activation) == (group, timer, activation);
                let found = self.clock.timers.iter().find(|(_, armed)| is_it(armed)).map(|(due, armed)| (*due, *armed));
                if let Some((due, cancelled)) = found {
                    self.clock.timers.remove(&due);
                    self.note_wait(cancelled, &Transition::Stopped);
                }
            }
            Command::Log { .. } | Command::Send { .. } | Command::Lost { .. } => self.say(group, &command),
        }
    }

    /// Handles the end of a group, which is an event for the group around it.
    fn ended(&mut self, group: usize, outcome: Outcome) {
        let outcome = self.escalated(group, outcome);
        self.record.states.remove(&group);
        let path = &self.plan.groups[group].path;
        let transition = match &outcome {
            Outcome::Done(_) => Transition::Done,
            Outcome::Aborted(reason) => Transition::Aborted(self.explain(group, reason)),
            Outcome::Stopped => Transition::Stopped,
        };
        self.note(path.clone(), transition.clone());
        self.note_end(group, &transition, &outcome);
        if group == self.pending.as_ref().map_or(0, |pending| pending.root) {
            self.outcome = Some(transition);
            return;
        }
        let own = group;
        let Some(ActivationRef { group, member, activation }) = self.seats.remove(&own) else { return };
        let event = match outcome {
            Outcome::Done(value) => Event::Done { member, activation, value },
            Outcome::Aborted(reason) if reason.cause == Cause::StopUnconfirmed && self.pending.is_some() => {
                Event::StopUnconfirmed { member, activation }
            }
            Outcome::Aborted(reason) => Event::Aborted { member, activation, report: reason.report() },
            Outcome::Stopped => Event::Stopped { member, activation },
        };
        if !self.is_reported(own, &(group, event.clone())) {
            self.queue.push_back((group, event));
        }
    }

    /// Returns the reason why a member that is a group has failed, if it has failed.
    fn last_words(&self, group: usize, member: u32) -> Option<String> {
        let MemberKind::Group(inner) = self.plan.groups[group].members[member as usize].kind else { return None };
        let Transition::Aborted(text) = &self.record.ends.get(&(inner as usize))?.transition else { return None };
        Some(text.clone())
    }

    fn explain(&self, group: usize, reason: &Reason) -> String {
        let cause = match &reason.cause {
            Cause::Reported(report) => match reason.member.and_then(|member| self.last_words(group, member)) {
                Some(text) => text,
                None => match Failure::of_report(report) {
                    Failure::Crash => "its program has died".to_owned(),
                    Failure::HostLost => "its host was lost".to_owned(),
                    Failure::ScriptBudget => "a script has used up its budget".to_owned(),
                    Failure::ScriptFailed => "a script has failed".to_owned(),
                    Failure::Reported
                    | Failure::Busy
                    | Failure::StopUnconfirmed
                    | Failure::ServiceEnded
                    | Failure::Failed(_)
                    | Failure::NoMatch
                    | Failure::Timeout => String::from_utf8_lossy(report.bytes()).into_owned(),
                },
            },
            Cause::Busy => "it was running already".to_owned(),
            Cause::StopUnconfirmed => "its stop could not be confirmed".to_owned(),
            Cause::ServiceEnded => "a service ended".to_owned(),
            Cause::NoMatch => "no arm of `match` has this outcome".to_owned(),
            Cause::Script(error) => error.to_string(),
            // The chart has space for one word only.
            Cause::Failed(why) if why.starts_with(DEADLINE) => "timeout".to_owned(),
            Cause::Failed(why) => why.to_string(),
        };
        match reason.member {
            Some(member) => format!("`{}`: {cause}", self.plan.groups[group].members[member as usize].name),
            None => cause,
        }
    }
}
