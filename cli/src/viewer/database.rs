//! The database of a robot on the page: keys with their values, and the history and the conflicts of one key. It is only read.

use super::ways::{READ_WITHIN, Ways};
use crate::client::words;
use crate::db::databases::{DatabaseArgs, Databases, keys, refusal};
use crate::db::read::{shown, stored};
use crate::db::readers::Readers;
use anyhow::anyhow;
use comms::io::clock;
use dbmanager::logic::key::Key;
use dbmanager::logic::state::{Version, differ};
use dbmanager::logic::view::conflict::{Conflict, Race};
use dbmanager::logic::view::past::{Filter, HistoryEntry, Keys};
use dbmanager::logic::view::table::{self, Span};
use dbmanager::logic::view::value::Datum;
use node::console::Failure;
use node::logic::database::question::{AsOf, Question, Reply};
use node::logic::printable::printable;
use serde_json::{Value, json};
use tokio::time::timeout;
use view::{Model, RobotId};

/// The most keys of one answer.
const KEYS_MAX: usize = 200;
/// The most changes in the history of a key.
const CHANGES_MAX: usize = 50;
/// The most characters of a value in a list, and of a value or a table of one key.
const LISTED_MAX: usize = 200;
const TEXT_MAX: usize = 20_000;

/// The robot whose database is asked, and the keys.
pub(super) struct Lookup {
    pub(super) robot: RobotId,
    keys: Keys,
}

/// All that is shown of one key.
struct KeyDetails {
    versions: Vec<Version>,
    default: Option<Datum>,
    history: Vec<HistoryEntry>,
    conflicts: Vec<Conflict>,
    races: Vec<Race>,
}

impl Lookup {
    /// Reads what the page asks for.
    ///
    /// # Errors
    /// One sentence about the mistake.
    pub(super) fn read(body: &Value, model: &Model) -> Result<Self, String> {
        let text = |name: &str| body.get(name).and_then(Value::as_str).unwrap_or_default();
        let id = model.robots().map(|one| &one.id).find(|id| id.to_string() == text("robot"));
        let robot = id.ok_or_else(|| format!("this view does not show the robot `{}`", text("robot")))?.clone();
        let keys = keys(text("key").to_owned()).map_err(|why| why.to_string())?;
        Ok(Self { robot, keys })
    }

    /// Asks the database of the robot. Returns JSON: the keys, or one key, or a sentence that says why there is nothing.
    pub(super) async fn ask(self, ways: Ways) -> Value {
        let Self { robot, keys } = self;
        let Some(client) = ways.clients.first() else { return json!({ "why": format!("`{robot}` does not answer") }) };
        let databases = Databases::through(client, robot.host.clone());
        let args = DatabaseArgs::of(ways.connect);
        let found = async {
            match keys {
                Keys::Below(prefix) => {
                    let (entries, is_cut) = below(&databases, prefix).await?;
                    Ok(listed(&entries, is_cut, &Readers::of(&args)))
                }
                Keys::Only(key) => {
                    let details = details(&databases, &key).await?;
                    Ok(one(&details, &Readers::of(&args)))
                }
            }
        };
        let found: Result<Value, Failure> = timeout(READ_WITHIN, found).await.unwrap_or_else(|_| {
            let why = anyhow!("the database of `{robot}` has not answered within {} s", READ_WITHIN.as_secs());
            Err(Failure::Unreachable(why))
        });
        found.unwrap_or_else(|failure| json!({ "why": words(&failure) }))
    }
}

/// Returns the first keys below a prefix, and whether there are more.
async fn below(databases: &Databases<'_>, prefix: String) -> Result<(Vec<(Key, Vec<Version>)>, bool), Failure> {
    let mut replies = databases.ask(databases.robot(), Question::List { prefix, at: AsOf::Now }).await?;
    let mut entries = Vec::new();
    while let Some(reply) = replies.next(clock::now() + READ_WITHIN).await? {
        let Reply::Entries(part) = reply else { return Err(refusal(&reply)) };
        entries.extend(part.into_iter().filter(|(_, versions)| shown(versions).is_some()));
        if entries.len() > KEYS_MAX {
            entries.truncate(KEYS_MAX);
            return Ok((entries, true));
        }
    }
    Ok((entries, false))
}

async fn details(databases: &Databases<'_>, key: &Key) -> Result<KeyDetails, Failure> {
    let (versions, default) = stored(databases, key).await?;
    let filter = Filter { keys: Keys::Only(key.clone()), by: None, from: None, until: None, limit: CHANGES_MAX };
    let (mut history, mut conflicts, mut races) = (Vec::new(), Vec::new(), Vec::new());
    let take = |reply| {
        let Reply::History(part) = reply else { return Err(refusal(&reply)) };
        history.extend(part);
        Ok(())
    };
    databases.ask_all(Question::History(filter), take).await?;
    let take = |reply| {
        let Reply::Conflicts(part, more) = reply else { return Err(refusal(&reply)) };
        // The keys below a prefix include keys that only begin like this one.
        conflicts.extend(part.into_iter().filter(|conflict| conflict.key == *key));
        races.extend(more.into_iter().filter(|race| race.key == *key));
        Ok(())
    };
    databases.ask_all(Question::Conflicts { prefix: key.to_string() }, take).await?;
    Ok(KeyDetails { versions, default, history, conflicts, races })
}

fn listed(entries: &[(Key, Vec<Version>)], is_cut: bool, readers: &Readers) -> Value {
    let row = |(key, versions): &(Key, Vec<Version>)| {
        let value = shown(versions).map(|datum| cut(&readers.text(&datum), LISTED_MAX));
        let writes = if differ(versions) { versions.len() } else { 1 };
        json!({ "key": key, "value": value, "writes": writes })
    };
    let note = if is_cut { format!("the first {KEYS_MAX} keys; a longer prefix shows others") } else { String::new() };
    json!({ "keys": entries.iter().map(row).collect::<Vec<_>>(), "note": note })
}

fn one(details: &KeyDetails, readers: &Readers) -> Value {
    let KeyDetails { versions, default, history, conflicts, races } = details;
    let show = |datum: &Datum| readers.text(datum);
    let value = shown(versions).or_else(|| default.clone()).map(|datum| cut(&show(&datum), TEXT_MAX));
    let history = (!history.is_empty()).then(|| table::history(history, Span::Key, &show, clock::minutes_ahead));
    let has_conflict = !conflicts.is_empty() || !races.is_empty();
    let conflicts = has_conflict.then(|| table::conflicts(conflicts, races, &show, clock::minutes_ahead));
    json!({
        "value": value, "is_default": default.is_some(),
        "history": history.map(|text| cut(&text, TEXT_MAX)), "conflicts": conflicts.map(|text| cut(&text, TEXT_MAX)),
    })
}

/// Returns a printable text of at most so many characters.
fn cut(text: &str, most: usize) -> String {
    let text = printable(text);
    if text.chars().count() <= most { text } else { text.chars().take(most - 1).chain(['…']).collect() }
}
