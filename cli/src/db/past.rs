//! `dca db history`, `conflicts`, `resolve` and `at`: past values, and conflicts that are not settled.

use super::databases::{DatabaseArgs, keys, refusal};
use super::moment::{a_date, a_moment};
use super::read;
use super::readers::Readers;
use super::write::CommitArgs;
use anyhow::Context;
use clap::builder::RangedU64ValueParser;
use comms::io::clock;
use dbmanager::logic::key::Key;
use dbmanager::logic::version_vector::Dot;
use dbmanager::logic::view::conflict::Conflict;
use dbmanager::logic::view::past::{Filter, Keys};
use dbmanager::logic::view::table::{self, Span};
use dbmanager::logic::view::token;
use dbmanager::logic::view::value::Datum;
use node::console::{self, Failure};
use node::logic::database::question::{AsOf, Choice, Question, Reply, Resolve as ResolveRequest};

/// The arguments of `dca db history`.
#[derive(Debug, clap::Args)]
pub struct History {
    /// A key, or a prefix that ends in `/` [default: all keys]
    #[arg(default_value = "")]
    key: String,
    /// Only changes by this robot
    #[arg(long, value_name = "ROBOT")]
    by: Option<String>,
    /// Only changes from this date on, such as `14:03`, `yesterday`, `5 min ago` or `2026-11-21 10:00`
    #[arg(long, value_name = "DATE", value_parser = a_date)]
    from: Option<u64>,
    /// Only changes before this date
    #[arg(long, value_name = "DATE", value_parser = a_date)]
    until: Option<u64>,
    /// Only the last changes, at most this many
    #[arg(long, short = 'n', value_name = "COUNT", default_value_t = 50, value_parser = RangedU64ValueParser::<usize>::new().range(1..))]
    limit: usize,
    #[command(flatten)]
    database: DatabaseArgs,
}

/// The arguments of `dca db conflicts`.
#[derive(Debug, clap::Args)]
pub struct Conflicts {
    /// The prefix of the keys
    #[arg(default_value = "")]
    prefix: String,
    #[command(flatten)]
    database: DatabaseArgs,
}

/// The arguments of `dca db resolve`.
#[derive(Debug, clap::Args)]
#[command(group = clap::ArgGroup::new("choice").required(true))]
pub struct Resolve {
    /// The key
    key: String,
    /// The write of this robot
    #[arg(long, value_name = "ROBOT", group = "choice")]
    by: Option<String>,
    /// The write of this transaction
    #[arg(long, value_name = "TRANSACTION", group = "choice", value_parser = a_dot)]
    transaction: Option<Dot>,
    /// The write that a read shows now
    #[arg(long, group = "choice")]
    shown: bool,
    /// Another value, as in TOML
    #[arg(long, value_name = "VALUE", group = "choice", allow_hyphen_values = true)]
    value: Option<String>,
    /// No value: delete the key
    #[arg(long, group = "choice")]
    delete: bool,
    /// The writes that you have seen, as `dca db conflicts` prints them; if there are other writes now, the conflict is not settled
    #[arg(long, value_name = "SEEN", default_value = "", hide_default_value = true)]
    seen: String,
    #[command(flatten)]
    commit: CommitArgs,
}

/// The arguments of `dca db at`.
#[derive(Debug, clap::Args)]
pub struct At {
    /// When: a date such as `14:03`, `yesterday` or `2026-11-21 10:00:00`, a version as `dca db version` prints it, or `on:ROBOT` for
    /// the part that this robot also has
    #[arg(value_parser = a_moment)]
    moment: AsOf,
    /// The prefix of the keys
    #[arg(default_value = "")]
    prefix: String,
    #[command(flatten)]
    database: DatabaseArgs,
}

/// The arguments of `dca db version`.
#[derive(Debug, clap::Args)]
pub struct VersionAt {
    /// When: a date, `now`, or `on:ROBOT`
    #[arg(value_parser = a_moment, default_value = "now")]
    moment: AsOf,
    #[command(flatten)]
    database: DatabaseArgs,
}

