//! A whole deployment in one thread on virtual time, with the real plan, the real algebra and the real controllers.
//!
//! `algebra::step` runs every group and every activity, and every leaf runs its controller under the virtual harness. Events and
//! orders between a leaf and its supervisor, and between supervisors, take one fixed latency. An activity takes the messages for
//! its ports every 4 ms. A host can be cut off for values and calls. Nothing else is simulated: no node and no process. So no host
//! is ever lost, and no supervisor starts a dead program again.

use comms::logic::control::{MessageFate, PortMessage};
use comms::logic::signals::Signal;
use comms::logic::time::Time;
pub use controllers::sdk::harness::Sample;
use controllers::sdk::harness::{CallEnd, Disturbance, Ending, Harness, ModuleId, Report, WireId};
use controllers::sdk::{Module, Registry};
use language::algebra::{Activation, Cause, Command, Event, Outcome, Program, Reason, State, StepRecord, Value, step};
use language::plan::{
    Argument, Constant, Expression, Leaf as PlanLeaf, MemberKind, Notice, PORTS, Plan, StateChart, Transfer,
};
use language::{Content, Options, Source, Style, compile, gather, render};
use rustix::process::setpriority_process;
use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

/// The time from a leaf's end to its supervisor's reaction, and from one supervisor to the next.
pub const LATENCY: Duration = Duration::from_millis(1);
const SLICE: Duration = Duration::from_millis(4);
/// The priority of simulated missions, in the numbers of setpriority(2). A thread of priority 0 gets about nine times as much
/// time.
const WITH_TIME: i32 = 10;

/// Compiles a spec against the interfaces of all controllers.
///
/// # Errors
/// Returns the diagnostics in readable form.
pub fn plan(name: &str, text: &str) -> Result<Plan, String> {
    plan_with(&Source::new(name, text), &[Source::new("controllers", controllers::registry().interface_text())])
}

/// Compiles a spec together with the files that it uses.
///
/// # Errors
/// Returns the diagnostics in readable form.
pub fn plan_with(spec: &Source, files: &[Source]) -> Result<Plan, String> {
    let compiled = compile(spec, files, &Options::named(&spec.name));
    compiled.plan.ok_or_else(|| render(&compiled.diagnostics, spec, files, Style::Plain))
}

/// Returns the files that a spec on the disk uses.
pub fn files_of(spec: &Source) -> Vec<Source> {
    gather(spec, &|path| {
        let told = |error: std::io::Error| error.to_string();
        if !Path::new(path).is_dir() {
            return std::fs::read_to_string(path).map(Content::File).map_err(told);
        }
        let names = std::fs::read_dir(path).map_err(told)?;
        let names = names.map(|entry| Ok(entry.map_err(told)?.file_name().to_string_lossy().into_owned()));
        names.collect::<Result<Vec<_>, String>>().map(Content::Folder)
    })
}

/// The ending of a deployment.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Finish {
    /// Normally.
    Done,
    /// By a failure: the leaf where it began, and the reason.
    Aborted(String),
    /// The mission was still running at the limit.
    Unfinished,
}

/// A deployment at work.
#[derive(Debug)]
pub struct Simulation {
    plan: Plan,
    registry: Registry,
    harness: Harness,
    groups: Vec<Supervisor>,
    leaves: Vec<Leaf>,
    wires: Vec<WireId>,
    queue: BTreeMap<(Time, u64), (usize, Event)>,
    numbered: u64,
    finish: Option<Finish>,
    steps: Vec<Vec<StepRecord>>,
    loses: Option<fn(&Command) -> bool>,
    /// The first leaf without a confirmed stop, and the reason.
    unconfirmed: Option<String>,
}

/// A group at work. `parent` is its group and its slot there.
#[derive(Debug)]
struct Supervisor {
    program: Program,
    state: State,
    parent: Option<(usize, u32)>,
    activation: Activation,
}

