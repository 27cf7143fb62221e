//! `dca audit --verify`: whether a file is an audit log that nobody has worked on.

use crate::io::named_file;
use anyhow::{Context as _, anyhow};
use node::console::{self, Failure};
use std::path::PathBuf;
use trust::audit::{Head, Verifier};

/// The longest log, in bytes.
const LOG_MAX: usize = 256 << 20;

/// The arguments of `dca audit`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The log to verify
    #[arg(long, value_name = "FILE", required = true)]
    verify: PathBuf,
    /// A file of signed heads, one a line: what they cover must be there. Their signatures are checked, not who the signers are
    #[arg(long, value_name = "FILE")]
    heads: Option<PathBuf>,
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let path = &arguments.verify;
    let heads = arguments.heads.as_deref().map_or(Ok(Vec::new()), heads)?;
    let count = heads.len();
    let text = named_file::text(path, LOG_MAX).with_context(|| format!("reading `{}`", path.display()))?;
    let mut verifier = Verifier::new(heads)?;
    let verified = text.lines().try_for_each(|line| verifier.line(line)).and_then(|()| verifier.finish());
    let log = verified.with_context(|| format!("`{}` is not as it was written", path.display()))?;
    let node = log.of().1;
    let heads = match count {
        0 => "no signed heads: records may be missing at the end".to_owned(),
        1 => "1 signed head fits".to_owned(),
        count => format!("{count} signed heads fit"),
    };
    console::say(&format!("{}: complete up to record {}, of node {node}; {heads}", path.display(), log.last()));
    Ok(())
}

fn heads(path: &std::path::Path) -> anyhow::Result<Vec<Head>> {
    let text = named_file::text(path, LOG_MAX).with_context(|| format!("reading `{}`", path.display()))?;
    let read = |(index, line): (usize, &str)| {
        Head::from_text(line).map_err(|error| anyhow!("line {} of `{}`: {error}", index + 1, path.display()))
    };
    text.lines().enumerate().map(read).collect()
}
