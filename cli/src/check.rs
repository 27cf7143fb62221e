//! `dca check`: prints the diagnostics of a spec.

pub(crate) mod json;
mod sarif;

use crate::follow::Spec;
use crate::io::{named_file, whole_file};
use crate::logic::externals;
use crate::{Controllers, Values, output};
use anyhow::{Context, anyhow};
use language::plan::{Environment, Plan};
use language::{
    Code, Compiled, Content, Diagnostic, Options, Role, Severity, Source, Style, Texts, assign, compile, gather, render,
};
use node::console::{self, Failure};
use node::io::programs;
use node::logic::table::counted;
use std::io::Read;
use std::path::{Path, PathBuf};

/// The most files in a folder that a spec uses. Other files than specs count as well.
const ENTRIES_MAX: usize = 10_000;

/// The arguments of `dca check`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The spec; `-` is standard input
    file: PathBuf,
    /// Take names that are not exact as errors
    #[arg(long, value_name = "LINT", value_parser = ["lenient-names"])]
    deny: Option<String>,
    /// Apply every fix that is the only possible correction, then check again
    #[arg(long, conflicts_with = "set")]
    fix: bool,
    /// The form of the diagnostics: text goes to standard error, the others to standard output
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
    /// The spec of another deployment whose processes the spec uses (`runs_in`): checks that they exist, and
    /// their exports
    #[arg(long, value_name = "SPEC")]
    with: Vec<PathBuf>,
    #[command(flatten)]
    controllers: Controllers,
    #[command(flatten)]
    values: Values,
}

/// The reader of the diagnostics: a person or a program.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Format {
    /// A person
    Text,
    /// A program
    Json,
    /// A code host or an editor: SARIF 2.1.0
    Sarif,
}

/// A spec with all of its diagnostics.
struct Checked {
    spec: Source,
    interfaces: Vec<Source>,
    plan: Option<Plan>,
    diagnostics: Vec<Diagnostic>,
    /// How many further diagnostics were left out.
    omitted: usize,
}

impl Checked {
    /// Reads and compiles a spec.
    fn read(
        file: &Path,
        controllers: &Controllers,
        values: &Values,
        deny_lenient_names: bool,
    ) -> Result<Self, Failure> {
        let spec = read_with(file, values)?;
        let interfaces = others(&spec, controllers)?;
        let Compiled { plan, diagnostics, omitted } = compile(&spec, &interfaces, &options(file, deny_lenient_names));
        Ok(Self { spec, interfaces, plan, diagnostics, omitted })
    }

    /// The texts that spans point into.
    fn texts(&self) -> Texts<'_> {
        Texts::new(&self.spec, &self.interfaces)
    }
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    if arguments.fix {
        fix(&arguments.file, &arguments.controllers)?;
    }
    let format = if console::is_json() { Format::Json } else { arguments.format };
    let print = match format {
        Format::Text => return check(arguments),
        Format::Json => json::json,
        Format::Sarif => sarif::sarif,
    };
    let checked = Checked::read(&arguments.file, &arguments.controllers, &arguments.values, arguments.deny.is_some())?;
    console::answer(&print(&checked));
    let Some(plan) = checked.plan else { return Err(Failure::Reported) };
    compare(&as_spec(&arguments.file, checked.spec, checked.interfaces, plan), arguments)
}

/// Compares the processes that the spec uses of other deployments with the specs of these deployments.
fn compare(spec: &Spec, arguments: &Arguments) -> Result<(), Failure> {
    let mut problems = Vec::new();
    for file in &arguments.with {
        let other = load(file, &arguments.controllers, &Values::default(), arguments.deny.is_some())?;
        let uses = |plan: &Plan| plan.leaves.iter().filter_map(|leaf| leaf.external.clone()).collect::<Vec<_>>();
        if !uses(&spec.plan).iter().any(|external| external.deployment == other.plan.name) {
            problems.push(format!("the spec uses no process of `{}`: no process has `runs_in {0}`", other.plan.name));
        }
        problems.extend(externals::against(&spec.plan, &spec.modules, &other.plan, &other.modules));
    }
    if problems.is_empty() { Ok(()) } else { Err(anyhow!(problems.join("\n")).into()) }
}