#[derive(Debug)]
struct Leaf {
    module: ModuleId,
    parent: (usize, u32),
    activation: Activation,
}

/// Makes this thread give way to real missions on the same machine. They have deadlines, while a simulated mission has a clock of
/// its own.
fn give_way() {
    // A thread may always lower its priority. If the system refuses, the thread keeps its priority.
    setpriority_process(None, WITH_TIME).unwrap_or_default();
}

impl Simulation {
    /// Makes every leaf and every wire of a plan, but starts nothing yet.
    ///
    /// # Errors
    /// Names the leaf or wire that cannot be made.
    pub fn new(plan: Plan, disturbance: Disturbance) -> Result<Self, String> {
        Self::with(plan, disturbance, controllers::registry())
    }

    /// Makes every leaf and every wire of a plan whose controllers are in `registry`, but starts nothing yet.
    ///
    /// # Errors
    /// Names the leaf or wire that cannot be made.
    pub fn with(plan: Plan, disturbance: Disturbance, registry: Registry) -> Result<Self, String> {
        give_way();
        let mut harness = Harness::new(disturbance);
        let mut modules = Vec::new();
        for leaf in &plan.leaves {
            modules.push(harness.add(made(&registry, leaf)?));
        }
        let mut wires = Vec::new();
        for wire in &plan.wires {
            let from = (modules[wire.from.leaf as usize], wire.from.port.as_str());
            let to = (modules[wire.to.leaf as usize], wire.to.port.as_str());
            let connected = match wire.transfer {
                Transfer::Push | Transfer::Pull => harness.connect(from, to),
                Transfer::Call => {
                    let [caller, server] = [from, to].map(|(module, name)| CallEnd { module, name });
                    harness.connect_call(caller, server)
                }
            };
            wires.push(connected.map_err(|error| error.to_string())?);
        }
        let mut parents = BTreeMap::new();
        let mut leaf_parents = BTreeMap::new();
        for (group, spec) in plan.groups.iter().enumerate() {
            for (slot, member) in (0..).zip(&spec.members) {
                match member.kind {
                    MemberKind::Leaf(leaf) => leaf_parents.insert(leaf as usize, (group, slot)),
                    MemberKind::Group(child) => parents.insert(child as usize, (group, slot)),
                };
            }
        }
        let supervisor = |(index, group)| {
            let program = Program::compile(group);
            let state = State::new(&program);
            Supervisor { program, state, parent: parents.get(&index).copied(), activation: Activation(0) }
        };
        let groups = plan.groups.iter().enumerate().map(supervisor).collect();
        let leaf = |(index, module)| Leaf { module, parent: leaf_parents[&index], activation: Activation(0) };
        let leaves = modules.into_iter().enumerate().map(leaf).collect();
        let queue = BTreeMap::from([((Time::ZERO, 0), (0, Event::Start(Value::EMPTY)))]);
        let steps = vec![Vec::new(); plan.groups.len()];
        let (numbered, finish, loses, unconfirmed) = (0, None, None, None);
        Ok(Self { plan, registry, harness, groups, leaves, wires, queue, numbered, finish, steps, loses, unconfirmed })
    }

    /// Returns the present time.
    pub fn now(&self) -> Time {
        self.harness.now()
    }

    /// Returns the number of samples sent so far.
    pub fn samples_sent(&self) -> u64 {
        self.harness.samples_sent()
    }

    /// Returns whether the leaf whose path ends with `path` is running or stopping.
    pub fn is_active(&self, path: &str) -> bool {
        self.leaf(path).is_some_and(|leaf| self.harness.is_active(leaf))
    }

    /// Returns whether a leaf whose path contains `part` is running or stopping.
    pub fn is_any_active(&self, part: &str) -> bool {
        let leaves = self.plan.leaves.iter().zip(&self.leaves);
        leaves.filter(|(leaf, _)| leaf.path.contains(part)).any(|(_, leaf)| self.harness.is_active(leaf.module))
    }

