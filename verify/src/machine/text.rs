//! A machine as a text: JANI and mCRL2.

use super::{Change, Machine, Term, Test, Var};
use std::collections::BTreeSet;
use std::fmt::Write as _;

/// In the JSON of JANI.
pub(super) fn jani(name: &str, machine: &Machine) -> String {
    let words: BTreeSet<&str> = machine.changes.iter().filter_map(|change| change.word.as_deref()).collect();
    let actions: Vec<String> = words.iter().map(|word| format!("{{\"name\": {}}}", quoted(word))).collect();
    let variable = |variable: &super::Variable| {
        let (name, most) = (quoted(&variable.name), variable.most);
        let kind = format!("{{\"kind\": \"bounded\", \"base\": \"int\", \"lower-bound\": 0, \"upper-bound\": {most}}}");
        format!("{{\"name\": {name}, \"type\": {kind}, \"initial-value\": 0}}")
    };
    let variables: Vec<String> = machine.variables.iter().map(variable).collect();
    let edges: Vec<String> = machine.changes.iter().map(|change| edge(machine, change)).collect();
    format!(
        "{{\"jani-version\": 1, \"name\": {}, \"type\": \"mdp\",\n\"actions\": [\n{}],\n\"variables\": [\n{}],\n\"properties\": [],\n\
         \"automata\": [{{\"name\": \"plan\", \"locations\": [{{\"name\": \"on\"}}], \"initial-locations\": [\"on\"],\n\
         \"edges\": [\n{}]}}],\n\
         \"system\": {{\"elements\": [{{\"automaton\": \"plan\"}}]}}}}\n",
        quoted(name),
        actions.join(",\n"),
        variables.join(",\n"),
        edges.join(",\n"),
    )
}

/// Returns a text with the quotes and escapes of JSON.
fn quoted(text: &str) -> String {
    let mut quoted = String::from("\"");
    for letter in text.chars() {
        match letter {
            '"' | '\\' => quoted.extend(['\\', letter]),
            _ if letter.is_control() => quoted += &format!("\\u{:04x}", u32::from(letter)),
            _ => quoted.push(letter),
        }
    }
    quoted + "\""
}

fn edge(machine: &Machine, change: &Change) -> String {
    let name = |var: Var| quoted(&machine.variables[var.0].name);
    let word = change.word.as_ref().map(|word| format!("\"action\": {}, ", quoted(word))).unwrap_or_default();
    let guard = jani_test(&Test::All(change.tests.clone()), &name);
    let set =
        |(var, term): &(Var, Term)| format!("{{\"ref\": {}, \"value\": {}}}", name(*var), jani_term(*term, &name));
    let sets: Vec<String> = change.sets.iter().map(set).collect();
    format!(
        "{{\"location\": \"on\", {word}\"guard\": {{\"exp\": {guard}}},\
         \"destinations\": [{{\"location\": \"on\", \"assignments\": [{}]}}]}}",
        sets.join(", ")
    )
}

fn jani_test(test: &Test, name: &dyn Fn(Var) -> String) -> String {
    let two =
        |op: &str, left: String, right: String| format!("{{\"op\": \"{op}\", \"left\": {left}, \"right\": {right}}}");
    let join = |tests: &[Test], op: &str, none: &str| {
        let tests = tests.iter().map(|test| jani_test(test, name));
        tests.reduce(|left, right| two(op, left, right)).unwrap_or_else(|| none.to_owned())
    };
    match test {
        Test::Is(var, number) => two("=", name(*var), number.to_string()),
        Test::Not(var, number) => two("≠", name(*var), number.to_string()),
        Test::Same(one, other) => two("=", name(*one), name(*other)),
        Test::Less(less, more) => two("<", name(*less), name(*more)),
        Test::All(tests) => join(tests, "∧", "true"),
        Test::Any(tests) => join(tests, "∨", "false"),
        Test::Fails(test) => format!("{{\"op\": \"¬\", \"exp\": {}}}", jani_test(test, name)),
    }
}

