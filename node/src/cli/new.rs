//! `dca new`: a folder with a spec, and a controller program for it, to begin with.

use crate::cli::{Failure, output};
use anyhow::{Context as _, anyhow};
use std::fs;
use std::path::{Path, PathBuf};

/// What `dca new` is told.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The folder, which is made; its name becomes that of the spec and of the program
    folder: PathBuf,
    /// Where the crate `controllers` is; without it there is only a spec
    #[arg(long, value_name = "DIR")]
    sdk: Option<PathBuf>,
}

const SPEC: &str = "\
// What runs where, and what happens next. Try `dca check`, `dca sim` and `dca run` on it.

process main(){
    host{c1}
    instantiated_processes{
        // Ends after five beats.
        count instof Count(c1, 5);
    }
    internal_event_actions{
        count within 10 s
    }
}
";

const MANIFEST: &str = "\
[package]
name = \"NAME\"
version = \"0.1.0\"
edition = \"2024\"

[dependencies]
controllers = { path = \"SDK\" }

# A folder of its own, even inside of another workspace.
[workspace]
";

const PROGRAM: &str = r#"//! A controller: it counts beats, one each 100 ms, and ends.

use controllers::sdk::{About, Arguments, Controller, Kind, Parameter, Progress, Registry, Tick, process};
use std::time::Duration;

/// Counts to a number.
struct Count {
    until: f64,
    beats: f64,
}

impl Controller for Count {
    type Inputs = ();
    type Outputs = ();
    const TYPE: &'static str = "Count";

    fn about() -> About {
        const PARAMETERS: &[Parameter] = &[Parameter::new("until", Kind::Number(1.0, 1e6))];
        About::task("Counts to a number, and ends.").every(Duration::from_millis(100)).with(PARAMETERS)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        Ok(Self { until: arguments.number("until"), beats: 0.0 })
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        self.beats = 0.0;
        Ok(())
    }

    fn main_calc(&mut self, _: Tick, (): &(), (): &mut ()) -> Progress {
        self.beats += 1.0;
        if self.beats < self.until { Progress::Continue } else { Progress::Done(Vec::new()) }
    }
}

fn main() -> std::process::ExitCode {
    let mut registry = Registry::default();
    registry.add::<Count>();
    process::run(&registry)
}
"#;

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let folder = &arguments.folder;
    let name = name(folder)?;
    if folder.exists() {
        return Err(anyhow!("`{}` is there already", folder.display()).into());
    }
    fs::create_dir_all(folder.join("src")).with_context(|| format!("making the folder `{}`", folder.display()))?;
    let spec = format!("{name}.dca");
    write(&folder.join(&spec), SPEC)?;
    let Some(sdk) = &arguments.sdk else {
        fs::remove_dir(folder.join("src")).context("removing an empty folder")?;
        output::say(&format!("{0}/{spec}: try `dca sim {0}/{spec}`", folder.display()));
        return Ok(());
    };
    let sdk = fs::canonicalize(sdk).with_context(|| format!("looking for the crate at `{}`", sdk.display()))?;
    let manifest = MANIFEST.replace("NAME", &name).replace("SDK", &sdk.display().to_string());
    write(&folder.join("Cargo.toml"), &manifest)?;
    write(&folder.join("src/main.rs"), PROGRAM)?;
    let next = format!("cargo build && dca run --controllers target/debug/{name} {spec}");
    output::say(&format!("cd {} && {next}", folder.display()));
    Ok(())
}

/// The name of the folder, which has to be one that Cargo takes.
fn name(folder: &Path) -> Result<String, Failure> {
    let name = folder.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let is_good = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    let starts_well = name.starts_with(|c: char| c.is_ascii_alphabetic());
    if starts_well && name.chars().all(is_good) {
        return Ok(name);
    }
    Err(anyhow!("`{name}` cannot be the name of a program: letters, digits, `_` and `-`, a letter first").into())
}

fn write(file: &Path, text: &str) -> Result<(), Failure> {
    Ok(fs::write(file, text).with_context(|| format!("writing `{}`", file.display()))?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use language::{Options, Source, compile, format};

    #[test]
    fn the_spec_is_good_and_formatted() {
        let spec = Source::new("a.dca", SPEC);
        let interface = Source::new("a", "module Count(host: Host, until: Number) { done; }");
        assert_eq!(format(&spec), Ok(SPEC.to_owned()));
        assert_eq!(compile(&spec, &[interface], &Options::named("a")).diagnostics, []);
    }

    #[test]
    fn a_name_is_one_that_cargo_takes() {
        assert!(matches!(name(Path::new("a/door-2")), Ok(name) if name == "door-2"));
        assert!(name(Path::new("2door")).is_err() && name(Path::new("a b")).is_err() && name(Path::new("/")).is_err());
    }
}