    /// Returns a signal of the leaf whose path ends with `path`; NaN if there is none.
    pub fn signal(&self, path: &str, name: &str) -> f64 {
        let signals = self.leaf(path).map(|leaf| self.harness.signals(leaf)).unwrap_or_default();
        signals.iter().find(|signal| signal.name == name).map_or(f64::NAN, |signal| signal.value)
    }

    /// Returns the signals of all leaves that are running or stopping, with the paths of their leaves.
    pub fn signals(&self) -> impl Iterator<Item = (&str, Signal)> {
        let active = self.plan.leaves.iter().zip(&self.leaves).filter(|(_, leaf)| self.harness.is_active(leaf.module));
        active.flat_map(|(spec, leaf)| {
            self.harness.signals(leaf.module).into_iter().map(|signal| (spec.path.as_str(), signal))
        })
    }

    /// Kills the leaf whose path ends with `path`, like `kill -9`. Returns whether it was active.
    pub fn crash(&mut self, path: &str) -> bool {
        let leaf = self.leaf(path).filter(|leaf| self.harness.is_active(*leaf));
        if let Some(leaf) = leaf {
            self.harness.crash(leaf);
        }
        leaf.is_some()
    }

    /// Restarts the leaf whose path ends with `path`, without its memory. Returns whether it was active.
    pub fn restart(&mut self, path: &str) -> bool {
        let leaf = self.leaf(path).filter(|leaf| self.harness.is_active(*leaf));
        if let Some(leaf) = leaf {
            self.harness.restart(leaf, &[]);
        }
        leaf.is_some()
    }

    /// Kills the leaf whose path ends with `path`, and starts it again at once, like a node whose policy says so. The new program
    /// has no memory. Returns whether it was active.
    ///
    /// # Panics
    /// Panics if the leaf cannot be made a second time.
    pub fn kill_and_restart(&mut self, path: &str) -> bool {
        let index = self.plan.leaves.iter().position(|leaf| leaf.path.ends_with(path));
        let Some(index) = index.filter(|index| self.harness.is_active(self.leaves[*index].module)) else {
            return false;
        };
        let again = made(&self.registry, &self.plan.leaves[index]).expect("it was made before");
        self.harness.replace(self.leaves[index].module, again);
        self.harness.activate(self.leaves[index].module, &[]);
        true
    }

    /// Cuts a host off: no value and no call passes. None heals the cut.
    pub fn cut(&mut self, host: Option<&str>) {
        let number = host.and_then(|host| self.plan.hosts.iter().position(|known| known == host));
        let far = self.plan.leaves.iter().zip(&self.leaves).filter(|(leaf, _)| Some(leaf.host as usize) == number);
        self.harness.cut(&far.map(|(_, leaf)| leaf.module).collect::<Vec<_>>());
    }

    /// Gives an activity a notice, like a person or a node. Returns whether the activity waits for such a notice.
    pub fn tell(&mut self, path: &str, notice: &Notice) -> bool {
        let Some(group) = self.plan.groups.iter().position(|group| group.path == path) else { return false };
        let event = self.chart(group).and_then(|chart| chart.notice(notice));
        let is_known = event.is_some();
        event.into_iter().for_each(|event| self.put(self.now() + LATENCY, group, event));
        is_known
    }

    /// Returns the active states of an activity that have no active inner states.
    pub fn states(&self, path: &str) -> Vec<&str> {
        let Some(index) = self.plan.groups.iter().position(|group| group.path == path) else { return Vec::new() };
        let group = &self.groups[index];
        let Some((automaton, place)) = group.program.automaton().zip(group.state.chart()) else { return Vec::new() };
        place.leaves(automaton).filter_map(|state| Some(automaton.chart().states.get(state)?.name.as_str())).collect()
    }

