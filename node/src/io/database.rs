//! The thread of a node's database. It owns the replica and the store, and it is the only thread that waits for the disk.
//!
//! In each turn, the thread takes all waiting inputs, as `Groups` gathers them, and writes the results in one batch.
//! Then it carries out the other effects. The queue for inputs is bounded. When it is full, callers are refused, and
//! messages of other replicas are dropped, since replicas ask again. A task (`wire`) sends messages over the node's
//! session.
//!
//! If the disk fails, unwritten changes are refused. The store is reopened, and the replica starts again from the disk:
//! a repeated sync may succeed without having written anything. If the store cannot be opened either, the database
//! answers reads and refuses writes. It tries to open the store again every few seconds.

mod notary;
mod presence;
mod receivers;
mod store;
mod wire;

use crate::io::caller::Caller;
use crate::logic::database::disk::Durable;
use crate::logic::database::question::{Commit, Envelope, Question, Reply};
use crate::logic::database::settings::Settings;
use crate::logic::database::{Database, Effect, Input};
use crate::logic::protocol::{self, Answer};
use anyhow::Context;
use comms::io::clock::{self, ClockQuality};
use comms::io::session::{Author, Request, Session};
use comms::logic::codec;
use comms::logic::time::Time;
use dbmanager::io::group::Groups;
use dbmanager::io::store::Engine;
use dbmanager::logic::clock::{Quality, Wall};
use dbmanager::logic::record::Batch;
use dbmanager::logic::version_vector::ReplicaId;
use receivers::Receivers;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::{SyncSender, TrySendError, sync_channel};
use std::time::Duration;
use store::Place;
use team::member::Member;
use tokio::sync::mpsc::Sender;
use tokio::sync::watch;
use tokio::task::JoinSet;
use wire::Outgoing;

/// The most events that wait for the thread.
const ARRIVALS_MAX: usize = 4096;
/// The most events that are taken in one turn.
const TURN_MAX: usize = 1024;
/// The pause before the next try to open a store.
const REOPEN_AFTER: Duration = Duration::from_secs(5);
/// How often the thread checks that the files of the store exist, while nothing is written.
const CHECK_EVERY: Duration = Duration::from_secs(1);

/// The options of a database.
#[derive(Clone, Debug)]
pub struct Options {
    /// Name of the robot.
    pub robot: String,
    /// Name of the team.
    pub team: String,
    /// The folder for durable data; nothing for a database in memory.
    pub folder: Option<PathBuf>,
    /// The folder for temporary data, such as a copy of a store that can only be read.
    pub scratch: PathBuf,
    /// The engine of a new database; nothing for the default.
    pub store: Option<Engine>,
    /// The proof that callers on this machine show.
    pub proof: String,
    /// The node as a member of its team; it signs the transactions. Nothing if the node is in no team.
    pub member: Option<Arc<Member>>,
    /// Whether the database founds a new team at once. The first of a command's own nodes does this.
    pub founds: bool,
}

/// An event for the thread.
enum Arrival {
    Call(u64, Question, Option<Caller>),
    /// A call from another machine.
    Elsewhere(u64, Question, Caller),
    Envelope(Envelope, Author),
    Asked(Box<Request>, Envelope, Author),
    Appeared,
    Leave,
}

/// Sends requests to a running database. The database ends when the last handle is dropped.
#[derive(Clone, Debug)]
pub struct Handle {
    arrivals: SyncSender<Arrival>,
    /// The proof that callers on this machine show.
    proof: Arc<str>,
}

/// A running database.
#[derive(Debug)]
pub struct DatabaseThread {
    handle: Handle,
    settings: watch::Receiver<Settings>,
    thread: std::thread::JoinHandle<()>,
    /// The task that sends and receives messages.
    wire: JoinSet<()>,
}

/// The state of the thread.
struct Worker {
    machine: Database,
    member: Option<Arc<Member>>,
    place: Place,
    arrivals: Groups<Arrival>,
    outgoing: Sender<Outgoing>,
    receivers: Receivers,
    reopen_at: Time,
    check_at: Time,
    /// The reason why the store could not be opened, as it was last reported.
    told: Option<String>,
    /// How many writes have failed since the last one that succeeded. Only the first failure is logged.
    failures: u64,
    /// Publishes the settings under the robot's own keys.
    settings: watch::Sender<Settings>,
}