fn check(arguments: &Arguments) -> Result<(), Failure> {
    let spec = load(&arguments.file, &arguments.controllers, &arguments.values, arguments.deny.is_some())?;
    compare(&spec, arguments)?;
    let plan = spec.plan;
    let (groups, programs) = (counted(plan.groups.len(), "group"), counted(plan.leaves.len(), "program"));
    let is_input = is_standard_input(&arguments.file);
    let file = if is_input { "<stdin>".into() } else { arguments.file.display().to_string() };
    let hosts = plan.hosts.join(", ");
    console::say(&format!("{file}: {groups}, {programs}, on {hosts}: no errors"));
    Ok(())
}

/// Reads and compiles a spec; diagnostics go to standard error.
pub(crate) fn load(
    file: &Path,
    controllers: &Controllers,
    values: &Values,
    deny_lenient_names: bool,
) -> Result<Spec, Failure> {
    let Checked { spec, interfaces, plan, diagnostics, omitted } =
        Checked::read(file, controllers, values, deny_lenient_names)?;
    if !diagnostics.is_empty() {
        console::note(&render(&diagnostics, &spec, &interfaces, style()));
    }
    let count = |severity| diagnostics.iter().filter(|diagnostic| diagnostic.severity == severity).count();
    let (errors, warnings) = (count(Severity::Error), count(Severity::Warning));
    if errors + warnings > 0 {
        let at_least = if omitted > 0 { "at least " } else { "" };
        let (errors, warnings) = (counted(errors, "error"), counted(warnings, "warning"));
        console::note(&format!("\n{}: {at_least}{errors}, {warnings}", spec.name));
    }
    if diagnostics.iter().any(|diagnostic| diagnostic.code == Code::W0205)
        && programs::chosen(&controllers.programs).is_empty()
    {
        let own = programs::beside("dca-controller");
        console::note(&format!(
            "note: `{}`, which offers the controllers of DCA, does not exist; put it there, or name your own program with `--controllers`",
            own.display()
        ));
    }
    let plan = plan.ok_or(Failure::Reported)?;
    values.strange_hosts(&plan.hosts).iter().for_each(|sentence| console::note(sentence));
    Ok(as_spec(file, spec, interfaces, plan))
}

fn as_spec(file: &Path, spec: Source, interfaces: Vec<Source>, plan: Plan) -> Spec {
    let text = spec.text.clone();
    let modules = std::iter::once(spec).chain(interfaces).collect();
    Spec { file: file.to_owned(), text, plan, modules }
}

/// Rewrites the file if there is something to fix.
pub(crate) fn fix(file: &Path, controllers: &Controllers) -> Result<bool, Failure> {
    if is_standard_input(file) {
        return Err(anyhow!("standard input cannot be rewritten; give a file").into());
    }
    let spec = read(file)?;
    let interfaces = others(&spec, controllers)?;
    let fixed = language::fix(&spec, &interfaces, &options(file, false));
    let is_changed = fixed != spec.text;
    if is_changed {
        whole_file::put(file, fixed.as_bytes()).context("writing the spec")?;
    }
    Ok(is_changed)
}

/// Returns whether a path means standard input.
pub(crate) fn is_standard_input(file: &Path) -> bool {
    file == Path::new("-")
}

/// Reads the text of a spec; `-` is standard input.
pub(crate) fn read(file: &Path) -> Result<Source, Failure> {
    if is_standard_input(file) {
        let mut text = Vec::new();
        let read = std::io::stdin().lock().take(named_file::TEXT_MAX as u64 + 1).read_to_end(&mut text);
        let text = read.map_err(anyhow::Error::from).and_then(|_| Ok(String::from_utf8(text)?));
        return Ok(Source::new("<stdin>", text.context("cannot read the spec from standard input")?));
    }
    let text = named_file::text(file, named_file::TEXT_MAX);
    let text = text.with_context(|| format!("cannot read the spec `{}`", file.display()))?;
    Ok(Source::new(file.display().to_string(), text))
}

/// Reads the text of a spec, with values of the user as the defaults of the root's parameters.
pub(crate) fn read_with(file: &Path, values: &Values) -> Result<Source, Failure> {
    Ok(assign(&read(file)?, &values.assignments()).map_err(anyhow::Error::from)?)
}

