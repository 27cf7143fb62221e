//! `dca audit`: the log of a node, and whether a file is an unchanged log.
//!
//! Other members of the team sign the positions of a log. Each node keeps such signatures in `team/heads` of its state
//! folder. The files of the nodes on this machine are always checked; no option has to name them.

use crate::io::named_file;
use anyhow::{Context as _, anyhow, ensure};
use dbmanager::logic::view::{date, table};
use node::console::{self, Failure};
use node::io::{run_dir, state_dir};
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use team::{audit, member};
use trust::audit::{Head, Log, Verifier};
use trust::name::{Name, NoName};

/// The longest log, in bytes.
const LOG_MAX: usize = 256 << 20;

/// The arguments of `dca audit`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The node of this machine whose log is shown; it need not run
    #[arg(required_unless_present = "verify", conflicts_with = "verify")]
    node: Option<Name>,
    /// Folder for the state of this machine's nodes, as `dca-node --state` has it
    #[arg(long, value_name = "DIR")]
    state: Option<PathBuf>,
    /// Folder with the sockets of this machine's nodes, as `dca-node --run-dir` has it: the node there says where its state is
    #[arg(long, value_name = "DIR", requires = "node", conflicts_with = "state")]
    run_dir: Option<PathBuf>,
    /// A file to verify instead
    #[arg(long, value_name = "FILE")]
    verify: Option<PathBuf>,
    /// A file of signed heads, such as `team/heads` in the state of another node; the log must have
    /// the records that these heads cover May be given more than once; the files of nodes on this
    /// machine are checked as well. Their signatures are checked, but not the signers' membership
    #[arg(long, value_name = "FILE", requires = "verify")]
    heads: Vec<PathBuf>,
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    match (&arguments.node, &arguments.verify) {
        (Some(node), _) => show(&state(node, arguments)?),
        (None, Some(path)) => verify(path, arguments),
        (None, None) => Ok(()),
    }
}

/// Returns the folder with the state of a node: below the given folder, or else the folder that the run folder of the node names.
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

/// Shows the records of a node's log, and whether they are unchanged.
fn show(state: &Path) -> Result<(), Failure> {
    let path = state.join(member::FOLDER).join(audit::FILE);
    let text = named_file::text(&path, LOG_MAX).with_context(|| format!("reading `{}`", path.display()))?;
    let rows: Vec<Vec<String>> = text.lines().filter_map(row).collect();
    if console::is_json() {
        console::answer(&text.lines().filter_map(record).collect::<Vec<_>>());
    } else if !rows.is_empty() {
        console::say(&table::table(&rows));
    }
    let own = Some(state.join(member::FOLDER).join(member::HEADS)).filter(|heads| heads.is_file());
    let signed = Signed::of(&text, &[], own.as_slice())?;
    let log = verified(&path, &text, &signed)?;
    console::note(&format!("complete up to record {}; {}", log.last(), signed.told()));
    Ok(())
}

/// Returns a record as a person reads it.
fn row(line: &str) -> Option<Vec<String>> {
    let fields: Vec<&str> = line.split('\t').collect();
    let &[_, at, decision, who, what, _, reason, _] = fields.as_slice() else { return None };
    let at = date::text(at.parse::<u64>().ok()?.saturating_mul(1000));
    Some([&at, decision, who, what, reason].map(str::to_owned).to_vec())
}

/// Returns a record as a program reads it.
fn record(line: &str) -> Option<Value> {
    let fields: Vec<&str> = line.split('\t').collect();
    let &[_, at, decision, who, what, _, reason, _] = fields.as_slice() else { return None };
    let time: u64 = at.parse().ok()?;
    Some(json!({ "time": time, "decision": decision, "who": who, "what": what, "reason": reason }))
}

fn verify(path: &Path, arguments: &Arguments) -> Result<(), Failure> {
    let text = named_file::text(path, LOG_MAX).with_context(|| format!("reading `{}`", path.display()))?;
    let signed = Signed::of(&text, &arguments.heads, &of_this_machine(arguments.state.as_deref()))?;
    let log = verified(path, &text, &signed)?;
    let node = log.of().1;
    let told = signed.told();
    if console::is_json() {
        let file = path.display().to_string();
        console::answer(&json!({ "file": file, "records": log.last(), "node": node.to_string(), "text": told }));
        return Ok(());
    }
    console::say(&format!("{}: complete up to record {}, of node {node}; {told}", path.display(), log.last()));
    Ok(())
}

