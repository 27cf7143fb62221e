//! `dca new`: makes a folder with a spec that can run. With `--sdk` or `--python`, it also makes a program with controllers for the spec.

use anyhow::{Context as _, anyhow};
use node::console::{self, Failure};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// The arguments of `dca new`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The folder, which is made; its name becomes the name of the spec and of the program
    folder: PathBuf,
    /// Also begin a program with your own controllers; DIR is a clone of DCA [default: the sources installed with `dca`, or
    /// the clone in which it was built]
    #[arg(long, value_name = "DIR", num_args = 0..=1, require_equals = true)]
    sdk: Option<Option<PathBuf>>,
    /// Also begin controllers in Python and their tests; DIR is a clone of DCA, whose package `dca` they need [default: the
    /// package installed with `dca`, or the clone in which it was built]
    #[arg(long, value_name = "DIR", num_args = 0..=1, require_equals = true, conflicts_with = "sdk")]
    python: Option<Option<PathBuf>>,
}

const SPEC: &str = include_str!("../templates/new.dca");
const SDK_SPEC: &str = include_str!("../templates/sdk/spec.dca");
const PYTHON_SPEC: &str = include_str!("../templates/python/spec.dca");
/// The line that names the virtual environment of a module.
const VENV: &str = "    venv \".venv\";\n";
const PYTHON: &str = include_str!("../templates/python/controllers.py");
const PYTHON_TESTS: &str = include_str!("../templates/python/test_controllers.py");
const PROGRAM: &str = include_str!("../templates/sdk/main.rs");

const MANIFEST: &str = "\
[package]
name = NAME
version = \"0.1.0\"
edition = \"2024\"

[dependencies]
controllers = { path = SDK }