/// Asks the controllers' programs for their interfaces.
fn interfaces(controllers: &Controllers) -> Result<Vec<Source>, Failure> {
    let ask = |program: &PathBuf| {
        let text = programs::interfaces(program)?;
        Ok(Source::new(program.display().to_string(), text))
    };
    programs::chosen(&controllers.programs).iter().map(ask).collect()
}

/// The texts that a spec is compiled with: the files it uses, and the interfaces of the controllers.
pub(crate) fn others(spec: &Source, controllers: &Controllers) -> Result<Vec<Source>, Failure> {
    others_with(spec, controllers, &|_, text| text)
}

/// Does the same as [`others`]. `change` may replace the text of each file: it gets the path and the text.
pub(crate) fn others_with(
    spec: &Source,
    controllers: &Controllers,
    change: &dyn Fn(&str, String) -> String,
) -> Result<Vec<Source>, Failure> {
    let mut others = files_with(spec, change);
    others.extend(interfaces(controllers)?);
    others.extend(python_interfaces(spec, &others));
    Ok(others)
}

/// The files that a spec uses.
pub(crate) fn files(spec: &Source) -> Vec<Source> {
    files_with(spec, &|_, text| text)
}

fn files_with(spec: &Source, change: &dyn Fn(&str, String) -> String) -> Vec<Source> {
    let read = |path: &str| {
        let text = named_file::text(Path::new(path), named_file::TEXT_MAX).map_err(|error| error.to_string())?;
        Ok(change(path, text))
    };
    gather(spec, &|path| content(path, read))
}

/// Asks the programs in Python that modules of a spec name for their interfaces. Each program is asked once. If a
/// program fails, each of its modules gets a source with the reason.
fn python_interfaces(spec: &Source, others: &[Source]) -> Vec<Source> {
    let texts: Vec<Source> = std::iter::once(spec).chain(others).cloned().collect();
    let mut asked: Vec<(String, Environment, Result<(), String>)> = Vec::new();
    let mut interfaces = Vec::new();
    for module in language::asked(&texts) {
        let command = module.command().to_owned();
        let known = asked.iter().find(|(other, of, _)| *other == command && *of == module.environment);
        let answered = known.map(|(.., answered)| answered.clone()).unwrap_or_else(|| {
            let answered = programs::interfaces_of(&module).map_err(|error| error.to_string());
            let told = answered.map(|text| {
                let name = command.clone();
                interfaces.push(Source { name, text, role: Role::Python });
            });
            asked.push((command, module.environment.clone(), told.clone()));
            told
        });
        if let Err(why) = answered {
            let role = Role::Missing(why);
            interfaces.push(Source { name: module.exec, text: String::new(), role });
        }
    }
    interfaces
}

/// Returns the content of a path in a `use`: a folder, or else a file, which `read` reads.
pub(crate) fn content(path: &str, read: impl FnOnce(&str) -> Result<String, String>) -> Result<Content, String> {
    match entries(path) {
        Some(entries) => entries.map(Content::Folder),
        None => read(path).map(Content::File),
    }
}

/// Returns the names of the entries in a folder; nothing if the path is not a folder.
fn entries(path: &str) -> Option<Result<Vec<String>, String>> {
    let told = |error: std::io::Error| error.to_string();
    let folder = Path::new(path).is_dir().then(|| std::fs::read_dir(path))?;
    let names = folder.map_err(told).and_then(|folder| {
        let names = folder.take(ENTRIES_MAX + 1).map(|entry| Ok(entry?.file_name().to_string_lossy().into_owned()));
        names.collect::<Result<Vec<String>, _>>().map_err(told)
    });
    Some(match names {
        Ok(names) if names.len() > ENTRIES_MAX => Err(format!("more than {ENTRIES_MAX} files are in the folder")),
        names => names,
    })
}

/// Returns the options for compiling the spec in a file.
pub(crate) fn options(file: &Path, deny_lenient_names: bool) -> Options {
    let stem = file.file_stem().filter(|_| !is_standard_input(file));
    let name = stem.map_or_else(|| "spec".to_owned(), |stem| stem.to_string_lossy().into_owned());
    Options { deny_lenient_names, ..Options::named(name) }
}

/// Returns the style of texts on standard error.
pub(crate) fn style() -> Style {
    if output::is_coloured() { Style::Colour } else { Style::Plain }
}

#[cfg(test)]
mod tests {
    use super::*;
    use expect_test::expect;