/// Opens the store and starts the database on it.
///
/// # Errors
/// The store cannot be read, is already open, or belongs to another robot.
pub fn start(options: &Options, session: &Arc<Session>) -> anyhow::Result<DatabaseThread> {
    let (place, replica, unwritable) = Place::open(options)?;
    let replica = notary::signed(replica, options.member.as_ref());
    let mut machine = Database::new(replica, &options.robot, &options.team, place.name());
    let mut closed = Vec::new();
    if let Some(why) = &unwritable {
        closed = machine.fail(why, machine.durable(), Vec::new());
    }
    let (to_thread, arrivals) = sync_channel(ARRIVALS_MAX);
    let arrivals = Groups::new(arrivals, TURN_MAX);
    let handle = Handle { arrivals: to_thread, proof: options.proof.as_str().into() };
    let (outgoing, wire) = wire::start(session, &options.team, machine.address(), &handle)?;
    if options.founds {
        handle.call(0, Question::Found, None);
    }
    let (settings, shown) = watch::channel(Settings::default());
    let (reopen_at, check_at) = (clock::now() + REOPEN_AFTER, clock::now() + CHECK_EVERY);
    let mut worker = Worker {
        machine,
        member: options.member.clone(),
        place,
        arrivals,
        outgoing,
        receivers: Receivers::default(),
        reopen_at,
        check_at,
        told: unwritable,
        failures: 0,
        settings,
    };
    closed.into_iter().for_each(|effect| worker.do_one(effect));
    let thread = std::thread::Builder::new().name("database".to_owned()).spawn(move || worker.run());
    Ok(DatabaseThread { handle, settings: shown, thread: thread.context("starting the thread of the database")?, wire })
}

impl DatabaseThread {
    /// Returns the handle for requests to the database.
    pub fn handle(&self) -> &Handle {
        &self.handle
    }

    /// Returns the settings under the robot's own keys. The receiver also gets every later change.
    pub fn settings(&self) -> watch::Receiver<Settings> {
        self.settings.clone()
    }

    /// Stops the database. Acknowledged changes are already on the disk.
    ///
    /// # Cancellation
    /// The database is closed even then.
    pub async fn close(self) {
        let Self { handle, thread, mut wire, .. } = self;
        let joined = tokio::task::spawn_blocking(move || {
            // If the queue is full, the thread empties it, so there is room soon. If the thread is gone, it needs no message.
            drop(handle.arrivals.send(Arrival::Leave));
            thread.join().is_err()
        });
        if joined.await.unwrap_or(true) {
            tracing::error!("the database has ended with a panic");
        }
        // The task ends with the thread.
        while wire.join_next().await.is_some() {}
    }
}

impl Handle {
    /// Asks a question. The answers go to `caller`.
    pub fn call(&self, call: u64, question: Question, caller: Option<Caller>) {
        self.ask(Arrival::Call(call, question, caller));
    }

    /// Takes a request if it is for the database. Returns any other request.
    pub fn take(&self, call: u64, request: protocol::Request, caller: Caller) -> Option<(protocol::Request, Caller)> {
        if let protocol::Request::Database(question) = request {
            self.ask(Arrival::Elsewhere(call, question, caller));
            return None;
        }
        if let protocol::Request::Here { proof, question } = request {
            let here = proof == *self.proof;
            self.ask(if here {
                Arrival::Call(call, question, Some(caller))
            } else {
                Arrival::Elsewhere(call, question, caller)
            });
            return None;
        }
        Some((request, caller))
    }

    fn ask(&self, arrival: Arrival) {
        let refused = self.arrivals.try_send(arrival);
        if let Err(TrySendError::Full(Arrival::Call(.., Some(caller)) | Arrival::Elsewhere(.., caller))) = refused {
            let why = "the database is overloaded; try again".to_owned();
            caller.offer(Answer::Database(Reply::Refused(why)));
            caller.end();
        }
    }

