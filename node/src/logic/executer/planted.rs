//! Faults planted in a supervisor: `verify::conform` must find them in its records.
//!
//! The supervisor is the node's own, and carries out what it records: a fault is planted after `step`, before its
//! commands are carried out. The simulated world obeys: programs run when they are activated, and end one after the
//! other.

use super::{ExecContext, Executer, MemberRef};
use crate::logic::effect::Out;
use crate::logic::protocol::{Body, Deployment, Ending, Failure, FailureCause, Target, ToCoordinator, ToParticipant};
use comms::logic::time::Time;
use language::algebra::{Activation, Cause, Command, Event, Outcome, Program, Reason, State, StepRecord, Value, step};
use language::plan::Plan;
use language::sites::Sites;
use language::{Options, Source, compile_with_sites};
use std::time::Duration;
use verify::{Alone, Always, Conformance, Limits};

const LIMITS: Limits<'static> = Limits { states: 10_000, memory: 16 << 20, threads: &Alone, goes_on: &Always };
/// A mission that continues for longer is stopped.
const EVENTS_MAX: usize = 40;

/// A step of a supervisor, to be spoilt.
pub(super) struct Step<'s> {
    program: &'s Program,
    state: &'s mut State,
    event: &'s Event,
    commands: &'s mut Vec<Command>,
    outcome: &'s mut Option<Outcome>,
}

/// A fault of the supervisor, applied to every step.
pub(super) type Fault = fn(&mut Step<'_>);

/// Spoils a step of a supervisor.
pub(super) fn spoil(
    executer: &mut Executer,
    event: &Event,
    commands: &mut Vec<Command>,
    mut outcome: Option<Outcome>,
) -> Option<Outcome> {
    if let Some(fault) = executer.planted {
        let (program, state) = (&executer.program, &mut executer.state);
        fault(&mut Step { program, state, event, commands, outcome: &mut outcome });
    }
    outcome
}

/// Event actions that between them want everything of a supervisor; `arm` is the program that fails.
const MISSIONS: [&str; 8] = [
    "(watch # drive) ; home",
    "eye[near], drive ; home",
    "drive : home",
    "drive within 5 s ; home",
    "arm else home",
    "(arm # watch) ; home",
    "wait(2 s) ; (drive, home)",
    "(eye[near], drive) ; eye[far] # home ; using(table) watch",
];

fn compiled(mission: &str) -> (Plan, Sites) {
    let text = format!(
        "module Step(host: Host) {{ in In: Ranges; done; }}
        module Eye(host: Host) {{ out Out: Ranges; service; }}
        process main(){{
            host{{c1}}
            resource table;
            instantiated_processes{{
                watch instof Step(c1); drive instof Step(c1); home instof Step(c1); arm instof Step(c1); eye instof Eye(c1);
            }}
            internal_connections(eye, near){{ eye, Out -> drive, In; }}
            internal_connections(eye, far){{ eye, Out -> home, In; }}
            internal_event_actions{{ {mission} }}
        }}"
    );
    let (compiled, sites) = compile_with_sites(&Source::new("test.dca", text), &[], &Options::named("test"));
    compiled.plan.zip(sites).unwrap_or_else(|| panic!("{mission}: {:?}", compiled.diagnostics))
}

/// The programs around a supervisor, and the messages that were sent to them.
struct World<'w> {
    plan: &'w Plan,
    deployment: Deployment,
    now: Time,
    executer: Executer,
    /// The programs that run, in the order in which they began: leaf, activation, whether it is to stop.
    programs: Vec<(u32, u32, bool)>,
    steps: Vec<StepRecord>,
    has_ended: bool,
}

