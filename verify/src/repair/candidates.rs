//! Finds candidate repairs for each kind of mistake. This module proves nothing.

use super::text::{has_word, head, inside, last_time, operand, steps, time};
use language::plan::{Expression, Plan};
use language::sites::{Consequence, EventKind, Fault, Moment, Occurrence, ProcessRef, Sentence, Sites};
use language::{Code, Diagnostic, Edit, Fix, Origin, Source, Span};
use std::time::Duration;

/// The limits that are tried, the longest first, in seconds.
const LIMITS: [u64; 7] = [120, 60, 30, 10, 5, 2, 1];

/// An operator or process of an expression, with its place in the text.
struct Node<'p> {
    group: usize,
    expression: &'p Expression,
    span: Span,
}

/// A spec, taken apart.
struct Spec<'s> {
    spec: &'s Source,
    plan: &'s Plan,
    nodes: Vec<Node<'s>>,
}

/// Returns the edits that might repair a mistake, the most likely first.
#[expect(clippy::wildcard_enum_match_arm, reason = "most codes are not the verifier's")]
pub(super) fn of(spec: &Source, plan: &Plan, sites: &Sites, found: &Diagnostic) -> Vec<Fix> {
    let mut nodes = Vec::new();
    for (group, source) in plan.groups.iter().enumerate() {
        // In the order of `walk`, in which `algebra::Program` also numbers them.
        let (mut open, mut spans) = (vec![&source.expression], sites.groups[group].nodes.iter());
        while let Some(expression) = open.pop() {
            open.extend(expression.operands().into_iter().rev());
            if let Some(span) = spans.next().copied().filter(|span| span.origin == Origin::Spec) {
                nodes.push(Node { group, expression, span });
            }
        }
    }
    let own = Spec { spec, plan, nodes };
    match found.code {
        Code::E0811 => own.taken_at_once(found.primary.span),
        Code::E0812 => own.reached(found.primary.span),
        Code::E0813 => own.bounded_shields(&[Duration::from_secs(5)]),
        Code::E0815 => own.longer(found),
        Code::E0816 => own.opened(found),
        Code::E0817 => {
            let properties = sites.properties.iter().filter(|property| property.span == found.primary.span);
            properties.take(1).flat_map(|property| own.sentence(property.group as usize, &property.sentence)).collect()
        }
        _ => Vec::new(),
    }
}

