//! The server's side of calls.
//!
//! A caller of a stream asks for one piece after the other, and the server sends nothing else ([`super::stream`]). Each
//! stream has a task that sends the requested piece as soon as there is an answer. So zenoh's threads send nothing.

mod request;

use super::Session;
use super::call::CallError;
use super::open::plain;
use super::proof::{self, Authenticator, Digest};
use super::stream::{Outgoing, Pull, StreamId};
use crate::io::clock;
use crate::io::queue::{self, Receiver, Sender};
use crate::logic::port::{Policy, Pushed};
use crate::logic::proof::Proof;
use crate::logic::time::Time;
use crate::logic::{codec, key};
use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::{Notify, watch};
use tokio::task::JoinSet;
use zenoh::Wait;
use zenoh::bytes::Encoding;
use zenoh::query::{Query, Queryable};

/// Marks an error reply as ours. Zenoh also makes error replies.
pub(super) const REFUSED: &str = "dca/refused";
/// The most requests that wait to be taken.
const REQUESTS_MAX: usize = 256;
/// The most streams of one server. A new stream replaces a stream without a reader.
const STREAMS_MAX: usize = 256;
/// How long a stream is kept while its caller asks for nothing: a person may be reading in a pager.
const IDLE_MAX: Duration = Duration::from_secs(600);
/// The shortest time for which such a stream is kept, even if there are too many streams.
const IDLE_MIN: Duration = Duration::from_secs(20);

/// Receives the calls to a key until it is dropped.
#[derive(Debug)]
pub struct Server {
    requests: Receiver<Request>,
    streams: Arc<Streams>,
    sending: JoinSet<()>,
    answering: watch::Sender<()>,
    _queryables: [Queryable<()>; 2],
}

/// One call. A call for one answer is complete with its first answer. A stream is complete only with [`Request::finish`]; if
/// the request is dropped before, the stream is broken.
#[derive(Debug)]
pub struct Request {
    key: String,
    payload: Vec<u8>,
    asked: Asked,
    caller: Caller,
}

/// A question, to which its answers refer, and the signer of the question.
#[derive(Debug)]
struct Asked {
    authenticator: Option<Arc<dyn Authenticator>>,
    question: Digest,
    proof: Option<Proof>,
}

#[derive(Debug)]
enum Caller {
    /// The caller wants one answer; `None` after the answer.
    One(Option<Query>),
    /// The caller asks for one piece after the other.
    Stream(Arc<Stream>),
}

/// The streams of a server.
#[derive(Debug, Default)]
struct Streams {
    known: Mutex<HashMap<StreamId, Arc<Stream>>>,
    /// Signs answers, in a team.
    authenticator: Option<Arc<dyn Authenticator>>,
}

/// A stream of answers between the program that gives them and the caller that asks for them.
#[derive(Debug)]
struct Stream {
    id: StreamId,
    question: Digest,
    authenticator: Option<Arc<dyn Authenticator>>,
    state: Mutex<State>,
    /// Notified when the server or the caller has sent something.
    changed: Notify,
    /// Notified when there is room for answers, or the stream has lost its reader.
    taken: Notify,
}

#[derive(Debug)]
struct State {
    outgoing: Outgoing,
    /// The caller's open request: the query, the most bytes of the answer, and whether answers waited when the request came.
    pull: Option<(Query, u32, bool)>,
    /// When the caller was last answered.
    answered: Time,
    /// Whether the server sends signs of life to the caller.
    is_here: bool,
    /// Whether no more answers will be given.
    is_dropped: bool,
    /// Whether the stream has no reader any more.
    is_left: bool,
    /// Whether an earlier piece has already proved the author of the answers to the caller.
    is_shown: bool,
}

/// The next step of a stream.
enum Turn {
    /// Send this, with a proof.
    Send(Query, Vec<u8>, Option<Vec<u8>>),
    /// Wait for a change; without a pull, for at most this long.
    Wait(Option<Duration>),
    /// Nothing more.
    Over,
}

