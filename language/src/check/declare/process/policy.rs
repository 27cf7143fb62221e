//! Reads the policies of an instance: `{ restart transient; memory 200 MB; }`.

use super::backoff::backoff;
use crate::check::names::twice;
use crate::check::spec::{Policies, RunsIn, ValueKind};
use crate::check::value::{Reader, quantity};
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::{
    Constant as PlanConstant, LinkLoss, Policy, REALTIME_MAX, Realtime, Replacement, Restart, Usage, Watchdog,
};
use crate::source::Span;
use crate::syntax::SyntaxKind::{self, Constant};
use crate::syntax::ast::{Name, Node};
use crate::unit::{self, Dimension};
use std::collections::BTreeMap;
use std::time::Duration;

/// The shortest bound of a watchdog. The scheduler of a busy host may delay a program by some milliseconds.
const WATCHDOG_MIN: Duration = Duration::from_millis(20);

/// The value of one policy in the text: its words after the first, and its number.
struct PolicyValue<'a> {
    node: &'a Node,
    words: Vec<String>,
    value: Option<Node>,
}

/// Reads the policies of an instance.
pub(super) fn policies(instance: &Node, reader: &mut Reader<'_>) -> Policies {
    let mut policies = Policies::default();
    let Some(node) = instance.child(SyntaxKind::Policies) else { return policies };
    let mut first: BTreeMap<String, Span> = BTreeMap::new();
    for item in node.children_of(SyntaxKind::Policy) {
        let mut names = item.names();
        let Some(name) = names.next() else { continue };
        if let Some(&first) = first.get(&name.text) {
            reader.diagnostics.push(twice("policy", &name.text, name.span, first));
            continue;
        }
        first.insert(name.text.clone(), name.span);
        let words: Vec<Name> = names.collect();
        if name.text == "backoff" {
            policies.policy.backoff = backoff(&item, &words, reader);
            policies.backoff = policies.policy.backoff.map(|_| item.span());
            continue;
        }
        if name.text == "runs_in" {
            policies.runs_in = runs_in(&item, &words, reader);
            continue;
        }
        if name.text == "restart" {
            policies.restart = words.first().map(|word| word.span);
        }
        if name.text == "replace" {
            policies.overlap = words.first().filter(|word| word.text == "overlap").map(|word| word.span);
        }
        let words = words.into_iter().map(|word| word.text).collect();
        let written = PolicyValue { node: &item, words, value: item.child(Constant) };
        read(&mut policies.policy, &name, &written, reader);
    }
    if let Some(runs_in) = &mut policies.runs_in {
        runs_in.is_alone = first.len() == 1;
    }
    policies.span = Some(node.span());
    policies
}

/// Reads `runs_in hardware;` or `runs_in "my-base" "main/arm/wheels";`.
fn runs_in(node: &Node, words: &[Name], reader: &mut Reader<'_>) -> Option<RunsIn> {
    let texts: Vec<Option<String>> = node.children_of(Constant).map(|value| text(&value, reader)).collect();
    let names = words.iter().map(|word| Some(word.text.clone()));
    let given: Option<Vec<String>> = names.chain(texts).collect();
    let is_path = |path: &String| path.starts_with("main/") && !path.ends_with('/');
    match given.as_deref() {
        Some([deployment]) if !deployment.is_empty() => {
            Some(RunsIn { deployment: deployment.clone(), path: None, span: node.span(), is_alone: true })
        }
        Some([deployment, path]) if words.len() < 2 && !deployment.is_empty() && is_path(path) => {
            let (deployment, path) = (deployment.clone(), Some(path.clone()));
            Some(RunsIn { deployment, path, span: node.span(), is_alone: true })
        }
        Some(_) | None => {
            let help = "write the name of a deployment: `runs_in hardware`; if the process has another name there, add its path: \
                        `runs_in hardware \"main/arm/wheels\"`";
            let message = "this `runs_in` has a wrong form";
            reader.diagnostics.push(Diagnostic::new(Code::E0009, node.span(), message).help(help));
            None
        }
    }
}

fn text(node: &Node, reader: &mut Reader<'_>) -> Option<String> {
    match reader.value(node).kind {
        ValueKind::Constant(PlanConstant::Text(text)) => Some(text),
        ValueKind::Constant(_)
        | ValueKind::Record(_)
        | ValueKind::List(_)
        | ValueKind::Param(_)
        | ValueKind::Broken => None,
    }
}

