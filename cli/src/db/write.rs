//! `dca db put` and `dca db delete`: commit one transaction, and report which level it has reached.

use super::databases::{ANSWER_WITHIN, DatabaseArgs, Databases, refusal};
use super::secret::SecretArgs;
use anyhow::{Context, anyhow};
use comms::io::clock;
use comms::logic::human::span;
use dbmanager::logic::key::{Key, Namespace};
use dbmanager::logic::txn::{Require, Write};
use dbmanager::logic::version_vector::Dot;
use dbmanager::logic::view::value::{Datum, TextError};
use node::console::{self, Failure};
use node::logic::database::question::{AckLevel, Commit, Question, Reply};
use node::logic::database::settings::spelt;
use node::logic::database::table::no_robot;
use node::logic::parameters::{self, Verdict};
use node::logic::protocol::InstanceParameters;
use std::collections::BTreeMap;
use std::time::Duration;

/// The arguments of every verb that commits a transaction.
#[derive(Debug, clap::Args)]
pub struct CommitArgs {
    /// The reason, for the history
    #[arg(long, short = 'm', value_name = "WHY", default_value = "")]
    reason: String,
    /// Wait until it is on disks: `local`, `replicated:2`, `on:r2,r3` or `everywhere`
    #[arg(long, value_name = "LEVEL", default_value = "local", value_parser = ack_level)]
    pub(crate) level: AckLevel,
    /// The time limit for this, such as `2s` or `500ms`
    #[arg(long, value_name = "TIME", default_value = "5s", value_parser = time)]
    pub(crate) within: Duration,
    #[command(flatten)]
    pub(crate) database: DatabaseArgs,
}

/// The arguments of `dca db put`.
#[derive(Debug, clap::Args)]
pub struct Put {
    /// A key, such as `team/camera/gain`
    key: String,
    /// A value as in TOML: `1.5`, `true`, `"text"`, `[1, 2]`, `{x = 1.0, y = 2.0}`; of a parameter also a quantity: `20 N`
    #[arg(allow_hyphen_values = true, required_unless_present = "secret", conflicts_with = "secret")]
    value: Option<String>,
    /// The value is a text, without quotes
    #[arg(long, conflicts_with_all = ["from_json", "secret"])]
    text: bool,
    /// The value is JSON
    #[arg(long, conflicts_with = "secret")]
    from_json: bool,
    #[command(flatten)]
    secret: SecretArgs,
    #[command(flatten)]
    commit: CommitArgs,
}

/// The arguments of `dca db delete`.
#[derive(Debug, clap::Args)]
pub struct Delete {
    /// The keys
    #[arg(required = true)]
    keys: Vec<String>,
    #[command(flatten)]
    commit: CommitArgs,
}

impl Put {
    /// Runs the verb.
    pub(crate) fn run(self) -> Result<(), Failure> {
        let key = Key::new(self.key)?;
        let Some(value) = self.value else { return self.secret.put(key, &self.commit) };
        let datum = if self.text {
            Datum::Text(value)
        } else if self.from_json {
            Datum::from_json(&value).context("reading the value")?
        } else {
            written(key.as_str(), &value).with_context(|| {
                format!("cannot read the value; to write it as a text, use `dca db put {key} --text '{value}'`")
            })?
        };
        self.commit.commit(vec![], vec![Write { key, value: Some(datum.encode()?) }])
    }
}

impl Delete {
    /// Runs the verb.
    pub(crate) fn run(self) -> Result<(), Failure> {
        // An earlier version may have written keys that are not valid any more. They can still be deleted.
        let keys: Result<Vec<Key>, _> = self.keys.into_iter().map(Key::try_from).collect();
        let writes = keys?.into_iter().map(|key| Write { key, value: None }).collect();
        self.commit.commit(vec![], writes)
    }
}

/// The progress of a transaction.
pub(crate) enum CommitProgress {
    /// It has reached the requested level.
    AckLevel(Dot),
    /// It is on a disk, but has not reached the requested level.
    Pending(Dot),
    /// There was nothing to commit.
    Done(String),
}

/// Returns whether a transaction writes only below `local/`. Such a transaction is in no log, so its name is of no use.
fn stays_here(question: &Question) -> bool {
    let Question::Commit(commit) = question else { return false };
    commit.writes.iter().all(|write| write.key.namespace() == Namespace::Local)
}

impl CommitArgs {
    /// Returns the options of a commit to the disk of one robot.
    pub(crate) fn local(reason: String, within: Duration, database: DatabaseArgs) -> Self {
        Self { reason, level: AckLevel::Local, within, database }
    }

