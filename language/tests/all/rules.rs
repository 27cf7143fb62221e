//! `step` follows every rule that the manual gives for an operator.
//!
//! The rules are the items of the lists in `docs/src/operators.md`. Each needs a run in [`RULES`]: an expression, then
//! events with the supervisor's reactions. The equations of the page, such as `P? = P else skip`, are read from it, and
//! both sides are compared with every event in every state.

use language::algebra::{Activity, Cause, Command, Event, Outcome, Program, State, Value, step};
use language::automaton::Failure;
use language::plan::DEADLINE;
use language::{Options, Source, compile, render};
use std::collections::{BTreeMap, BTreeSet};

mod table;

use table::RULES;

/// A group with the names that an expression of the page may use, and the expression.
fn program(actions: &str) -> (Program, Vec<String>) {
    let text = format!(
        "const d = 5 s;
         module A(host: Host) {{ init on: Truth; done; }}
         module B(host: Host) {{ service; }}
         module C(host: Host) {{ done(t: Truth | u); }}
         process main(){{
             host{{c1}}
             resource arm, table;
             instantiated_processes{{
                 P instof A(c1); Q instof A(c1); R instof A(c1);
                 S instof B(c1); U instof B(c1); M instof C(c1); W[2] instof A(c1);
             }}
             internal_event_actions{{ {actions} }}
         }}"
    );
    let source = Source::new("rule.dca", text);
    let compiled = compile(&source, &[], &Options::named("rule"));
    let said = || render(&compiled.diagnostics, &source, &[], language::Style::Plain);
    let group = &compiled.plan.as_ref().unwrap_or_else(|| panic!("{}", said())).groups[0];
    (Program::compile(group), group.members.iter().map(|member| member.name.clone()).collect())
}

/// `x`; `t:x` with a tag; `x+y` of several processes together.
fn value(word: &str) -> Value {
    if let Some((tag, rest)) = word.split_once(':') {
        return Value::tagged(tag, rest.as_bytes()).expect("a tag of a rule is short");
    }
    let parts: Vec<Value> = word.split('+').map(|part| Value::new(part.as_bytes())).collect();
    Value::tuple(parts.iter())
}

fn shown(value: &Value) -> String {
    String::from_utf8_lossy(value.bytes()).into_owned()
}

/// One run of one expression.
struct Run {
    program: Program,
    names: Vec<String>,
    state: State,
}

impl Run {
    fn new(actions: &str) -> Self {
        let (program, names) = program(actions);
        Self { state: State::new(&program), program, names }
    }

    /// `start v`, `stop`, `P done v`, `P abort r`, `P crash`, `P host_lost`, `P stopped`, `P unconfirmed`, `time` for the first timer that is armed.
    fn event(&self, text: &str) -> Event {
        let words: Vec<&str> = text.split_whitespace().collect();
        let slot = |name: &str| {
            let member = self.names.iter().position(|known| known == name).unwrap_or_else(|| panic!("no {name}"));
            u32::try_from(member).expect("a rule has few members")
        };
        let with = |name: &str| (slot(name), self.state.activation(slot(name)));
        match words.as_slice() {
            ["start", word] => Event::Start(value(word)),
            ["stop"] => Event::Stop,
            ["time"] => {
                let armed = (0..self.program.timers()).find(|&timer| self.state.timer(&self.program, timer).1);
                let timer = armed.unwrap_or_else(|| panic!("no timer is armed at `{text}`"));
                Event::Elapsed { timer, activation: self.state.timer(&self.program, timer).0 }
            }
            [name, "done", word] => {
                let (member, activation) = with(name);
                Event::Done { member, activation, value: value(word) }
            }
            [name, "abort", word] => {
                let (member, activation) = with(name);
                Event::Aborted { member, activation, report: value(word) }
            }
            [name, word @ ("crash" | "host_lost")] => {
                let (member, activation) = with(name);
                let report = if *word == "crash" { Failure::Crash } else { Failure::HostLost }.report();
                Event::Aborted { member, activation, report }
            }
            [name, "stopped"] => {
                let (member, activation) = with(name);
                Event::Stopped { member, activation }
            }
            [name, "unconfirmed"] => {
                let (member, activation) = with(name);
                Event::StopUnconfirmed { member, activation }
            }
            [..] => panic!("`{text}` is not an event"),
        }
    }

