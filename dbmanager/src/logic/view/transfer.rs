//! The database as a text file: to read, to edit, to compare, and to keep under version control.
//!
//! ```toml
//! # A database of DCA, one key a line.
//! format = 1
//! below = "team/"
//!
//! [values]
//! "team/camera/gain" = 1.5
//! # 2 concurrent writes, also: 3
//! "team/camera/rate" = 2
//! # end
//! ```
//!
//! The file is TOML, sorted by key, with one line for each key, so that two files differ where the databases differ. It
//! contains the value that a read of the key shows; a concurrent value is a comment. The database's own records (`sys/`)
//! and local ones (`local/`) are left out, unless requested.
//!
//! An import writes the values that differ. An unchanged file changes nothing; in particular, it does not resolve a
//! conflict. An incomplete file lacks the last line, `# end`, so no key is deleted because such a file does not contain it.

use super::as_of::Difference;
use super::past::Keys;
use super::value::text::Fault;
use super::value::{Datum, TextError, quote, text};
use crate::logic::key::{Key, Namespace};
use crate::logic::state::{State, Version};
use crate::logic::txn::{CHANGES_MAX, Draft, TXN_SIZE_MAX, Value};
use std::collections::BTreeMap;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// The format of the file.
const FORMAT: i64 = 1;
/// The approximate size of the writes in one transaction, in bytes. It leaves room for the other parts.
const WRITES_SIZE_MAX: usize = TXN_SIZE_MAX - (32 << 10);
/// The last line of a complete file.
const END: &str = "# end";
/// The longest file, in bytes.
pub const FILE_SIZE_MAX: usize = 256 << 20;

/// The policy for keys that are not in the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Absent {
    /// Keep these keys.
    Keep,
    /// Delete these keys, if they are below the prefix of the file.
    Delete,
}

/// The changes that a file would make.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Import {
    /// The transactions, in order. There is more than one if the changes do not fit into one. Other robots may then see
    /// some of the changes without the rest.
    pub drafts: Vec<Draft>,
    /// The changes.
    pub differences: Vec<Difference>,
    /// The keys whose conflicts these transactions would resolve.
    pub settles: Vec<Key>,
}

/// Returns the keys below `prefix` as a file.
pub fn export(state: &State, prefix: &str) -> String {
    let mut file = head(prefix);
    for (key, versions) in state.scan(prefix).filter(|(key, _)| is_about(prefix, key)) {
        let Some(value) = versions.last().and_then(|version| version.value.as_ref()) else { continue };
        if let [others @ .., _] = versions
            && state.is_conflict(key)
        {
            let other = |version: &Version| match &version.value {
                Some(value) => Datum::of(value).to_toml(),
                None => "(deleted)".to_owned(),
            };
            let others = others.iter().map(other).collect::<Vec<_>>().join(", ");
            file.push_str(&format!("# {} concurrent writes, also: {others}\n", versions.len()));
        }
        file.push_str(&line(key, &Datum::of(value)));
    }
    file + END + "\n"
}

fn head(prefix: &str) -> String {
    format!("# A database of DCA, one key a line.\nformat = {FORMAT}\nbelow = {}\n\n[values]\n", quote(prefix))
}

fn line(key: &Key, datum: &Datum) -> String {
    format!("{} = {}\n", quote(key.as_str()), datum.to_toml())
}

/// Returns the changes that a file would make.
///
/// # Errors
/// If the text is not such a file, with the position. Also if keys are to be deleted because the file does not contain
/// them, and the file may be incomplete.
pub fn import(file: &str, state: &State, absent: Absent, reason: &str) -> Result<Import, TextError> {
    let File { below, values } = read(file)?;
    if absent == Absent::Delete && file.trim_end().lines().next_back() != Some(END) {
        let what = "the file may have been cut off, so keys that are not in it are not deleted".to_owned();
        return Err(text::at(file, file.len(), Fault::new(what, "the last line of a complete file is `# end`")));
    }
    let mut wanted: BTreeMap<Key, Option<(Datum, Value)>> =
        values.into_iter().map(|(key, value)| (key, Some(value))).collect();
    if absent == Absent::Delete {
        for (key, _) in state.scan(&below).filter(|(key, _)| is_about(&below, key)) {
            wanted.entry(key.clone()).or_insert(None);
        }
    }
    let mut import = Import::default();
    let mut size = 0;
    for (key, wanted) in wanted {
        let versions = state.versions(&key);
        let before = versions.last().and_then(|version| version.value.as_ref()).map(Datum::of);
        let (after, value) = wanted.unzip();
        if before == after {
            continue;
        }
        if state.is_conflict(&key) {
            import.settles.push(key.clone());
        }
        let bytes = key.as_str().len() + value.as_ref().map_or(0, |value| value.bytes.len()) + 16;
        let full = |draft: &Draft| size + bytes > WRITES_SIZE_MAX || draft.writes().count() >= CHANGES_MAX;
        let draft = match import.drafts.pop_if(|draft| !full(draft)) {
            Some(draft) => draft,
            None => {
                size = 0;
                Draft::new(reason)
            }
        };
        size += bytes;
        import.drafts.push(match value {
            Some(value) => draft.put(key.clone(), value),
            None => draft.delete(key.clone()),
        });
        import.differences.push(Difference { key, before, after, siblings: 1 });
    }
    Ok(import)
}

