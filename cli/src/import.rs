//! `dca import`: makes a spec from a state chart in SCXML, a behavior tree of BehaviorTree.CPP, or a launch file of ROS 2.

use crate::io::{named_file, whole_file};
use crate::{assignment, check};
use ::import::{Files, Imported, LaunchSettings, RemarkKind};
use anyhow::{Context as _, anyhow};
use language::{Assignment, Source};
use node::console::{self, Failure};
use node::logic::table::counted;
use std::path::{Path, PathBuf};

/// The most remarks that are printed; the text has all of them.
const REMARKS_MAX: usize = 100;
/// The folder in an installation of ROS 2 that has a file for each package.
const INDEX: &str = "share/ament_index/resource_index/packages";

/// The arguments of `dca import`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// A chart in SCXML, behavior trees of BehaviorTree.CPP 4, or a launch file of ROS 2 in XML or
    /// YAML; `-` reads XML from standard input
    file: PathBuf,
    /// Where the spec goes; the file must not exist yet [default: standard output]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Another file with trees, or with the ports of actions (`<TreeNodesModel>`); may be given more than once
    #[arg(long, value_name = "FILE")]
    with: Vec<PathBuf>,
    /// Give this argument of the launch file a value; may be given more than once [default: as in the file]
    #[arg(id = "launch-arguments", long = "set", value_name = "NAME=VALUE", value_parser = assignment)]
    arguments: Vec<Assignment>,
    /// The setup file of ROS 2 for the programs of the launch file, such as `/opt/ros/jazzy/setup.bash`
    #[arg(long, value_name = "FILE")]
    setup: Option<String>,
}

/// Runs the verb. Prints a line on standard error for each part whose meaning differs, or that is missing.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    if let Some(output) = arguments.output.as_ref().filter(|output| output.exists()) {
        let output = output.display();
        return Err(Failure::Usage(anyhow!("`{output}` exists, and may have been edited; give the spec another name")));
    }
    let source = check::read(&arguments.file)?;
    let others = arguments.with.iter().map(|file| check::read(file)).collect::<Result<Vec<_>, _>>()?;
    let given = arguments.arguments.iter().map(|given| (given.name.clone(), given.value.clone()));
    let settings = LaunchSettings { arguments: given.collect(), setup: arguments.setup.clone() };
    let files = Files { read: &included, share: &share };
    let Imported { text, remarks, .. } = ::import::import_with(&source, &others, &settings, &files)?;
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

/// Reads a file that a launch file includes.
fn included(path: &str) -> Result<Source, String> {
    let text = named_file::text(Path::new(path), named_file::TEXT_MAX);
    text.map(|text| Source::new(path, text)).map_err(|error| format!("`{path}` cannot be read: {error}"))
}

/// Returns the folder of a package's shared files. A setup file of ROS 2 must have been sourced here, and the package must be installed.
fn share(package: &str) -> Option<String> {
    // The package must be a plain name, so that the path stays inside the folder.
    let is_name = !package.is_empty() && package.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
    let prefixes = std::env::var("AMENT_PREFIX_PATH").ok().filter(|_| is_name)?;
    let mut prefixes = prefixes.split(':').filter(|prefix| !prefix.is_empty());
    let prefix = prefixes.find(|prefix| Path::new(prefix).join(INDEX).join(package).is_file())?;
    Some(format!("{}/share/{package}", prefix.trim_end_matches('/')))
}
