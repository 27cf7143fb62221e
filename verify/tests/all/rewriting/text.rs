//! A random group as the text of a spec.

use super::random::TAGS;
use language::plan::{Expression, Group, MemberKind};
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// Returns the spec as a text, and the tags of its modules.
pub(crate) fn text(group: &Group, sentences: &str) -> (String, BTreeMap<u32, Vec<String>>) {
    let mut matched = Vec::new();
    let expression = written(&group.expression, &mut matched);
    let (mut modules, mut instances, mut tags) = (String::new(), String::new(), BTreeMap::new());
    for (slot, member) in (0..).zip(&group.members) {
        assert!(matches!(member.kind, MemberKind::Leaf(_)), "a text has leaves only");
        let ends = match (matched.contains(&slot), member.service) {
            (true, _) => {
                tags.insert(slot, TAGS.map(str::to_owned).to_vec());
                format!("done({} | {})", TAGS[0], TAGS[1])
            }
            (false, true) => "service".to_owned(),
            (false, false) => "done".to_owned(),
        };
        writeln!(modules, "module M{slot}(host: Host) {{ init start; {ends}; }}").expect("a text");
        writeln!(instances, "        m{slot} instof M{slot}(c1);").expect("a text");
    }
    let text = format!(
        "{modules}\nprocess main(){{\n    host{{c1}}\n    resource arm, gripper;\n    instantiated_processes{{\n\
         {instances}    }}\n    internal_event_actions{{\n        {expression}\n    }}\n    verify{{\n{sentences}    }}\n}}\n"
    );
    (text, tags)
}

/// Returns an expression with parentheses around each operand. Adds the members with outcomes for a `match`.
pub(crate) fn written(expression: &Expression, matched: &mut Vec<u32>) -> String {
    let mut join = |of: &[Expression], sign: &str| {
        let operands: Vec<String> = of.iter().map(|operand| format!("({})", written(operand, matched))).collect();
        operands.join(sign)
    };
    match expression {
        Expression::Run { member, .. } => format!("m{member}"),
        Expression::Skip => "skip".to_owned(),
        Expression::Never => "never".to_owned(),
        Expression::Fail(why) => format!("fail(\"{why}\")"),
        Expression::Wait(after) => format!("wait({} s)", after.as_secs()),
        Expression::Concurrent(of) => join(of, ", "),
        Expression::FailFast(of) => join(of, " & "),
        Expression::AnyOf { count, of } => format!("any {count} of ({})", join(of, ", ")),
        Expression::AtLeast { count, of } => format!("at least {count} of ({})", join(of, ", ")),
        Expression::Disable(of) => join(of, " # "),
        Expression::Sequence(p, q) => format!("({}) ; ({})", written(p, matched), written(q, matched)),
        Expression::Conditional(p, q) => {
            if let (Expression::Run { member, .. }, Expression::Match(_)) = (&**p, &**q) {
                matched.push(*member);
            }
            let is_match = matches!(**q, Expression::Match(_));
            let (p, q) = (written(p, matched), written(q, matched));
            if is_match { format!("({p}) : {q}") } else { format!("({p}) : ({q})") }
        }
        Expression::Recurrent(p, q) => format!("({}) ;; ({})", written(p, matched), written(q, matched)),
        Expression::Otherwise(p, q) => format!("({}) else ({})", written(p, matched), written(q, matched)),
        Expression::Finally(p, q) => format!("({}) finally ({})", written(p, matched), written(q, matched)),
        Expression::Match(arms) => {
            let arms: Vec<String> = arms
                .iter()
                .map(|arm| format!("{} => ({})", arm.tag.as_deref().unwrap_or("else"), written(&arm.body, matched)))
                .collect();
            format!("match {{ {} }}", arms.join(", "))
        }
        Expression::Shield { bound: None, of } => format!("shield ({})", written(of, matched)),
        Expression::Shield { bound: Some(after), of } => {
            format!("shield({} s) ({})", after.as_secs(), written(of, matched))
        }
        Expression::Using { resources, of } => format!("using({}) ({})", resources.join(", "), written(of, matched)),
        // The pool of a text has one place, since more places would need arrays.
        Expression::Asynchronous { source, pool } => {
            format!("({}) ::[1] ({})", written(source, matched), written(&pool[0], matched))
        }
        Expression::Chart(_) => unreachable!("random expressions have no activities"),
        Expression::With { given, of } => format!("({}) with {given}", written(of, matched)),
        Expression::Named { name, of } => format!("{name} => ({})", written(of, matched)),
        Expression::Catch { of, arms } => {
            let of = written(of, matched);
            let arms = arms.iter().map(|arm| {
                let failure = arm.failure.as_ref().map_or_else(|| "else".to_owned(), ToString::to_string);
                format!("{failure} => ({})", written(&arm.body, matched))
            });
            format!("({of}) else match {{ {} }}", arms.collect::<Vec<_>>().join(", "))
        }
        Expression::Repeat { until, of } => {
            if let Expression::Run { member, .. } = **of {
                matched.push(member);
            }
            format!("repeat ({}) until {}", written(of, matched), until.join(" | "))
        }
        Expression::Tagged { tag, of } => format!("({}) as {tag}", written(of, matched)),
    }
}