    /// Returns the commands for an event: `P(v)` starts P with v; then the outcome of the group. Timers are left out.
    fn react(&mut self, event: Event) -> Vec<String> {
        let mut commands = Vec::new();
        let outcome = step(&self.program, &mut self.state, event, &mut commands);
        let name = |member: u32| &self.names[member as usize];
        let shown_command = |command: &Command| match command {
            Command::Activate { member, value, .. } => Some(format!("{}({})", name(*member), shown(value))),
            Command::Stop { member, .. } => Some(format!("stop {}", name(*member))),
            Command::Connect { .. }
            | Command::Disconnect { .. }
            | Command::Arm { .. }
            | Command::Cancel { .. }
            | Command::Send { .. }
            | Command::Log { .. }
            | Command::Lost { .. } => None,
        };
        let outcome = outcome.map(|outcome| match outcome {
            Outcome::Done(value) => format!("done({})", shown(&value)),
            Outcome::Stopped => "stopped".to_owned(),
            Outcome::Aborted(reason) => match reason.cause {
                Cause::Reported(report) if Failure::of_report(&report) == Failure::Crash => "aborted(crash)".to_owned(),
                Cause::Reported(report) => format!("aborted({})", shown(&report)),
                Cause::Failed(why) if why.starts_with(DEADLINE) => "aborted(deadline)".to_owned(),
                Cause::Failed(why) => format!("aborted({why})"),
                Cause::ServiceEnded => "aborted(ended)".to_owned(),
                Cause::StopUnconfirmed => "aborted(unconfirmed)".to_owned(),
                Cause::Busy => "aborted(busy)".to_owned(),
                Cause::NoMatch => "aborted(no arm)".to_owned(),
                Cause::Script(error) => format!("aborted({error})"),
            },
        });
        commands.iter().filter_map(shown_command).chain(outcome).collect()
    }
}

/// `P(x+y)` with the value in its printed form.
fn expected(text: &str) -> Vec<String> {
    let parts = text.split(", ").filter(|part| !part.is_empty());
    let parts = parts.map(|part| match part.split_once('(') {
        Some((head, rest)) => format!("{head}({})", shown(&value(rest.trim_end_matches(')')))),
        None => part.to_owned(),
    });
    parts.collect()
}

fn follow(run: &str) {
    let mut parts = run.split(" | ");
    let mut machine = Run::new(parts.next().expect("a run has an expression"));
    for part in parts {
        let (event, reaction) = part.split_once(": ").unwrap_or((part.trim_end_matches(':'), ""));
        if event == "kind" {
            assert_eq!(machine.program.is_service(), reaction == "service", "{run}");
            continue;
        }
        let event = machine.event(event.trim());
        assert_eq!(machine.react(event), expected(reaction.trim()), "{part}\nin {run}");
    }
}

fn page() -> String {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/src/operators.md");
    std::fs::read_to_string(path).expect("the page on operators")
}

/// The sections of the page that are about one operator each, with the items of their lists.
fn rules(page: &str) -> BTreeMap<String, BTreeSet<String>> {
    let mut rules: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for section in page.split("\n## ").skip(1) {
        let (heading, body) = section.split_once('\n').expect("a heading ends");
        if ["How a process ends", "Laws"].contains(&heading) {
            continue;
        }
        let items = rules.entry(heading.to_owned()).or_default();
        let mut lines = body.lines().peekable();
        while let Some(line) = lines.next() {
            let Some(item) = line.strip_prefix("- ") else { continue };
            let mut item = item.to_owned();
            while let Some(more) = lines.next_if(|line| line.starts_with("  ")) {
                item = format!("{item} {}", more.trim());
            }
            items.insert(item);
        }
    }
    rules
}

