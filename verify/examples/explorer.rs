//! Measures the speed of the verifier, with one command, and prints one table.
//!
//! ```text
//! cargo run --release -p verify --example explorer
//! ```
//!
//! Times are processor times of this thread, since other programs may use the machine.
#![expect(clippy::print_stdout, reason = "its output is its result")]

use language::{Options, Source, compile_with_sites};
use std::time::Duration;
use verify::{Alone, Always, Detail, Faults, Limits, flat, fmea, verify};

const LIMITS: Limits<'static> = Limits { states: 20_000_000, memory: 4 << 30, threads: &Alone, goes_on: &Always };

fn main() {
    println!("| what | states | time | figure |\n|---|---|---|---|");
    let objects = std::env::args().nth(1).and_then(|objects| objects.parse().ok());
    if objects.is_none() {
        tidy_up(14);
        groups(100, 10);
        checked(99, 100);
        door();
    }
    let objects = objects.unwrap_or(12);
    flat_system(&format!("tidy-up, {objects} objects, flat"), &tidy_up_spec(objects));
    flat_system(&format!("the same with one hand, {objects} objects, flat"), &one_hand_spec(objects));
    let steps = objects + objects / 4;
    flat_system(&format!("{steps} steps side by side, flat"), &side_by_side(steps));
}

/// A spec with `steps` parallel steps.
fn side_by_side(steps: usize) -> String {
    let instances = (0..steps).map(|i| format!("p{i} instof Step(c1);")).collect::<String>();
    let actions = (0..steps).map(|i| format!("p{i}")).collect::<Vec<_>>().join(", ");
    format!(
        "module Step {{ done; }}\nprocess main(){{ host{{c1}} instantiated_processes{{ {instances} }} internal_event_actions{{ {actions} }} }}"
    )
}

/// Returns how long this thread has used a processor.
fn busy() -> Duration {
    let status = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    let nanoseconds = status.split_whitespace().next().and_then(|first| first.parse().ok());
    Duration::from_nanos(nanoseconds.expect("Linux counts how long a thread runs"))
}

/// The tidy-up example of the paper with `objects` objects, each of which is found and placed.
fn tidy_up_spec(objects: usize) -> String {
    let each = |write: fn(usize) -> String| (0..objects).map(write).collect::<Vec<_>>();
    let instances = each(|i| format!("f{i} instof Step(c1); p{i} instof Step(c1);")).join("\n");
    let actions = each(|i| format!("(f{i} : p{i})")).join(", ");
    format!(
        "module Step {{ done; }}\nprocess main(){{ host{{c1}} instantiated_processes{{ timeout instof Step(c1); {instances} }}\n\
         internal_event_actions{{ timeout # ({actions}) }} }}"
    )
}

/// The tidy-up with `objects` objects, each placed by the one hand.
fn one_hand_spec(objects: usize) -> String {
    let mut text = tidy_up_spec(objects).replace("host{c1}", "host{c1} resource hand;");
    for object in 0..objects {
        text = text.replace(&format!(": p{object})"), &format!(": using(hand) p{object})"));
    }
    text
}

fn tidy_up(objects: usize) {
    whole(&format!("tidy-up, {objects} objects, by composition"), &tidy_up_spec(objects));
}

/// Verifies `groups` parallel groups of `size` processes each.
fn groups(groups: usize, size: usize) {
    whole(&format!("{} processes in {groups} groups, by composition", groups * size), &groups_spec(groups, size));
}

/// Checks groups that `dca check` accepts by their structure alone. Groups are processes, and a plan has at most
/// 10,000.
fn checked(groups: usize, size: usize) {
    let text = groups_spec(groups, size);
    let start = busy();
    let (plan, _) = compiled(&text, &[]);
    let time = (busy() - start).as_secs_f64();
    let all = plan.leaves.len() + plan.groups.len();
    println!("| {all} processes, {groups} of them groups, checked |  | {time:.3} s |  |");
}

fn groups_spec(groups: usize, size: usize) -> String {
    let instances = (0..size).map(|i| format!("p{i} instof Step(c1);")).collect::<String>();
    let pairs = (0..size / 2).map(|i| format!("(p{} ; p{})", 2 * i, 2 * i + 1)).collect::<Vec<_>>().join(", ");
    let all = (0..groups).map(|i| format!("g{i} instof Group();")).collect::<String>();
    let together = (0..groups).map(|i| format!("g{i}")).collect::<Vec<_>>().join(", ");
    format!(
        "module Step {{ done; }}\nprocess Group(){{ host{{c1}} instantiated_processes{{ {instances} }} internal_event_actions{{ {pairs} }} }}\n\
         process main(){{ host{{c1}} instantiated_processes{{ {all} }} internal_event_actions{{ {together} }} }}"
    )
}

fn compiled(text: &str, interfaces: &[Source]) -> (language::plan::Plan, language::sites::Sites) {
    let (compiled, sites) =
        compile_with_sites(&Source::new("figures.dca", text), interfaces, &Options::named("figures"));
    compiled.plan.zip(sites).expect("the spec has no errors")
}

fn whole(what: &str, text: &str) {
    let (plan, sites) = compiled(text, &[]);
    let start = busy();
    let report = verify(&plan, &sites, &LIMITS);
    let time = busy() - start;
    println!("| {what} | {} | {:.3} s | {} findings |", report.states, time.as_secs_f64(), report.findings.len());
}

fn door() {
    let read = |path: &str| std::fs::read_to_string(path).expect("it is run from the root of the repository");
    let interface = Source::new("library", read("language/tests/graph/door_opening.interface"));
    let (plan, sites) = compiled(&read("specs/door_opening.dca"), &[interface]);
    let start = busy();
    let report = verify(&plan, &sites, &LIMITS);
    let time = busy() - start;
    println!(
        "| the door, with its properties | {} | {:.3} s | {} findings |",
        report.states,
        time.as_secs_f64(),
        report.findings.len()
    );
    let start = busy();
    let table = fmea(&plan, &sites, &LIMITS, Faults::One);
    let time = busy() - start;
    println!(
        "| the door, every single fault | {} | {:.3} s | {} rows |",
        table.states,
        time.as_secs_f64(),
        table.rows.len()
    );
}

/// A spec without any reduction.
fn flat_system(what: &str, text: &str) {
    let (plan, sites) = compiled(text, &[]);
    let start = busy();
    let found = flat(&plan, &sites, &LIMITS, Detail::Count);
    let time = (busy() - start).as_secs_f64();
    let (states, rate) = (found.states, found.transitions as f64 / time / 1e6);
    let (bytes, all) = (found.memory / states.max(1) as usize, found.transitions);
    println!("| {what} | {states} | {time:.3} s | {rate:.2} M of {all} transitions/s, {bytes} bytes a stored state |");
}