    /// Commits on the robot that owns the keys, and reports the level that was reached.
    pub(crate) fn commit(&self, requires: Vec<Require>, writes: Vec<Write>) -> Result<(), Failure> {
        self.send(&self.question(self.reason.clone(), requires, writes))
    }

    /// Returns the question that asks for a commit.
    pub(crate) fn question(&self, reason: String, requires: Vec<Require>, writes: Vec<Write>) -> Question {
        let (level, within) = (self.level.clone(), self.within);
        Question::Commit(Commit { reason, requires, writes, level, within })
    }

    /// Returns the reason that the user gave, or else `otherwise`.
    pub(crate) fn reason_or(&self, otherwise: &str) -> String {
        if self.reason.is_empty() { otherwise.to_owned() } else { self.reason.clone() }
    }

    /// Sends a question to the robot that owns the keys, and reports the level that was reached. The answers to the
    /// question have to be those to a transaction.
    pub(crate) fn send(&self, question: &Question) -> Result<(), Failure> {
        let (dot, reached) = match self.database.with(async |databases| self.write_on(databases, question).await)? {
            CommitProgress::AckLevel(dot) => (dot, true),
            CommitProgress::Pending(dot) => (dot, false),
            CommitProgress::Done(sentence) => {
                console::say(&sentence);
                return Ok(());
            }
        };
        if self.database.json {
            console::answer(&serde_json::json!({ "transaction": dot.to_string(), "reached": reached }));
        } else {
            console::say(&if stays_here(question) {
                "written, on this robot only".to_owned()
            } else {
                format!("committed as {dot}")
            });
        }
        if reached { Ok(()) } else { Err(self.pending()) }
    }

    /// Returns the failure that the write has not reached the requested level in time.
    pub(crate) fn pending(&self) -> Failure {
        Failure::Unreachable(anyhow!(
            "the write is committed and will reach the other robots, but it has not reached the requested level within {}; `dca db \
             status` shows who is behind",
            span(self.within)
        ))
    }

    /// Writes on the robot that owns the keys.
    pub(crate) async fn write_on(
        &self,
        databases: &Databases<'_>,
        question: &Question,
    ) -> Result<CommitProgress, Failure> {
        if let Question::Commit(commit) = question {
            check_parameters(databases, &commit.writes).await?;
        }
        match self.ask(databases, databases.robot(), question.clone()).await? {
            Ok(got) => Ok(got),
            Err(owner) => self.forward(databases, &owner, question.clone()).await,
        }
    }

    /// Asks one robot. If only another robot may write these keys, returns the name of that robot.
    async fn ask(
        &self,
        databases: &Databases<'_>,
        robot: &str,
        question: Question,
    ) -> Result<Result<CommitProgress, String>, Failure> {
        let mut replies = databases.ask(robot, question).await?;
        let first = replies.next(clock::now() + ANSWER_WITHIN).await?.ok_or_else(|| replies.ended())?;
        if let Reply::NotOwner { owner } = first {
            return Ok(Err(owner));
        }
        if let Reply::Done(sentence) = first {
            return Ok(Ok(CommitProgress::Done(sentence)));
        }
        let Reply::Committed(dot) = first else { return Err(refusal(&first)) };
        if self.level == AckLevel::Local {
            return Ok(Ok(CommitProgress::AckLevel(dot)));
        }
        match replies.next(clock::now() + self.within + ANSWER_WITHIN).await {
            Ok(Some(Reply::Reached(dot))) => Ok(Ok(CommitProgress::AckLevel(dot))),
            // The transaction is on a disk, even if the asked robot cannot be reached any more.
            Ok(Some(Reply::Pending(_)) | None) | Err(Failure::Unreachable(_)) => Ok(Ok(CommitProgress::Pending(dot))),
            Ok(Some(other)) => Err(refusal(&other)),
            Err(failure) => Err(failure),
        }
    }

    /// Sends a transaction to the robot that owns its keys.
    async fn forward(
        &self,
        databases: &Databases<'_>,
        owner: &str,
        question: Question,
    ) -> Result<CommitProgress, Failure> {
        if !databases.reaches(owner).await? {
            let status = databases.ask_one(databases.robot(), Question::Status).await;
            if let Ok(Reply::Status(status)) = status
                && let Some(why) = no_robot(owner, status.members.iter().map(|member| member.robot.as_str()))
            {
                return Err(
                    anyhow!("{why}; `dca db own PREFIX ROBOT --by-force` gives these keys to another robot").into()
                );
            }
            return Err(Failure::Unreachable(anyhow!(
                "only `{owner}` may write these keys, and it cannot be reached now; nothing was written"
            )));
        }
        match self.ask(databases, owner, question).await {
            Ok(Ok(got)) => Ok(got),
            Ok(Err(other)) => {
                Err(anyhow!("`{owner}` reports that only `{other}` may write these keys; nothing was written").into())
            }
            Err(Failure::Unreachable(_)) => Err(Failure::Unreachable(anyhow!(
                "`{owner}`, the owner of these keys, has not answered. The write may have been done; check with `dca db get` when the \
                 owner answers again"
            ))),
            Err(failure) => Err(failure),
        }
    }
}