# Dependencies are optimised, so that control loops keep their time.
[profile.dev.package.\"*\"]
opt-level = 2

# A folder of its own, even inside of another workspace.
[workspace]
";

/// Names that Cargo, the program itself or DCA uses otherwise. The crates of DCA are in the dependencies of the program,
/// and its programs are on the search path. So a program with one of their names would be built or started instead.
const TAKEN: [&str; 42] = [
    "alloc",
    "bridge",
    "build",
    "cli",
    "comms",
    "controllers",
    "controllers_derive",
    "core",
    "dbmanager",
    "dca",
    "dca-controller",
    "dca-counting",
    "dca-examples",
    "dca-fakes",
    "dca-hanging",
    "dca-keys",
    "dca-node",
    "dca-noting",
    "dca-python",
    "dca-ros",
    "dca-shim",
    "dca-starter",
    "dca-talking",
    "dca-tests",
    "deps",
    "examples",
    "import",
    "incremental",
    "language",
    "main",
    "node",
    "proc_macro",
    "ros",
    "self",
    "shim",
    "std",
    "super",
    "team",
    "test",
    "trust",
    "verify",
    "view",
];
/// Keywords of Rust that consist only of letters. They cannot be the name of a program.
const WORDS: [&str; 36] = [
    "abstract", "as", "async", "await", "become", "box", "break", "const", "continue", "crate", "do", "dyn", "else",
    "enum", "extern", "false", "final", "fn", "for", "gen", "if", "impl", "in", "let", "loop", "macro", "match", "mod",
    "move", "mut", "pub", "ref", "return", "static", "struct", "trait",
];

/// Where packages have the sources that a program with controllers needs, below a folder such as `/usr`.
const INSTALLED: &str = "share/dca/sdk";

/// The crate with which controllers are written.
#[derive(Debug)]
struct Sdk {
    /// The folder of the crate `controllers`.
    path: PathBuf,
    /// The clone of DCA that contains the crate, or the installed part of a clone.
    clone: PathBuf,
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let folder = &arguments.folder;
    let name = name(folder, arguments.sdk.is_some())?;
    if let Some(given) = &arguments.python {
        return new_python(folder, &name, &Sdk::find(given.as_deref())?);
    }
    let sdk = arguments.sdk.as_ref().map(|given| Sdk::find(given.as_deref())).transpose()?;
    let files = sdk.as_ref().map_or_else(|| Ok(plain(&name)), |sdk| program(&name, sdk))?;
    make(folder, &files)?;
    let next = match sdk {
        None => format!("dca run {name}.dca"),
        Some(_) => format!("cargo build && dca run --controllers target/debug/{name} {name}.dca"),
    };
    console::say(&format!("cd {} && {next}", folder.display()));
    if sdk.is_some() {
        console::note("the first build takes some minutes; `cargo test` runs the controllers on virtual time");
    }
    Ok(())
}

/// Makes controllers in Python. Installed sources have no package for Python, because Debian's Python has it already.
fn new_python(folder: &Path, name: &str, sdk: &Sdk) -> Result<(), Failure> {
    let package = sdk.clone.join("python");
    if !package.is_dir() {
        make(folder, &python(name, &PYTHON_SPEC.replace(VENV, "")))?;
        console::say(&format!("cd {} && dca run {name}.dca", folder.display()));
        console::note(
            "`python3` needs the package `dca`, which Debian's `python3-dca` has; `python3 -m pytest` runs the tests",
        );
        return Ok(());
    }
    make(folder, &python(name, PYTHON_SPEC))?;
    console::say(&format!(
        "cd {} && python3 -m venv .venv && .venv/bin/pip install {} pytest && .venv/bin/pytest && dca run {name}.dca",
        folder.display(),
        package.display()
    ));
    console::note("the first build of the package `dca` takes some minutes");
    Ok(())
}

/// The path of a file in the folder, and its text.
type File = (PathBuf, String);

fn plain(name: &str) -> Vec<File> {
    vec![(format!("{name}.dca").into(), SPEC.to_owned())]
}

fn python(name: &str, spec: &str) -> Vec<File> {
    vec![
        (format!("{name}.dca").into(), spec.to_owned()),
        ("controllers.py".into(), PYTHON.to_owned()),
        ("test_controllers.py".into(), PYTHON_TESTS.to_owned()),
        (".gitignore".into(), "/.venv\n/runs\n__pycache__\n.pytest_cache\n".to_owned()),
    ]
}

fn program(name: &str, sdk: &Sdk) -> Result<Vec<File>, Failure> {
    let path = sdk.path.to_str().with_context(|| format!("the path of `{}` is not text", sdk.path.display()))?;
    // Each JSON string is also a valid TOML string.
    let manifest = MANIFEST.replace("NAME", &format!("\"{name}\"")).replace("SDK", &serde_json::to_string(path)?);
    let mut files = vec![
        (format!("{name}.dca").into(), SDK_SPEC.to_owned()),
        ("Cargo.toml".into(), manifest),
        ("src/main.rs".into(), PROGRAM.to_owned()),
        (".gitignore".into(), "/target\n/runs\n".to_owned()),
    ];
    // These files have the versions that DCA was tested with, and the options for building its dependencies.
    for shared in ["Cargo.lock", ".cargo/config.toml"] {
        let file = sdk.clone.join(shared);
        match fs::read_to_string(&file) {
            Ok(text) => files.push((shared.into(), text)),
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            Err(error) => return Err(anyhow!(error).context(format!("reading `{}`", file.display())).into()),
        }
    }
    Ok(files)
}

/// Makes the folder completely or not at all.
fn make(folder: &Path, files: &[File]) -> Result<(), Failure> {
    let making = || format!("making the folder `{}`", folder.display());
    if let Some(parent) = folder.parent().filter(|parent| !parent.as_os_str().is_empty()) {
        fs::create_dir_all(parent).with_context(making)?;
    }
    match fs::create_dir(folder) {
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
            return Err(anyhow!("`{}` is there already", folder.display()).into());
        }
        made => made.with_context(making)?,
    }
    let written = files.iter().try_for_each(|(file, text)| {
        let file = folder.join(file);
        let made = file.parent().map_or(Ok(()), fs::create_dir_all);
        made.and_then(|()| fs::write(&file, text)).with_context(|| format!("writing `{}`", file.display()))
    });
    if written.is_err() {
        // The remains are of no use. If removing them fails, the first error is still the one to report.
        drop(fs::remove_dir_all(folder));
    }
    Ok(written?)
}

impl Sdk {
    /// Searches the given folder, or else the folders above this program and the folder where it was built.
    fn find(given: Option<&Path>) -> Result<Self, Failure> {
        if let Some(given) = given {
            let looking = || format!("looking for DCA at `{}`", given.display());
            let found = fs::canonicalize(given).with_context(looking)?;
            let none = || anyhow!("`{}` is not a clone of DCA: it has no crate `controllers`", given.display());
            let around = || Self::at(found.parent()?).filter(|sdk| sdk.path == found);
            return Ok(Self::at(&found).or_else(around).ok_or_else(none)?);
        }
        let program = std::env::current_exe().ok();
        let above_program = program.iter().flat_map(|program| program.ancestors());
        let above_program = above_program.flat_map(|above| [above.to_owned(), above.join(INSTALLED)]);
        let built = Path::new(env!("CARGO_MANIFEST_DIR")).parent().map(Path::to_owned);
        let here = std::env::current_dir().ok();
        let above_here = here.iter().flat_map(|here| here.ancestors().map(Path::to_owned));
        let none = || anyhow!("no clone of DCA was found near `dca`; name a clone with `--sdk=DIR` or `--python=DIR`");
        Ok(above_program.chain(built).chain(above_here).find_map(|clone| Self::at(&clone)).ok_or_else(none)?)
    }