    /// Writes a change of the node itself, without an answer.
    pub fn write(&self, commit: Commit) {
        self.call(0, Question::Commit(commit), None);
    }

    /// Notes that another node has come or has returned.
    pub fn appeared(&self) {
        self.offer(Arrival::Appeared);
    }

    /// Adds an input that may be lost.
    fn offer(&self, arrival: Arrival) {
        if self.arrivals.try_send(arrival).is_err() {
            tracing::debug!("the database is overloaded; a message of another replica is dropped");
        }
    }
}

impl Worker {
    fn run(mut self) {
        while let Some(arrivals) = self.wait() {
            let Some(inputs) = self.inputs(arrivals) else { return };
            self.reopen_if_due();
            self.check_if_due();
            let (mut effects, durable) = (Vec::new(), self.machine.durable());
            self.machine.handle(clock::now(), wall(), inputs, &mut effects);
            self.carry_out(effects, durable);
        }
    }

    /// Waits for the first input, and returns all waiting inputs. Returns nothing if the last sender is gone.
    fn wait(&mut self) -> Option<Vec<Arrival>> {
        let deadline = if self.machine.closed().is_some() { Some(self.reopen_at) } else { self.machine.deadline() };
        self.arrivals.next(deadline)
    }

    /// Converts arrivals to inputs, and stores their receivers of answers. Returns nothing if the thread should end.
    fn inputs(&mut self, arrivals: Vec<Arrival>) -> Option<Vec<Input>> {
        let mut inputs: Vec<Input> = self.receivers.take_gone().into_iter().map(Input::Gone).collect();
        for arrival in arrivals {
            inputs.push(match arrival {
                Arrival::Call(call, question, sink) => {
                    if sink.is_some() {
                        self.reopen_at = clock::now();
                    }
                    sink.into_iter().for_each(|caller| self.receivers.call(call, caller));
                    Input::Call(call, question)
                }
                Arrival::Elsewhere(call, question, caller) => {
                    self.receivers.call(call, caller);
                    Input::Elsewhere(call, question)
                }
                Arrival::Envelope(envelope, author) if self.is_from(&envelope, &author) => Input::Envelope(envelope),
                Arrival::Envelope(..) => continue,
                Arrival::Asked(request, envelope, author) => {
                    if !self.is_from(&envelope, &author) {
                        request.refuse("it does not come from the sender that it names");
                        continue;
                    }
                    Input::Asked(self.receivers.ask(request), envelope)
                }
                Arrival::Appeared => Input::Appeared,
                Arrival::Leave => return None,
            });
        }
        Some(inputs)
    }

    /// Writes the durable effects in one batch, and then carries out the other effects.
    fn carry_out(&mut self, effects: Vec<Effect>, durable: Durable) {
        let (mut batch, mut rest) = (Batch::default(), Vec::with_capacity(effects.len()));
        for effect in effects {
            if let Effect::Persist(more) = effect {
                batch.0.extend(more.0);
            } else {
                rest.push(effect);
            }
        }
        if !batch.is_empty() {
            let began = clock::now();
            if let Err(error) = self.place.commit(&batch) {
                return self.fail(&error, durable, rest);
            }
            self.arrivals.synced(clock::now().since(began));
            self.machine.written();
            if std::mem::take(&mut self.failures) > 1 {
                tracing::info!("the store of the database can be written again");
            }
        }
        rest.into_iter().for_each(|effect| self.do_one(effect));
    }

    fn do_one(&mut self, effect: Effect) {
        match effect {
            Effect::Persist(_) => {}
            Effect::Address(address) => self.send(Outgoing::Address(address)),
            Effect::Broadcast(envelope) => self.put(None, &envelope),
            Effect::Tell(to, envelope) => self.put(Some(to), &envelope),
            Effect::Ask(to, envelope, within) => self.encoded(&envelope, |bytes| Outgoing::Ask(to, bytes, within)),
            Effect::ReplyToPeer(asked, envelope) => {
                let request = self.receivers.reply(asked);
                if let (Some(request), Some(envelope)) = (request, envelope) {
                    self.encoded(&envelope, |bytes| Outgoing::Reply(request, bytes));
                }
            }
            Effect::AnswerCaller(call, reply) => self.receivers.answer(call, Answer::Database(reply)),
            Effect::End(call) => self.receivers.end(call),
            Effect::Alarm(words) => tracing::warn!("{words}"),
            Effect::Refused { from, why } => {
                let what = format!("pass on to the database, as `{from}`");
                if let Some(member) = &self.member {
                    member.refuse_message(&what, &why);
                }
            }
            Effect::Settings(settings) => drop(self.settings.send_replace(settings)),
        }
    }

