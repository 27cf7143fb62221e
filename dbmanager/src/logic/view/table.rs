//! The results of the other views as text for people: aligned columns under headings. A `!` marks entries that need
//! attention.

use super::as_of::Difference;
use super::conflict::{Conflict, Party, Race, Sibling};
use super::date::{self, Ahead};
use super::past::{HistoryEntry, When};
use super::value::Datum;
use crate::logic::txn::Condition;
use crate::logic::version_vector::Dot;
use unicode_width::UnicodeWidthStr as _;

/// How many characters of a value or a reason a table shows.
const CELL_MAX: usize = 48;

/// Returns rows in aligned columns, without trailing blanks. A wide character, such as a Chinese one, takes two columns of a
/// terminal.
pub fn table(rows: &[Vec<String>]) -> String {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let width = |column: usize| rows.iter().filter_map(|row| row.get(column)).map(|cell| cell.width()).max();
    let widths: Vec<usize> = (0..columns).map(|column| width(column).unwrap_or(0)).collect();
    let line = |row: &Vec<String>| {
        let cells = row.iter().zip(&widths).map(|(cell, width)| format!("{cell}{}", " ".repeat(width - cell.width())));
        cells.collect::<Vec<_>>().join("  ").trim_end().to_owned()
    };
    rows.iter().map(line).collect::<Vec<_>>().join("\n")
}

/// A function that shows a value, such as [`Datum::to_toml`].
pub type Show<'a> = &'a dyn Fn(&Datum) -> String;

/// The keys of a list of transactions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Span {
    /// One key, which is not repeated in each line.
    Key,
    /// Several keys: each line names its key.
    All,
}

/// Returns transactions, the oldest first, with one line for each changed key. The heading names the zone of the dates. A date
/// with another offset, for example in summer, shows its own.
pub fn history(history: &[HistoryEntry], span: Span, show: Show<'_>, ahead: Ahead) -> String {
    let last = history.iter().rev().find(|entry| entry.when.is_known());
    let minutes = last.map_or(0, |entry| ahead(entry.when.millis));
    let zone = format!("WHEN ({})", date::zone(minutes));
    let when = |at: When| when(at, ahead, Some(minutes));
    let mut rows = vec![match span {
        Span::Key => head(&[&zone, "BY", "VALUE", "WHY", "TRANSACTION", ""]),
        Span::All => head(&[&zone, "BY", "KEY", "VALUE", "WHY", "TRANSACTION", ""]),
    }];
    let short = |dot: &Dot| match history.iter().find(|entry| entry.dot == *dot) {
        Some(entry) => format!("{}'s {}", entry.by, when(entry.when)),
        None => dot.to_string(),
    };
    for entry in history {
        let mut note = String::new();
        if !entry.concurrent.is_empty() {
            note = format!("! concurrent with {}", entry.concurrent.iter().map(short).collect::<Vec<_>>().join(", "));
        }
        for (index, (key, value)) in entry.changes.iter().enumerate() {
            let first = |text: String| if index == 0 { text } else { String::new() };
            let mut row = vec![first(when(entry.when)), first(entry.by.clone())];
            row.extend((span == Span::All).then(|| key.to_string()));
            let why = first(shortened(&entry.reason));
            row.extend([shown(value.as_ref(), show), why, first(entry.dot.to_string()), first(note.clone())]);
            rows.push(row);
        }
    }
    table(&rows)
}

/// Returns the differences: `+` appeared, `-` vanished, `~` changed.
pub fn differences(differences: &[Difference], show: Show<'_>) -> String {
    let row = |difference: &Difference| {
        let Difference { key, before, after, siblings } = difference;
        let (sign, values) = match (before, after) {
            (None, Some(after)) => ("+", shown(Some(after), show)),
            (Some(before), None) => ("-", shown(Some(before), show)),
            (Some(before), Some(after)) if before == after => ("~", shown(Some(after), show)),
            _ => ("~", format!("{} → {}", shown(before.as_ref(), show), shown(after.as_ref(), show))),
        };
        let note = match siblings {
            0 | 1 => String::new(),
            count => format!("! {count} concurrent writes"),
        };
        vec![format!("{sign} {key}"), values, note]
    };
    table(&differences.iter().map(row).collect::<Vec<_>>())
}

