//! `dca import`: makes a spec of a state chart in SCXML, or of a behavior tree of BehaviorTree.CPP.

use crate::check;
use crate::io::whole_file;
use ::import::{Imported, RemarkKind};
use anyhow::{Context as _, anyhow};
use node::console::{self, Failure};
use node::logic::table::counted;
use std::path::PathBuf;

/// The most remarks that are printed; the text has all of them.
const REMARKS_MAX: usize = 100;

/// The arguments of `dca import`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// A chart in SCXML, or behavior trees of BehaviorTree.CPP 4; `-` is standard input
    file: PathBuf,
    /// Where the spec goes; the file must not exist yet [default: standard output]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Another file with trees, or with the ports of actions (`<TreeNodesModel>`); may be given more than once
    #[arg(long, value_name = "FILE")]
    with: Vec<PathBuf>,
}

/// Runs the verb. Each part that means something else, or that is missing, is a line on standard error.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    if let Some(output) = arguments.output.as_ref().filter(|output| output.exists()) {
        let output = output.display();
        return Err(Failure::Usage(anyhow!("`{output}` exists, and may have been edited; give the spec another name")));
    }
    let source = check::read(&arguments.file)?;
    let others = arguments.with.iter().map(|file| check::read(file)).collect::<Result<Vec<_>, _>>()?;
    let Imported { text, remarks, .. } = ::import::import(&source, &others)?;
    match &arguments.output {
        None => console::say(text.trim_end()),
        Some(file) => whole_file::put(file, text.as_bytes()).context("writing the spec")?,
    }
    for remark in remarks.iter().take(REMARKS_MAX) {
        console::note(&remark.to_string());
    }
    let missing = remarks.iter().filter(|remark| remark.kind == RemarkKind::Missing).count();
    if !remarks.is_empty() {
        let differs = counted(remarks.len() - missing, "part");
        let missing = counted(missing, "part");
        console::note(&format!(
            "{}: {differs} with another meaning, {missing} missing; each has a comment `// import:` in the spec",
            source.name
        ));
    }
    if missing == 0 { Ok(()) } else { Err(Failure::Reported) }
}
