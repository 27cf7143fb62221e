//! Every file of the corpus compiles to its expected result.
//!
//! `name.dca` is compiled alone and compared with `name.expected`; if there is a `name.interface`, it is also compiled
//! with these interfaces and compared with `name.interface.expected`. Files that a spec uses are in `parts/`, folders
//! beside. `UPDATE_EXPECT=1` rewrites the expected files.

use crate::disk;

use language::algebra::Program;
use language::automaton::Failure;
use language::plan::{
    Arm, CatchArm, DEADLINE, Expression, Group, LeafPort, MemberKind, OnBoot, Plan, Policy, Retention, StateChart,
};
use language::{Code, Compiled, Options, Severity, Source, Style, apply_fixes, compile, gather, render};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

fn corpus() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/corpus")
}

fn files() -> Vec<PathBuf> {
    let entries = std::fs::read_dir(corpus()).expect("the corpus is a folder");
    let mut files: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    files.retain(|path| path.extension().is_some_and(|extension| extension == "dca"));
    files.sort();
    files
}

fn read(path: &Path) -> Source {
    let text = std::fs::read_to_string(path).expect("a file of the corpus is text");
    Source::new(path.file_name().map_or(String::new(), |name| name.to_string_lossy().into_owned()), text)
}

fn options(path: &Path) -> Options {
    Options::named(path.file_stem().map_or(String::new(), |name| name.to_string_lossy().into_owned()))
}

#[test]
fn every_file_says_what_it_always_said() {
    for path in files() {
        check(&path, &[], &path.with_extension("expected"));
        let interface = path.with_extension("interface");
        if interface.exists() {
            check(&path, &[read(&interface)], &path.with_extension("interface.expected"));
        }
    }
}

fn check(path: &Path, interfaces: &[Source], expected: &Path) {
    let spec = read(path);
    let interfaces = &with_parts(&spec, interfaces);
    let Compiled { plan, diagnostics, .. } = compile(&spec, interfaces, &options(path));
    let mut text = render(&diagnostics, &spec, interfaces, Style::Plain);
    let is_refused = diagnostics.iter().any(|found| found.severity == Severity::Error);
    assert_eq!(plan.is_none(), is_refused, "{}", path.display());
    if let Some(plan) = plan {
        assert_eq!(plan.validate(), Ok(()));
        check_services(&plan);
        text.push_str(&describe(&plan));
    }
    expect_test::expect_file![expected].assert_eq(&text);
}

/// The files that a spec uses, and the interfaces.
fn with_parts(spec: &Source, interfaces: &[Source]) -> Vec<Source> {
    let mut parts = gather(spec, &|path| disk::content(&corpus().join(path)));
    parts.extend_from_slice(interfaces);
    parts
}

/// Every remark that can be made is made in some file; but that a text is too long is not worth 16 MiB.
#[test]
fn every_code_occurs() {
    let mut missing: BTreeSet<Code> = Code::ALL.iter().copied().collect();
    for path in files() {
        let interface = path.with_extension("interface");
        let interfaces = if interface.exists() { vec![read(&interface)] } else { Vec::new() };
        for interfaces in [Vec::new(), interfaces] {
            let spec = read(&path);
            let compiled = compile(&spec, &with_parts(&spec, &interfaces), &options(&path));
            missing.retain(|code| compiled.diagnostics.iter().all(|found| found.code != *code));
        }
    }
    let long = Source::new("long.dca", " ".repeat(language::SOURCE_MAX + 1));
    for found in compile(&long, &[], &Options::named("long")).diagnostics {
        missing.remove(&found.code);
    }
    // Diagnostics of `dca verify` are tested there.
    missing.retain(|code| !("E0811"..="E0819").contains(&code.as_str()));
    assert_eq!(missing, BTreeSet::new());
}

/// Checks that the services inferred from the text are those of the algebra.
fn check_services(plan: &Plan) {
    for member in plan.groups.iter().flat_map(|group| &group.members) {
        if let MemberKind::Group(group) = member.kind {
            assert_eq!(member.service, Program::compile(&plan.groups[group as usize]).is_service(), "{}", member.name);
        }
    }
}

