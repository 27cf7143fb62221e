//! `dca db watch`: prints every change of keys as it happens. Changes that happen while no robot can be reached are printed later.

use super::databases::{ANSWER_WITHIN, DatabaseArgs, Databases, Replies, keys, refusal};
use super::moment::zone;
use super::readers::Readers;
use crate::reader::Reader;
use anyhow::anyhow;
use comms::io::clock;
use dbmanager::logic::version_vector::VersionVector;
use dbmanager::logic::view::past::Keys;
use dbmanager::logic::view::table::{self, Span};
use dbmanager::logic::view::token;
use dbmanager::logic::view::watch::{Event, Notification};
use node::console::{self, Failure};
use node::logic::database::question::{Question, Reply};
use std::time::Duration;

/// The pause before the next search for a robot that can no longer be reached.
const AGAIN_AFTER: Duration = Duration::from_millis(500);

/// The arguments of `dca db watch`.
#[derive(Debug, clap::Args)]
pub struct Watch {
    /// A key, or a prefix that ends in `/` [default: all keys]
    #[arg(default_value = "")]
    key: String,
    /// Continue after this version, as `dca db version` and an earlier watch print it
    #[arg(long, value_name = "VERSION", value_parser = a_version)]
    from: Option<VersionVector>,
    #[command(flatten)]
    database: DatabaseArgs,
}

impl Watch {
    /// Runs the verb until the user interrupts it.
    pub(crate) fn run(self) -> Result<(), Failure> {
        let keys = keys(self.key.clone())?;
        let mut told = self.from.clone();
        let result = self.database.with(async |databases| {
            let mut reader = Reader::new()?;
            tokio::select! {
                result = self.follow(databases, keys, &mut told) => result,
                () = reader.left() => Ok(()),
            }
        });
        if let Some(told) = told.filter(|_| !self.database.json) {
            console::note(&format!("to go on from here: --from {}", token::token(&told)));
        }
        result
    }

    async fn follow(
        &self,
        databases: &Databases<'_>,
        keys: Keys,
        told: &mut Option<VersionVector>,
    ) -> Result<(), Failure> {
        loop {
            let question = Question::Watch { keys: keys.clone(), from: told.clone() };
            let mut replies = databases.ask(databases.robot(), question).await?;
            match replies.next(clock::now() + ANSWER_WITHIN).await {
                Ok(Some(Reply::Version(version))) => {
                    if told.is_none() && !self.database.json {
                        console::note(&format!("watching, with dates in {}; ^C ends it", zone()));
                    }
                    *told = Some(version);
                }
                Ok(Some(other)) => return Err(refusal(&other)),
                // The robot has answered before. When it returns, it sends the missed changes.
                Ok(None) | Err(Failure::Unreachable(_)) if told.is_some() => {}
                Ok(None) => return Err(replies.ended()),
                Err(failure) => return Err(failure),
            }
            match self.take(&mut replies, told).await {
                Ok(()) | Err(Failure::Unreachable(_)) => {}
                Err(failure) => return Err(failure),
            }
            clock::sleep_until(clock::now() + AGAIN_AFTER).await;
        }
    }

    /// Prints the changes until the answers end.
    async fn take(&self, replies: &mut Replies, told: &mut Option<VersionVector>) -> Result<(), Failure> {
        while let Some(reply) = replies.more().await? {
            let Reply::Notification(told_now) = reply else { return Err(refusal(&reply)) };
            match told_now {
                Notification::Event(event) => {
                    told.get_or_insert_default().include(event.entry.dot);
                    self.print(&event)?;
                }
                Notification::Lagged { resume } => {
                    *told = Some(resume);
                    self.begin_anew("some changes are no longer stored");
                }
                Notification::Replaced { resume } => {
                    *told = Some(resume);
                    self.begin_anew("this robot has taken over the state of another robot");
                }
            }
        }
        Ok(())
    }

    fn begin_anew(&self, why: &str) {
        if self.database.json {
            console::answer(&serde_json::json!({ "read_anew": why }));
        } else {
            console::note(&format!("{why}: read the state, `dca db get {}`", self.key));
        }
    }

    fn print(&self, event: &Event) -> Result<(), Failure> {
        // The readers are looked up again each time, because the team may change during a watch.
        let readers = Readers::of(&self.database);
        if self.database.json {
            console::answer(&readers.json(serde_json::to_value(event)?));
            return Ok(());
        }
        // The first line of the table is its heading, which is not printed here.
        let entry = std::slice::from_ref(&event.entry);
        let lines = table::history(entry, Span::All, &|datum| readers.text(datum), clock::minutes_ahead);
        lines.lines().skip(1).for_each(console::say);
        for key in &event.conflicts {
            console::note(&format!("note: `{key}` has concurrent writes; `dca db conflicts {key}` lists them"));
        }
        Ok(())
    }
}

fn a_version(text: &str) -> Result<VersionVector, String> {
    token::vector(text).ok_or_else(|| anyhow!("write a version as `dca db version` prints it").to_string())
}
