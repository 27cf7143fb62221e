//! `dca doctor`: checks whether this machine is ready for a node.

use crate::io::machine;
use crate::logic::checkup::{Check, Level, findings};
use node::console::{self, Failure, block_on};
use node::io::{run_dir, state_dir};
use std::path::PathBuf;

/// The arguments of `dca doctor`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Print the findings as JSON
    #[arg(long)]
    json: bool,
    /// The folder for sockets that the node will use
    #[arg(long, value_name = "DIR")]
    run_dir: Option<PathBuf>,
    /// The folder for the database that the node will use
    #[arg(long, value_name = "DIR")]
    state: Option<PathBuf>,
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let run = arguments.run_dir.clone().unwrap_or_else(run_dir::default_base);
    let state = arguments.state.clone().or_else(state_dir::default_base);
    let machine = block_on(async { Ok(machine::look(&run, state.as_deref()).await) })?;
    let checks = findings(&machine);
    if arguments.json {
        console::answer(&checks);
    } else {
        console::say(&text(&checks));
    }
    let is_good = checks.iter().all(|check| check.level < Level::Failed);
    if is_good { Ok(()) } else { Err(Failure::Reported) }
}

fn text(checks: &[Check]) -> String {
    let line = |check: &Check| {
        let line = format!("{:<8} {:<12} {}", check.level, check.name, check.finding);
        check.hint.map_or(line.clone(), |hint| format!("{line}\n{:<8} {:<12} {hint}", "", ""))
    };
    checks.iter().map(line).collect::<Vec<_>>().join("\n")
}
