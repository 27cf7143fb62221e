//! `dca db export`, `import`, `tx`: many keys at once, from and to text.

use super::asking::{Asking, refusal};
use super::past::a_moment;
use super::write::Writing;
use crate::cli::{Failure, output};
use crate::io::named_file;
use crate::io::whole_file::WholeFile;
use crate::logic::database::question::{Moment, Question, Reply};
use anyhow::{Context, anyhow, bail};
use dbmanager::logic::key::Key;
use dbmanager::logic::owner::{Owner, Owners};
use dbmanager::logic::txn::{Condition, Require, Write};
use dbmanager::logic::view::value::Datum;
use dbmanager::logic::view::{table, token};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The longest file of values, in bytes: some million keys.
const FILE_MAX: usize = 256 << 20;

/// What `dca db export` is told.
#[derive(Debug, clap::Args)]
pub struct Export {
    /// How the keys begin
    #[arg(default_value = "")]
    prefix: String,
    /// When: a date, a cut, or `now`
    #[arg(long, value_name = "MOMENT", value_parser = a_moment, default_value = "now")]
    at: Moment,
    /// Write to this file, which has its name only once it is whole [default: standard output]
    #[arg(long, short, value_name = "FILE", conflicts_with = "json")]
    output: Option<PathBuf>,
    #[command(flatten)]
    asking: Asking,
}

/// What `dca db import` is told.
#[derive(Debug, clap::Args)]
pub struct Import {
    /// A file as `dca db export` prints it; `-` for standard input
    file: PathBuf,
    /// Delete keys that are not in the file, if they are below its prefix
    #[arg(long)]
    delete: bool,
    /// Only show what would change
    #[arg(long)]
    dry_run: bool,
    #[command(flatten)]
    writing: Writing,
}

/// What `dca db tx` is told.
#[derive(Debug, clap::Args)]
pub struct Tx {
    /// One change a line: `put KEY VALUE`, `delete KEY`, `require KEY absent|exists|TRANSACTION`; `-` for standard input
    #[arg(default_value = "-")]
    file: PathBuf,
    #[command(flatten)]
    writing: Writing,
}

impl Export {
    /// Runs the verb.
    pub(crate) fn run(self) -> Result<(), Failure> {
        let question = Question::Export { prefix: self.prefix, at: self.at };
        let (mut text, mut file) = (String::new(), self.output.as_deref().map(WholeFile::create).transpose()?);
        self.asking.ask_all(question, |reply| {
            let Reply::Text(part) = reply else { return Err(refusal(&reply)) };
            match &mut file {
                Some(file) => file.write(part.as_bytes())?,
                None => text.push_str(&part),
            }
            Ok(())
        })?;
        if let Some(file) = file {
            return Ok(file.finish()?);
        }
        output::say(&if self.asking.json { serde_json::json!({ "file": text }).to_string() } else { text });
        Ok(())
    }
}

impl Import {
    /// Runs the verb.
    pub(crate) fn run(self) -> Result<(), Failure> {
        let question =
            Question::Import { file: read(&self.file)?, delete: self.delete, reason: self.writing.reason_or("import") };
        let reply = self.writing.asking.ask(question)?;
        let Reply::Import(differences, settles, transactions) = reply else { return Err(refusal(&reply)) };
        if differences.is_empty() {
            output::note("nothing differs");
            return Ok(());
        }
        if !self.writing.asking.json {
            output::say(&table::differences(&differences));
        } else if self.dry_run {
            output::say(&serde_json::to_string_pretty(&differences)?);
        }
        for key in settles {
            output::note(&format!("note: this settles the writes beside each other at `{key}`"));
        }
        if self.dry_run {
            return Ok(());
        }
        // What belongs to one robot goes to it; a transaction over the keys of several would be refused by all.
        let reply = self.writing.asking.ask(Question::Owners)?;
        let Reply::Owners(owners) = reply else { return Err(refusal(&reply)) };
        let owner = |(prefix, robot)| (prefix, Owner { term: 0, robot, grant: None });
        let owners = owners.into_iter().map(owner).collect();
        let parts: Vec<_> = transactions.into_iter().flat_map(|writes| by_owner(writes, &owners)).collect();
        let count = parts.len();
        for (done, writes) in parts.into_iter().enumerate() {
            self.writing.commit(vec![], writes).map_err(|failure| partly(failure, done, count))?;
        }
        Ok(())
    }
}

impl Tx {
    /// Runs the verb.
    pub(crate) fn run(self) -> Result<(), Failure> {
        let (requires, writes) = changes(&read(&self.file)?)?;
        self.writing.commit(requires, writes)
    }
}

/// Returns the writes by whose keys they are, as the prefixes with an owner say.
fn by_owner(writes: Vec<Write>, owners: &Owners) -> Vec<Vec<Write>> {
    let mut groups: BTreeMap<Option<String>, Vec<Write>> = BTreeMap::new();
    for write in writes {
        let owner = owners.find(&write.key).and_then(|(_, owner)| owner.robot);
        groups.entry(owner).or_default().push(write);
    }
    groups.into_values().collect()
}

