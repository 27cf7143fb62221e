//! `dca db import`: makes keys equal to the content of a file.
//!
//! The changes are computed here, from the keys that the robot sends: the file and its changes may be too large for one
//! message. They are written in as few transactions as possible. If an import is repeated, it continues where the last
//! one ended: keys that are already written no longer differ.

use super::databases::{Databases, refusal};
use super::file::read;
use super::readers::Readers;
use super::write::{CommitArgs, CommitProgress};
use crate::logic::estimate::Estimate;
use crate::logic::mission::{Line, Style};
use crate::output::Output;
use anyhow::{Context, anyhow};
use comms::io::clock;
use comms::logic::time::Time;
use dbmanager::logic::key::Key;
use dbmanager::logic::owner::{Owner, Owners};
use dbmanager::logic::state::State;
use dbmanager::logic::txn::{Condition, Draft, Require, Value, Write};
use dbmanager::logic::version_vector::Dot;
use dbmanager::logic::view::as_of::state_of;
use dbmanager::logic::view::table;
use dbmanager::logic::view::transfer::{self, Absent};
use node::console::{self, Failure};
use node::logic::database::question::{Question, Reply};
use node::logic::table::counted;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Duration;

/// How often the progress is printed.
const TELL_EVERY: Duration = Duration::from_secs(1);

/// The arguments of `dca db import`.
#[derive(Debug, clap::Args)]
pub struct Import {
    /// A file as `dca db export` prints it; `-` for standard input
    file: PathBuf,
    /// Write the keys below this prefix, such as `robot/r3/`, instead of the prefix of the file
    #[arg(long, value_name = "PREFIX")]
    below: Option<String>,
    /// Delete keys that are not in the file, if they are below its prefix
    #[arg(long)]
    delete: bool,
    /// Only show the changes
    #[arg(long)]
    dry_run: bool,
    /// Everything in one transaction, and only if no other client writes these keys in the meantime
    #[arg(long)]
    atomic: bool,
    #[command(flatten)]
    commit: CommitArgs,
}

/// The progress of an import.
#[derive(Default)]
struct Done {
    /// The transactions that were committed.
    dots: Vec<Dot>,
    /// Whether one of the transactions has not reached the requested level.
    pending: bool,
}

impl Import {
    /// Runs the verb.
    pub(crate) fn run(self) -> Result<(), Failure> {
        let text = read(&self.file)?;
        let text = match &self.below {
            Some(prefix) => {
                transfer::moved(&text, prefix).with_context(|| format!("moving the keys below `{prefix}`"))?
            }
            None => text,
        };
        let below = transfer::below(&text).with_context(|| format!("reading {}", self.file.display()))?;
        self.commit.database.with(async |databases| {
            let state = state_of(databases.entries(&below).await?);
            let absent = if self.delete { Absent::Delete } else { Absent::Keep };
            let import = transfer::import(&text, &state, absent, "").context("reading the file")?;
            self.show(&import);
            if self.dry_run || import.differences.is_empty() {
                return self.report(&import, &Done::default());
            }
            let owners = owners(databases).await?;
            let parts: Vec<_> = import.drafts.iter().flat_map(|draft| by_owner(draft, &owners)).collect();
            let done = match &parts[..] {
                [part] if self.atomic => self.write(databases, vec![(as_seen(part, &state)?, part.clone())]).await?,
                several if self.atomic => return Err(does_not_fit(several, import.drafts.len())),
                several => self.write(databases, several.iter().map(|part| (vec![], part.clone())).collect()).await?,
            };
            self.report(&import, &done)
        })
    }

    /// Writes one transaction after another.
    async fn write(&self, databases: &Databases<'_>, parts: Vec<(Vec<Require>, Vec<Write>)>) -> Result<Done, Failure> {
        let (count, keys) = (parts.len(), parts.iter().map(|(_, writes)| writes.len()).sum());
        let (mut done, mut progress) = (Done::default(), Progress::new(keys));
        for (requires, writes) in parts {
            let keys = writes.len();
            let question = self.commit.question(self.commit.reason_or("import"), requires, writes);
            let got = self.commit.write_on(databases, &question).await;
            match got.map_err(|failure| partly(failure, done.dots.len(), count))? {
                CommitProgress::AckLevel(dot) => done.dots.push(dot),
                CommitProgress::Pending(dot) => {
                    done.dots.push(dot);
                    done.pending = true;
                }
                CommitProgress::Done(_) => {}
            }
            progress.more(keys);
        }
        progress.output.clear();
        Ok(done)
    }

    /// Shows the changes to a person.
    fn show(&self, import: &transfer::Import) {
        let readers = Readers::of(&self.commit.database);
        if self.commit.database.json {
            return;
        }
        if import.differences.is_empty() {
            console::note("nothing differs");
        } else {
            console::say(&table::differences(&import.differences, &|datum| readers.text(datum)));
        }
        for key in &import.settles {
            console::note(&format!("note: this settles the concurrent writes at `{key}`"));
        }
    }

