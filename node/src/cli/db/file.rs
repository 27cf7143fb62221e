//! `dca db export`, `import`, `tx`: many keys at once, from and to text.

use super::asking::{Asking, refusal};
use super::past::a_moment;
use super::write::Writing;
use crate::cli::{Failure, output};
use crate::logic::database::question::{Moment, Question, Reply};
use anyhow::{Context, anyhow, bail};
use dbmanager::logic::key::{Key, Namespace};
use dbmanager::logic::txn::{Condition, Require, Write};
use dbmanager::logic::view::value::Datum;
use dbmanager::logic::view::{table, token};
use std::collections::BTreeMap;
use std::io::Read;
use std::path::{Path, PathBuf};

/// What `dca db export` is told.
#[derive(Debug, clap::Args)]
pub struct Export {
    /// How the keys begin
    #[arg(default_value = "")]
    prefix: String,
    /// When: a date, a cut, or `now`
    #[arg(long, value_name = "MOMENT", value_parser = a_moment, default_value = "now")]
    at: Moment,
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
        let mut text = String::new();
        self.asking.ask_all(question, |reply| {
            let Reply::Text(part) = reply else { return Err(refusal(&reply)) };
            text.push_str(&part);
            Ok(())
        })?;
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
        // Each robot's own keys go to it; a transaction over several of them would be refused by all.
        for writes in transactions.into_iter().flat_map(by_owner) {
            self.writing.commit(vec![], writes)?;
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

/// Returns the writes by whose keys they are.
fn by_owner(writes: Vec<Write>) -> Vec<Vec<Write>> {
    let mut groups: BTreeMap<Option<String>, Vec<Write>> = BTreeMap::new();
    for write in writes {
        let owner = match write.key.namespace() {
            Namespace::Robot(name) => Some(name.to_owned()),
            Namespace::Team | Namespace::System | Namespace::Local => None,
        };
        groups.entry(owner).or_default().push(write);
    }
    groups.into_values().collect()
}

fn read(file: &Path) -> anyhow::Result<String> {
    if file == Path::new("-") {
        let mut text = String::new();
        std::io::stdin().read_to_string(&mut text).context("reading standard input")?;
        return Ok(text);
    }
    std::fs::read_to_string(file).with_context(|| format!("reading {}", file.display()))
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