fn jani_term(term: Term, name: &dyn Fn(Var) -> String) -> String {
    let minus = |var| format!("{{\"op\": \"-\", \"left\": {}, \"right\": 1}}", name(var));
    let less_if = |var, than: String| {
        let test = format!("{{\"op\": \"<\", \"left\": {than}, \"right\": {}}}", name(var));
        format!("{{\"op\": \"ite\", \"if\": {test}, \"then\": {}, \"else\": {}}}", minus(var), name(var))
    };
    match term {
        Term::Number(number) => number.to_string(),
        Term::Of(var) => name(var),
        Term::OneMore(var) => format!("{{\"op\": \"+\", \"left\": {}, \"right\": 1}}", name(var)),
        Term::OneLess(var) => less_if(var, "0".to_owned()),
        Term::MovesUp(var, than) => less_if(var, name(than)),
    }
}

/// In mCRL2.
pub(super) fn mcrl2(machine: &Machine) -> String {
    let names = Names::of(machine);
    let name = |var: Var| machine.variables[var.0].name.clone();
    let mut text = String::from("% what happens, and its action\n");
    for (word, action) in &names.actions {
        writeln!(text, "% {action}: {word}").expect("a text takes everything");
    }
    let actions: Vec<&str> = names.actions.iter().map(|(_, action)| action.as_str()).collect();
    let variables: Vec<String> = machine.variables.iter().map(|variable| format!("{}: Int", variable.name)).collect();
    let changes: Vec<String> = machine
        .changes
        .iter()
        .map(|change| {
            let action = change.word.as_deref().map_or("tau", |word| names.action(word));
            let tests = mcrl2_test(&Test::All(change.tests.clone()), &name);
            let sets = change.sets.iter().map(|(var, term)| format!("{} = {}", name(*var), mcrl2_term(*term, &name)));
            format!("  ({tests}) -> {action} . Plan({})", sets.collect::<Vec<_>>().join(", "))
        })
        .collect();
    let zeros = vec!["0"; machine.variables.len()];
    format!(
        "{text}\nact {};\n\nproc Plan(\n  {}) =\n{};\n\ninit Plan({});\n",
        actions.join(",\n  "),
        variables.join(",\n  "),
        changes.join("\n+\n"),
        zeros.join(", ")
    )
}

/// The action names for mCRL2: each word in letters, digits and `_`, and no two of them equal.
struct Names {
    actions: Vec<(String, String)>,
}

impl Names {
    fn of(machine: &Machine) -> Self {
        let words: BTreeSet<&str> = machine.changes.iter().filter_map(|change| change.word.as_deref()).collect();
        let mut known = BTreeSet::new();
        let mut actions = Vec::new();
        for word in words {
            let plain: String =
                word.chars().map(|letter| if letter.is_ascii_alphanumeric() { letter } else { '_' }).collect();
            let plain = plain.trim_end_matches('_').to_owned();
            let mut action = plain.clone();
            let mut number = 1;
            while !known.insert(action.clone()) {
                number += 1;
                action = format!("{plain}_{number}");
            }
            actions.push((word.to_owned(), action));
        }
        Self { actions }
    }

    fn action(&self, word: &str) -> &str {
        let found = self.actions.binary_search_by(|(known, _)| known.as_str().cmp(word));
        found.map_or("tau", |index| &self.actions[index].1)
    }
}

fn mcrl2_test(test: &Test, name: &dyn Fn(Var) -> String) -> String {
    let join = |tests: &[Test], sign: &str, none: &str| match tests {
        [] => none.to_owned(),
        [one] => mcrl2_test(one, name),
        _ => {
            let tests: Vec<String> = tests.iter().map(|test| format!("({})", mcrl2_test(test, name))).collect();
            tests.join(sign)
        }
    };
    match test {
        Test::Is(var, number) => format!("{} == {number}", name(*var)),
        Test::Not(var, number) => format!("{} != {number}", name(*var)),
        Test::Same(one, other) => format!("{} == {}", name(*one), name(*other)),
        Test::Less(less, more) => format!("{} < {}", name(*less), name(*more)),
        Test::All(tests) => join(tests, " && ", "true"),
        Test::Any(tests) => join(tests, " || ", "false"),
        Test::Fails(test) => format!("!({})", mcrl2_test(test, name)),
    }
}

fn mcrl2_term(term: Term, name: &dyn Fn(Var) -> String) -> String {
    match term {
        Term::Number(number) => number.to_string(),
        Term::Of(var) => name(var),
        Term::OneMore(var) => format!("{} + 1", name(var)),
        Term::OneLess(var) => format!("if(0 < {0}, {0} - 1, {0})", name(var)),
        Term::MovesUp(var, than) => format!("if({1} < {0}, {0} - 1, {0})", name(var), name(than)),
    }
}
