//! `dca events`: prints the events of all deployments on all hosts.

use crate::ConnectArgs;
use crate::client::feed::{Feed, FeedItem, Mode};
use crate::complete;
use crate::logic::process_name::DeploymentName;
use crate::logic::record::report_kind;
use crate::logic::suggestion;
use crate::reader::Reader;
use anyhow::anyhow;
use clap_complete::ArgValueCompleter;
use comms::io::clock;
use comms::logic::time::Time;
use node::console::{self, Failure, block_on};
use node::logic::protocol::{Deployment, Event, Report};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;
use view::RobotId;
use view::sentence::{change_text, date_and_time, report_text};

/// The arguments of `dca events`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Only of this deployment: NAME, or NAME@NUMBER for one run of it
    #[arg(value_parser = DeploymentName::parse, add = ArgValueCompleter::new(complete::deployments))]
    name: Option<DeploymentName>,
    /// Also print new events, until Ctrl-C
    #[arg(short, long)]
    follow: bool,
    /// Print each event as one object of JSON on one line; the last object has `end`
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connect: ConnectArgs,
}

/// How the stream has ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum End {
    /// All known events were printed.
    Complete,
    /// Some node has not sent its events.
    Incomplete,
    /// The user has interrupted the command.
    Interrupted,
    /// The output has no reader any more.
    Unread,
}

/// The printer of events.
#[derive(Debug)]
struct Printer<'a> {
    arguments: &'a Arguments,
    /// The earlier events, each with its time on the boot clock. They are printed in the order of this time: the clocks
    /// of two homes may differ, and may have been set.
    waiting: Option<Vec<(Duration, Event)>>,
    /// When the first event of each deployment arrived. The home of a deployment counts the ages of all of its events up to one moment.
    arrived: BTreeMap<Deployment, Time>,
    lost: BTreeSet<String>,
    /// The deployments of all events, including events that are not printed.
    known: BTreeSet<Deployment>,
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let mut printer = Printer {
        arguments,
        waiting: Some(Vec::new()),
        arrived: BTreeMap::new(),
        lost: BTreeSet::new(),
        known: BTreeSet::new(),
    };
    let end = block_on(async {
        let mut reader = Reader::new()?;
        let mode = if arguments.follow { Mode::Follow } else { Mode::Snapshot };
        let mut feed = tokio::select! {
            feed = Feed::open(&arguments.connect, mode) => feed?,
            () = reader.left() => return Ok(End::Interrupted),
        };
        let end = loop {
            let end = tokio::select! {
                said = feed.next() => printer.take(said)?,
                () = reader.left() => Some(End::Interrupted),
            };
            if let Some(end) = end {
                break end;
            }
        };
        feed.close().await;
        Ok(end)
    })?;
    printer.end(end)
}