    /// Reports the writes.
    fn report(&self, import: &transfer::Import, done: &Done) -> Result<(), Failure> {
        let transactions: Vec<String> = done.dots.iter().map(ToString::to_string).collect();
        if self.commit.database.json {
            let (differences, settles) = (&import.differences, &import.settles);
            let json = serde_json::json!({
                "differences": differences, "settles": settles, "transactions": transactions, "reached": !done.pending,
            });
            console::answer(&Readers::of(&self.commit.database).json(json));
        } else {
            match &transactions[..] {
                [] => {}
                [one] => console::say(&format!("committed as {one}")),
                [.., last] => {
                    let keys = counted(u64::try_from(import.differences.len()).unwrap_or(u64::MAX), "key");
                    console::say(&format!(
                        "{keys} written in {} transactions, the last one {last}",
                        transactions.len()
                    ));
                }
            }
        }
        if done.pending { Err(self.commit.pending()) } else { Ok(()) }
    }
}

/// The progress of an import, for a person.
struct Progress {
    output: Output,
    keys: usize,
    done: usize,
    begun: Time,
    told: Time,
}

impl Progress {
    fn new(keys: usize) -> Self {
        let now = clock::now();
        Self { output: Output::standard(), keys, done: 0, begun: now, told: now }
    }

    fn more(&mut self, keys: usize) {
        self.done += keys;
        let now = clock::now();
        if self.output.style() != Style::Plain || now.since(self.told) >= TELL_EVERY {
            self.told = now;
            let mut estimate = Estimate::default();
            estimate.jobs(Duration::ZERO, "keys", self.done, self.keys);
            self.output.line(&Line::Live(format!("written: {}", estimate.line(now.since(self.begun)))));
        }
    }
}

/// Returns the owners of prefixes.
async fn owners(databases: &Databases<'_>) -> Result<Owners, Failure> {
    let mut owners = Vec::new();
    let take = |reply| {
        let Reply::Owners(part) = reply else { return Err(refusal(&reply)) };
        owners.extend(part);
        Ok(())
    };
    databases.ask_all(Question::Owners, take).await?;
    let owner = |(prefix, robot)| (prefix, Owner { term: 0, robot, grant: None });
    Ok(owners.into_iter().map(owner).collect())
}

/// Groups the writes by the owner of their keys. All robots would refuse a transaction over keys of several owners.
fn by_owner(draft: &Draft, owners: &Owners) -> Vec<Vec<Write>> {
    let mut groups: BTreeMap<Option<String>, Vec<Write>> = BTreeMap::new();
    for (key, value) in draft.writes() {
        let owner = owners.find(key).and_then(|(_, owner)| owner.robot);
        let write = |(key, value): (&Key, Option<&Value>)| Write { key: key.clone(), value: value.cloned() };
        groups.entry(owner).or_default().push(write((key, value)));
    }
    groups.into_values().collect()
}

/// Returns conditions that fail if these keys were written again after they were read.
fn as_seen(writes: &[Write], state: &State) -> Result<Vec<Require>, Failure> {
    let condition = |key: &Key| match state.versions(key) {
        _ if state.is_conflict(key) => Err(anyhow!(
            "`{key}` has concurrent writes, and `--atomic` needs a single value; choose the value with `dca db resolve`"
        )),
        [.., last] if last.value.is_some() => Ok(Condition::Is(last.dot)),
        _ => Ok(Condition::Absent),
    };
    let require = |write: &Write| Ok(Require { key: write.key.clone(), condition: condition(&write.key)? });
    writes.iter().map(require).collect()
}

/// Explains why the file does not fit into one transaction.
fn does_not_fit(parts: &[Vec<Write>], drafts: usize) -> Failure {
    let keys = counted(parts.iter().map(|part| part.len() as u64).sum::<u64>(), "key");
    let why = if drafts == 1 {
        "the keys belong to several robots"
    } else {
        "one transaction cannot contain so many changes"
    };
    anyhow!("nothing was written: {keys} would change, and {why}; import a part of the file, or remove `--atomic`")
        .into()
}

/// Adds to a failure how much was committed before it.
fn partly(failure: Failure, done: usize, count: usize) -> Failure {
    let add = |error: anyhow::Error| {
        anyhow!(
            "{error:#}; before that, {done} of the {count} transactions for this file were committed, and the same command \
             goes on with the rest"
        )
    };
    match failure {
        Failure::Refused(error) if done > 0 => Failure::Refused(add(error)),
        Failure::Unreachable(error) if done > 0 => Failure::Unreachable(add(error)),
        Failure::Refused(_)
        | Failure::Usage(_)
        | Failure::Unreachable(_)
        | Failure::Reported
        | Failure::ReportedUnreachable
        | Failure::Limited => failure,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_goes_to_whom_its_keys_belong() {
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
        let draft = keys.iter().fold(Draft::new(""), |draft, key| draft.delete(Key::new(*key).unwrap()));
        let groups = by_owner(&draft, &owners);
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
        check(
            2,
            "`r3` is away; before that, 2 of the 3 transactions for this file were committed, and the same command goes on \
             with the rest",
        );
    }
}