    /// Returns the steps of the supervisor of each group.
    pub fn steps(&self) -> &[Vec<StepRecord>] {
        &self.steps
    }

    /// Introduces a mistake: from now on, supervisors lose the commands for which `loses` returns true.
    pub fn lose(&mut self, loses: fn(&Command) -> bool) {
        self.loses = Some(loses);
    }

    /// From now on, lets `meddler` see and change the encoded samples for leaves. It also receives the path of the leaf.
    ///
    /// # Panics
    /// Panics if a sample comes from a module that is not a leaf, which does not happen.
    pub fn meddle(&mut self, mut meddler: impl FnMut(&str, &Sample, &mut Vec<u8>) + 'static) {
        let modules = self.leaves.iter().map(|leaf| leaf.module);
        let paths: BTreeMap<ModuleId, String> =
            modules.zip(self.plan.leaves.iter().map(|leaf| leaf.path.clone())).collect();
        self.harness.meddle(move |sample, bytes| {
            let path = paths.get(&sample.module).expect("each module is a leaf");
            meddler(path, sample, bytes);
        });
    }

    /// Changes the disturbance by the machine and the network from now on.
    pub fn disturb(&mut self, disturbance: Disturbance) {
        self.harness.disturb(disturbance);
    }

    /// Returns the paths of all leaves.
    pub fn leaves(&self) -> impl Iterator<Item = &str> {
        self.plan.leaves.iter().map(|leaf| leaf.path.as_str())
    }

    fn leaf(&self, path: &str) -> Option<ModuleId> {
        let index = self.plan.leaves.iter().position(|leaf| leaf.path.ends_with(path))?;
        self.leaves.get(index).map(|leaf| leaf.module)
    }

    /// Asks the root to stop, as Ctrl-C does.
    pub fn stop(&mut self) {
        self.put(self.now(), 0, Event::Stop);
    }

    /// Runs until the end, but at most until `limit`. It calls `observe` every 4 ms.
    pub fn run(&mut self, limit: Time, observe: &mut dyn FnMut(&mut Self)) -> Finish {
        while self.finish.is_none() && self.now() < limit {
            let slice = self.now() + SLICE;
            self.run_until(slice);
            observe(self);
        }
        self.finish.clone().unwrap_or(Finish::Unfinished)
    }

    fn run_until(&mut self, until: Time) {
        while self.finish.is_none() {
            let event_at = self.queue.first_key_value().map(|(key, _)| key.0).filter(|at| *at <= until);
            let report = self.harness.run(event_at.unwrap_or(until));
            self.take_messages();
            if let Some(report) = report {
                self.report(report);
            } else if event_at.is_some() {
                if let Some((_, (group, event))) = self.queue.pop_first() {
                    self.react(group, event);
                }
            } else {
                return;
            }
        }
    }

    fn chart(&self, group: usize) -> Option<&StateChart> {
        let expression = &self.plan.groups.get(group)?.expression;
        if let Expression::Chart(chart) = expression { Some(chart) } else { None }
    }

    /// Hands the messages at the ports of activities to the activities.
    fn take_messages(&mut self) {
        for (group, leaf) in self.port_leaves() {
            let module = self.leaves[leaf].module;
            for message in self.harness.take_messages(module) {
                let (number, fate) = (message.number, self.take_message(group, message));
                self.harness.received(module, number, fate);
            }
        }
    }

    /// Returns each activity with connections, with the leaf that has its ports.
    fn port_leaves(&self) -> Vec<(usize, usize)> {
        let groups = (0_u32..).zip(&self.plan.groups);
        let with_ports = groups.filter_map(|(group, _)| Some((group as usize, self.plan.ports_of(group)?.1 as usize)));
        with_ports.collect()
    }