impl World<'_> {
    /// Lets the supervisor act, and collects its commands.
    fn let_it(&mut self, act: impl FnOnce(&mut Executer, ExecContext<'_>, &mut Out<'_>) -> Option<Ending>) {
        let (mut effects, mut messages) = (Vec::new(), Vec::new());
        let mut out = Out { now: self.now, since_1970: Duration::ZERO, effects: &mut effects, messages: &mut messages };
        let context = ExecContext {
            deployment: &self.deployment,
            home: "c1",
            plan: self.plan,
            since_go: Duration::ZERO,
            start: Time::ZERO,
        };
        self.has_ended |= act(&mut self.executer, context, &mut out).is_some();
        for (_, message) in messages {
            if let Body::Coordinator(ToCoordinator::Stepped { steps, .. }) = message.body {
                self.steps.extend(steps);
            } else if let Body::Participant(message) = message.body {
                self.obey(message);
            }
        }
    }

    fn obey(&mut self, message: ToParticipant) {
        if let ToParticipant::Activate { target: Target::Leaf(leaf), activation, .. } = message {
            self.programs.push((leaf, activation, false));
        } else if let ToParticipant::Stop { target: Target::Leaf(leaf), activation } = message {
            let is_it = |program: &&mut (u32, u32, bool)| (program.0, program.1) == (leaf, activation);
            self.programs.iter_mut().filter(is_it).for_each(|program| program.2 = true);
        } else if let ToParticipant::Flip { generation, .. } = message {
            self.let_it(|executer, at, out| {
                executer.switched(generation, at, out);
                None
            });
        } else if let ToParticipant::Ended { target: Target::Leaf(leaf), activation, ending } = message {
            self.ends(leaf, activation, ending);
        }
    }

    fn ends(&mut self, leaf: u32, activation: u32, ending: Ending) {
        self.let_it(|executer, at, out| executer.ended(MemberRef { slot: leaf, activation }, ending, at, out));
    }

    /// Lets something happen: a member that is to stop has stopped, the first running one ends, or else time passes.
    /// Returns whether anything did.
    fn goes_on(&mut self) -> bool {
        let soon = self.now + Duration::from_millis(50);
        let ends = |leaf: u32| self.plan.leaves[leaf as usize].module != "Eye";
        let stops = self.programs.iter().position(|(.., is_stopping)| *is_stopping);
        let first = stops.or_else(|| self.programs.iter().position(|(leaf, ..)| ends(*leaf)));
        let due = self.executer.deadline();
        if let Some(due) = due.filter(|due| *due <= soon || first.is_none()) {
            self.now = self.now.max(due);
            self.let_it(Executer::tick);
            return true;
        }
        let Some(first) = first else { return false };
        let (leaf, activation, is_stopping) = self.programs.remove(first);
        let cause = FailureCause::Reported("broken".to_owned());
        let ending = match self.plan.leaves[leaf as usize].path.as_str() {
            _ if is_stopping => Ending::Stopped,
            "main/arm" => Ending::Aborted(Failure { origin: "main/arm".to_owned(), cause, at: Duration::ZERO }),
            _ => Ending::Done(vec![7, 7]),
        };
        self.ends(leaf, activation, ending);
        true
    }
}

/// Returns the steps that the supervisor of a plan records of a mission.
fn recorded(plan: &Plan, planted: Option<Fault>) -> Vec<StepRecord> {
    let executer = Executer::new(plan, 0, false).expect("there is a group");
    let deployment = Deployment { name: "test".to_owned(), epoch: 1 };
    let mut world = World {
        plan,
        deployment,
        now: Time::ZERO,
        executer,
        programs: Vec::new(),
        steps: Vec::new(),
        has_ended: false,
    };
    world.executer.planted = planted;
    world.let_it(|executer, at, out| executer.activate(1, &[], at, out));
    for _ in 0..EVENTS_MAX {
        if world.has_ended || !world.goes_on() {
            break;
        }
    }
    world.let_it(|executer, at, out| executer.stop(1, at, out));
    // The steps that would be recorded with the next ones.
    world.steps.append(&mut world.executer.outside.news.steps);
    world.steps
}

fn compared(plan: &Plan, sites: &Sites, steps: Vec<StepRecord>) -> Conformance {
    verify::conform(plan, sites, &[vec![steps]], &LIMITS)
}

fn lose(step: &mut Step<'_>, is_lost: fn(&Command) -> bool) {
    step.commands.retain(|command| !is_lost(command));
}

fn change(step: &mut Step<'_>, change: fn(&mut Command)) {
    step.commands.iter_mut().for_each(change);
}