/// Returns the prefix of the keys in a file.
///
/// # Errors
/// If the text is not such a file, with the position.
pub fn below(file: &str) -> Result<String, TextError> {
    read(file).map(|file| file.below)
}

/// Returns the same file for the keys below another prefix.
///
/// # Errors
/// If the text is not such a file, with the position. Also if one of its keys would not be a valid key below `prefix`.
pub fn moved(file: &str, prefix: &str) -> Result<String, TextError> {
    let refuse = |what: String| text::at(file, 0, Fault::new(what, "a prefix ends in `/`, such as `robot/r3/`"));
    let File { below, values } = read(file)?;
    if !prefix.ends_with('/') {
        return Err(refuse(format!("`{prefix}` is not a prefix")));
    }
    let mut moved = head(prefix);
    for (key, (datum, _)) in &values {
        let name = key.as_str().strip_prefix(below.as_str()).unwrap_or_default();
        let key = Key::new(format!("{prefix}{name}")).map_err(|error| refuse(error.to_string()))?;
        if !is_about(prefix, &key) {
            return Err(refuse(format!("`{key}` is not below `{prefix}`")));
        }
        moved.push_str(&line(&key, datum));
    }
    let is_whole = file.trim_end().lines().next_back() == Some(END);
    Ok(moved + if is_whole { END } else { "" } + "\n")
}

/// Returns whether a key belongs into the file of `prefix`.
fn is_about(prefix: &str, key: &Key) -> bool {
    let below = Keys::Below(prefix.to_owned()).contains(key);
    below
        && match key.namespace() {
            Namespace::Team | Namespace::Robot(_) => true,
            Namespace::Local => prefix.starts_with("local"),
            Namespace::System => false,
        }
}

struct File {
    below: String,
    values: BTreeMap<Key, (Datum, Value)>,
}

fn read(file: &str) -> Result<File, TextError> {
    let refuse = |byte: usize, what: String, hint: &'static str| text::at(file, byte, Fault::new(what, hint));
    if file.len() > FILE_SIZE_MAX {
        return Err(refuse(0, format!("the file has more than {FILE_SIZE_MAX} bytes"), ""));
    }
    let document = DeTable::parse(file).map_err(|error| {
        let byte = error.span().map_or(0, |span| span.start);
        refuse(byte, error.message().trim().replace('\n', ", "), "")
    })?;
    let fields: BTreeMap<&str, &Spanned<DeValue<'_>>> =
        document.get_ref().iter().map(|(name, value)| (name.get_ref().as_ref(), value)).collect();
    if let Some((name, value)) = fields.iter().find(|(name, _)| !["format", "below", "values"].contains(*name)) {
        let hint = "keys with their values stand under [values], each key in quotes";
        return Err(refuse(value.span().start, format!("`{name}` is not a known name"), hint));
    }
    match fields.get("format").map(|format| text::of_toml(file, format)).transpose()? {
        Some(Datum::Integer(FORMAT)) => {}
        Some(other) => {
            let at = fields.get("format").map_or(0, |format| format.span().start);
            let hint = "a newer version of DCA can read it";
            return Err(refuse(at, format!("the file has format {other}, and this program reads {FORMAT}"), hint));
        }
        None => {
            return Err(refuse(0, "the file does not say its format".to_owned(), "write `format = 1` first"));
        }
    }
    let below = fields.get("below").map(|below| text::of_toml(file, below)).transpose()?;
    let Some(Datum::Text(below)) = below else {
        let hint = "write for example `below = \"team/\"`";
        return Err(refuse(0, "the file does not say which keys it contains".to_owned(), hint));
    };
    let mut values = BTreeMap::new();
    let Some(DeValue::Table(table)) = fields.get("values").map(|values| values.get_ref()) else {
        return Err(refuse(0, "the file has no [values]".to_owned(), ""));
    };
    for (name, value) in table {
        let at = name.span().start;
        let key = Key::new(name.get_ref().as_ref()).map_err(|error| refuse(at, error.to_string(), ""))?;
        if !is_about(&below, &key) {
            let hint = "`below` names the prefix of its keys; keys that the database itself writes (`sys/`) are never in a file";
            return Err(refuse(at, format!("`{key}` does not belong in this file"), hint));
        }
        let datum = text::of_toml(file, value)?;
        let stored = datum.encode().map_err(|error| refuse(value.span().start, error.to_string(), ""))?;
        values.insert(key, (datum, stored));
    }
    Ok(File { below, values })
}

#[cfg(test)]
mod tests;
