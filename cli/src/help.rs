//! The help of `dca`: verbs in groups, and examples of each.

use clap::Command;
use std::fmt::Write as _;

/// The verbs, grouped by purpose.
const GROUPS: [(&str, &[&str]); 7] = [
    ("Run", &["new", "import", "run", "replay", "deploy", "attach", "stop", "estop"]),
    (
        "Look",
        &[
            "status", "top", "view", "nodes", "names", "events", "logs", "list", "echo", "hz", "get", "queue",
            "router", "lock", "clock", "report", "export",
        ],
    ),
    ("Change what runs", &["plan", "replace", "add", "remove", "switch", "ctl", "param", "call"]),
    (
        "Check",
        &["check", "fix", "fmt", "graph", "types", "sim", "verify", "test", "fmea", "conform", "explain", "doctor"],
    ),
    ("Team", &["team", "audit"]),
    ("Database", &["db"]),
    ("Editor and shell", &["lsp", "completions", "man"]),
];

/// Two examples of each verb: its most common use, and another one.
const EXAMPLES: [(&str, [&str; 2]); 49] = [
    ("new", ["dca new robot", "dca new --sdk robot"]),
    ("import", ["dca import fetch.scxml -o fetch.dca", "dca import robot.launch.xml --set robot=r7 -o robot.dca"]),
    ("run", ["dca run robot.dca", "dca run robot.dca --set speed='0.3 m/s' --record all"]),
    (
        "replay",
        [
            "dca replay runs/robot-1 robot.dca",
            "dca replay runs/robot-1 robot.dca --ports laser.Scan,map.Out --rate 2 --record all",
        ],
    ),
    ("deploy", ["dca deploy robot.dca", "dca deploy robot.dca --require-verified --aligned"]),
    ("attach", ["dca attach", "dca attach robot"]),
    ("stop", ["dca stop robot", "dca stop robot --forget"]),
    ("estop", ["dca estop 'a person is in the cell'", "dca estop --release"]),
    ("status", ["dca status", "dca status robot --watch"]),
    ("top", ["dca top", "dca top --ascii"]),
    ("view", ["dca view --page", "dca view --foxglove --origin https://viewer.example"]),
    ("nodes", ["dca nodes", "dca nodes --json"]),
    ("names", ["dca names", "dca names --json"]),
    ("events", ["dca events robot", "dca events --follow --json"]),
    ("logs", ["dca logs hit/force", "dca logs robot:hit/force --follow"]),
    ("list", ["dca list", "dca list robot:hand"]),
    ("echo", ["dca echo hit/force.Out", "dca echo robot:force.Out -n 5 --json"]),
    ("hz", ["dca hz hit/force.Out", "dca hz force.Out --for 10"]),
    ("get", ["dca get hand.opening", "dca get hand.opening --watch"]),
    ("queue", ["dca queue", "dca queue base.commands --watch"]),
    ("router", ["dca router", "dca router robot:post --json"]),
    ("lock", ["dca lock", "dca lock arm --watch"]),
    ("clock", ["dca clock", "dca clock --json"]),
    ("report", ["dca report runs/robot-1", "dca report runs/robot-1 -o robot.html"]),
    ("export", ["dca export otlp runs/robot-1", "dca export otlp runs/robot-1 -o robot.jsonl"]),
    ("plan", ["dca plan robot.dca", "dca plan robot.dca --json"]),
    ("replace", ["dca replace robot hit/force", "dca replace robot hit/force arm --probation 20"]),
    (
        "add",
        [
            "dca add robot 'logger instof Logger(c1)'",
            "dca add robot 'view instof View(c1)' --connect 'eye, Out -> view, In' --optional",
        ],
    ),
    ("remove", ["dca remove robot logger", "dca remove robot robot:main/view"]),
    ("switch", ["dca switch robot 'hit/force[lbl2]'", "dca switch robot 'hit/force[]'"]),
    ("ctl", ["dca ctl robot fetch message speech continue", "dca ctl robot fetch message speech stop --priority 5"]),
    ("param", ["dca param list", "dca param set hit/force threshold '12 N'"]),
    ("call", ["dca call hand.Open", "dca call robot:hand.Grip force='20 N'"]),
    ("check", ["dca check robot.dca", "dca check robot.dca --format sarif"]),
    ("fix", ["dca fix robot.dca", "dca fix robot.dca --controllers target/debug/arms"]),
    ("fmt", ["dca fmt robot.dca", "dca fmt --check robot.dca"]),
    ("graph", ["dca graph robot.dca -o robot.svg", "dca graph robot.dca --dot"]),
    ("types", ["dca types --python robot.dca", "dca types --rust robot.dca"]),
    ("sim", ["dca sim robot.dca", "dca sim robot.dca --seed 1 --faults 20 --chart run.svg"]),
    ("verify", ["dca verify robot.dca", "dca verify robot.dca --fix"]),
    ("test", ["dca test tests", "dca test tests/robot-1.story"]),
    ("fmea", ["dca fmea robot.dca", "dca fmea robot.dca --faults 2 --html"]),
    (
        "conform",
        ["dca conform runs/robot-1 robot.dca", "dca conform runs/robot-1 robot.dca --controllers target/debug/arms"],
    ),
    ("explain", ["dca explain E0201", "dca explain"]),
    ("doctor", ["dca doctor", "dca doctor --json"]),
    ("team", ["dca team init lab", "dca team invite r1"]),
    ("audit", ["dca audit r1", "dca audit --verify r1.log"]),
    ("db", ["dca db get team/", "dca db put team/camera/gain 1.5"]),
    ("lsp", ["dca lsp", "dca lsp --controllers target/debug/arms"]),
];

