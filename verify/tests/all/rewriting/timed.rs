//! Runs random groups with the clock of a supervisor, which is late at times. The verifier must know each run.

use super::random::{Dice, Taste, group};
use super::text::text;
use language::algebra::{Activation, Command, Event, Program, State, StepRecord, Value, step};
use language::plan::TIMER_LEAST;
use language::{Options, Source, compile_with_sites};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;
use verify::{Alone, Always, Limits, conform};

/// The number of runs of each group.
const RUNS: usize = 12;
/// A run with more events is cut off.
const EVENTS_MAX: usize = 60;

/// A timer that is armed. Alarms elapse in this order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Alarm {
    due: Duration,
    order: usize,
    timer: u32,
    activation: Activation,
}

/// One run of a supervisor.
struct Run<'r> {
    dice: &'r mut Dice,
    program: &'r Program,
    services: Vec<bool>,
    tags: &'r BTreeMap<u32, Vec<String>>,
    state: State,
    now: Duration,
    alarms: BTreeSet<Alarm>,
    armed: usize,
    /// The next event of each program, with its time.
    programs: BTreeMap<u32, (Duration, Event)>,
    steps: Vec<StepRecord>,
}

impl Run<'_> {
    /// Carries out a run; returns how many timers elapsed.
    fn complete(&mut self) -> u64 {
        let mut elapsed = 0;
        let mut is_over = self.happen(Event::Start(Value::EMPTY));
        while !is_over && self.steps.len() < EVENTS_MAX {
            let Some(event) = self.next() else { break };
            elapsed += u64::from(matches!(event, Event::Elapsed { .. }));
            is_over = self.happen(event);
        }
        elapsed
    }

    /// Lets time pass until something is due, and often longer. Returns one of the events that are due.
    fn next(&mut self) -> Option<Event> {
        let alarm = self.alarms.first().copied();
        let first = self.programs.values().map(|(at, _)| *at).chain(alarm.map(|alarm| alarm.due)).min()?;
        self.now = self.now.max(first);
        if self.dice.one_in(4) {
            let late = self.sometime();
            self.now += late;
        }
        let due: Vec<u32> =
            self.programs.iter().filter(|(_, (at, _))| *at <= self.now).map(|(slot, _)| *slot).collect();
        match alarm.filter(|alarm| alarm.due <= self.now) {
            Some(alarm) if due.is_empty() || self.dice.one_in(2) => {
                self.alarms.remove(&alarm);
                Some(Event::Elapsed { timer: alarm.timer, activation: alarm.activation })
            }
            Some(_) | None => Some(self.programs.remove(self.dice.pick(&due))?.1),
        }
    }

    fn sometime(&mut self) -> Duration {
        Duration::from_millis(500 * u64::from(self.dice.below(13)))
    }

    /// Applies an event; returns whether the group has ended.
    fn happen(&mut self, event: Event) -> bool {
        let mut commands = Vec::new();
        let outcome = step(self.program, &mut self.state, event.clone(), &mut commands);
        for command in &commands {
            self.carry_out(command);
        }
        let is_over = outcome.is_some();
        self.steps.push(StepRecord::new(event, commands, outcome));
        is_over
    }

    fn carry_out(&mut self, command: &Command) {
        match command {
            Command::Activate { member, activation, .. } => self.begins(*member, *activation),
            Command::Stop { member, activation } => {
                let stopped = Event::Stopped { member: *member, activation: *activation };
                let at = self.now + self.sometime();
                self.programs.insert(*member, (at, stopped));
            }
            Command::Arm { timer, activation, after } => {
                let due = self.now + (*after).max(TIMER_LEAST);
                self.alarms.insert(Alarm { due, order: self.armed, timer: *timer, activation: *activation });
                self.armed += 1;
            }
            Command::Cancel { timer, .. } => self.alarms.retain(|alarm| alarm.timer != *timer),
            Command::Connect { .. }
            | Command::Disconnect { .. }
            | Command::Send { .. }
            | Command::Log { .. }
            | Command::Lost { .. } => {}
        }
    }

    fn begins(&mut self, member: u32, activation: Activation) {
        let event = match self.tags.get(&member) {
            _ if self.dice.one_in(4) => Event::Aborted { member, activation, report: Value::EMPTY },
            // A service runs until it is stopped.
            _ if self.services[member as usize] => return,
            None => Event::Done { member, activation, value: Value::EMPTY },
            Some(tags) => {
                let value = Value::tagged(self.dice.pick::<String>(tags), &[]).expect("a short tag");
                Event::Done { member, activation, value }
            }
        };
        let at = self.now + self.sometime();
        self.programs.insert(member, (at, event));
    }
}

/// Returns how many timers elapsed, or a run that the verifier does not know.
pub(crate) fn compare(seed: u64) -> Result<u64, String> {
    let mut dice = Dice::new(seed ^ 0xC10C);
    let made = group(&mut dice, Taste::Text);
    let (text, tags) = text(&made, "");
    let (compiled, sites) = compile_with_sites(&Source::new("r.dca", text.clone()), &[], &Options::named("r"));
    let Some((plan, sites)) = compiled.plan.zip(sites) else { return Ok(0) };
    let program = Program::compile(&plan.groups[0]);
    let (mut elapsed, mut runs) = (0, Vec::new());
    for _ in 0..RUNS {
        let mut run = Run {
            dice: &mut dice,
            program: &program,
            services: plan.groups[0].members.iter().map(|member| member.service).collect(),
            tags: &tags,
            state: State::new(&program),
            now: Duration::ZERO,
            alarms: BTreeSet::new(),
            armed: 0,
            programs: BTreeMap::new(),
            steps: Vec::new(),
        };
        elapsed += run.complete();
        runs.push(run.steps);
    }
    let limits = Limits { states: 100_000, memory: 64 << 20, threads: &Alone, goes_on: &Always };
    let found = conform(&plan, &sites, &[runs], &limits);
    let outside: usize = found.coverage.iter().map(|coverage| coverage.outside).sum();
    if outside > 0 || !found.deviations.is_empty() {
        return Err(format!(
            "seed {seed}: {outside} events are unknown, {} deviations\n{text}",
            found.deviations.len()
        ));
    }
    Ok(elapsed)
}
