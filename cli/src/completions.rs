//! `dca completions`: prints what a shell needs to complete the words of `dca`, or of `dca-node`.
//!
//! The shell asks `dca` itself for the words of `dca`, so that they include what runs now. The words of `dca-node` are in the script.

use crate::complete::VARIABLE;
use clap_complete::env::Shells;
use clap_complete::{Shell, generate};
use node::console::{self, Failure};

/// The arguments of `dca completions`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The shell; for bash, its words go to `~/.local/share/bash-completion/completions/dca`
    shell: Shell,
    /// The program to complete
    #[arg(long, value_name = "PROGRAM", default_value = "dca")]
    of: Program,
}

/// A program with a command line.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Program {
    /// The command line.
    Dca,
    /// The agent of a host.
    DcaNode,
}

/// In bash a colon ends a word, unless it is removed from this list. `door:hit/force` has to stay one word.
const BASH_WORDS: &str = "COMP_WORDBREAKS=${COMP_WORDBREAKS//:}\n";

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    console::pass(&script(arguments.shell, arguments.of)?)?;
    Ok(())
}

fn script(shell: Shell, of: Program) -> anyhow::Result<Vec<u8>> {
    let mut script = Vec::new();
    match of {
        Program::Dca => {
            let shells = Shells::builtins();
            let named = shells.completer(&shell.to_string());
            let named = named.ok_or_else(|| anyhow::anyhow!("the shell `{shell}` is not supported"))?;
            named.write_registration(VARIABLE, "dca", "dca", "dca", &mut script)?;
            if shell == Shell::Bash {
                script.extend(BASH_WORDS.as_bytes());
            }
        }
        Program::DcaNode => generate(shell, &mut node::command::command(), "dca-node", &mut script),
    }
    Ok(script)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_shell_has_a_script() {
        for shell in [Shell::Bash, Shell::Elvish, Shell::Fish, Shell::PowerShell, Shell::Zsh] {
            for (of, words) in [(Program::Dca, ["dca", VARIABLE]), (Program::DcaNode, ["install", "peer"])] {
                let text = String::from_utf8(script(shell, of).unwrap()).unwrap();
                assert!(words.iter().all(|word| text.contains(word)), "{shell}");
            }
        }
    }
}