impl History {
    /// Runs the verb.
    pub(crate) fn run(self) -> Result<(), Failure> {
        let keys = keys(self.key)?;
        let span = if matches!(keys, Keys::Only(_)) { Span::Key } else { Span::All };
        let filter = Filter { keys, by: self.by, from: self.from, until: self.until, limit: self.limit };
        let mut entries = Vec::new();
        self.database.ask_all(Question::History(filter), |reply| {
            let Reply::History(part) = reply else { return Err(refusal(&reply)) };
            entries.extend(part);
            Ok(())
        })?;
        let readers = Readers::of(&self.database);
        if self.database.json {
            console::answer(&readers.json(serde_json::to_value(&entries)?));
        } else if entries.is_empty() {
            console::note("the log has no such changes");
        } else {
            console::say(&table::history(&entries, span, &|datum| readers.text(datum), clock::minutes_ahead));
        }
        Ok(())
    }
}

impl Conflicts {
    /// Runs the verb.
    pub(crate) fn run(self) -> Result<(), Failure> {
        let (mut conflicts, mut races) = (Vec::new(), Vec::new());
        self.database.ask_all(Question::Conflicts { prefix: self.prefix }, |reply| {
            let Reply::Conflicts(part, more) = reply else { return Err(refusal(&reply)) };
            conflicts.extend(part);
            races.extend(more);
            Ok(())
        })?;
        let readers = Readers::of(&self.database);
        if self.database.json {
            let listed = conflicts.iter().map(json).collect::<Result<Vec<_>, _>>()?;
            let json = serde_json::json!({ "conflicts": listed, "races": races });
            console::answer(&readers.json(json));
        } else if conflicts.is_empty() && races.is_empty() {
            console::say("no conflicts");
        } else {
            console::say(&table::conflicts(&conflicts, &races, &|datum| readers.text(datum), clock::minutes_ahead));
            console::note(
                "`dca db resolve KEY --seen SEEN --by ROBOT` (or `--value`, `--shown`, `--delete`) settles one everywhere",
            );
        }
        Ok(())
    }
}

/// Returns a conflict as JSON: with a name for its writes, and with a mark on the write that a read shows. This is the last write.
fn json(conflict: &Conflict) -> serde_json::Result<serde_json::Value> {
    let mut json = serde_json::to_value(conflict)?;
    json["seen"] = conflict.seen().into();
    let count = conflict.versions.len();
    for (index, version) in json["versions"].as_array_mut().into_iter().flatten().enumerate() {
        version["shown"] = (index + 1 == count).into();
    }
    Ok(json)
}

impl Resolve {
    /// Runs the verb.
    pub(crate) fn run(self) -> Result<(), Failure> {
        let choice = match (self.by, self.transaction, self.value) {
            (Some(robot), ..) => Choice::By(robot),
            (_, Some(dot), _) => Choice::Txn(dot),
            (.., Some(value)) => {
                let datum = Datum::from_toml(&value).context("reading the value")?;
                Choice::Value(Some(datum.encode()?))
            }
            _ if self.delete => Choice::Value(None),
            _ => Choice::Shown,
        };
        let CommitArgs { level, within, .. } = &self.commit;
        self.commit.send(&Question::Resolve(ResolveRequest {
            key: Key::new(self.key)?,
            choice,
            reason: self.commit.reason_or("settle"),
            level: level.clone(),
            within: *within,
            seen: self.seen,
        }))
    }
}

impl At {
    /// Runs the verb.
    pub(crate) fn run(self) -> Result<(), Failure> {
        read::list(&self.database, self.prefix, self.moment)
    }
}

impl VersionAt {
    /// Runs the verb.
    pub(crate) fn run(self) -> Result<(), Failure> {
        let reply = self.database.ask(Question::Version(self.moment))?;
        let Reply::Version(version) = reply else { return Err(refusal(&reply)) };
        let text = token::token(&version);
        if self.database.json {
            console::answer(&serde_json::json!({ "version": text }));
        } else {
            console::say(&text);
        }
        Ok(())
    }
}

fn a_dot(text: &str) -> Result<Dot, String> {
    token::dot(text).ok_or_else(|| "a transaction is named as `dca db history` shows it".to_owned())
}