/// A supervisor that has the mistakes of others.
const FAULTS: [(&str, Fault); 20] = [
    ("it forgets to stop", |step| lose(step, |command| matches!(command, Command::Stop { .. }))),
    ("it forgets to start", |step| lose(step, |command| matches!(command, Command::Activate { member: 2, .. }))),
    ("it forgets to connect", |step| lose(step, |command| matches!(command, Command::Connect { .. }))),
    ("it forgets to disconnect", |step| lose(step, |command| matches!(command, Command::Disconnect { .. }))),
    ("it sets no timer", |step| lose(step, |command| matches!(command, Command::Arm { .. }))),
    ("it keeps a timer", |step| lose(step, |command| matches!(command, Command::Cancel { .. }))),
    ("it starts another", |step| {
        change(step, |command| {
            if let Command::Activate { member, .. } = command {
                *member = (*member + 1) % 4;
            }
        });
    }),
    ("it stops another", |step| {
        change(step, |command| {
            if let Command::Stop { member, .. } = command {
                *member = (*member + 1) % 4;
            }
        });
    }),
    ("it connects another set", |step| {
        change(step, |command| {
            if let Command::Connect { set } = command {
                *set = 1 - (*set).min(1);
            }
        });
    }),
    ("it starts twice", |step| {
        let again = step.commands.iter().find(|command| matches!(command, Command::Activate { .. })).cloned();
        step.commands.extend(again);
    }),
    ("its timer is late", |step| {
        change(step, |command| {
            if let Command::Arm { after, .. } = command {
                *after += Duration::from_secs(1);
            }
        });
    }),
    ("it loses the value of the step before", |step| {
        change(step, |command| {
            if let Command::Activate { value, .. } = command {
                *value = Value::EMPTY;
            }
        });
    }),
    ("its activations have other numbers", |step| {
        change(step, |command| {
            if let Command::Activate { activation, .. } = command {
                *activation = Activation(activation.0 + 1);
            }
        });
    }),
    ("it starts before it connects", |step| step.commands.reverse()),
    ("it says that a failure is a success", |step| {
        if matches!(step.outcome, Some(Outcome::Aborted(_) | Outcome::Stopped)) {
            *step.outcome = Some(Outcome::Done(Value::EMPTY));
        }
    }),
    ("it says that a success is a failure", |step| {
        if matches!(step.outcome, Some(Outcome::Done(_))) {
            let cause = Cause::Failed("no".into());
            *step.outcome = Some(Outcome::Aborted(Reason { member: None, cause }));
        }
    }),
    ("it does not say that it has ended", |step| *step.outcome = None),
    ("it ends too early", |step| {
        if matches!(step.event, Event::Done { .. }) && step.outcome.is_none() {
            *step.outcome = Some(Outcome::Done(Value::EMPTY));
        }
    }),
    ("it takes an event twice", |step| {
        if matches!(step.event, Event::Elapsed { .. } | Event::Start(_)) {
            let again = if matches!(step.event, Event::Start(_)) { Event::Stop } else { step.event.clone() };
            *step.outcome = language_step(step, again).or(step.outcome.take());
        }
    }),
    ("it forgets where it was", |step| {
        if !matches!(step.event, Event::Start(_)) {
            *step.state = State::new(step.program);
        }
    }),
];

fn language_step(planted: &mut Step<'_>, event: Event) -> Option<Outcome> {
    step(planted.program, planted.state, event, planted.commands)
}

#[test]
fn a_supervisor_without_mistakes_conforms() {
    for mission in MISSIONS {
        let (plan, sites) = compiled(mission);
        let steps = recorded(&plan, None);
        assert!(steps.len() > 2 && steps.iter().any(|step| step.outcome.is_some()), "{mission}: {steps:?}");
        assert_eq!(compared(&plan, &sites, steps).deviations, Vec::new(), "{mission}");
    }
}

#[test]
fn every_planted_mistake_is_found() {
    for (what, fault) in FAULTS {
        let (mut made, mut found) = (0, 0);
        for mission in MISSIONS {
            let (plan, sites) = compiled(mission);
            let (right, wrong) = (recorded(&plan, None), recorded(&plan, Some(fault)));
            let is_made = right != wrong;
            let deviations = compared(&plan, &sites, wrong).deviations;
            assert_eq!(is_made, !deviations.is_empty(), "{what}, in {mission}: {deviations:?}");
            (made, found) = (made + usize::from(is_made), found + deviations.len());
        }
        assert!(made > 0 && found == made, "{what}: made in {made} missions, found in {found}");
    }
}

/// A supervisor that carries out the event actions of another spec.
#[test]
fn other_event_actions_are_found() {
    let mut found = 0;
    for mission in MISSIONS {
        for other in MISSIONS.into_iter().filter(|other| *other != mission) {
            let (plan, sites) = compiled(mission);
            let steps = recorded(&compiled(other).0, None);
            found += compared(&plan, &sites, steps).deviations.len();
        }
    }
    assert_eq!(found, MISSIONS.len() * (MISSIONS.len() - 1));
}