fn read(policy: &mut Policy, name: &Name, written: &PolicyValue<'_>, reader: &mut Reader<'_>) {
    let words: Vec<&str> = written.words.iter().map(String::as_str).collect();
    let time = |reader: &mut Reader<'_>| written.value.as_ref().and_then(|value| reader.duration(value));
    let before = reader.diagnostics.count();
    let (is_read, help) = match name.text.as_str() {
        "restart" => {
            let restart = restart(&words).filter(|_| written.value.is_none());
            policy.restart = restart.unwrap_or_default();
            (restart.is_some(), "write `restart temporary` (never), `transient` (after a failure) or `permanent`")
        }
        "replace" => {
            let replacement = replacement(&words).filter(|_| written.value.is_none());
            policy.replacement = replacement.unwrap_or_default();
            (replacement.is_some(), "write `replace overlap` or `replace break_before_make`")
        }
        "watchdog" => {
            let bound = if words.is_empty() { time(reader).filter(|bound| *bound >= WATCHDOG_MIN) } else { None };
            let never = (words == ["none"] && written.value.is_none()).then_some(Watchdog::Never);
            let watchdog = bound.map(Watchdog::Within).or(never);
            policy.watchdog = watchdog.unwrap_or_default();
            (watchdog.is_some(), "write `watchdog 500 ms` (at least 20 ms), or `watchdog none`")
        }
        "ready" => {
            policy.ready_within = if words == ["within"] { time(reader).filter(|time| !time.is_zero()) } else { None };
            (policy.ready_within.is_some(), "write `ready within 3 s`")
        }
        "on_agent_loss" => {
            policy.agent_loss = if words == ["stop", "within"] { time(reader) } else { None };
            (policy.agent_loss.is_some(), "write `on_agent_loss stop within 3 s`")
        }
        "on_link_loss" => {
            let after = if words == ["safe_stop_after"] { time(reader).map(LinkLoss::SafeStopAfter) } else { None };
            let link_loss = link_loss(&words).filter(|_| written.value.is_none()).or(after);
            policy.link_loss = link_loss.unwrap_or_default();
            (link_loss.is_some(), "write `on_link_loss keep`, `hold`, or `safe_stop_after 2 s`")
        }
        limit => usage(&mut policy.usage, limit, written, reader),
    };
    if !is_read && reader.diagnostics.count() == before {
        let message = format!("this `{}` has a wrong form", name.text);
        reader.diagnostics.push(Diagnostic::new(Code::E0009, written.node.span(), message).help(help));
    }
}

/// Reads a limit on the resources of a program. Returns whether the text is valid. If it is not valid, also returns advice.
fn usage(usage: &mut Usage, name: &str, written: &PolicyValue<'_>, reader: &mut Reader<'_>) -> (bool, &'static str) {
    let bytes = unit::unit("B", None).map(|(_, dimension)| dimension);
    let no_words = written.words.is_empty();
    match name {
        "memory" => {
            usage.memory = whole(written, bytes, 1, reader).filter(|_| no_words);
            (usage.memory.is_some(), "write `memory 200 MB`")
        }
        "cpu" => {
            let time = written.value.as_ref().and_then(|value| reader.duration(value));
            usage.cpu = time.filter(|time| no_words && time.as_secs() > 0);
            (usage.cpu.is_some(), "write `cpu 10 min`: the processor time, at least 1 s")
        }
        "cores" => {
            usage.cpu_share = share(written, reader).filter(|_| no_words);
            (usage.cpu_share.is_some(), "write `cores 0.5`: the number of processors, from 0.01 to 1000")
        }
        "pids" => {
            usage.pids = whole(written, None, 1, reader).filter(|_| no_words);
            (usage.pids.is_some(), "write `pids 64`: the number of processes and threads, at least 1")
        }
        "files" => {
            usage.files = whole(written, None, 3, reader).filter(|_| no_words);
            (usage.files.is_some(), "write `files 64`: the number of open files, at least 3")
        }
        "file_size" => {
            usage.file_size = whole(written, bytes, 1, reader).filter(|_| no_words);
            (usage.file_size.is_some(), "write `file_size 100 MB`")
        }
        "nice" => {
            usage.nice = number(written, reader).filter(|nice| no_words && (-20..=19).contains(nice));
            (usage.nice.is_some(), "write `nice 10`: from -20 (before other programs) to 19 (after other programs)")
        }
        _ => {
            let is_optional = written.words == ["optional"];
            let priority = whole(written, None, 1, reader).and_then(|priority| u8::try_from(priority).ok());
            let priority = priority.filter(|&priority| priority <= REALTIME_MAX && (no_words || is_optional));
            usage.realtime = priority.map(|priority| Realtime { priority, is_optional });
            (
                priority.is_some(),
                "write `realtime 40` (from 1 to 49); add `optional` if the program may run without this priority",
            )
        }
    }
}

/// Reads a share of the processors. The unit of the result is a thousandth of one processor.
fn share(written: &PolicyValue<'_>, reader: &mut Reader<'_>) -> Option<u32> {
    let (value, found) = quantity(written.value.as_ref()?, reader.diagnostics)?;
    let is_share = found.is_none() && (0.01..=1000.0).contains(&value);
    format!("{:.0}", value * 1000.0).parse().ok().filter(|_| is_share)
}

fn restart(words: &[&str]) -> Option<Restart> {
    match words {
        ["temporary"] => Some(Restart::Temporary),
        ["transient"] => Some(Restart::Transient),
        ["permanent"] => Some(Restart::Permanent),
        [..] => None,
    }
}

fn replacement(words: &[&str]) -> Option<Replacement> {
    match words {
        ["break_before_make"] => Some(Replacement::BreakBeforeMake),
        ["overlap"] => Some(Replacement::Overlap),
        [..] => None,
    }
}

fn link_loss(words: &[&str]) -> Option<LinkLoss> {
    match words {
        ["keep"] => Some(LinkLoss::Keep),
        ["hold"] => Some(LinkLoss::Hold),
        [..] => None,
    }
}

/// Reads a whole number of this dimension that is at least `least`.
fn whole(written: &PolicyValue<'_>, dimension: Option<Dimension>, least: u64, reader: &mut Reader<'_>) -> Option<u64> {
    let (value, found) = quantity(written.value.as_ref()?, reader.diagnostics)?;
    let whole: u64 = format!("{value:.0}").parse().ok()?;
    (found == dimension && value.fract() == 0.0 && whole >= least).then_some(whole)
}

fn number(written: &PolicyValue<'_>, reader: &mut Reader<'_>) -> Option<i8> {
    let (value, found) = quantity(written.value.as_ref()?, reader.diagnostics)?;
    if found.is_some() { None } else { value.to_string().parse().ok() }
}
