//! `dca db get`: prints the values of keys.

use super::databases::{DatabaseArgs, Databases, keys, refusal};
use super::readers::Readers;
use anyhow::{Context, anyhow};
use dbmanager::logic::key::Key;
use dbmanager::logic::state::{Version, differ};
use dbmanager::logic::view::as_of::state_of;
use dbmanager::logic::view::past::Keys;
use dbmanager::logic::view::schema::{SCHEMA, Schemas};
use dbmanager::logic::view::value::Datum;
use node::console::{self, Failure};
use node::logic::database::question::{AsOf, Question, Reply};

/// The arguments of `dca db get`.
#[derive(Debug, clap::Args)]
pub struct Get {
    /// A key, such as `team/camera/gain`, or a prefix that ends in `/` [default: all keys]
    #[arg(default_value = "")]
    key: String,
    #[command(flatten)]
    database: DatabaseArgs,
}

impl Get {
    /// Runs the verb.
    pub(crate) fn run(self) -> Result<(), Failure> {
        let key = match keys(self.key.clone()).context("reading the key")? {
            Keys::Below(prefix) => return list(&self.database, prefix, AsOf::Now),
            Keys::Only(key) => key,
        };
        let (versions, default) = self.database.with(async |databases| stored(databases, &key).await)?;
        let Some(datum) = shown(&versions).or_else(|| default.clone()) else {
            return Err(anyhow!("there is nothing at `{}`", self.key).into());
        };
        if default.is_some() {
            console::note(&format!("note: nothing is stored at `{}`; its schema has this default", self.key));
        }
        if differ(&versions) {
            let (key, count) = (&self.key, versions.len());
            console::note(&format!(
                "note: {count} writes to `{key}` did not see each other; `dca db conflicts {key}` lists them"
            ));
        }
        let readers = Readers::of(&self.database);
        if self.database.json {
            console::answer(&readers.json(serde_json::to_value(&datum)?));
        } else {
            console::say(&readers.text(&datum));
        }
        Ok(())
    }
}

/// Returns the writes to a key. If there are none, returns the default of its schema.
pub(crate) async fn stored(databases: &Databases<'_>, key: &Key) -> Result<(Vec<Version>, Option<Datum>), Failure> {
    let reply = databases.ask_one(databases.robot(), Question::Get { key: key.clone() }).await?;
    let Reply::Entries(entries) = reply else { return Err(refusal(&reply)) };
    let versions = entries.into_iter().next().map(|(_, versions)| versions).unwrap_or_default();
    if shown(&versions).is_some() {
        return Ok((versions, None));
    }
    let schemas = Schemas::of(&state_of(databases.entries(SCHEMA).await?));
    Ok((versions, schemas.find(key).and_then(|schema| schema.default.clone())))
}

/// Prints the present or past values of the keys below a prefix.
pub(crate) fn list(database: &DatabaseArgs, prefix: String, at: AsOf) -> Result<(), Failure> {
    let question = Question::List { prefix, at };
    let mut entries = Vec::new();
    database.ask_all(question, |reply| {
        let Reply::Entries(more) = reply else { return Err(refusal(&reply)) };
        entries.extend(more);
        Ok(())
    })?;
    let siblings = |versions: &[Version]| if differ(versions) { versions.len() } else { 1 };
    let shown: Vec<(Key, Datum, usize)> =
        entries.into_iter().filter_map(|(key, all)| Some((key, shown(&all)?, siblings(&all)))).collect();
    let readers = Readers::of(database);
    if database.json {
        let fields = shown.iter().map(|(key, datum, _)| {
            let value = serde_json::to_value(datum).unwrap_or_default();
            (key.to_string(), readers.json(value))
        });
        console::answer(&serde_json::Value::Object(fields.collect()));
        return Ok(());
    }
    for (key, datum, versions) in shown {
        let more = if versions > 1 { format!("  # {versions} concurrent writes") } else { String::new() };
        console::say(&format!("{key} = {}{more}", readers.text(&datum)));
    }
    Ok(())
}

/// Returns the value that a read shows for these writes.
pub(crate) fn shown(versions: &[Version]) -> Option<Datum> {
    versions.last()?.value.as_ref().map(Datum::of)
}
