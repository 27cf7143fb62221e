//! The node's session with other nodes and with command lines: presence, frames and calls, as inputs for the agent.

use crate::logic::agent::Input;
use crate::logic::link::Frame;
use crate::logic::protocol::{Answer, Request, SILENCE_MAX};
use anyhow::Context;
use comms::io::session::{self, NodeOptions, Presence, Server, Session, Subscription, Token, Watch};
use comms::logic::port::Policy;
use comms::logic::{codec, key};
use std::collections::BTreeMap;
use std::sync::Arc;
use tokio::sync::mpsc::Sender;
use tokio::task::JoinSet;

/// How many frames wait for the agent; more are dropped, and their senders send them again.
const FRAMES_MAX: usize = 4096;
/// How many answers wait for one caller; one that takes fewer than this behind is given up.
const ANSWERS_MAX: usize = 4096;

/// The open session of a node.
#[derive(Debug)]
pub struct Peers {
    session: Arc<Session>,
    token: Token,
    calls: BTreeMap<u64, Sender<Answer>>,
}

/// What comes in from outside.
#[derive(Debug)]
pub enum Arrival {
    /// For the agent.
    Input(Input),
    /// A call: its number, and where its answers go.
    Call(u64, Request, Sender<Answer>),
}

impl Peers {
    /// Opens the session, announces the node and begins to listen; arrivals go to `sink` from tasks of `tasks`.
    ///
    /// # Errors
    /// The session cannot be opened.
    pub async fn open(
        options: NodeOptions,
        boot: u64,
        sink: Sender<Arrival>,
        tasks: &mut JoinSet<()>,
    ) -> anyhow::Result<Self> {
        let host = options.name.clone();
        let session = Session::open_node(options).await.with_context(|| format!("opening the node `{host}`"))?;
        let inbox = session.subscribe(&key::inbox(host.as_str()), Policy::reject(FRAMES_MAX))?;
        let calls = session.serve(&key::rpc_any(host.as_str()))?;
        let presence = session.watch(&key::live_any())?;
        let token = session.announce(&key::live(host.as_str(), boot))?;
        tasks.spawn(hear_frames(inbox, sink.clone()));
        tasks.spawn(hear_presence(presence, sink.clone()));
        tasks.spawn(hear_calls(calls, sink));
        Ok(Self { session: Arc::new(session), token, calls: BTreeMap::new() })
    }

    /// Sends a frame; one that is lost is sent again by its link.
    pub fn send(&self, to: &str, frame: &Frame) {
        let sent = codec::encode(frame).map_err(anyhow::Error::from);
        let sent = sent.and_then(|bytes| Ok(self.session.put(&key::inbox(to), bytes)?));
        if let Err(error) = sent {
            tracing::warn!(host = to, error = format!("{error:#}"), "cannot send to a node");
        }
    }

    /// Notes where the answers of a call go.
    pub fn expect(&mut self, call: u64, sink: Sender<Answer>) {
        self.calls.insert(call, sink);
    }

    /// Answers a call. Returns whether the caller is still there.
    pub fn answer(&self, call: u64, answer: Answer) -> bool {
        // A caller that does not take its answers must not hold the node up.
        self.calls.get(&call).is_some_and(|sink| sink.try_send(answer).is_ok())
    }

    /// Ends the answers of a call; returns where they went.
    pub fn end(&mut self, call: u64) -> Option<Sender<Answer>> {
        self.calls.remove(&call)
    }

    /// Returns the session, for the database, which closes before this does.
    pub fn session(&self) -> &Arc<Session> {
        &self.session
    }

    /// Closes the session.
    pub async fn close(self) {
        drop(self.token);
        match Arc::into_inner(self.session) {
            Some(session) => session.close().await,
            None => tracing::debug!("somebody still uses the session; it closes with the process"),
        }
    }
}

async fn hear_frames(mut inbox: Subscription, sink: Sender<Arrival>) {
    while let Some((_, bytes)) = inbox.next().await {
        match codec::decode::<Frame>(&bytes) {
            Ok(frame) => {
                if sink.send(Arrival::Input(Input::Frame(Box::new(frame)))).await.is_err() {
                    return;
                }
            }
            Err(error) => tracing::warn!(%error, "a frame of a node cannot be read"),
        }
    }
}

async fn hear_presence(mut watch: Watch, sink: Sender<Arrival>) {
    while let Some(presence) = watch.next().await {
        let (key, appeared) = match presence {
            Presence::Appeared(key) => (key, true),
            Presence::Vanished(key) => (key, false),
        };
        let Some((host, boot)) = key::parse_live(&key) else { continue };
        let input = if appeared { Input::Appeared { host, boot } } else { Input::Vanished { host, boot } };
        if sink.send(Arrival::Input(input)).await.is_err() {
            return;
        }
    }
}

async fn hear_calls(mut calls: Server, sink: Sender<Arrival>) {
    let (mut number, mut answering) = (0, JoinSet::new());
    while let Some(request) = calls.next().await {
        while answering.try_join_next().is_some() {}
        number += 1;
        match codec::decode::<Request>(&request.payload()) {
            Ok(asked) => {
                let (answers, to_send) = tokio::sync::mpsc::channel(ANSWERS_MAX);
                answering.spawn(reply(request, to_send));
                if sink.send(Arrival::Call(number, asked, answers)).await.is_err() {
                    return;
                }
            }
            Err(error) => request.refuse(&format!("the request cannot be read: {error}")),
        }
    }
}

/// Passes answers on, and says in the pauses that there may be more.
async fn reply(request: session::Request, mut answers: tokio::sync::mpsc::Receiver<Answer>) {
    let mut pause = tokio::time::interval(SILENCE_MAX / 4);
    pause.reset();
    loop {
        tokio::select! {
            answer = answers.recv() => match answer.map(|answer| codec::encode(&answer)) {
                Some(Ok(bytes)) => request.reply(bytes),
                Some(Err(error)) => return request.refuse(&format!("the answer cannot be written: {error}")),
                None => return,
            },
            _ = pause.tick() => request.still_here(),
        }
    }
}
