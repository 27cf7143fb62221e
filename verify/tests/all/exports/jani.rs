//! Reads the part of JANI that the exporter writes.

use super::machine::{Change, Expr, Machine, Variable};
use serde_json::Value;

pub(crate) fn read(text: &str) -> Machine {
    let model: Value = serde_json::from_str(text).expect("it is JSON");
    assert_eq!((&model["jani-version"], &model["type"]), (&Value::from(1), &Value::from("mdp")));
    let variables: Vec<Variable> = list(&model["variables"]).iter().map(variable).collect();
    let name = |value: &Value| value.as_str().expect("a name").to_owned();
    let actions: Vec<String> = list(&model["actions"]).iter().map(|action| name(&action["name"])).collect();
    let [automaton] = list(&model["automata"]).as_slice() else { panic!("there is one automaton") };
    let edge = |edge: &Value| {
        let word = edge.get("action").map(&name);
        assert!(word.iter().all(|word| actions.contains(word)), "{word:?} is declared");
        let [destination] = list(&edge["destinations"]).as_slice() else { panic!("there is one destination") };
        let assignment = |set: &Value| {
            let variable = position(&variables, set["ref"].as_str().expect("a variable"));
            (variable, expr(&set["value"], &variables))
        };
        let sets: Vec<(usize, Expr)> = list(&destination["assignments"]).iter().map(assignment).collect();
        for (index, (variable, _)) in sets.iter().enumerate() {
            assert!(sets[..index].iter().all(|(other, _)| other != variable), "nothing is assigned twice");
        }
        Change { word, guard: expr(&edge["guard"]["exp"], &variables), sets }
    };
    let changes: Vec<Change> = list(&automaton["edges"]).iter().map(edge).collect();
    Machine::new(variables, changes)
}

fn list(value: &Value) -> &Vec<Value> {
    value.as_array().expect("a list")
}

fn variable(value: &Value) -> Variable {
    let number = |value: &Value| value.as_i64().expect("a number");
    Variable {
        name: value["name"].as_str().expect("a name").to_owned(),
        first: number(&value["initial-value"]),
        most: Some(number(&value["type"]["upper-bound"])),
    }
}

fn position(variables: &[Variable], name: &str) -> usize {
    variables.iter().position(|variable| variable.name == name).unwrap_or_else(|| panic!("`{name}` is declared"))
}

fn expr(value: &Value, variables: &[Variable]) -> Expr {
    let part = |key: &str| expr(&value[key], variables);
    match value {
        Value::Number(number) => Expr::Number(number.as_i64().expect("a whole number")),
        Value::Bool(truth) => Expr::Number(i64::from(*truth)),
        Value::String(name) => Expr::Variable(position(variables, name)),
        Value::Null | Value::Array(_) | Value::Object(_) => match value["op"].as_str().expect("an operator") {
            "ite" => Expr::Of("if", vec![part("if"), part("then"), part("else")]),
            "¬" => Expr::Of("!", vec![part("exp")]),
            op => {
                let signs = [("∧", "&&"), ("∨", "||"), ("=", "=="), ("≠", "!="), ("<", "<"), ("+", "+"), ("-", "-")];
                let sign = signs.iter().find(|(known, _)| *known == op).unwrap_or_else(|| panic!("`{op}` is known"));
                Expr::Of(sign.1, vec![part("left"), part("right")])
            }
        },
    }
}