    /// Gives an activity a message, by the rules of a node.
    fn take_message(&mut self, group: usize, message: PortMessage) -> MessageFate {
        let PortMessage { port, value, priority, has_receipt, .. } = message;
        let supervisor = &self.groups[group];
        let place = supervisor.program.automaton().zip(supervisor.state.chart());
        let event = self.chart(group).and_then(|chart| {
            let number = chart.inputs.iter().position(|name| *name == port)?;
            chart.value_at(u32::try_from(number).ok()?, Value::new(&value), priority)
        });
        let (Some((automaton, place)), Some(event)) = (place.filter(|_| !supervisor.state.is_idle()), event) else {
            return MessageFate::Idle;
        };
        if let Event::Message { port, .. } = &event
            && has_receipt
            && place.has_no_room(automaton, *port as usize, priority)
        {
            return MessageFate::Full;
        }
        self.react(group, event);
        MessageFate::Taken
    }

    /// Sends a value of an activity through the program with its ports.
    fn send(&mut self, group: usize, output: u32, value: &Value) {
        let leaf = u32::try_from(group).ok().and_then(|group| self.plan.ports_of(group));
        let port = self.chart(group).and_then(|chart| chart.outputs.get(output as usize)).cloned();
        if let (Some((_, leaf)), Some(port)) = (leaf, port) {
            let module = self.leaves[leaf as usize].module;
            self.harness.send_from(module, &port, value.bytes()).expect("the plan has this output");
        }
    }

    fn put(&mut self, at: Time, group: usize, event: Event) {
        self.numbered += 1;
        self.queue.insert((at, self.numbered), (group, event));
    }

    fn report(&mut self, report: Report) {
        let Some(index) = self.leaves.iter().position(|leaf| leaf.module == report.module) else { return };
        let ((group, member), activation) = (self.leaves[index].parent, self.leaves[index].activation);
        let event = match report.ending {
            Ending::Done(value) => Event::Done { member, activation, value: Value::new(&value) },
            Ending::Aborted(reason) => {
                let text = format!("{}: {reason}", self.plan.leaves[index].path);
                Event::Aborted { member, activation, report: Value::new(text.as_bytes()) }
            }
            Ending::Stopped => Event::Stopped { member, activation },
            Ending::Unconfirmed(why) => {
                let path = &self.plan.leaves[index].path;
                self.unconfirmed.get_or_insert(format!("{path}: its stop could not be confirmed: {why}"));
                Event::StopUnconfirmed { member, activation }
            }
        };
        self.put(self.now() + LATENCY, group, event);
    }

    fn react(&mut self, group: usize, event: Event) {
        let starts = matches!(event, Event::Start(_));
        let mut commands = Vec::new();
        let supervisor = &mut self.groups[group];
        let outcome = step(&supervisor.program, &mut supervisor.state, event.clone(), &mut commands);
        if let Some(loses) = self.loses {
            commands.retain(|command| !loses(command));
        }
        self.steps[group].push(StepRecord::new(event, commands.clone(), outcome.clone()));
        if starts {
            for set in self.plan.groups[group].sets_always.clone() {
                self.switch(group, set, Harness::open);
            }
        }
        for command in commands {
            self.obey(group, command);
        }
        if let Some(outcome) = outcome {
            for set in self.plan.groups[group].sets_always.clone() {
                self.switch(group, set, Harness::close);
            }
            self.end(group, outcome);
        }
    }

    fn switch(&mut self, group: usize, set: u32, switch: fn(&mut Harness, WireId)) {
        for wire in &self.plan.groups[group].sets[set as usize].wires {
            switch(&mut self.harness, self.wires[*wire as usize]);
        }
    }

