//! `dca audit`: the log of a node, and whether a file is such a log that nobody has worked on.

use crate::io::named_file;
use anyhow::{Context as _, anyhow, ensure};
use dbmanager::logic::view::{date, table};
use node::console::{self, Failure};
use node::io::{run_dir, state_dir};
use std::path::{Path, PathBuf};
use team::{audit, member};
use trust::audit::{Head, Log, Verifier};
use trust::name::Name;

/// The longest log, in bytes.
const LOG_MAX: usize = 256 << 20;

/// The arguments of `dca audit`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The node of this machine whose log is shown; it need not run
    #[arg(required_unless_present = "verify", conflicts_with = "verify")]
    node: Option<Name>,
    /// Folder for the state of this machine's nodes, as `dca-node --state` has it
    #[arg(long, value_name = "DIR", requires = "node")]
    state: Option<PathBuf>,
    /// Folder with the sockets of this machine's nodes, as `dca-node --run-dir` has it: the node there says where its state is
    #[arg(long, value_name = "DIR", requires = "node", conflicts_with = "state")]
    run_dir: Option<PathBuf>,
    /// A file to verify instead
    #[arg(long, value_name = "FILE")]
    verify: Option<PathBuf>,
    /// A file of signed heads, one a line: what they cover must be there. Their signatures are checked, not who the signers are
    #[arg(long, value_name = "FILE", requires = "verify")]
    heads: Option<PathBuf>,
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let heads = arguments.heads.as_deref().map_or(Ok(Vec::new()), heads)?;
    match (&arguments.node, &arguments.verify) {
        (Some(node), _) => show(&state(node, arguments)?),
        (None, Some(path)) => verify(path, heads),
        (None, None) => Ok(()),
    }
}

/// Returns the folder with the state of a node: below the one that was given, else where the node itself says.
fn state(node: &Name, arguments: &Arguments) -> anyhow::Result<PathBuf> {
    let base = arguments.run_dir.clone().unwrap_or_else(run_dir::default_base);
    let told = || state_dir::told(&base, node.as_str());
    if let (None, Some(folder)) = (&arguments.state, told()) {
        return Ok(folder);
    }
    ensure!(
        arguments.run_dir.is_none(),
        "no node `{node}` has said in `{}` where its state is; name that folder with `--state`",
        base.display()
    );
    let base = arguments.state.clone().or_else(state_dir::default_base).context("choose a folder with `--state`")?;
    Ok(base.join(node.as_str()))
}

/// Shows the records of a node's log, and whether they are as they were written.
fn show(state: &Path) -> Result<(), Failure> {
    let path = state.join(member::FOLDER).join(audit::FILE);
    let text = named_file::text(&path, LOG_MAX).with_context(|| format!("reading `{}`", path.display()))?;
    let rows: Vec<Vec<String>> = text.lines().filter_map(row).collect();
    if !rows.is_empty() {
        console::say(&table::table(&rows));
    }
    let log = verified(&path, &text, Vec::new())?;
    console::note(&format!("complete up to record {}", log.last()));
    Ok(())
}

/// Returns a record as a person reads it.
fn row(line: &str) -> Option<Vec<String>> {
    let fields: Vec<&str> = line.split('\t').collect();
    let &[_, at, decision, who, what, _, reason, _] = fields.as_slice() else { return None };
    let at = date::text(at.parse::<u64>().ok()?.saturating_mul(1000));
    Some([&at, decision, who, what, reason].map(str::to_owned).to_vec())
}

fn verify(path: &Path, heads: Vec<Head>) -> Result<(), Failure> {
    let text = named_file::text(path, LOG_MAX).with_context(|| format!("reading `{}`", path.display()))?;
    let count = heads.len();
    let log = verified(path, &text, heads)?;
    let node = log.of().1;
    let heads = match count {
        0 => "no signed heads: records may be missing at the end".to_owned(),
        1 => "1 signed head fits".to_owned(),
        count => format!("{count} signed heads fit"),
    };
    console::say(&format!("{}: complete up to record {}, of node {node}; {heads}", path.display(), log.last()));
    Ok(())
}

/// Returns the end of a log that is as it was written, to which all heads fit.
fn verified(path: &Path, text: &str, heads: Vec<Head>) -> anyhow::Result<Log> {
    let mut verifier = Verifier::new(heads)?;
    let verified = text.lines().try_for_each(|line| verifier.line(line)).and_then(|()| verifier.finish());
    verified.with_context(|| format!("`{}` is not as it was written", path.display()))
}

fn heads(path: &Path) -> anyhow::Result<Vec<Head>> {
    let text = named_file::text(path, LOG_MAX).with_context(|| format!("reading `{}`", path.display()))?;
    let read = |(index, line): (usize, &str)| {
        Head::from_text(line).map_err(|error| anyhow!("line {} of `{}`: {error}", index + 1, path.display()))
    };
    text.lines().enumerate().map(read).collect()
}
