//! `dca db export` and `dca db tx`: write many keys at once to a text, and read them from a text.

use super::databases::{DatabaseArgs, refusal};
use super::moment::a_moment;
use super::readers::Readers;
use super::write::{CommitArgs, written};
use crate::io::named_file;
use crate::io::whole_file::WholeFile;
use anyhow::{Context, anyhow, bail};
use dbmanager::logic::key::Key;
use dbmanager::logic::txn::{Condition, Require, Write};
use dbmanager::logic::view::token;
use dbmanager::logic::view::value::Datum;
use node::console::{self, Failure};
use node::logic::database::question::{AsOf, Question, Reply};
use std::path::{Path, PathBuf};

/// The largest size of a file of values, in bytes: some million keys.
const FILE_MAX: usize = 256 << 20;

/// The kinds of lines of a transaction.
const LINES: &str = "a line is `put KEY VALUE`, `delete KEY` or `require KEY absent|exists|TRANSACTION`; put a key with blanks into quotes";

/// The arguments of `dca db export`.
#[derive(Debug, clap::Args)]
pub struct Export {
    /// The prefix of the keys
    #[arg(default_value = "")]
    prefix: String,
    /// When: a date, a cut, or `now`
    #[arg(long, value_name = "MOMENT", value_parser = a_moment, default_value = "now")]
    at: AsOf,
    /// Write to this file, which has its name only once it is whole [default: standard output]
    #[arg(long, short, value_name = "FILE", conflicts_with = "json")]
    output: Option<PathBuf>,
    #[command(flatten)]
    database: DatabaseArgs,
}

/// The arguments of `dca db tx`.
#[derive(Debug, clap::Args)]
pub struct Tx {
    /// One change a line: `put KEY VALUE`, `delete KEY`, `require KEY absent|exists|TRANSACTION`, with quotes around a key that has
    /// blanks; `-` for standard input
    #[arg(default_value = "-")]
    file: PathBuf,
    #[command(flatten)]
    commit: CommitArgs,
}

impl Export {
    /// Runs the verb.
    pub(crate) fn run(self) -> Result<(), Failure> {
        let question = Question::Export { prefix: self.prefix, at: self.at };
        let (mut text, mut file) = (String::new(), self.output.as_deref().map(WholeFile::create).transpose()?);
        let (readers, mut rest) = (Readers::of(&self.database), String::new());
        self.database.ask_all(question, |reply| {
            let Reply::Text(part) = reply else { return Err(refusal(&reply)) };
            rest.push_str(&part);
            // A part of the answer may end in the middle of a line.
            let lines: String = rest.drain(..rest.rfind('\n').map_or(0, |end| end + 1)).collect();
            readers.explain(&lines, &mut text);
            if let Some(file) = &mut file {
                file.write(text.as_bytes())?;
                text.clear();
            }
            Ok(())
        })?;
        text.push_str(&rest);
        if let Some(mut file) = file {
            file.write(text.as_bytes())?;
            return Ok(file.finish()?);
        }
        console::say(&text);
        Ok(())
    }
}

impl Tx {
    /// Runs the verb.
    pub(crate) fn run(self) -> Result<(), Failure> {
        let (requires, writes) = changes(&read(&self.file)?)?;
        self.commit.commit(requires, writes)
    }
}

/// Reads a file, or standard input.
pub(crate) fn read(file: &Path) -> anyhow::Result<String> {
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
    if !["put", "delete", "require"].contains(&verb) {
        bail!(LINES);
    }
    let (key, value) = key_and_rest(rest.trim())?;
    let key = Key::new(key)?;
    if verb != "require" && writes.iter().any(|write| write.key == key) {
        bail!("`{key}` is written by an earlier line; a transaction can write a key only once");
    }
    match (verb, value) {
        ("put", "") => bail!("the value is missing"),
        ("put", value) => writes.push(Write { value: Some(written(key.as_str(), value)?.encode()?), key }),
        ("delete", "") => writes.push(Write { key, value: None }),
        ("require", "absent") => requires.push(Require { key, condition: Condition::Absent }),
        ("require", "exists") => requires.push(Require { key, condition: Condition::Exists }),
        ("require", name) => {
            let dot = token::dot(name).ok_or_else(|| anyhow!("`{name}` is not a transaction, `absent` or `exists`"))?;
            requires.push(Require { key, condition: Condition::Is(dot) });
        }
        _ => bail!(LINES),
    }
    Ok(())
}

/// Splits a key from the rest of the line. A key that contains blanks is quoted like a string in TOML.
fn key_and_rest(text: &str) -> anyhow::Result<(String, &str)> {
    let Some(quoted) = text.strip_prefix('"') else {
        let (key, rest) = text.split_once(' ').unwrap_or((text, ""));
        return Ok((key.to_owned(), rest.trim()));
    };
    // The quote after a backslash does not end the key.
    let mut escaped = false;
    let end = quoted.find(|character| {
        let is_end = character == '"' && !escaped;
        escaped = character == '\\' && !escaped;
        is_end
    });
    let (key, rest) = text.split_at(end.map(|end| end + 2).context("the key has no second quote")?);
    let read = Datum::from_toml(key).with_context(|| format!("reading the key {key}"))?;
    let (Datum::Text(name), true) = (read, rest.is_empty() || rest.starts_with(' ')) else {
        bail!("a blank separates the key {key} from the next word");
    };
    Ok((name, rest.trim()))
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
        check("put team/a 1\nset team/b 2", "line 2, `set team/b 2`: a line is `put KEY VALUE`");
        check("garbage", "line 1, `garbage`: a line is `put KEY VALUE`");
        check("put team/a 1\ndelete team/a", "line 2, `delete team/a`: `team/a` is written by an earlier line");
        check("require team/a 7", "`7` is not a transaction");
        check("put a//b 1", "empty segment");
        check("put \"team/a b 1", "the key has no second quote");
        check("put \"team/a b\"1", "a blank separates the key \"team/a b\" from the next word");
        check("put \"team/a b\"", "the value is missing");
    }

    #[test]
    fn a_key_with_blanks_stands_in_quotes() {
        let text =
            "put \"team/a b\" \"c d\"\ndelete \"team/a  \\\"c\\\"\"\nrequire \"team/x y\" absent\nput team/z 1\n";
        let (requires, writes) = changes(text).unwrap();
        let keys: Vec<&str> = writes.iter().map(|write| write.key.as_str()).collect();
        assert_eq!((keys, requires[0].key.as_str()), (vec!["team/a b", "team/a  \"c\"", "team/z"], "team/x y"));
    }
}
