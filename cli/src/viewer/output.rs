//! The output of one process for one window of the page. It is received only while the stream of the window is open.

use super::ways::WaysRequest;
use crate::client::words;
use comms::io::clock;
use node::logic::protocol::{Answer, Request};
use serde_json::{Value, json};
use std::collections::VecDeque;
use std::time::Duration;
use tokio::sync::mpsc::{self, Receiver, Sender};
use tokio::task::JoinSet;
use view::{Lines, MissionId, Model};

/// How many pieces of output wait for the window. Further ones wait at their node.
const PIECES_MAX: usize = 64;
/// The most lines of one message. Older ones are left out.
const LINES_MAX: usize = 500;
/// The pause before a node that could not be asked is asked again.
const AGAIN_AFTER: Duration = Duration::from_secs(1);

/// A process, by the number of the plan of its mission and its path: `17-main/hit/force`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct OutputChoice {
    plan: u64,
    path: String,
}

impl OutputChoice {
    /// Reads a choice.
    pub(super) fn read(text: &str) -> Option<Self> {
        let (plan, path) = text.split_once('-')?;
        Some(Self { plan: plan.parse().ok()?, path: path.to_owned() })
    }
}

/// Returns the news that a process is not shown any more.
pub(super) fn gone() -> Value {
    json!({ "begins": true, "lines": [], "leftOut": 0, "why": "this process is no longer shown" })
}

enum Piece {
    /// The node sends the output again from its oldest line on.
    Begins,
    Bytes(Vec<u8>),
    /// There is no more output, and why.
    Ended(String),
}

/// The output of a process.
pub(super) struct Output {
    mission: MissionId,
    path: String,
    pieces: Receiver<Piece>,
    /// The task that receives. It ends with this value.
    _task: JoinSet<()>,
    lines: Lines,
    news: OutputNews,
}

/// The lines that the window does not have yet.
#[derive(Default)]
struct OutputNews {
    begins: bool,
    waiting: VecDeque<String>,
    left_out: usize,
    why: Option<String>,
}

impl Output {
    /// Begins to receive the output of a process. Returns nothing if the model has no such process.
    pub(super) fn begin(choice: OutputChoice, model: &Model, ways: &Sender<WaysRequest>) -> Option<Self> {
        let OutputChoice { plan, path } = choice;
        let live = model.planned(plan)?;
        let host = live.processes.get(&path)?.host.clone();
        let mission = live.id.clone();
        let (sink, pieces) = mpsc::channel(PIECES_MAX);
        let mut task = JoinSet::new();
        task.spawn(hear(ways.clone(), mission.clone(), host, path.clone(), sink));
        Some(Self { mission, path, pieces, _task: task, lines: Lines::default(), news: OutputNews::default() })
    }

    /// Waits until there is something new. After the end of the output, waits for ever.
    ///
    /// # Cancellation
    /// Safe.
    pub(super) async fn changed(&mut self) {
        match self.pieces.recv().await {
            Some(piece) => self.take(piece),
            None => std::future::pending().await,
        }
    }

    /// Returns what is new as JSON, if there is anything.
    pub(super) fn news(&mut self) -> Option<Value> {
        for _ in 0..PIECES_MAX {
            let Ok(piece) = self.pieces.try_recv() else { break };
            self.take(piece);
        }
        let OutputNews { begins, waiting, left_out, why } = std::mem::take(&mut self.news);
        let is_new = begins || !waiting.is_empty() || why.is_some();
        is_new.then(|| json!({ "begins": begins, "lines": waiting, "leftOut": left_out, "why": why }))
    }

    fn take(&mut self, piece: Piece) {
        let news = &mut self.news;
        match piece {
            Piece::Begins => {
                self.lines.forget(&self.mission, &self.path);
                *news = OutputNews { begins: true, ..OutputNews::default() };
            }
            Piece::Bytes(bytes) => news.waiting.extend(self.lines.push(&self.mission, &self.path, &bytes)),
            Piece::Ended(why) => news.why = Some(why),
        }
        let more = news.waiting.len().saturating_sub(LINES_MAX);
        news.waiting.drain(..more);
        news.left_out += more;
    }
}

/// Receives the output: first the earlier lines, then new ones. If the connection is lost, begins again.
async fn hear(ways: Sender<WaysRequest>, mission: MissionId, host: String, path: String, sink: Sender<Piece>) {
    let name = mission.deployment.name.clone();
    let request = Request::Logs { deployment: Some(name), process: path, follow: true };
    loop {
        let Some(found) = WaysRequest::send(&ways, Some(mission.robot(&host))).await else { return };
        let asked = found.clients.first().map(|client| client.ask_on(&host, &request));
        drop(found);
        let mut has_begun = false;
        let why = match asked {
            Some(Ok(mut answers)) => loop {
                match answers.next().await {
                    Some(Ok(Answer::Output(bytes))) => {
                        if !std::mem::replace(&mut has_begun, true) && sink.send(Piece::Begins).await.is_err() {
                            return;
                        }
                        if sink.send(Piece::Bytes(bytes)).await.is_err() {
                            return;
                        }
                    }
                    Some(Ok(Answer::Refused(why))) => return drop(sink.send(Piece::Ended(why)).await),
                    Some(Ok(_)) | None => {
                        return drop(sink.send(Piece::Ended("the output has ended".to_owned())).await);
                    }
                    Some(Err(failure)) => break words(&failure),
                }
            },
            Some(Err(failure)) => words(&failure),
            None => format!("`{host}` does not answer"),
        };
        if sink.send(Piece::Ended(format!("{why}; asking again"))).await.is_err() {
            return;
        }
        clock::sleep_until(clock::now() + AGAIN_AFTER).await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use node::logic::protocol::Deployment;
    use view::Fleet;

    #[test]
    fn a_choice_has_a_plan_and_a_path() {
        let choice = OutputChoice { plan: 17, path: "main/hit-1/force".to_owned() };
        assert_eq!(OutputChoice::read("17-main/hit-1/force"), Some(choice));
        for wrong in ["", "17", "-main", "x-main", "-1-main"] {
            assert_eq!(OutputChoice::read(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn a_slow_window_loses_the_oldest_lines_and_is_told_how_many() {
        let (sink, pieces) = mpsc::channel(PIECES_MAX);
        let deployment = Deployment { name: "door".into(), epoch: 1 };
        let mission = MissionId { deployment, home: "c1".into(), fleet: Fleet::Standing };
        let mut output = Output {
            mission,
            path: "main/a".to_owned(),
            pieces,
            _task: JoinSet::new(),
            lines: Lines::default(),
            news: OutputNews::default(),
        };
        assert!(output.news().is_none());
        let many: String = (0..LINES_MAX + 2).map(|number| format!("line {number}\n")).collect();
        for piece in [Piece::Bytes(b"old\nhalf".to_vec()), Piece::Begins, Piece::Bytes(many.into_bytes())] {
            assert!(sink.try_send(piece).is_ok());
        }
        let news = output.news().expect("there are lines");
        assert_eq!((&news["begins"], &news["leftOut"], &news["lines"][0]), (&true.into(), &2.into(), &"line 2".into()));
        assert_eq!(news["lines"].as_array().map(Vec::len), Some(LINES_MAX));
        assert!(output.news().is_none());
        assert!(sink.try_send(Piece::Bytes(b"\x1b[2J<b>\n".to_vec())).is_ok());
        assert_eq!(output.news().expect("there is a line")["lines"], json!(["\\x1b[2J<b>"]));
    }
}