impl Server {
    /// Serves `key` on a session.
    pub(super) fn open(session: &Session, key: &str) -> Result<Self, CallError> {
        let (to_serve, requests) = queue::channel(Policy::reject(REQUESTS_MAX));
        let streams = Streams { authenticator: session.authenticator.clone(), ..Streams::default() };
        let (streams, to_serve) = (Arc::new(streams), Arc::new(to_serve));
        let serve = |key: &str| {
            let (known, to_serve) = (Arc::clone(&streams), Arc::clone(&to_serve));
            let on_query = move |query| known.hear(query, &to_serve);
            let queryable = session.opened.session.declare_queryable(key).complete(true).callback(on_query).wait();
            queryable.map_err(|cause| CallError::Session { key: key.to_owned(), cause: plain(&cause) })
        };
        let queryables = [serve(key)?, serve(&key::of_session(key, &session.id()))?];
        let answering = session.answering.clone();
        Ok(Self { requests, streams, sending: JoinSet::new(), answering, _queryables: queryables })
    }

    /// Returns the next call; none once the session is closed.
    ///
    /// # Cancellation
    /// Safe.
    pub async fn next(&mut self) -> Option<Request> {
        while self.sending.try_join_next().is_some() {}
        let request = self.requests.recv().await?;
        if let Caller::Stream(stream) = &request.caller {
            let (stream, streams, answering) =
                (Arc::clone(stream), Arc::clone(&self.streams), self.answering.subscribe());
            self.sending.spawn(async move {
                stream.send().await;
                streams.lock().remove(&stream.id);
                drop(answering);
            });
        }
        Some(request)
    }
}

impl Streams {
    fn lock(&self) -> MutexGuard<'_, HashMap<StreamId, Arc<Stream>>> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes a message of a caller. Called by zenoh.
    fn hear(&self, query: Query, to_serve: &Sender<Request>) {
        let one = |nonce: &[u8], proof| {
            let asked = self.asked(&query, nonce, proof);
            pass(Request::new(&query, asked, Caller::One(Some(query.clone()))), to_serve);
        };
        let Some(pull) = query.attachment() else { return one(&[], None) };
        match codec::decode(&pull.to_bytes()) {
            Ok(Pull::One { nonce, proof }) => one(&nonce, proof),
            Ok(Pull::First { stream, size }) => {
                let asked = self.asked(&query, &stream.nonce(), None);
                let made = self.make(stream, asked.question);
                let Some(made) = made else { return refuse(&query, "it is already answering too many requests") };
                let request = Request::new(&query, asked, Caller::Stream(Arc::clone(&made)));
                made.ask(query, size);
                pass(request, to_serve);
            }
            Ok(Pull::Next { stream, size }) => match self.find(&stream) {
                Some(stream) => stream.ask(query, size),
                None => refuse(&query, "it has discarded an answer that was not fetched, or it was started again"),
            },
            Ok(Pull::Leave { stream }) => self.find(&stream).iter().for_each(|stream| stream.leave()),
            Err(error) => refuse(&query, &format!("the request cannot be read: {error}")),
        }
    }

    fn asked(&self, query: &Query, nonce: &[u8], proof: Option<Proof>) -> Asked {
        let payload = query.payload().map(|payload| payload.to_bytes()).unwrap_or_default();
        let question = proof::question(key::without_session(query.key_expr().as_str()), nonce, &payload);
        Asked { authenticator: self.authenticator.clone(), question, proof }
    }

    fn find(&self, stream: &StreamId) -> Option<Arc<Stream>> {
        self.lock().get(stream).cloned()
    }

    /// Makes a stream, if there is room for one. If there are too many, it removes the stream whose caller has been silent
    /// for longest.
    fn make(&self, id: StreamId, question: Digest) -> Option<Arc<Stream>> {
        let mut streams = self.lock();
        if streams.len() >= STREAMS_MAX {
            let idle = streams.values().filter_map(|stream| Some((stream.idle_since()?, stream)));
            let (since, idlest) = idle.min_by_key(|(since, _)| *since)?;
            if clock::now() - since < IDLE_MIN {
                return None;
            }
            idlest.leave();
            let idlest = idlest.id.clone();
            streams.remove(&idlest);
        }
        let state = State {
            outgoing: Outgoing::default(),
            pull: None,
            answered: clock::now(),
            is_here: false,
            is_dropped: false,
            is_left: false,
            is_shown: false,
        };
        let (changed, taken) = (Notify::new(), Notify::new());
        let authenticator = self.authenticator.clone();
        let state = Mutex::new(state);
        let stream = Arc::new(Stream { id: id.clone(), question, authenticator, state, changed, taken });
        streams.insert(id, Arc::clone(&stream));
        Some(stream)
    }
}