impl Spec<'_> {
    fn text(&self, span: Span) -> &str {
        self.spec.text.get(span.start as usize..span.end as usize).unwrap_or_default()
    }

    /// Returns whether a text has only braces or parentheses around it.
    fn is_alone(&self, span: Span) -> bool {
        let (before, after) = (&self.spec.text[..span.start as usize], &self.spec.text[span.end as usize..]);
        let (before, after) = (before.trim_end(), after.trim_start());
        before.ends_with(['(', '{']) && after.starts_with([')', '}'])
    }

    fn replace(&self, title: String, span: Span, text: String) -> Fix {
        Fix { title, edits: vec![Edit { span, text }] }
    }

    fn name(&self, who: ProcessRef) -> Option<&str> {
        Some(&self.plan.groups[who.group as usize].members[who.member? as usize].name)
    }

    /// Returns the places at which a member is run.
    fn runs(&self, who: ProcessRef) -> Vec<Span> {
        let is_it = |node: &&Node<'_>| {
            node.group == who.group as usize
                && matches!(node.expression, Expression::Run { member, .. } if Some(*member) == who.member)
        };
        let mut spans: Vec<Span> = self.nodes.iter().filter(is_it).map(|node| node.span).collect();
        spans.sort_unstable();
        spans.dedup();
        spans
    }

    // ---- the catalogue ----

    /// Changes `using(a) (.. using(b) ..)` so that it takes both resources at once.
    fn taken_at_once(&self, span: Span) -> Vec<Fix> {
        let groups: Vec<usize> =
            self.nodes.iter().filter(|node| node.span.contains(span)).map(|node| node.group).collect();
        let is_using =
            |node: &&Node<'_>| groups.contains(&node.group) && matches!(node.expression, Expression::Using { .. });
        let all: Vec<Span> = self.nodes.iter().filter(is_using).map(|node| node.span).collect();
        let is_inner = |span: &Span| all.iter().any(|other| other != span && other.contains(*span));
        let mut edits: Vec<Edit> = Vec::new();
        let mut names = Vec::new();
        for outer in all.iter().filter(|span| !is_inner(span)) {
            let Some((own, resources, _)) = head(self.text(*outer), "using") else { continue };
            let mut taken: Vec<String> = resources.split(',').map(|name| name.trim().to_owned()).collect();
            let before = taken.len();
            for inner in all.iter().filter(|span| *span != outer && outer.contains(**span)) {
                let Some((_, resources, body)) = head(self.text(*inner), "using") else { continue };
                let more = resources.split(',').map(|name| name.trim().to_owned());
                more.for_each(|name| {
                    if !taken.contains(&name) {
                        taken.push(name);
                    }
                });
                let end = inner.end - u32::try_from(body.len()).unwrap_or(0);
                edits.push(Edit { span: Span { end, ..*inner }, text: String::new() });
            }
            if taken.len() > before {
                let end = outer.start + u32::try_from(own.len()).unwrap_or(0);
                edits.push(Edit { span: Span { end, ..*outer }, text: format!("using({})", taken.join(", ")) });
                names.push(format!("`using({})`", taken.join(", ")));
            }
        }
        edits.sort_by_key(|edit| edit.span);
        edits.dedup();
        if edits.is_empty() {
            return Vec::new();
        }
        names.dedup();
        vec![Fix { title: format!("take them at once: {}", names.join(", ")), edits }]
    }

    /// Makes the previous step end in the way that starts this step.
    fn reached(&self, span: Span) -> Vec<Fix> {
        let mut fixes = Vec::new();
        for node in &self.nodes {
            let Expression::Sequence(before, _) = node.expression else { continue };
            if !node.span.contains(span) {
                continue;
            }
            let text = self.text(node.span);
            let all = steps(text);
            let Some(at) = all.iter().position(|step| *step == self.text(span)).filter(|at| *at > 0) else { continue };
            let [first, last] = [all[..at].join(" ; "), all[at..].join(" ; ")];
            if matches!(**before, Expression::Recurrent(..)) {
                let limited = format!("({} within 60 s else skip) ; {last}", operand(&first));
                fixes.push(self.replace(format!("end `{first}` after 60 s"), node.span, keep(text, limited)));
            } else {
                let beside = format!("{}, {}", operand(&first), operand(&last));
                fixes.push(self.replace(
                    format!("run `{last}` at the same time as `{first}`"),
                    node.span,
                    keep(text, beside),
                ));
            }
        }
        fixes
    }

    fn bounded_shields(&self, bounds: &[Duration]) -> Vec<Fix> {
        let is_open = |node: &&Node<'_>| matches!(node.expression, Expression::Shield { bound: None, .. });
        let mut spans: Vec<Span> = self.nodes.iter().filter(is_open).map(|node| node.span).collect();
        spans.sort_unstable();
        spans.dedup();
        spans.retain(|span| self.text(*span).starts_with("shield"));
        if spans.is_empty() {
            return Vec::new();
        }
        let fix = |bound: &Duration| {
            let head = |span: &Span| Edit {
                span: Span { end: span.start + 6, ..*span },
                text: format!("shield({})", time(*bound)),
            };
            Fix {
                title: format!("let the shield hold a stop up for {} at most", time(*bound)),
                edits: spans.iter().map(head).collect(),
            }
        };
        bounds.iter().filter(|bound| !bound.is_zero()).map(fix).collect()
    }

    fn longer(&self, found: &Diagnostic) -> Vec<Fix> {
        let span = found.primary.span;
        let (text, least) = (self.text(span), found.help.iter().find_map(|help| last_time(help)));
        let Some((body, _)) = text.rsplit_once(" within ") else { return Vec::new() };
        let limits = least.map_or_else(|| vec![Duration::from_secs(5)], |least| vec![least.saturating_mul(2)]);
        let fix = |limit: Duration| {
            let limit = time(limit);
            self.replace(format!("give it {limit}"), span, keep(text, format!("{} within {limit}", body.trim())))
        };
        limits.into_iter().map(fix).collect()
    }

    /// Opens the connection that the advice names.
    fn opened(&self, found: &Diagnostic) -> Vec<Fix> {
        let written = found.help.iter().find_map(|help| help.split_once("write `")?.1.split_once('`'));
        let Some((with, _)) = written else { return Vec::new() };
        let Some((name, _)) = with.split_once('[') else { return Vec::new() };
        let runs = self.nodes.iter().filter(|node| matches!(node.expression, Expression::Run { .. }));
        let runs = runs.filter(|node| self.text(node.span) == name);
        runs.map(|node| self.replace(format!("open the connection: `{with}`"), node.span, with.to_owned())).collect()
    }

    // ---- sentences ----

    fn sentence(&self, group: usize, sentence: &Sentence) -> Vec<Fix> {
        let own = |who: &ProcessRef| who.member.is_none() && who.group as usize == group;
        match sentence {
            Sentence::After(
                Moment { event: Occurrence { who, kind: EventKind::Done(_) | EventKind::Ended }, nth: None },
                then,
            ) => match then {
                Consequence::Never(Occurrence { who: whole, kind: EventKind::Done(_) }) if own(whole) => {
                    self.counted_as_failure(*who)
                }
                Consequence::Eventually(Occurrence { who: last, .. }) => self.in_any_case(*who, *last),
                Consequence::Stopped(_, Some(limit)) => self.bounded_shields(&parts(*limit)),
                Consequence::Never(_) | Consequence::Stopped(_, None) => Vec::new(),
            },
            Sentence::AtMost(who, _) => self.retried_alone(*who),
            Sentence::StopsWithin(limit) => self.bounded_shields(&parts(*limit)),
            Sentence::FinishesWithin(limit) => self.limited(group, *limit),
            Sentence::On(Fault::Hang(Some(who)), _) => self.limited_step(*who),
            Sentence::NeverTogether(_)
            | Sentence::Implies(..)
            | Sentence::OnlyAfter(..)
            | Sentence::After(..)
            | Sentence::Once(..)
            | Sentence::On(..)
            | Sentence::Eventually(_)
            | Sentence::CanFinish
            | Sentence::Assume(..)
            | Sentence::Holds(_) => Vec::new(),
        }
    }

    /// Makes the end of an emergency stop a failure of the whole.
    fn counted_as_failure(&self, who: ProcessRef) -> Vec<Fix> {
        let Some(name) = self.name(who) else { return Vec::new() };
        let fail = |span: &Span| format!("({} ; fail(\"{name}\"))", self.text(*span));
        self.runs(who)
            .iter()
            .map(|span| self.replace(format!("let the end of `{name}` be a failure"), *span, fail(span)))
            .collect()
    }

    /// Changes `lock ; work ; unlock` to `lock ; (work finally unlock)`.
    fn in_any_case(&self, first: ProcessRef, last: ProcessRef) -> Vec<Fix> {
        let (Some(first), Some(last)) = (self.name(first), self.name(last)) else { return Vec::new() };
        let mut fixes = Vec::new();
        for node in self.nodes.iter().filter(|node| matches!(node.expression, Expression::Sequence(..))) {
            let text = self.text(node.span);
            let all = steps(text);
            let from = all.iter().position(|step| has_word(step, first));
            let to = all.iter().position(|step| has_word(step, last));
            let Some((from, to)) = from.zip(to).filter(|(from, to)| from + 1 < *to) else { continue };
            let body = operand(&all[from + 1..to].join(" ; "));
            let mut steps: Vec<String> = all[..=from].iter().map(|step| (*step).to_owned()).collect();
            steps.push(format!("({body} finally {})", operand(all[to])));
            steps.extend(all[to + 1..].iter().map(|step| (*step).to_owned()));
            let title = format!("run `{last}` in any case, also after a failure or a stop");
            fixes.push(self.replace(title, node.span, keep(text, steps.join(" ; "))));
        }
        fixes.dedup();
        fixes
    }

    /// Changes `retry(2) (pick ; place)` to `pick ; retry(2) place`.
    fn retried_alone(&self, who: ProcessRef) -> Vec<Fix> {
        let Some(name) = self.name(who) else { return Vec::new() };
        let mut fixes = Vec::new();
        for node in self.nodes.iter().filter(|node| node.group == who.group as usize) {
            let text = self.text(node.span);
            let Some((head, _, body)) = head(text, "retry") else { continue };
            let all = steps(body);
            let Some(at) = all.iter().position(|step| has_word(step, name)) else { continue };
            let rest = all[at + 1..].join(" ; ");
            if rest.is_empty() {
                continue;
            }
            let first = all[..=at].join(" ; ");
            let title = format!("try `{rest}` again, and `{name}` only once");
            let new = format!("{first} ; {head} {}", operand(&rest));
            let new = if self.is_alone(node.span) { new } else { format!("({new})") };
            fixes.push(self.replace(title, node.span, new));
        }
        fixes.dedup();
        fixes
    }

    /// Gives the whole a limit.
    fn limited(&self, group: usize, limit: Duration) -> Vec<Fix> {
        let Some(root) = self.nodes.iter().find(|node| node.group == group) else { return Vec::new() };
        let text = operand(self.text(root.span));
        let fix = |limit: Duration| {
            let limit = time(limit);
            self.replace(format!("limit all of it to {limit}"), root.span, format!("{text} within {limit}"))
        };
        parts(limit).into_iter().map(fix).collect()
    }

    /// Gives a step a limit.
    fn limited_step(&self, who: ProcessRef) -> Vec<Fix> {
        let Some(name) = self.name(who) else { return Vec::new() };
        let fixes = |span: Span| {
            LIMITS.map(|limit| {
                let text = format!("({} within {limit} s)", self.text(span));
                self.replace(format!("give `{name}` {limit} s at most"), span, text)
            })
        };
        self.runs(who).into_iter().flat_map(fixes).collect()
    }
}

/// Returns a time limit and parts of it, since stops take some of the time.
fn parts(limit: Duration) -> Vec<Duration> {
    vec![limit, limit * 3 / 4, limit / 2, limit / 4]
}

/// Returns the new text, in parentheses if the old text was in parentheses.
fn keep(old: &str, new: String) -> String {
    if inside(old).is_some() { format!("({new})") } else { new }
}