impl Printer<'_> {
    /// Prints an item. Returns how the stream ends, if it ends with this item.
    fn take(&mut self, said: FeedItem) -> anyhow::Result<Option<End>> {
        let is_read = match said {
            FeedItem::Event(_, event) => self.event(*event)?,
            FeedItem::Reached(..) => true,
            FeedItem::Current => {
                let mut known = self.waiting.take().unwrap_or_default();
                known.sort_by(|(a, one), (b, other)| (a, one.number).cmp(&(b, other.number)));
                for (_, event) in known {
                    if !self.print(&event)? {
                        return Ok(Some(End::Unread));
                    }
                }
                if let Some(why) = self.unknown().filter(|_| self.arguments.follow) {
                    console::note(&format!("note: waiting for this deployment: {why}"));
                }
                if !self.arguments.follow {
                    return Ok(Some(if self.lost.is_empty() { End::Complete } else { End::Incomplete }));
                }
                true
            }
            FeedItem::Left(robot) => self.mark("left", &robot.host, "has left", None)?,
            FeedItem::Back(RobotId { host, .. }) => {
                self.lost.remove(&host);
                self.mark("back", &host, "is heard again", None)?
            }
            FeedItem::Lost(RobotId { host, .. }, why) => {
                self.lost.insert(host.clone());
                self.mark("lost", &host, "has stopped answering", Some(&why))?
            }
        };
        Ok((!is_read).then_some(End::Unread))
    }

    /// Returns a sentence if no event belongs to the named deployment.
    fn unknown(&self) -> Option<String> {
        let name = self.arguments.name.as_ref()?;
        if self.known.iter().any(|deployment| name.is(deployment)) {
            return None;
        }
        let near = suggestion::deployment(name, self.known.iter());
        let hint = suggestion::question(near, "`dca events` prints all known events");
        Some(format!("no node knows a deployment `{name}`; {hint}"))
    }

    fn event(&mut self, event: Event) -> anyhow::Result<bool> {
        self.known.insert(event.deployment.clone());
        if self.arguments.name.as_ref().is_some_and(|name| !name.is(&event.deployment)) {
            return Ok(true);
        }
        if let Some(waiting) = &mut self.waiting {
            let arrived = self.arrived.entry(event.deployment.clone()).or_insert_with(clock::now);
            waiting.push((arrived.since(Time::ZERO).saturating_sub(event.ago), event));
            return Ok(true);
        }
        self.print(&event)
    }

    fn print(&self, event: &Event) -> anyhow::Result<bool> {
        let line = if self.arguments.json { object(event).to_string() } else { line(event) };
        console::pass(format!("{line}\n").as_bytes())
    }

    /// Reports a change of a node: as an object between the events, or on standard error.
    fn mark(&self, key: &str, host: &str, words: &str, why: Option<&str>) -> anyhow::Result<bool> {
        if !self.arguments.json {
            let why = why.map_or(String::new(), |why| format!(": {why}"));
            console::note(&format!("`{host}` {words}{why}"));
            return Ok(true);
        }
        let mut mark = json!({ "time": clock::unix_time().as_secs_f64(), key: host });
        if let (Some(why), Some(mark)) = (why, mark.as_object_mut()) {
            mark.insert("why".to_owned(), why.into());
        }
        console::pass(format!("{mark}\n").as_bytes())
    }

    fn end(&self, end: End) -> Result<(), Failure> {
        let word = match end {
            End::Complete => "complete",
            End::Incomplete => "incomplete",
            End::Interrupted => "interrupted",
            End::Unread => return Ok(()),
        };
        let unknown = self.unknown().filter(|_| end == End::Complete);
        if self.arguments.json && unknown.is_none() {
            console::answer(&json!({ "end": word, "lost": self.lost }));
        }
        if let Some(why) = unknown {
            return Err(Failure::Usage(anyhow!(why)));
        }
        let lost: Vec<&str> = self.lost.iter().map(String::as_str).collect();
        match end {
            End::Incomplete => Err(Failure::Unreachable(anyhow!(
                "the list is not complete: `{}` has not sent its events",
                lost.join("`, `")
            ))),
            End::Complete | End::Interrupted | End::Unread => Ok(()),
        }
    }
}

/// Returns an event as a line: its time, place and content.
fn line(event: &Event) -> String {
    let text = if let Report::Process { path, change, .. } = &event.report {
        format!("{path}  {}", change_text(change))
    } else {
        report_text(&event.report)
    };
    let Event { deployment, host, time, .. } = event;
    format!("{}.{:03}Z  {host}  {deployment}  {text}", date_and_time(*time), time.subsec_millis())
}

fn object(event: &Event) -> Value {
    let (process, text, since_go) = if let Report::Process { path, change, at } = &event.report {
        (Some(path), change_text(change), Some(at.as_secs_f64()))
    } else {
        (None, report_text(&event.report), None)
    };
    json!({
        "time": event.time.as_secs_f64(),
        "host": event.host,
        "deployment": event.deployment.name,
        "epoch": event.deployment.epoch,
        "number": event.number,
        "process": process,
        "kind": report_kind(&event.report),
        "text": text,
        "since_go": since_go,
        "report": event.report,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use node::logic::protocol::Change;

    fn event(report: Report) -> Event {
        let deployment = Deployment { name: "door".into(), epoch: 3 };
        let time = Duration::from_millis(1_795_392_000_250);
        Event { deployment, number: 7, host: "c2".into(), ago: Duration::ZERO, report, time }
    }

    #[test]
    fn an_event_is_one_line() {
        let change = Change::Started { pid: 12 };
        let process = Report::Process { path: "main/hit".into(), change, at: Duration::from_millis(1500) };
        assert_eq!(
            line(&event(process.clone())),
            "2026-11-23T00:00:00.250Z  c2  door@3  main/hit  started as process 12"
        );
        let go = Report::Go { took: Duration::from_millis(340), signals: Vec::new() };
        assert_eq!(line(&event(go)), "2026-11-23T00:00:00.250Z  c2  door@3  GO after 0.3 s");
        let object = object(&event(process));
        let expected = json!({
            "time": 1_795_392_000.25, "host": "c2", "deployment": "door", "epoch": 3, "number": 7, "process": "main/hit",
            "kind": "started", "text": "started as process 12", "since_go": 1.5,
            "report": { "Process": { "path": "main/hit", "change": { "Started": { "pid": 12 } }, "at": 1.5 } },
        });
        assert_eq!(object, expected);
    }
}