#[test]
fn every_rule_of_the_manual_is_what_step_does() {
    let mut rules = rules(&page());
    for (heading, rule, runs) in RULES {
        let known = rules.get_mut(*heading).is_some_and(|rules| rules.remove(*rule));
        assert!(known, "the manual has no rule `{rule}` under `{heading}`");
        assert!(!runs.is_empty() || rule.contains(" = "), "`{rule}` has no run");
        runs.iter().for_each(|run| follow(run));
    }
    rules.retain(|_, rules| !rules.is_empty());
    assert!(rules.is_empty(), "rules of the manual without a run in tests/rules/table.rs: {rules:#?}");
}

/// The equations in the text: two expressions of processes P, Q, R.
fn equations(page: &str) -> Vec<(String, String)> {
    let quoted = page.split("```").step_by(2).flat_map(|text| text.split('`').skip(1).step_by(2));
    let sides = quoted.filter(|quoted| !quoted.contains("=>")).filter_map(|quoted| quoted.split_once(" = "));
    let whole = |side: &str| side.replace("fail(r)", "fail(\"r\")");
    sides.map(|(left, right)| (whole(left), whole(right))).collect()
}

/// The page says that this law only holds for a start without a value.
const STARTED_WITH_NOTHING: &str = "skip ; P";

/// Compares both sides with every event in every state. Where operands change their places, values are empty and commands
/// are sorted.
fn compare(left: &str, right: &str) {
    let are_values_empty = left.contains(',') || left.contains('#') || left == STARTED_WITH_NOTHING;
    let word = if are_values_empty { "" } else { "v" };
    let (first, second) = (Run::new(left), Run::new(right));
    let mut seen = BTreeSet::new();
    let mut todo = vec![(first.state.clone(), second.state.clone(), Vec::<String>::new())];
    while let Some((one, other, trace)) = todo.pop() {
        for event in events(&first, &one, word) {
            let mut left_run = Run { program: first.program.clone(), names: first.names.clone(), state: one.clone() };
            let mut right_run =
                Run { program: second.program.clone(), names: second.names.clone(), state: other.clone() };
            let trace = [&trace[..], &[format!("{event:?}")]].concat();
            let mut reactions = [left_run.react(event.clone()), right_run.react(event)];
            reactions.iter_mut().filter(|_| are_values_empty).for_each(|reaction| reaction.sort());
            assert_eq!(reactions[0], reactions[1], "`{left} = {right}` after {trace:#?}");
            let key = format!("{:?} {:?}", left_run.state.configuration(), right_run.state.configuration());
            if seen.insert(key) {
                todo.push((left_run.state, right_run.state, trace));
            }
        }
    }
    assert!(!seen.is_empty(), "`{left} = {right}` gets nowhere");
}

fn events(run: &Run, state: &State, word: &str) -> Vec<Event> {
    let mut events = if state.is_idle() { vec![Event::Start(value(word))] } else { vec![Event::Stop] };
    for member in state.members_active() {
        let activation = state.activation(member);
        events.push(Event::Aborted { member, activation, report: value("r") });
        events.push(Event::Done { member, activation, value: value(word) });
        if state.activity(member) == Activity::Stopping {
            events.push(Event::StopUnconfirmed { member, activation });
        }
    }
    let armed = (0..run.program.timers()).map(|timer| (timer, state.timer(&run.program, timer)));
    events.extend(
        armed
            .filter(|(_, (_, is_armed))| *is_armed)
            .map(|(timer, (activation, _))| Event::Elapsed { timer, activation }),
    );
    events
}

#[test]
fn every_equation_of_the_manual_holds() {
    let equations = equations(&page());
    assert!(equations.len() >= 12, "{equations:?}");
    for (left, right) in equations {
        compare(&left, &right);
    }
}