/// Says of a transaction that failed what was committed before it.
fn partly(failure: Failure, done: usize, count: usize) -> Failure {
    let add = |error: anyhow::Error| {
        anyhow!("{error:#}; before that, {done} of the {count} transactions for this file were committed")
    };
    match failure {
        Failure::Refused(error) if done > 0 => Failure::Refused(add(error)),
        Failure::Unreachable(error) if done > 0 => Failure::Unreachable(add(error)),
        Failure::Refused(_) | Failure::Unreachable(_) | Failure::Told => failure,
    }
}

fn read(file: &Path) -> anyhow::Result<String> {
    if file == Path::new("-") {
        return named_file::standard_input(FILE_MAX).context("reading standard input");
    }
    named_file::text(file, FILE_MAX).with_context(|| format!("reading {}", file.display()))
}

/// Reads the lines of a transaction.
fn changes(text: &str) -> anyhow::Result<(Vec<Require>, Vec<Write>)> {
    let (mut requires, mut writes) = (Vec::new(), Vec::new());
    for (number, line) in text.lines().enumerate().map(|(index, line)| (index + 1, line.trim())) {
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        change(line, &mut requires, &mut writes).with_context(|| format!("line {number}, `{line}`"))?;
    }
    if writes.is_empty() {
        bail!("the transaction writes nothing; a line is `put KEY VALUE` or `delete KEY`");
    }
    Ok((requires, writes))
}

fn change(line: &str, requires: &mut Vec<Require>, writes: &mut Vec<Write>) -> anyhow::Result<()> {
    let (verb, rest) = line.split_once(' ').unwrap_or((line, ""));
    let (key, value) = rest.trim().split_once(' ').map_or((rest.trim(), ""), |(key, value)| (key, value.trim()));
    let key = Key::new(key)?;
    match (verb, value) {
        ("put", "") => bail!("the value is missing"),
        ("put", value) => writes.push(Write { key, value: Some(Datum::from_toml(value)?.encode()?) }),
        ("delete", "") => writes.push(Write { key, value: None }),
        ("require", "absent") => requires.push(Require { key, condition: Condition::Absent }),
        ("require", "exists") => requires.push(Require { key, condition: Condition::Exists }),
        ("require", name) => {
            let dot = token::dot(name).ok_or_else(|| anyhow!("`{name}` is no transaction, `absent` or `exists`"))?;
            requires.push(Require { key, condition: Condition::Is(dot) });
        }
        _ => bail!("a line is `put KEY VALUE`, `delete KEY` or `require KEY absent|exists|TRANSACTION`"),
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_goes_to_whom_its_keys_belong() {
        let write = |key: &&str| Write { key: Key::new(*key).unwrap(), value: None };
        let owners = [
            ("team/arm", Some("r2")),
            ("team/arm/left", Some("r3")),
            ("team/free", None),
            ("robot/r5/leg", Some("r6")),
        ];
        let owner = |robot: Option<&str>| Owner { term: 0, robot: robot.map(str::to_owned), grant: None };
        let owners = owners.into_iter().map(|(prefix, robot)| (prefix.to_owned(), owner(robot))).collect();
        let keys =
            ["robot/r2/a", "robot/r5/a", "robot/r5/leg/a", "team/arm/a", "team/arm/left/a", "team/army", "team/free/a"];
        let groups = by_owner(keys.iter().map(write).collect(), &owners);
        let texts = |group: &Vec<Write>| group.iter().map(|write| write.key.to_string()).collect::<Vec<_>>();
        let expected: [&[&str]; 5] = [
            &["team/army", "team/free/a"],
            &["robot/r2/a", "team/arm/a"],
            &["team/arm/left/a"],
            &["robot/r5/a"],
            &["robot/r5/leg/a"],
        ];
        assert_eq!(groups.iter().map(texts).collect::<Vec<_>>(), expected);
    }

    #[test]
    fn what_was_committed_before_a_failure_is_said() {
        let check = |done, expected: &str| {
            let Failure::Refused(error) = partly(anyhow!("`r3` is away").into(), done, 3) else { panic!("told") };
            assert_eq!(error.to_string(), expected);
        };
        check(0, "`r3` is away");
        check(2, "`r3` is away; before that, 2 of the 3 transactions for this file were committed");
    }

    #[test]
    fn a_transaction_as_text() {
        let text = "# new lens\nrequire team/a absent\nput team/a {x = 1.0, y = 2.0}\n\n  delete team/b\n";
        let (requires, writes) = changes(text).unwrap();
        assert_eq!((requires.len(), requires[0].condition), (1, Condition::Absent));
        let values: Vec<Option<String>> =
            writes.iter().map(|write| write.value.as_ref().map(|value| Datum::of(value).to_toml())).collect();
        assert_eq!(values, [Some("{x = 1.0, y = 2.0}".to_owned()), None]);
        let check = |text: &str, part: &str| {
            let why = format!("{:#}", changes(text).unwrap_err());
            assert!(why.contains(part), "{why}");
        };
        check("", "writes nothing");
        check("put team/a", "line 1, `put team/a`: the value is missing");
        check("put team/a 1\nset team/b 2", "line 2");
        check("require team/a 7", "`7` is no transaction");
        check("put a//b 1", "empty segment");
    }
}