/// Returns the unresolved conflicts and races, with one block for each.
pub fn conflicts(conflicts: &[Conflict], races: &[Race], show: Show<'_>, ahead: Ahead) -> String {
    let when = |at: When| when(at, ahead, None);
    let mut blocks = Vec::new();
    for conflict in conflicts {
        let Conflict { key, versions } = conflict;
        let mut rows = Vec::new();
        for (index, sibling) in versions.iter().enumerate() {
            let Sibling { dot, value, by, when: at, reason } = sibling;
            let mark = if index + 1 == versions.len() { "shown" } else { "" };
            let why =
                reason.as_deref().map_or("(this robot has not kept the reason and the time)".to_owned(), shortened);
            rows.push(vec![shown(value.as_ref(), show), mark.to_owned(), by.clone(), when(*at), dot.to_string(), why]);
        }
        let (count, seen) = (versions.len(), conflict.seen());
        blocks
            .push(format!("{key}: {count} writes did not see each other (--seen {seen})\n{}", indented(&table(&rows))));
    }
    for Race { key, count, seen, relied, condition, changed } in races {
        let relied_on =
            |what: &str| (format!("relied on {what}, unaware of a change"), ["relied on it", "had changed it"]);
        let (did, [first, second]) = match condition {
            Some(Condition::Absent) => relied_on("there being nothing"),
            Some(Condition::Exists) => relied_on("there being a value"),
            Some(Condition::Is(_)) => relied_on("the value it had read"),
            None => ("wrote it, unaware that it was granted to another".to_owned(), ["wrote it", "granted it"]),
        };
        let row = |what: &str, party: &Party| {
            let Party { dot, by, when: at, reason } = party;
            vec![what.to_owned(), by.clone(), when(*at), dot.to_string(), shortened(reason)]
        };
        let rows = [row(first, relied), row(second, changed)];
        let more = match count {
            0 | 1 => String::new(),
            count => format!(", and so did {} more transactions", count - 1),
        };
        blocks.push(format!("{key}: {} {did}{more} (--seen {seen})\n{}", relied.by, indented(&table(&rows))));
    }
    blocks.join("\n\n")
}

/// Returns a date with its offset, unless the offset equals `told`, the offset in the heading. A leading `~` means that no clock was
/// synchronised.
fn when(when: When, ahead: Ahead, told: Option<i64>) -> String {
    if !when.is_known() {
        return "no date".to_owned();
    }
    let minutes = ahead(when.millis);
    let offset = if told == Some(minutes) { String::new() } else { date::offset(minutes) };
    format!("{}{}{offset}", if when.trusted { "" } else { "~" }, date::local(when.millis, ahead))
}

fn shown(value: Option<&Datum>, show: Show<'_>) -> String {
    value.map_or("(deleted)".to_owned(), |datum| shortened(&show(datum)))
}

/// Returns a text on one line. If it is long, its end is left out.
fn shortened(text: &str) -> String {
    let line: String = text.chars().map(|character| if character.is_control() { ' ' } else { character }).collect();
    match line.char_indices().nth(CELL_MAX) {
        Some((end, _)) => format!("{}…", &line[..end]),
        None => line,
    }
}

fn head(names: &[&str]) -> Vec<String> {
    names.iter().map(|name| (*name).to_owned()).collect()
}

fn indented(text: &str) -> String {
    text.lines().map(|line| format!("  {line}")).collect::<Vec<_>>().join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wide_character_takes_two_columns() {
        let rows = [["a", "b"], ["左腕", "c"], ["e\u{301}", "d"]].map(|row| row.map(str::to_owned).to_vec());
        assert_eq!(table(&rows), "a     b\n左腕  c\ne\u{301}     d");
    }
}