/// Hands a request on, or refuses it if too many requests wait.
fn pass(request: Request, to_serve: &Sender<Request>) {
    if let Pushed::Rejected(request) = to_serve.push(request) {
        request.refuse("it has too many requests waiting; try again");
    }
}

/// Sends an answer on a separate thread: zenoh waits while the link takes nothing.
async fn send(query: Query, bytes: Vec<u8>, proof: Option<Vec<u8>>) {
    let sending = tokio::task::spawn_blocking(move || {
        let reply = query.reply(query.key_expr().clone(), bytes);
        let sent = if let Some(proof) = proof { reply.attachment(proof).wait() } else { reply.wait() };
        if let Err(error) = sent {
            tracing::debug!(key = query.key_expr().as_str(), %error, "an answer was not sent");
        }
    });
    if let Err(error) = sending.await {
        tracing::debug!(%error, "an answer was not sent");
    }
}

fn refuse(query: &Query, reason: &str) {
    if let Err(error) = query.reply_err(reason).encoding(Encoding::from(REFUSED)).wait() {
        tracing::debug!(key = query.key_expr().as_str(), %error, "a refusal was not sent");
    }
}

impl Stream {
    fn lock(&self) -> MutexGuard<'_, State> {
        // Nothing in a critical section of this file can panic.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn ask(&self, query: Query, size: u32) {
        let mut state = self.lock();
        let was_ready = state.outgoing.is_ready();
        state.pull = Some((query, size, was_ready));
        drop(state);
        self.changed.notify_one();
    }

    fn leave(&self) {
        self.lock().is_left = true;
        self.changed.notify_one();
        self.taken.notify_one();
    }

    fn idle_since(&self) -> Option<Time> {
        let state = self.lock();
        state.pull.is_none().then_some(state.answered)
    }

    /// Changes the state of the stream, and wakes the task that sends.
    fn change(&self, change: impl FnOnce(&mut State)) {
        change(&mut self.lock());
        self.changed.notify_one();
    }

    /// Adds an answer. Returns whether the stream still has a reader, or `None` while the answer does not fit.
    fn give(&self, answer: &[u8]) -> Option<bool> {
        let mut state = self.lock();
        let is_taken = !state.is_left;
        if is_taken {
            state.outgoing.has_room().then(|| state.outgoing.push(answer))?;
        }
        drop(state);
        self.changed.notify_one();
        Some(is_taken)
    }

    /// Sends the requested pieces, until all are taken or the reader has left.
    async fn send(&self) {
        loop {
            match self.turn() {
                Turn::Send(query, piece, proof) => {
                    send(query, piece, proof).await;
                    self.taken.notify_one();
                }
                Turn::Wait(None) => self.changed.notified().await,
                Turn::Wait(Some(within)) => {
                    if tokio::time::timeout(within, self.changed.notified()).await.is_err() {
                        return self.leave();
                    }
                }
                Turn::Over => return,
            }
        }
    }

    fn turn(&self) -> Turn {
        let mut state = self.lock();
        if state.is_left || state.is_dropped && !state.outgoing.is_ready() {
            // A caller that asks for more learns that the server has ended, because its query gets no answer.
            return Turn::Over;
        }
        let is_here = std::mem::take(&mut state.is_here);
        if state.pull.is_some() && !state.outgoing.is_ready() && !is_here {
            return Turn::Wait(None);
        }
        let Some((query, size, was_ready)) = state.pull.take() else {
            return Turn::Wait(Some(IDLE_MAX.saturating_sub(clock::now() - state.answered)));
        };
        let piece = state.outgoing.piece(size, was_ready);
        state.answered = clock::now();
        let is_last = piece.end.is_some();
        match codec::encode(&piece) {
            Ok(bytes) => {
                state.is_left |= is_last;
                let shows = !std::mem::replace(&mut state.is_shown, true);
                let digest = || proof::answer(&self.question, &bytes);
                let proof = proof::beside(self.authenticator.as_ref(), digest, shows);
                Turn::Send(query, bytes, proof)
            }
            Err(error) => {
                tracing::debug!(%error, "an answer cannot be written");
                Turn::Over
            }
        }
    }
}
