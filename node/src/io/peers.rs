//! The node's session with other nodes and with command lines. Presence, frames and calls become inputs for the agent.

mod beat;
mod calls;

use crate::io::authors::Authors;
use crate::io::caller::Caller;
use crate::io::{heads, renewal};
use crate::logic::agent::Input;
use crate::logic::link::Frame;
use crate::logic::protocol::{Answer, Body, Namesake, Ping, Pong, Request};
use anyhow::Context;
use beat::Sessions;
use comms::io::clock;
use comms::io::session::{Beats, Identity as _, NodeOptions, Presence, Session, Subscription, Token, Watch};
use comms::logic::port::Policy;
use comms::logic::time::Time;
use comms::logic::{codec, key};
use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use team::member::Member;
use tokio::sync::mpsc::Sender;
use tokio::sync::{broadcast, watch};
use tokio::task::JoinSet;

/// The most frames that wait for the agent. Further frames are dropped, and their senders send them again.
const FRAMES_MAX: usize = 4096;
/// How long callers may take to receive the last answers of a node that ends.
const ANSWERED_WITHIN: Duration = Duration::from_secs(1);
/// The most messages about revocations that wait. Nodes repeat them when they meet.
const REVOKED_MAX: usize = 64;
/// The most messages of other nodes with this name that wait. Each is repeated every second.
const NAMESAKES_MAX: usize = 64;
/// The most rounds of questions that are remembered. They show how long answers take.
const ROUNDS_MAX: usize = 64;
/// The most refusals by others that wait. They are repeated.
const REFUSED_MAX: usize = 16;
/// The number of rounds in which a node of a team introduces itself after another node has come.
const SHOWN_ROUNDS: u64 = 5;

/// The open session of a node.
#[derive(Debug)]
pub struct Peers {
    session: Arc<Session>,
    token: Token,
    calls: BTreeMap<u64, Caller>,
    own: Arc<Own>,
    authors: Authors,
    /// The hosts that get beats from this node.
    beaten: watch::Sender<BTreeSet<String>>,
    _beats: Beats,
}

/// The answers of this node about itself. A separate task sends them. So a node whose driver is busy does not seem to be gone.
#[derive(Debug)]
pub(super) struct Own {
    pub(super) host: String,
    boot: u64,
    started: Time,
    place: String,
    origin: u32,
    /// For each other name, the boot that this node communicates with.
    holders: Mutex<BTreeMap<String, u64>>,
    sessions: Sessions,
    /// When the last rounds of questions were sent.
    rounds: Mutex<VecDeque<(u64, Time)>>,
    /// The number of further rounds in which this node introduces itself.
    shows: AtomicU64,
    /// Reports that a node has come.
    pub(super) appeared: broadcast::Sender<()>,
}

/// An event of the session.
#[derive(Debug)]
pub enum Arrival {
    /// An input for the agent.
    Input(Input),
    /// A call: its number, the request, and the receiver of the answers.
    Call(u64, Request, Caller),
}

/// The facts about the life of a node that its answers contain.
#[derive(Clone, Copy, Debug)]
pub struct Life {
    /// Its boot number.
    pub boot: u64,
    /// When it was started.
    pub started: Time,
    /// [`Pong::origin`].
    pub origin: u32,
}