    /// Returns the crate in a clone of DCA; nothing if the folder is not a clone.
    fn at(clone: &Path) -> Option<Self> {
        let path = clone.join("controllers");
        let manifest = fs::read_to_string(path.join("Cargo.toml")).ok()?;
        let is_it = manifest.lines().any(|line| line.trim() == "name = \"controllers\"");
        is_it.then(|| Self { path, clone: clone.to_owned() })
    }
}

/// Returns the name of the folder. It has to be a valid name for Cargo.
fn name(folder: &Path, is_program: bool) -> Result<String, Failure> {
    let name = folder.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let is_good = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    let starts_well = name.starts_with(|c: char| c.is_ascii_alphabetic());
    if !starts_well || !name.chars().all(is_good) {
        return Err(
            anyhow!("`{name}` cannot be the name of a program: letters, digits, `_` and `-`, a letter first").into()
        );
    }
    // Cargo treats `a-b` and `a_b` as the same crate.
    let is_same = |taken: &&str| taken.replace('-', "_") == name.replace('-', "_");
    if is_program && TAKEN.iter().chain(&WORDS).any(is_same) {
        return Err(anyhow!(
            "a program cannot be called `{name}`: this word has another meaning in Rust, Cargo or DCA"
        )
        .into());
    }
    Ok(name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use language::{Options, Source, compile, format};

    /// The specs are valid and formatted. `tests/tests/all/new.rs` runs them with real processes.
    #[test]
    fn the_specs_are_good_and_formatted() {
        let interface = "type Level = { value: Number };
            module Ramp(host: Host, until: Number) { out Out: Level; done; }
            module Smooth(host: Host, gain: Number = 0.5) { in In: Level; service; }
            module DoorWorld(host: Host) { service; }
            module GripperControl(host: Host, goal: Text) { done; }
            module RateSource(host: Host) { out Out: Beat; service; }
            module RateMonitor(host: Host) { in In: Beat; service; }";
        let installed = PYTHON_SPEC.replace(VENV, "");
        assert!(!installed.contains("venv"));
        for text in [SPEC, SDK_SPEC, PYTHON_SPEC, &installed] {
            let spec = Source::new("a.dca", text);
            assert_eq!(format(&spec), Ok(text.to_owned()));
            let compiled = compile(&spec, &[Source::new("a", interface)], &Options::named("a"));
            assert_eq!(compiled.diagnostics, []);
        }
    }

    #[test]
    fn a_name_is_one_that_cargo_takes() {
        assert!(matches!(name(Path::new("a/door-2"), true), Ok(name) if name == "door-2"));
        for bad in ["2door", "a b", "/", ".", "match", "controllers", "test"] {
            assert!(name(Path::new(bad), true).is_err(), "{bad}");
        }
        assert!(name(Path::new("test"), false).is_ok());
    }

    /// The members of this workspace and their programs are among the names that are taken.
    #[test]
    fn a_name_is_none_of_dca() {
        let clone = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
        let workspace = fs::read_to_string(clone.join("Cargo.toml")).unwrap();
        let members = workspace.lines().find_map(|line| line.strip_prefix("members = ")).unwrap();
        let members: Vec<String> = serde_json::from_str(members).unwrap();
        let mut names = Vec::new();
        for member in members.iter().map(|member| clone.join(member)) {
            let manifest = fs::read_to_string(member.join("Cargo.toml")).unwrap();
            let sections =
                manifest.split("\n[").filter(|part| part.starts_with("[package]") || part.starts_with("[bin]]"));
            let own = sections.flat_map(str::lines).filter_map(|line| line.strip_prefix("name = "));
            names.extend(own.map(|name| name.trim_matches('"').to_owned()));
            let programs = fs::read_dir(member.join("src/bin")).into_iter().flatten().flatten();
            names.extend(programs.map(|file| file.path().file_stem().unwrap().to_string_lossy().into_owned()));
        }
        names.sort();
        for needed in ["cli", "dca", "dca-controller", "dca-node", "dca-shim", "dca-starter", "shim"] {
            assert!(names.iter().any(|name| name == needed), "{needed}: {names:?}");
        }
        let free: Vec<&String> = names.iter().filter(|own| name(Path::new(own), true).is_ok()).collect();
        assert!(free.is_empty(), "a program may be called {free:?}");
        assert!(name(Path::new("dca_node"), true).is_err() && name(Path::new("dca"), false).is_ok());
    }

    #[test]
    fn what_is_no_clone_is_none() {
        assert!(Sdk::find(None).is_ok_and(|sdk| sdk.path.join("Cargo.toml").is_file()));
        let clone = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
        for good in [clone, &clone.join("controllers")] {
            assert!(Sdk::find(Some(good)).is_ok_and(|sdk| sdk.clone == fs::canonicalize(clone).unwrap()), "{good:?}");
        }
        for bad in ["/", "/nowhere/at/all", env!("CARGO_MANIFEST_DIR")] {
            assert!(Sdk::find(Some(Path::new(bad))).is_err(), "{bad}");
        }
    }
}