/// Returns the end of a log, if the log is unchanged and all heads fit it.
fn verified(path: &Path, text: &str, signed: &Signed) -> anyhow::Result<Log> {
    let heads = signed.0.iter().map(|(_, head)| head.clone()).collect();
    let verifier = Verifier::new(heads)?;
    let read = |mut verifier: Verifier| {
        // `lines` would remove a carriage return, and so hide that a record was changed.
        text.split_terminator('\n').try_for_each(|line| verifier.line(line))?;
        verifier.finish()
    };
    read(verifier).with_context(|| {
        let of_others = signed.signer_of_last().map_or_else(String::new, |name| format!(", as `{name}` has signed it"));
        format!("the log `{}` was changed after it was written{of_others}", path.display())
    })
}

/// Returns the files with signed heads of all nodes of this machine.
fn of_this_machine(base: Option<&Path>) -> Vec<PathBuf> {
    let base = base.map(Path::to_owned).or_else(state_dir::default_base);
    let nodes = base.and_then(|base| std::fs::read_dir(base).ok());
    let folders = nodes.into_iter().flatten().flatten().map(|node| node.path());
    folders.map(|node| node.join(member::FOLDER).join(member::HEADS)).filter(|file| file.is_file()).collect()
}

/// The signed heads of a log, with the name that each signer had.
struct Signed(Vec<(Name, Head)>);

impl Signed {
    /// Returns the heads of the log with this text. It is an error if one of the `named` files has no head of this log.
    fn of(text: &str, named: &[PathBuf], found: &[PathBuf]) -> anyhow::Result<Self> {
        // A text that is not a log has no heads; `verified` reports the mistake.
        let Some(log) = text.lines().next().and_then(Log::node_of) else { return Ok(Self(Vec::new())) };
        let (mut all, mut known) = (Vec::new(), BTreeSet::new());
        for (path, is_named) in named.iter().map(|path| (path, true)).chain(found.iter().map(|path| (path, false))) {
            let heads = match heads(path) {
                Err(error) if !is_named => {
                    console::note(&format!("warning: {error:#}"));
                    continue;
                }
                heads => heads?,
            };
            let mut of_log = heads.into_iter().filter(|(_, head)| head.position().log == log).peekable();
            ensure!(!is_named || of_log.peek().is_some(), "`{}` has no signed head of this log", path.display());
            // The same head may be in two files: the file of its signer, and the file of the owner of the log.
            all.extend(of_log.filter(|(_, head)| known.insert(head.to_bytes())));
        }
        Ok(Self(all))
    }

    fn last(&self) -> Option<&(Name, Head)> {
        self.0.iter().max_by_key(|(_, head)| head.position().number)
    }

    fn signer_of_last(&self) -> Option<&Name> {
        self.last().map(|(name, _)| name)
    }

    /// Describes the records that the heads cover.
    fn told(&self) -> String {
        match self.last() {
            None => "no signed heads: records may be missing at the end".to_owned(),
            Some((name, head)) => {
                let number = head.position().number;
                let heads = if self.0.len() == 1 {
                    "1 signed head fits".to_owned()
                } else {
                    format!("{} signed heads fit", self.0.len())
                };
                format!("{heads}, the last of record {number} by `{name}`")
            }
        }
    }
}

/// Reads the heads in a file: one head on each line, followed by the name of its signer.
fn heads(path: &Path) -> anyhow::Result<Vec<(Name, Head)>> {
    let text = named_file::text(path, LOG_MAX).with_context(|| format!("reading `{}`", path.display()))?;
    let read = |(index, line): (usize, &str)| {
        let (head, name) = line.split_once(' ').unwrap_or((line, "somebody"));
        let wrong = |error: &dyn std::fmt::Display| anyhow!("line {} of `{}`: {error}", index + 1, path.display());
        let head = Head::from_text(head).map_err(|error| wrong(&error))?;
        Ok((name.parse().map_err(|error: NoName| wrong(&error))?, head))
    };
    text.lines().enumerate().map(read).collect()
}