impl Peers {
    /// Opens the session, announces the node and begins to listen. Arrivals go to `sink` from tasks of `tasks`. If this
    /// node takes over from a killed one, it keeps the boot number and the start time of that node.
    ///
    /// # Errors
    /// The session cannot be opened.
    pub async fn open(
        options: NodeOptions,
        life: Life,
        member: Option<Arc<Member>>,
        sink: Sender<Arrival>,
        tasks: &mut JoinSet<()>,
    ) -> anyhow::Result<Self> {
        let Life { boot, started, origin } = life;
        let host = options.name.clone();
        let session = Session::open_node(options).await.with_context(|| format!("opening the node `{host}`"))?;
        let session = match &member {
            Some(member) => session.authenticated_by(Arc::clone(member) as _),
            None => session,
        };
        let session = Arc::new(session);
        let authors = Authors::new(member.clone(), &session, host.as_str());
        let inbox = session.subscribe(&key::inbox(host.as_str()), Policy::reject(FRAMES_MAX))?;
        let calls = session.serve(&key::rpc_any(host.as_str()))?;
        let [pings, asked, pongs] = [key::ping_any(), key::asked(host.as_str()), key::pong(host.as_str())]
            .map(|key| session.subscribe(&key, Policy::reject(FRAMES_MAX)));
        let (pings, asked, pongs) = (pings?, asked?, pongs?);
        let presence = session.watch(&key::live_any())?;
        let namesakes = session.subscribe(&key::namesake(host.as_str()), Policy::reject(NAMESAKES_MAX))?;
        tasks.spawn(hear_namesakes(namesakes, authors.clone(), host.as_str().to_owned(), sink.clone()));
        let token = session.announce(&key::live(host.as_str(), boot))?;
        tasks.spawn(hear_frames(inbox, authors.clone(), sink.clone()));
        let refused = session.subscribe(&key::refused(host.as_str()), Policy::reject(REFUSED_MAX))?;
        tasks.spawn(hear_refusals(refused, authors.clone()));
        let host = host.as_str().to_owned();
        let (holders, rounds, shows) = (Mutex::default(), Mutex::default(), AtomicU64::new(SHOWN_ROUNDS));
        let (place, sessions, appeared) = (place(), Sessions::default(), broadcast::Sender::new(1));
        let own = Arc::new(Own { host, boot, started, place, origin, holders, sessions, rounds, shows, appeared });
        let (beaten, to_beat) = watch::channel(BTreeSet::new());
        let beats = session.hear_beats(&key::beat(&own.host))?;
        tasks.spawn(beat::beat(Arc::clone(&session), to_beat));
        tasks.spawn(hear_presence(presence, Arc::clone(&own), sink.clone()));
        let speaking = Speaking { session: Arc::clone(&session), own: Arc::clone(&own), authors: authors.clone() };
        tasks.spawn(answer_pings(pings, speaking.clone(), sink.clone()));
        tasks.spawn(answer_pings(asked, speaking.clone(), sink.clone()));
        tasks.spawn(hear_pongs(pongs, speaking.clone(), sink.clone()));
        let revoked = session.subscribe(&key::revoked_any(), Policy::reject(REVOKED_MAX))?;
        if let Some(member) = &member {
            heads::spawn(member, &speaking, tasks)?;
            renewal::spawn(member, &speaking, tasks)?;
            tasks.spawn(spread_revocations(Arc::clone(member), revoked, Arc::clone(&session), Arc::clone(&own)));
        }
        tasks.spawn(calls::hear(calls, Arc::clone(&session), member, sink));
        Ok(Self { session, token, calls: BTreeMap::new(), own, authors, beaten, _beats: beats })
    }

    /// Asks other nodes whether they are present: nodes with certain names, or all nodes. With `shows`, introduces this node
    /// to nodes that may not know it.
    pub fn ping(&self, round: u64, only: Option<&BTreeSet<String>>, shows: bool) {
        let ping = Ping { from: self.own.host.clone(), boot: self.own.boot, round };
        let mut rounds = self.own.rounds();
        rounds.push_back((round, clock::now()));
        let old = rounds.len().saturating_sub(ROUNDS_MAX);
        rounds.drain(..old);
        drop(rounds);
        let keys =
            only.map_or_else(|| vec![key::ping(&ping.from)], |hosts| hosts.iter().map(|to| key::asked(to)).collect());
        // A node that has just come does not know this node yet.
        let shows = self.own.is_to_show() || shows;
        for key in keys {
            let sent = codec::encode(&ping).map_err(anyhow::Error::from).and_then(|bytes| {
                let sent = if shows { self.session.put_shown(&key, bytes) } else { self.session.put(&key, bytes) };
                Ok(sent?)
            });
            if let Err(error) = sent {
                tracing::warn!(error = format!("{error:#}"), "cannot ask for the nodes of the network");
            }
        }
    }

    /// Tells another node with the name of this node which deployments run here.
    pub fn greet(&self, namesake: &Namesake) {
        let sent = codec::encode(namesake).map_err(anyhow::Error::from);
        let sent = sent.and_then(|bytes| Ok(self.session.put(&key::namesake(&self.own.host), bytes)?));
        if let Err(error) = sent {
            tracing::warn!(
                error = format!("{error:#}"),
                "cannot tell another node of this name which programs run here"
            );
        }
    }

    /// From now on, answers to other nodes contain the boot of their name that this node communicates with.
    pub fn hold(&self, holders: BTreeMap<String, u64>) {
        self.own.sessions.keep(&holders);
        *self.own.holders() = holders;
    }

