//! `dca db diff`: the changes between two moments, and the differences between the keys below two prefixes.

use super::databases::{DatabaseArgs, refusal};
use super::moment::a_moment;
use super::readers::Readers;
use anyhow::anyhow;
use dbmanager::logic::view::as_of::{Difference, compare, state_of};
use dbmanager::logic::view::table;
use node::console::{self, Failure};
use node::logic::database::question::{AsOf, Question, Reply};

/// The arguments of `dca db diff`.
#[derive(Debug, clap::Args)]
pub struct Diff {
    /// From when: a date such as `14:03`, `yesterday` or `2026-11-21 10:00:00`, a version as `dca db version` prints it, or `on:ROBOT`
    /// for the part that this robot also has. Or a prefix, such as `robot/r2/`: compares the keys below it with the
    /// keys below another prefix
    #[arg(value_parser = side)]
    from: Side,
    /// To when, or the other prefix
    #[arg(value_parser = side, default_value = "now")]
    to: Side,
    /// The prefix of the keys
    #[arg(long, value_name = "PREFIX", default_value = "")]
    prefix: String,
    #[command(flatten)]
    database: DatabaseArgs,
}

/// One side of a comparison.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Side {
    Past(AsOf),
    /// How keys begin; it ends in `/`.
    Keys(String),
}

impl Diff {
    /// Runs the verb.
    pub(crate) fn run(self) -> Result<(), Failure> {
        let (differences, none) = match (self.from, self.to) {
            (Side::Keys(from), Side::Keys(to)) => {
                let all = self.database.with(async |databases| {
                    let mut entries = databases.entries(&from).await?;
                    entries.extend(databases.entries(&to).await?);
                    Ok(compare(&state_of(entries), &from, &to))
                });
                (all?, "nothing differs")
            }
            (Side::Past(from), Side::Past(to)) => {
                (changes(&self.database, Question::Diff { from, to, prefix: self.prefix })?, "nothing has changed")
            }
            _ => {
                let why = "compare a prefix with a prefix, or a time with a time; `--prefix` limits the keys";
                return Err(Failure::Usage(anyhow!(why)));
            }
        };
        let readers = Readers::of(&self.database);
        if self.database.json {
            console::answer(&readers.json(serde_json::to_value(&differences)?));
        } else if differences.is_empty() {
            console::note(none);
        } else {
            console::say(&table::differences(&differences, &|datum| readers.text(datum)));
        }
        Ok(())
    }
}

fn changes(database: &DatabaseArgs, question: Question) -> Result<Vec<Difference>, Failure> {
    let mut differences = Vec::new();
    database.ask_all(question, |reply| {
        let Reply::Differences(part) = reply else { return Err(refusal(&reply)) };
        differences.extend(part);
        Ok(())
    })?;
    Ok(differences)
}

fn side(text: &str) -> Result<Side, String> {
    if text.ends_with('/') { Ok(Side::Keys(text.to_owned())) } else { a_moment(text).map(Side::Past) }
}