    /// Handles a failure of the disk. Nothing of this turn is valid. Other robots repeat their writes, so after a second failure the
    /// store stays closed for a while, unless a user needs it.
    fn fail(&mut self, error: &anyhow::Error, durable: Durable, rest: Vec<Effect>) {
        self.failures += 1;
        let is_first = self.failures == 1;
        self.reopen_at = if is_first { clock::now() } else { clock::now() + REOPEN_AFTER };
        let mut effects = self.machine.fail(&words(error), durable, rest);
        effects.retain(|effect| is_first || !matches!(effect, Effect::Alarm(_)));
        effects.into_iter().for_each(|effect| self.do_one(effect));
    }

    /// Checks from time to time whether the store still exists, even if nothing is written.
    fn check_if_due(&mut self) {
        let now = clock::now();
        if self.machine.closed().is_some() || now < self.check_at {
            return;
        }
        self.check_at = now + CHECK_EVERY;
        if let Err(error) = self.place.check() {
            let durable = self.machine.durable();
            self.fail(&error, durable, Vec::new());
        }
    }

    fn reopen_if_due(&mut self) {
        if self.machine.closed().is_none() || clock::now() < self.reopen_at {
            return;
        }
        match self.place.reopen() {
            Ok(replica) => {
                self.told = None;
                self.machine.reopen(notary::signed(replica, self.member.as_ref()));
                if self.failures <= 1 {
                    tracing::info!("the store of the database is open again");
                }
            }
            Err(error) => {
                let why = words(&error);
                if self.told.as_ref() != Some(&why) {
                    tracing::warn!(error = why, "the store of the database cannot be opened");
                    self.told = Some(why);
                }
                self.reopen_at = clock::now() + REOPEN_AFTER;
            }
        }
    }

    fn put(&self, to: Option<ReplicaId>, envelope: &Envelope) {
        self.encoded(envelope, |bytes| Outgoing::Put(to, bytes));
    }

    fn encoded(&self, envelope: &Envelope, make: impl FnOnce(Vec<u8>) -> Outgoing) {
        match codec::encode(envelope) {
            Ok(bytes) => self.send(make(bytes)),
            Err(error) => tracing::warn!(%error, "a message to another replica cannot be written"),
        }
    }

    fn send(&self, outgoing: Outgoing) {
        // Other messages may be lost, since replicas ask for them again. Without its address, a replica could not be
        // found, so an address waits for room.
        let sent = if matches!(outgoing, Outgoing::Address(_)) {
            self.outgoing.blocking_send(outgoing).is_ok()
        } else {
            self.outgoing.try_send(outgoing).is_ok()
        };
        if !sent {
            tracing::debug!("a message to another replica is dropped");
        }
    }
}

/// Explains to a person why a store does not write.
fn words(error: &anyhow::Error) -> String {
    let text = format!("{error:#}");
    // The engine reports errors of the system in its own form.
    if text.contains("StorageFull") || text.contains("No space left") {
        return "the disk of the store is full; the database continues by itself when there is room again".to_owned();
    }
    if text.contains("ReadOnlyFilesystem") || text.contains("Read-only file system") {
        return "the disk of the store is read-only; the database continues by itself when the disk can be written again".to_owned();
    }
    text
}

/// Returns the calendar time, and how far the clock can be trusted.
fn wall() -> Wall {
    let millis = u64::try_from(clock::unix_time().as_millis()).unwrap_or(u64::MAX);
    let quality = match clock::belief() {
        ClockQuality::Kept => Quality::Network,
        ClockQuality::Plausible => Quality::Battery,
        ClockQuality::Unset => Quality::Unset,
    };
    Wall { millis, quality }
}