    /// Sends beats to these hosts from now on, and no longer to others.
    pub fn beat(&self, hosts: BTreeSet<String>) {
        self.beaten.send_replace(hosts);
    }

    /// Drops the link to a node that is lost.
    pub fn cut(&self, host: &str) {
        let boot = self.own.holders().get(host).copied();
        let session = boot.and_then(|boot| self.own.sessions.take(host, boot));
        session.into_iter().for_each(|session| self.session.cut(&session));
    }

    /// Sends a frame. If it is lost, its link sends it again.
    pub fn send(&self, to: &str, frame: &Frame) {
        let mut frame = Cow::Borrowed(frame);
        if matches!(&frame.message, Some((_, message)) if matches!(message.body, Body::Relay(_))) {
            self.authors.sign_relay(frame.to_mut());
        }
        let sent = codec::encode(&*frame).map_err(anyhow::Error::from);
        let sent = sent.and_then(|bytes| Ok(self.session.put(&key::inbox(to), bytes)?));
        if let Err(error) = sent {
            tracing::warn!(host = to, error = format!("{error:#}"), "cannot send to a node");
        }
    }

    /// Stores the receiver of a call's answers.
    pub fn expect(&mut self, call: u64, caller: Caller) {
        self.calls.insert(call, caller);
    }

    /// Answers a call. Returns whether the caller still takes answers. A caller that takes none must not delay the node.
    pub fn answer(&self, call: u64, answer: Answer) -> bool {
        self.calls.get(&call).is_some_and(|caller| caller.offer(answer))
    }

    /// Removes a call. Returns the receiver of its answers.
    pub fn take(&mut self, call: u64) -> Option<Caller> {
        self.calls.remove(&call)
    }

    /// Returns the session. The database also uses it, and closes before the session closes.
    pub fn session(&self) -> &Arc<Session> {
        &self.session
    }

    /// Sends no more answers, and waits until callers have received the existing ones.
    pub async fn answered(&mut self) {
        self.calls.clear();
        if tokio::time::timeout(ANSWERED_WITHIN, self.session.answered()).await.is_err() {
            tracing::debug!("a caller did not receive all answers");
        }
    }

    /// Closes the session.
    pub async fn close(self) {
        drop(self.token);
        match Arc::into_inner(self.session) {
            Some(session) => session.close().await,
            None => tracing::debug!("the session is still in use; it closes with the process"),
        }
    }
}

impl Own {
    fn rounds(&self) -> MutexGuard<'_, VecDeque<(u64, Time)>> {
        self.rounds.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns whether this node introduces itself in this round, because another node has come.
    fn is_to_show(&self) -> bool {
        self.shows.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| left.checked_sub(1)).is_ok()
    }

    fn holders(&self) -> MutexGuard<'_, BTreeMap<String, u64>> {
        // The map contains plain values, so it is valid even after a panic.
        self.holders.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Describes to a person where this node runs.
fn place() -> String {
    let machine = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    let machine: String = machine.trim().chars().take(64).collect();
    format!("on `{machine}`, process {}", std::process::id())
}

/// Everything that is needed to answer other nodes, and to check who they are.
#[derive(Clone)]
pub(super) struct Speaking {
    pub(super) session: Arc<Session>,
    pub(super) own: Arc<Own>,
    pub(super) authors: Authors,
}

/// Answers every question of another node about the presence of this one.
async fn answer_pings(mut pings: Subscription, Speaking { session, own, authors }: Speaking, sink: Sender<Arrival>) {
    while let Some((key, bytes, author)) = pings.next_signed().await {
        let Ok(Ping { from, boot, round }) = codec::decode(&bytes) else {
            tracing::debug!("a question of a node for the nodes of the network cannot be read");
            continue;
        };
        let is_own = from == own.host && boot == own.boot;
        let is_fit = key == key::ping(&from) || key == key::asked(&own.host);
        if is_own || !is_fit || !authors.admits(&author, &from) {
            continue;
        }
        let pong = Pong {
            from: own.host.clone(),
            boot: own.boot,
            to_boot: boot,
            round,
            up: clock::now() - own.started,
            place: own.place.clone(),
            holder: own.holders().get(&from).copied(),
            session: session.id(),
            origin: own.origin,
        };
        let sent = codec::encode(&pong).map_err(anyhow::Error::from);
        if let Err(error) = sent.and_then(|bytes| Ok(session.put(&key::pong(&from), bytes)?)) {
            tracing::debug!(host = from, error = format!("{error:#}"), "an answer was not sent");
        }
        if sink.send(Arrival::Input(Input::Ping { host: from, boot })).await.is_err() {
            return;
        }
    }
}