/// A plan as lines: one for each leaf, group and wire.
fn describe(plan: &Plan) -> String {
    let resumed = if plan.on_boot == OnBoot::Resume { ", resumed" } else { "" };
    let mut text = format!("plan {} on {}{resumed}\n", plan.name, plan.hosts.join(", "));
    for leaf in &plan.leaves {
        text += &format!("{} = {} on {}", leaf.path, leaf.module, plan.hosts[leaf.host as usize]);
        for argument in &leaf.arguments {
            let name = argument.name.as_ref().map_or(String::new(), |name| format!("{name}="));
            text += &format!(" {name}{:?}", argument.value);
        }
        if !leaf.outcomes.is_empty() {
            text += &format!(" done({})", leaf.outcomes.join(" | "));
        }
        if leaf.policy != Policy::default() {
            text += &format!(" {:?}", leaf.policy);
        }
        for keys in &leaf.keys {
            let arrow = if keys.is_write { "->" } else { "<-" };
            text += &format!(" {} {arrow} {}", keys.port, keys.keys);
        }
        text.push('\n');
    }
    for group in &plan.groups {
        text += &describe_group(plan, group);
    }
    for (index, wire) in plan.wires.iter().enumerate() {
        let port = |end: &LeafPort| format!("{}.{}", plan.leaves[end.leaf as usize].path, end.port);
        text += &format!("{index}: {} -> {} {:?}", port(&wire.from), port(&wire.to), wire.transfer);
        let quality = wire.quality;
        if quality.retention == Retention::Latch {
            text += " latch";
        }
        text += &quality.queue.map_or(String::new(), |queue| format!(" queue {queue}"));
        text += &quality.period_min.map_or(String::new(), |period| format!(" every {period:?}"));
        text.push('\n');
    }
    text
}

fn describe_group(plan: &Plan, group: &Group) -> String {
    let name = |member: u32| group.members[member as usize].name.clone();
    let mut text = format!("{} = {} on {}", group.path, group.process, plan.hosts[group.host as usize]);
    let services: Vec<&str> = group.members.iter().filter(|it| it.service).map(|it| it.name.as_str()).collect();
    text += &if services.is_empty() { "\n".to_owned() } else { format!("; services {}\n", services.join(" ")) };
    for (index, set) in (0_u32..).zip(&group.sets) {
        let always = if group.sets_always.contains(&index) { " always" } else { "" };
        let owner = set.owner.map_or("-".to_owned(), name);
        text += &format!("    set {index} {owner} {} {:?}{always}\n", set.label.as_deref().unwrap_or("-"), set.wires);
    }
    text + &format!("    {}\n", expression(&group.expression, &name))
}

