//! `dca check`: what is wrong with a spec.

use crate::cli::follow::Spec;
use crate::cli::{Controllers, Failure, output};
use crate::io::programs;
use anyhow::Context;
use language::{Options, Severity, Source, Style, apply_fixes, compile, render};
use std::io::IsTerminal;
use std::path::{Path, PathBuf};

/// What `dca check` is told.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The spec
    file: PathBuf,
    /// Take names that are not exact as errors
    #[arg(long, value_name = "LINT", value_parser = ["lenient-names"])]
    deny: Option<String>,
    /// Apply every fix that is certain, then check again
    #[arg(long)]
    fix: bool,
    #[command(flatten)]
    controllers: Controllers,
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    if arguments.fix {
        fix(arguments)?;
    }
    let plan = load(&arguments.file, &arguments.controllers, arguments.deny.is_some())?.plan;
    let (groups, leaves, hosts) = (plan.groups.len(), plan.leaves.len(), plan.hosts.join(", "));
    let file = arguments.file.display();
    output::say(&format!("{file}: {groups} groups, {leaves} programs, on {hosts}: no errors"));
    Ok(())
}

/// Reads and compiles a spec; diagnostics go to standard error.
pub(crate) fn load(file: &Path, controllers: &Controllers, deny_lenient_names: bool) -> Result<Spec, Failure> {
    let spec = read(file)?;
    let interfaces = interfaces(controllers)?;
    let compiled = compile(&spec, &interfaces, &options(file, deny_lenient_names));
    if !compiled.diagnostics.is_empty() {
        output::note(&render(&compiled.diagnostics, &spec, &interfaces, style()));
    }
    let count = |severity| compiled.diagnostics.iter().filter(|diagnostic| diagnostic.severity == severity).count();
    let (errors, warnings) = (count(Severity::Error), count(Severity::Warning));
    if errors + warnings > 0 {
        let plural = |count: usize, word| format!("{count} {word}{}", if count == 1 { "" } else { "s" });
        output::note(&format!("{}: {}, {}", spec.name, plural(errors, "error"), plural(warnings, "warning")));
    }
    let plan = compiled.plan.ok_or(Failure::Told)?;
    Ok(Spec { file: file.to_owned(), text: spec.text, plan })
}

fn fix(arguments: &Arguments) -> Result<(), Failure> {
    let spec = read(&arguments.file)?;
    let interfaces = interfaces(&arguments.controllers)?;
    let compiled = compile(&spec, &interfaces, &options(&arguments.file, false));
    let fixed = apply_fixes(&spec.text, &compiled.diagnostics);
    if fixed != spec.text {
        let file = &arguments.file;
        std::fs::write(file, fixed).with_context(|| format!("cannot write the spec `{}`", file.display()))?;
    }
    Ok(())
}

fn read(file: &Path) -> Result<Source, Failure> {
    let text = std::fs::read_to_string(file).with_context(|| format!("cannot read the spec `{}`", file.display()))?;
    Ok(Source::new(file.display().to_string(), text))
}

fn interfaces(controllers: &Controllers) -> Result<Vec<Source>, Failure> {
    let ask = |program: &PathBuf| {
        let text = programs::interfaces(program)?;
        Ok(Source::new(program.display().to_string(), text))
    };
    programs::chosen(&controllers.programs).iter().map(ask).collect()
}

fn options(file: &Path, deny_lenient_names: bool) -> Options {
    let name = file.file_stem().map_or_else(|| "spec".to_owned(), |stem| stem.to_string_lossy().into_owned());
    Options { deny_lenient_names, ..Options::named(name) }
}

fn style() -> Style {
    if std::io::stderr().is_terminal() { Style::Colour } else { Style::Plain }
}