async fn hear_pongs(mut pongs: Subscription, Speaking { session, own, authors }: Speaking, sink: Sender<Arrival>) {
    while let Some((_, bytes, author)) = pongs.next_signed().await {
        match codec::decode::<Pong>(&bytes) {
            Ok(pong) if !authors.admits(&author, &pong.from) => {}
            Ok(pong) => {
                let asked = own.rounds().iter().find(|(round, _)| *round == pong.round).map(|(_, at)| *at);
                if let Some(asked) = asked.filter(|_| pong.to_boot == own.boot) {
                    own.sessions.note(&pong.from, pong.boot, &pong.session);
                    session.note_round_trip(&pong.session, clock::now() - asked);
                }
                if sink.send(Arrival::Input(Input::Pong(Box::new(pong)))).await.is_err() {
                    return;
                }
            }
            Err(error) => tracing::debug!(%error, "an answer of a node cannot be read"),
        }
    }
}

async fn hear_namesakes(mut namesakes: Subscription, authors: Authors, own: String, sink: Sender<Arrival>) {
    while let Some((_, bytes, author)) = namesakes.next_signed().await {
        match codec::decode::<Namesake>(&bytes) {
            Ok(_) if !authors.admits(&author, &own) => {}
            Ok(namesake) => {
                if sink.send(Arrival::Input(Input::Namesake(Box::new(namesake)))).await.is_err() {
                    return;
                }
            }
            Err(error) => tracing::debug!(%error, "a message of another node of this name cannot be read"),
        }
    }
}

async fn hear_frames(mut inbox: Subscription, authors: Authors, sink: Sender<Arrival>) {
    while let Some((_, bytes, author)) = inbox.next_signed().await {
        match codec::decode::<Frame>(&bytes) {
            Ok(frame) if !authors.admits(&author, &frame.from) => {}
            Ok(mut frame) => {
                authors.check_relay(&mut frame);
                if sink.send(Arrival::Input(Input::Frame(Box::new(frame)))).await.is_err() {
                    return;
                }
            }
            Err(error) => tracing::warn!(%error, "a frame of a node cannot be read"),
        }
    }
}

async fn hear_refusals(mut refused: Subscription, authors: Authors) {
    while let Some((_, bytes, author)) = refused.next_signed().await {
        authors.hear_refusal(&author, &bytes);
    }
}

async fn hear_presence(mut watch: Watch, own: Arc<Own>, sink: Sender<Arrival>) {
    while let Some(presence) = watch.next().await {
        let (key, appeared) = match presence {
            Presence::Appeared(key) => (key, true),
            Presence::Vanished(key) => (key, false),
        };
        let Some((host, boot)) = key::parse_live(&key) else { continue };
        if appeared {
            // The other node has not met this node yet.
            own.shows.store(SHOWN_ROUNDS, Ordering::Relaxed);
            drop(own.appeared.send(()));
        }
        let input = if appeared { Input::Appeared { host, boot } } else { Input::Vanished { host, boot } };
        if sink.send(Arrival::Input(input)).await.is_err() {
            return;
        }
    }
}

/// When this node learns of further revoked keys, from any source, it tells all other nodes. It also ends the tunnels
/// to the owners of these keys.
async fn spread_revocations(member: Arc<Member>, mut revoked: Subscription, session: Arc<Session>, own: Arc<Own>) {
    let mut changes = member.changes();
    loop {
        tokio::select! {
            changed = changes.changed() => {
                if changed.is_err() {
                    return;
                }
                session.judge_again();
                if let Err(error) = member.check() {
                    tracing::error!(error = format!("{error:#}"), "the other nodes of the team refuse this node");
                }
                if let Err(error) = session.put(&key::revoked(&own.host), member.revocations()) {
                    tracing::warn!(%error, "cannot tell the other nodes which keys are revoked");
                }
            }
            told = revoked.next() => match told {
                // If the sets are new, `changes` reports this.
                Some((_, sets)) => drop(member.hear(&sets)),
                None => return,
            },
        }
    }
}