    fn checked() -> Checked {
        let text = "process main(){\n    instantiated_processes{ arm instof Arm(c1); }\n    internal_event_actions{ Arm }\n}\n";
        let (spec, interfaces) = (Source::new("a.dca", text), vec![Source::new("arms", "module Arm(host) { done; }")]);
        let Compiled { plan, diagnostics, omitted } = compile(&spec, &interfaces, &Options::named("a"));
        Checked { spec, interfaces, plan, diagnostics, omitted }
    }

    #[test]
    fn programs_read_json() {
        expect![[r#"
            {
              "accepted": true,
              "diagnostics": [
                {
                  "choices": [],
                  "code": "W0201",
                  "fix": {
                    "edits": [
                      {
                        "place": {
                          "end": {
                            "column": 32,
                            "line": 3,
                            "offset": 97
                          },
                          "file": "a.dca",
                          "start": {
                            "column": 29,
                            "line": 3,
                            "offset": 94
                          }
                        },
                        "text": "arm"
                      }
                    ],
                    "title": "replace with `arm`"
                  },
                  "help": [],
                  "label": "read as `arm`, the only instance of Arm",
                  "message": "process type `Arm` used where an instance is expected",
                  "place": {
                    "end": {
                      "column": 32,
                      "line": 3,
                      "offset": 97
                    },
                    "file": "a.dca",
                    "start": {
                      "column": 29,
                      "line": 3,
                      "offset": 94
                    }
                  },
                  "reasons": [
                    {
                      "place": {
                        "end": {
                          "column": 32,
                          "line": 2,
                          "offset": 47
                        },
                        "file": "a.dca",
                        "start": {
                          "column": 29,
                          "line": 2,
                          "offset": 44
                        }
                      },
                      "text": "declared here"
                    }
                  ],
                  "severity": "warning"
                }
              ],
              "omitted": 0,
              "spec": "a.dca",
              "version": 1
            }"#]]
        .assert_eq(&format!("{:#}", json::json(&checked())));
    }

    #[test]
    #[expect(clippy::too_many_lines, reason = "most of it is the text that is expected")]
    fn code_hosts_read_sarif() {
        expect![[r#"
            {
              "$schema": "https://json.schemastore.org/sarif-2.1.0.json",
              "runs": [
                {
                  "columnKind": "unicodeCodePoints",
                  "results": [
                    {
                      "fixes": [
                        {
                          "artifactChanges": [
                            {
                              "artifactLocation": {
                                "uri": "a.dca"
                              },
                              "replacements": [
                                {
                                  "deletedRegion": {
                                    "endColumn": 32,
                                    "endLine": 3,
                                    "startColumn": 29,
                                    "startLine": 3
                                  },
                                  "insertedContent": {
                                    "text": "arm"
                                  }
                                }
                              ]
                            }
                          ],
                          "description": {
                            "text": "replace with `arm`"
                          }
                        }
                      ],
                      "level": "warning",
                      "locations": [
                        {
                          "physicalLocation": {
                            "artifactLocation": {
                              "uri": "a.dca"
                            },
                            "region": {
                              "endColumn": 32,
                              "endLine": 3,
                              "startColumn": 29,
                              "startLine": 3
                            }
                          }
                        }
                      ],
                      "message": {
                        "text": "process type `Arm` used where an instance is expected; read as `arm`, the only instance of Arm"
                      },
                      "relatedLocations": [
                        {
                          "message": {
                            "text": "declared here"
                          },
                          "physicalLocation": {
                            "artifactLocation": {
                              "uri": "a.dca"
                            },
                            "region": {
                              "endColumn": 32,
                              "endLine": 2,
                              "startColumn": 29,
                              "startLine": 2
                            }
                          }
                        }
                      ],
                      "ruleId": "W0201"
                    }
                  ],
                  "tool": {
                    "driver": {
                      "name": "dca",
                      "rules": [
                        {
                          "defaultConfiguration": {
                            "level": "warning"
                          },
                          "fullDescription": {
                            "text": "The name is the type of exactly one instance and is read as that instance."
                          },
                          "id": "W0201",
                          "shortDescription": {
                            "text": "type name used"
                          }
                        }
                      ],
                      "version": "0.1.0"
                    }
                  }
                }
              ],
              "version": "2.1.0"
            }"#]].assert_eq(&format!("{:#}", sarif::sarif(&checked())));
    }
}