/// Two examples of each verb for a shell.
const SHELL: [(&str, [&str; 2]); 2] = [
    ("completions", ["dca completions bash", "dca completions fish --of dca-node"]),
    ("man", ["dca man ~/.local/share/man/man1", "dca man pages"]),
];

/// Returns the command line with a help that lists the verbs in groups, and shows examples of each verb.
pub(crate) fn with_help(command: Command) -> Command {
    let groups = groups(&command);
    let command = command.after_help(groups).help_template(
        "{about-with-newline}\n{usage-heading} {usage}\n\n{after-help}\n\nOptions:\n{options}\n\n\
         `dca VERB --help` explains a verb, with examples.\n",
    );
    EXAMPLES.iter().chain(&SHELL).fold(command, |command, (verb, examples)| {
        command
            .mut_subcommand(*verb, |verb| verb.after_help(format!("Examples:\n  {}\n  {}", examples[0], examples[1])))
    })
}

/// Returns the verbs in their groups, each with its purpose.
fn groups(command: &Command) -> String {
    let width = command.get_subcommands().map(|verb| verb.get_name().len()).max().unwrap_or_default();
    let about = |verb: &str| command.find_subcommand(verb).and_then(Command::get_about).map(ToString::to_string);
    let mut text = String::new();
    for (group, verbs) in GROUPS {
        writeln!(text, "{group}:").unwrap_or_default();
        for verb in verbs {
            writeln!(text, "  {verb:<width$}  {}", about(verb).unwrap_or_default()).unwrap_or_default();
        }
        text.push('\n');
    }
    text.trim_end().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory as _;
    use std::collections::BTreeSet;

    fn command() -> Command {
        with_help(crate::Command::command())
    }

    #[test]
    fn every_verb_is_in_one_group_and_has_examples() {
        let verbs: Vec<String> = command().get_subcommands().map(|verb| verb.get_name().to_owned()).collect();
        let grouped: Vec<&str> = GROUPS.iter().flat_map(|(_, verbs)| verbs.iter().copied()).collect();
        let shown: BTreeSet<&str> = EXAMPLES.iter().chain(&SHELL).map(|(verb, _)| *verb).collect();
        let known: BTreeSet<&str> = verbs.iter().map(String::as_str).collect();
        assert_eq!(grouped.len(), known.len(), "each verb stands once");
        assert_eq!(grouped.into_iter().collect::<BTreeSet<_>>(), known);
        assert_eq!(shown, known);
    }

    /// Splits an example into words, as a shell does.
    fn words(example: &str) -> Vec<String> {
        let (mut words, mut is_quoted) = (vec![String::new()], false);
        for sign in example.chars() {
            match sign {
                '\'' => is_quoted = !is_quoted,
                ' ' if !is_quoted => words.push(String::new()),
                _ => words.last_mut().unwrap().push(sign),
            }
        }
        words
    }

    #[test]
    fn every_example_can_be_parsed() {
        for (verb, examples) in EXAMPLES.iter().chain(&SHELL) {
            assert_ne!(examples[0], examples[1]);
            for example in examples {
                let words = words(example);
                assert_eq!((words[0].as_str(), words[1].as_str()), ("dca", *verb), "{example}");
                command().try_get_matches_from(&words).unwrap_or_else(|error| panic!("{example}: {error}"));
            }
        }
    }

    #[test]
    fn the_help_has_the_groups_in_order() {
        let help = command().render_help().to_string();
        let places: Vec<usize> = GROUPS.iter().map(|(group, _)| help.find(&format!("\n{group}:\n")).unwrap()).collect();
        assert!(places.is_sorted() && help.contains("\n  run          Run a spec on this machine alone"), "{help}");
        let run = command().find_subcommand_mut("run").unwrap().render_help().to_string();
        assert!(
            run.ends_with("Examples:\n  dca run robot.dca\n  dca run robot.dca --set speed='0.3 m/s' --record all\n"),
            "{run}"
        );
    }
}