    fn obey(&mut self, group: usize, command: Command) {
        let soon = self.now() + LATENCY;
        match command {
            Command::Connect { set } => self.switch(group, set, Harness::open),
            Command::Disconnect { set } => self.switch(group, set, Harness::close),
            Command::Activate { member, activation, value } => match self.kind(group, member) {
                MemberKind::Leaf(leaf) => {
                    let leaf = &mut self.leaves[leaf as usize];
                    leaf.activation = activation;
                    self.harness.activate(leaf.module, value.bytes());
                }
                MemberKind::Group(child) => {
                    self.groups[child as usize].activation = activation;
                    self.put(soon, child as usize, Event::Start(value));
                }
            },
            Command::Stop { member, .. } => match self.kind(group, member) {
                MemberKind::Leaf(leaf) => self.harness.stop(self.leaves[leaf as usize].module),
                MemberKind::Group(child) => self.put(soon, child as usize, Event::Stop),
            },
            Command::Arm { timer, activation, after } => {
                self.put(self.now() + after, group, Event::Elapsed { timer, activation });
            }
            // The activation number of a late timer shows that it was cancelled, so the late timer is dropped.
            Command::Cancel { .. } => {}
            Command::Send { output, value } => self.send(group, output, &value),
            Command::Log { .. } | Command::Lost { .. } => {}
        }
    }

    fn kind(&self, group: usize, member: u32) -> MemberKind {
        self.plan.groups[group].members[member as usize].kind
    }

    fn end(&mut self, group: usize, outcome: Outcome) {
        let Some((parent, member)) = self.groups[group].parent else {
            self.finish = Some(match outcome {
                Outcome::Done(_) | Outcome::Stopped => Finish::Done,
                Outcome::Aborted(reason) => Finish::Aborted(self.why(group, &reason)),
            });
            return;
        };
        let activation = self.groups[group].activation;
        let event = match outcome {
            Outcome::Done(value) => Event::Done { member, activation, value },
            Outcome::Aborted(Reason { cause: Cause::StopUnconfirmed, .. }) => {
                Event::StopUnconfirmed { member, activation }
            }
            Outcome::Aborted(reason) => {
                let report = Value::new(self.why(group, &reason).as_bytes());
                Event::Aborted { member, activation, report }
            }
            Outcome::Stopped => Event::Stopped { member, activation },
        };
        self.put(self.now() + LATENCY, parent, event);
    }

    fn why(&self, group: usize, reason: &Reason) -> String {
        let group = &self.plan.groups[group];
        let member = reason.member.and_then(|slot| group.members.get(slot as usize));
        let path = member.map_or_else(|| group.path.clone(), |member| format!("{}/{}", group.path, member.name));
        match &reason.cause {
            Cause::Reported(report) => String::from_utf8_lossy(report.bytes()).into_owned(),
            Cause::Busy => format!("{path}: it was already running"),
            Cause::StopUnconfirmed => {
                self.unconfirmed.clone().unwrap_or_else(|| format!("{path}: its stop is not confirmed"))
            }
            Cause::ServiceEnded => format!("{path}: a service ended"),
            Cause::Failed(text) => format!("{path}: {text}"),
            Cause::NoMatch => format!("{path}: no arm of `match` has this outcome"),
            Cause::Script(error) => format!("{path}: {error}"),
        }
    }
}

/// Makes the controller of a leaf.
fn made(registry: &Registry, leaf: &PlanLeaf) -> Result<Box<dyn Module>, String> {
    let arguments: Vec<String> = leaf.arguments.iter().map(spelled).collect();
    let ports = (leaf.module == PORTS).then(controllers::activity_ports);
    let made = ports.as_ref().unwrap_or(registry).create_at("", &leaf.path, &leaf.module, &arguments);
    made.map_err(|error| format!("{}: {error}", leaf.path))
}

/// Returns an argument in the form that the controller kit reads.
fn spelled(argument: &Argument) -> String {
    let value = match &argument.value {
        Constant::Text(text) => text.clone(),
        Constant::Number(number) => number.to_string(),
        Constant::Truth(truth) => truth.to_string(),
        Constant::Secret(key) => format!("secret({key:?})"),
    };
    argument.name.as_ref().map_or(value.clone(), |name| format!("{name}={value}"))
}
