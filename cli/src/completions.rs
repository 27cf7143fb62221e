//! `dca completions`: prints the completions of verbs and options for a shell, of `dca` or of `dca-node`.

use crate::Command;
use clap::CommandFactory as _;
use clap_complete::{Shell, generate};
use node::console::{self, Failure};

/// The arguments of `dca completions`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The shell; for bash, its words go to `~/.local/share/bash-completion/completions/dca`
    shell: Shell,
    /// The program whose words they are
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

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    console::pass(&script(arguments.shell, arguments.of))?;
    Ok(())
}

fn script(shell: Shell, of: Program) -> Vec<u8> {
    let mut script = Vec::new();
    let (mut command, name) = match of {
        Program::Dca => (Command::command(), "dca"),
        Program::DcaNode => (node::command::command(), "dca-node"),
    };
    generate(shell, &mut command, name, &mut script);
    script
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write as _;
    use std::process::Stdio;

    /// A shell reads its script, and completes by it.
    #[test]
    fn bash_completes_verbs_and_options() {
        let mut asked = script(Shell::Bash, Program::Dca);
        asked.extend(b"\nfor words in 'dca gra' 'dca check --f'; do COMP_WORDS=($words); COMP_CWORD=$((${#COMP_WORDS[@]} - 1))\n");
        asked.extend(
            b"COMPREPLY=(); _dca dca \"${COMP_WORDS[-1]}\" \"${COMP_WORDS[-2]}\"; echo \"${COMPREPLY[@]}\"; done\n",
        );
        let started =
            std::process::Command::new("bash").arg("--norc").stdin(Stdio::piped()).stdout(Stdio::piped()).spawn();
        let Ok(mut bash) = started else { return };
        bash.stdin.take().unwrap().write_all(&asked).unwrap();
        let told = bash.wait_with_output().unwrap();
        assert_eq!(String::from_utf8_lossy(&told.stdout), "graph\n--fix --format\n");
    }

    #[test]
    fn every_shell_has_a_script() {
        for shell in [Shell::Bash, Shell::Elvish, Shell::Fish, Shell::PowerShell, Shell::Zsh] {
            for (of, words) in [(Program::Dca, ["completions", "deploy"]), (Program::DcaNode, ["install", "peer"])] {
                let text = String::from_utf8(script(shell, of)).unwrap();
                assert!(words.iter().all(|word| text.contains(word)), "{shell}");
            }
        }
    }
}