/// Reads a value that is written as in TOML. The value of a parameter may also be a quantity, which becomes a text.
pub(crate) fn written(key: &str, value: &str) -> Result<Datum, TextError> {
    Datum::from_toml(value).or_else(|error| {
        let is_quantity = parameters::robot_of(key).is_some() && language::is_quantity(value);
        if is_quantity { Ok(Datum::Text(value.trim().to_owned())) } else { Err(error) }
    })
}

/// Refuses values that no running program accepts. Prints a note if this cannot be checked.
async fn check_parameters(databases: &Databases<'_>, writes: &[Write]) -> Result<(), Failure> {
    let mut known: BTreeMap<&str, Vec<InstanceParameters>> = BTreeMap::new();
    let values = writes.iter().filter_map(|write| Some((write.key.as_str(), write.value.as_ref()?)));
    for (key, value) in values {
        let Some(robot) = parameters::robot_of(key) else { continue };
        if !known.contains_key(robot) {
            let told = match databases.parameters(robot).await {
                Ok(told) => told,
                // The robot that gets the write reports whether it can be written there.
                Err(Failure::Unreachable(_)) => continue,
                Err(failure) => return Err(failure),
            };
            known.insert(robot, told);
        }
        let known = known.get(robot).map(Vec::as_slice).unwrap_or_default();
        match parameters::check(key, &spelt(&Datum::of(value)), known) {
            Verdict::Fits => {}
            Verdict::Unknown(why) => console::note(&format!("note: {why}")),
            Verdict::Refused(why) => return Err(anyhow!("{why}; nothing was written").into()),
        }
    }
    Ok(())
}

/// Reads a level of acknowledgement.
fn ack_level(text: &str) -> Result<AckLevel, String> {
    let names = |names: &str| names.split(',').map(str::to_owned).collect::<Vec<_>>();
    match text.split_once(':') {
        None if text == "local" => Ok(AckLevel::Local),
        None if text == "everywhere" => Ok(AckLevel::Everywhere),
        Some(("replicated", count)) => match count.parse() {
            Ok(count) if count > 0 => Ok(AckLevel::Replicated(count)),
            _ => Err(format!("`{count}` is not a number of robots")),
        },
        Some(("on", robots)) if !robots.split(',').any(str::is_empty) => Ok(AckLevel::On(names(robots))),
        _ => Err("a level is `local`, `replicated:2`, `on:r2,r3` or `everywhere`".to_owned()),
    }
}

/// Reads a length of time.
fn time(text: &str) -> Result<Duration, String> {
    let wrong = || "a time is a number with a unit: `500ms`, `2s`, `1.5s`, `1min`".to_owned();
    let at = text.find(|c: char| c.is_ascii_alphabetic()).ok_or_else(wrong)?;
    let (number, unit) = text.split_at(at);
    let number: f64 = number.trim().parse().map_err(|_not_a_number| wrong())?;
    let seconds = match unit {
        "ms" => number / 1e3,
        "s" => number,
        "min" => number * 60.0,
        _ => return Err(wrong()),
    };
    Duration::try_from_secs_f64(seconds).map_err(|_out_of_range| wrong())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_and_times() {
        assert_eq!(ack_level("local"), Ok(AckLevel::Local));
        assert_eq!(ack_level("replicated:2"), Ok(AckLevel::Replicated(2)));
        assert_eq!(ack_level("on:r2,r3"), Ok(AckLevel::On(vec!["r2".into(), "r3".into()])));
        for bad in ["", "replicated", "replicated:0", "on:", "on:a,,b", "everywhere:1", "2"] {
            assert!(ack_level(bad).is_err(), "{bad}");
        }
        assert_eq!(time("500ms"), Ok(Duration::from_millis(500)));
        assert_eq!(time("1.5 s").map(|time| time.as_millis()), Ok(1500));
        for bad in ["", "2", "s", "-1s", "2h", "nan s"] {
            assert!(time(bad).is_err(), "{bad}");
        }
    }
}
