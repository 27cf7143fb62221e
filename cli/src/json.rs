//! `--json`: which verbs have this option, and which of them get it here.
//!
//! A verb whose answer has a form of its own reads the option itself and calls `console::answer`. The answers of the
//! other verbs are sentences or texts: `console::say` writes each of them as `{"text": …}`.

use clap::{Arg, ArgAction, Command};

/// The verbs that get the option here. For `ctl`, `export` and `team`, all of their subcommands get it.
const TEXTS: [&str; 18] = [
    "add", "audit", "check", "conform", "ctl", "export", "fix", "fmt", "graph", "import", "new", "remove", "replace",
    "report", "sim", "team", "test", "types",
];

/// Returns a command line in which every verb that answers has `--json`.
pub(crate) fn with_json(command: Command) -> Command {
    let option = || Arg::new("json").long("json").action(ArgAction::SetTrue).help("Print JSON").global(true);
    TEXTS.iter().fold(command, |command, verb| command.mut_subcommand(verb, |verb| verb.arg(option())))
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory as _;

    /// Verbs that have no answer: they show a mission, or write in the form that another program needs.
    const OTHERS: [&str; 9] = ["attach", "completions", "deploy", "lsp", "man", "replay", "run", "top", "view"];

    /// Returns the verbs that have no subcommands, each as its list of words.
    fn leaves(command: &Command, words: &[&str]) -> Vec<Vec<String>> {
        let below: Vec<&Command> = command.get_subcommands().filter(|verb| verb.get_name() != "help").collect();
        let own = || words.iter().map(|word| (*word).to_owned()).collect();
        if below.is_empty() {
            return vec![own()];
        }
        below.iter().flat_map(|verb| leaves(verb, &[words, &[verb.get_name()]].concat())).collect()
    }

    #[test]
    fn every_verb_that_answers_has_the_option() {
        let mut command = with_json(crate::Command::command());
        command.build();
        command.clone().debug_assert();
        for words in leaves(&command, &[]) {
            let find = |found: &Command, word: &String| found.find_subcommand(word).unwrap().clone();
            let verb = words.iter().fold(command.clone(), |found, word| find(&found, word));
            let has_option = verb.get_arguments().any(|option| option.get_id() == "json");
            assert_eq!(has_option, !OTHERS.contains(&words[0].as_str()), "dca {}", words.join(" "));
        }
    }
}