fn expression(root: &Expression, name: &dyn Fn(u32) -> String) -> String {
    let two = |first: &Expression, operator: &str, second: &Expression| {
        format!("({} {operator} {})", expression(first, name), expression(second, name))
    };
    let many = |operator: &str, parts: &[Expression]| {
        let parts: Vec<String> = parts.iter().map(|part| expression(part, name)).collect();
        format!("({})", parts.join(operator))
    };
    match root {
        Expression::Run { member, sets } if sets.is_empty() => name(*member),
        Expression::Run { member, sets } => format!("{}{sets:?}", name(*member)),
        Expression::Skip => "skip".to_owned(),
        Expression::Never => "never".to_owned(),
        Expression::Fail(reason) if reason.starts_with(DEADLINE) => "fail(\"timeout\")".to_owned(),
        Expression::Fail(reason) => format!("fail({reason:?})"),
        Expression::Wait(limit) => format!("wait({limit:?})"),
        Expression::Concurrent(parts) => many(" , ", parts),
        Expression::FailFast(parts) => many(" & ", parts),
        Expression::AnyOf { count, of } => format!("any {count} of {}", many(" , ", of)),
        Expression::AtLeast { count, of } => format!("at least {count} of {}", many(" , ", of)),
        Expression::Disable(parts) => many(" # ", parts),
        Expression::Sequence(first, second) => two(first, ";", second),
        Expression::Conditional(first, second) => two(first, ":", second),
        Expression::Recurrent(first, second) => two(first, ";;", second),
        Expression::Otherwise(first, second) => two(first, "else", second),
        Expression::Match(arms) => {
            let tag = |arm: &Arm| arm.tag.clone().unwrap_or_else(|| "else".to_owned());
            let arms: Vec<String> =
                arms.iter().map(|arm| format!("{} => {}", tag(arm), expression(&arm.body, name))).collect();
            format!("match {{ {} }}", arms.join(", "))
        }
        Expression::Shield { bound: Some(bound), of } => format!("shield({bound:?}) {}", expression(of, name)),
        Expression::Shield { bound: None, of } => format!("shield {}", expression(of, name)),
        Expression::Using { resources, of } => format!("using({}) {}", resources.join(", "), expression(of, name)),
        Expression::Finally(first, second) => two(first, "finally", second),
        Expression::Tagged { tag, of } => format!("{} as {tag}", expression(of, name)),
        Expression::With { given, of } => format!("{} with {}", expression(of, name), given),
        Expression::Named { name: result, of } => format!("{result} => {}", expression(of, name)),
        Expression::Repeat { until, of } => format!("repeat {} until {}", expression(of, name), until.join(" | ")),
        Expression::Catch { of, arms } => {
            let word = |arm: &CatchArm| arm.failure.as_ref().map_or_else(|| "else".to_owned(), Failure::to_string);
            let arms: Vec<String> =
                arms.iter().map(|arm| format!("{} => {}", word(arm), expression(&arm.body, name))).collect();
            format!("({} else match {{ {} }})", expression(of, name), arms.join(", "))
        }
        Expression::Chart(chart) => activity(chart, name),
        Expression::Asynchronous { source, pool } => {
            format!("({} ::[{}] {})", expression(source, name), pool.len(), many(" | ", pool))
        }
    }
}

/// An activity as lines: its states with their runs, its transitions, and the rest.
fn activity(chart: &StateChart, name: &dyn Fn(u32) -> String) -> String {
    let StateChart { chart: states, runs, inputs, outputs, filters, notices, questions, signals } = chart;
    let mut text = format!("activity; in {inputs:?} out {outputs:?} signals {signals:?}\n");
    for (number, state) in (0_u32..).zip(&states.states) {
        text += &format!("        {number} {} in {:?}: {:?}", state.name, state.parent, state.kind);
        if let Some(run) = runs.iter().find(|run| run.state == number) {
            text += &format!(", runs {} with {:?}", expression(&run.expression, name), state.run);
        }
        text += &format!(", entry {:?}, exit {:?}\n", state.entry, state.exit);
    }
    for variable in &states.variables {
        text += &format!("        var {} {}..{} = {}\n", variable.name, variable.min, variable.max, variable.initial);
    }
    for transition in &states.transitions {
        let (source, trigger, guard) = (transition.source, &transition.trigger, &transition.guard);
        text += &format!(
            "        {source} on {trigger:?} when {guard:?} -> {:?} {:?}\n",
            transition.target, transition.actions
        );
    }
    filters.iter().for_each(|filter| text += &format!("        filter {filter:?}\n"));
    questions.iter().for_each(|question| text += &format!("        question {} {question}\n", question.state));
    notices.iter().for_each(|notice| text += &format!("        notice {notice}\n"));
    text
}

/// The paper's listings run in their printed form; warnings report their gaps.
#[test]
fn the_papers_listings_are_accepted_and_fixed() {
    for name in ["paper_appendix_a", "paper_compliant_motion"] {
        let path = corpus().join(name).with_extension("dca");
        let spec = read(&path);
        let with_interfaces = [read(&path.with_extension("interface"))];
        for interfaces in [&[][..], &with_interfaces] {
            let compiled = compile(&spec, interfaces, &options(&path));
            assert!(compiled.plan.is_some(), "{name}");
            let fixed = Source::new(name, apply_fixes(&spec.text, &compiled.diagnostics));
            let strict = Options { deny_lenient_names: true, ..options(&path) };
            let again = compile(&fixed, interfaces, &strict);
            assert!(again.plan.is_some(), "{}", render(&again.diagnostics, &fixed, interfaces, Style::Plain));
            assert!(
                again.diagnostics.iter().all(|found| !found.code.as_str().starts_with("W020") || found.fix.is_none())
            );
        }
    }
}
