//! The database of a node: a replica and its callers.
//!
//! [`Database::handle`] takes all inputs since the previous call and returns the effects in order. It is driven by a
//! separate thread (`io::database`). The thread writes all [`Effect::Persist`] of one turn together, and carries out
//! the other effects only when these are on the disk. So callers that wait at the same time share
//! one flush, and no caller gets data that could be lost. The loop that supervises programs never
//! waits for a disk.
//!
//! When the disk fails, the database is *closed*: it answers most questions, and refuses writes with the disk's error.
//! It takes nothing from peers during that time, since it could not store anything.

mod alarms;
mod author;
pub mod chronicle;
pub mod disk;
mod look;
mod orders;
mod other_team;
pub mod program;
pub mod question;
mod refuse;
pub mod settings;
mod status;
pub mod table;
mod watch;

use alarms::Alarms;
use comms::logic::time::Time;
use dbmanager::logic::clock::Wall;
use dbmanager::logic::message::{Message, Pattern};
use dbmanager::logic::record::Batch;
use dbmanager::logic::replica::{self, Alarm, CommitRequest, Replica};
use dbmanager::logic::state::State;
use dbmanager::logic::txn::{Draft, EncodedTxn, TxnError};
use dbmanager::logic::version_vector::{ReplicaId, VersionVector};
use dbmanager::logic::view::as_of::{AsOfError, Checkpoints};
use dbmanager::logic::view::conflict::RaceCount;
use dbmanager::logic::view::past::{Keys, Past};
use dbmanager::logic::view::schema::{self, Schemas};
use disk::{Disk, Durable};
use look::Readable;
use other_team::{OtherTeam, Teams};
use question::{AckLevel, AsOf, Commit, Envelope, Question, Reply, Resolve, WriteRequest};
use refuse::LOCAL;
use settings::Settings;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;
use watch::Watchers;

/// The team name of robots that were given no other.
pub const TEAM: &str = "dca";
/// How many peers are remembered after their last message.
const HEARD_MAX: usize = 1024;
/// The refusal of a watcher of local keys.
const NO_NEWS: &str = "keys below `local/` can be read and written, but not watched";
/// About how many bytes of keys and values go into one reply.
const REPLY_SIZE_MAX: usize = 256 << 10;

/// An input of the database.
#[derive(Debug)]
pub enum Input {
    /// A question; its answers have this number. Number 0 is the node itself, which wants no answers.
    Call(u64, Question),
    /// A question from another machine. It gets no keys that are local to this machine.
    Elsewhere(u64, Question),
    /// A message of another replica, which needs no answer.
    Envelope(Envelope),
    /// A question of another replica with this number. [`Effect::ReplyToPeer`] ends the question.
    Asked(u64, Envelope),
    /// Another node has arrived or returned: its replica and this one compare their transactions.
    Appeared,
    /// The caller with this number wants no more answers.
    Gone(u64),
}

/// An effect of the database. Effects are carried out in order.
#[derive(Debug)]
pub enum Effect {
    /// Write this to the disk before any other effect of this turn.
    Persist(Batch),
    /// From now on, other replicas know this replica by this name.
    Address(ReplicaId),
    /// Send a message to every replica.
    Broadcast(Envelope),
    /// Send a message to one replica.
    Tell(ReplicaId, Envelope),
    /// Ask one replica. If its answer comes within this time, give the answer back as an envelope.
    Ask(ReplicaId, Envelope, Duration),
    /// Answer a question of another replica, or end the question if no envelope is given.
    ReplyToPeer(u64, Option<Envelope>),
    /// Send one element of the answer to a call.
    AnswerCaller(u64, Reply),
    /// Tell a caller that the answer is complete.
    End(u64),
    /// Tell an operator this.
    Alarm(String),
    /// Apply these settings of the robot for its node, which have changed.
    Settings(Settings),
    /// Report a refused write, which no user is permitted to make.
    Refused {
        /// The sender.
        from: String,
        /// The reason, for a person.
        why: String,
    },
}

/// The state machine of a node's database.
#[derive(Debug)]
pub struct Database {
    replica: Replica,
    /// The name by which other replicas know this one, as the driver was last told.
    announced: ReplicaId,
    place: Place,
    disk: Disk,
    calls: Calls,
    /// The other replicas that have sent messages recently, and the times of these messages.
    heard: BTreeMap<ReplicaId, KnownPeer>,
    other_team: OtherTeam,
    alarms: Alarms,
    wall: Wall,
    /// Whether this turn has changed the settings that the robot's keys give to its node.
    resettled: bool,
    derived: Derived,
}

#[derive(Debug)]
struct Place {
    /// Name of the robot.
    robot: String,
    /// Name of the team.
    team: String,
    /// Where the store is.
    store: Option<String>,
}

#[derive(Debug, Default)]
struct Calls {
    /// The calls that wait until their transaction has reached more than the local disk.
    waiting: BTreeSet<u64>,
    watchers: Watchers,
}

/// The values that are derived from the replica.
#[derive(Debug, Default)]
struct Derived {
    /// The last count of races.
    races: RaceCount,
    /// The schemas, as last read from the state.
    schemas: Option<Schemas>,
    /// States from which the states of earlier moments are computed.
    checkpoints: Checkpoints,
}

/// Another replica that has sent a message recently.
#[derive(Clone, Copy, Debug)]
struct KnownPeer {
    at: Time,
    /// Whether the replica said that it belongs to a team.
    member: bool,
    /// The replica's wall clock and the clock of this one, when the replica last reported its clock.
    walls: Option<(Wall, Wall)>,
}

/// A question of another replica, which this turn may answer.
type Asked = Option<(u64, ReplicaId)>;

impl Database {
    /// Returns the database of this replica.
    pub fn new(replica: Replica, robot: &str, team: &str, store: Option<String>) -> Self {
        Self {
            announced: replica.address(),
            replica,
            place: Place { robot: robot.to_owned(), team: team.to_owned(), store },
            disk: Disk::default(),
            calls: Calls::default(),
            heard: BTreeMap::new(),
            other_team: OtherTeam::default(),
            alarms: Alarms::default(),
            wall: Wall::default(),
            resettled: true,
            derived: Derived::default(),
        }
    }

    /// Takes the inputs; appends the effects in order.
    pub fn handle(&mut self, now: Time, wall: Wall, inputs: Vec<Input>, effects: &mut Vec<Effect>) {
        self.wall = wall;
        self.announce(effects);
        let mut commits = Vec::new();
        for input in inputs {
            let input = if let Input::Elsewhere(call, question) = input {
                let now = AsOf::Version(self.replica.log().vector().clone());
                match refuse::from_elsewhere(question, &now) {
                    Ok(question) => Input::Call(call, question),
                    Err(why) => {
                        effects.extend([Effect::AnswerCaller(call, Reply::Refused(why)), Effect::End(call)]);
                        continue;
                    }
                }
            } else {
                input
            };
            match input {
                Input::Elsewhere(..) => {}
                Input::Call(0, Question::Commit(commit)) => {
                    let commit = chronicle::trimmed(commit, self.replica.state());
                    commits.extend(self.request(now, 0, commit.into(), effects));
                }
                Input::Call(call, Question::Commit(commit)) => {
                    commits.extend(self.request(now, call, commit.into(), effects));
                }
                Input::Call(call, Question::Own(own)) => match self.unknown_owner(&own) {
                    Some(why) => effects.extend([Effect::AnswerCaller(call, Reply::Refused(why)), Effect::End(call)]),
                    None => commits.extend(self.request(now, call, own.into(), effects)),
                },
                Input::Call(call, Question::Resolve(resolve)) => match self.settle(&resolve) {
                    Ok(commit) => commits.extend(self.request(now, call, commit.into(), effects)),
                    Err(reply) => effects.extend([Effect::AnswerCaller(call, reply), Effect::End(call)]),
                },
                Input::Call(call, question) => self.answer(now, call, question, effects),
                Input::Envelope(envelope) => self.receive(now, envelope, None, effects),
                Input::Asked(asked, envelope) => {
                    let from = envelope.from;
                    self.receive(now, envelope, Some((asked, from)), effects);
                }
                Input::Gone(call) => self.calls.watchers.forget(call),
                Input::Appeared => self.feed(now, replica::Input::Appeared(wall), &mut None, effects),
            }
        }
        if !commits.is_empty() {
            self.feed(now, replica::Input::Commit(commits, wall), &mut None, effects);
        }
        if self.replica.deadline().is_some_and(|deadline| deadline <= now) {
            self.feed(now, replica::Input::Tick(wall), &mut None, effects);
        }
        let past = Past { log: self.replica.log(), state: self.replica.state() };
        self.calls.watchers.tell(&past, effects);
        self.derived.checkpoints.note(&past);
        if std::mem::take(&mut self.resettled) {
            effects.push(Effect::Settings(Settings::of(self.replica.state(), &self.place.robot)));
        }
    }

    /// Returns when [`Database::handle`] is to be called even if no input has come.
    pub fn deadline(&self) -> Option<Time> {
        match self.disk.closed() {
            None if self.calls.watchers.has_more() => Some(Time::ZERO),
            None => self.replica.deadline(),
            Some(_) => None,
        }
    }

    /// Returns the name by which other replicas know this one.
    pub fn address(&self) -> ReplicaId {
        self.replica.address()
    }

    /// Returns the replica, to read from it.
    pub fn replica(&self) -> &Replica {
        &self.replica
    }

    /// Returns what can be read of it.
    fn readable(&self) -> Readable<'_> {
        let Self { replica, disk, derived, place, .. } = self;
        let (state, local) = (disk.state(replica), disk.local(replica));
        Readable { replica, state, local, checkpoints: &derived.checkpoints, robot: &place.robot }
    }

    fn teams(&self) -> Teams<'_> {
        Teams { place: &self.place, replica: &self.replica, other: &self.other_team, heard: &self.heard }
    }

    /// Returns the readable state: nothing that may not be on the disk.
    pub fn state(&self) -> &State {
        self.disk.state(&self.replica)
    }

    /// Returns the readable state before a turn that may fail to reach the disk.
    pub fn durable(&self) -> Durable {
        self.disk.durable(&self.replica)
    }

    /// Returns why the database does not write. None if it writes.
    pub fn closed(&self) -> Option<&str> {
        self.disk.closed()
    }

    /// Takes note that the disk has not taken a turn. Returns the remaining effects: `rest`, the effects planned after
    /// the write, without those that have not happened. From now on only questions are answered, from `before`, the
    /// state before the turn.
    pub fn fail(&mut self, why: &str, before: Durable, rest: Vec<Effect>) -> Vec<Effect> {
        let mut effects = self.disk.fail(why, &self.place.robot, before, rest);
        let watchers = self.calls.watchers.take();
        effects.extend(std::mem::take(&mut self.calls.waiting).into_iter().chain(watchers).map(Effect::End));
        self.alarms.tell(why.to_owned(), &mut effects);
        effects
    }

    /// The store was opened again, with this content.
    pub fn reopen(&mut self, replica: Replica) {
        self.replica = replica;
        self.disk.reopen();
        self.replaced();
    }

    /// The disk has written a turn: its earlier failures are over, and only the present ones are listed.
    pub fn written(&mut self) {
        let over = self.disk.written();
        if !over.is_empty() {
            self.alarms.forget(&over);
        }
    }

    /// The state was replaced: everything derived from the previous state is dropped.
    fn replaced(&mut self) {
        (self.resettled, self.derived.schemas, self.derived.checkpoints) = (true, None, Checkpoints::default());
    }

    /// Checks that the member `author` may send a message: it speaks for replicas of its own robot only.
    ///
    /// # Errors
    /// The claimed author, and the reason for the refusal, for a user.
    pub fn check_author(&self, envelope: &Envelope, author: &str) -> Result<(), (String, String)> {
        author::check(self.replica.members(), envelope, author)
    }

    /// Returns the transaction that settles a key: one more write, which has seen all of the others.
    fn settle(&mut self, resolve: &Resolve) -> Result<Commit, Reply> {
        let past = Past { log: self.replica.log(), state: self.replica.state() };
        let is_settled =
            !past.state.is_conflict(&resolve.key) && self.derived.races.race_at(&past, &resolve.key).is_none();
        if is_settled {
            return Err(self.readable().settled_already(&resolve.key, &resolve.choice));
        }
        self.readable().settle(resolve)
    }

    /// Begins to watch; returns from where.
    fn watch(&mut self, call: u64, keys: Keys, from: Option<VersionVector>) -> Result<VersionVector, AsOfError> {
        let log = self.replica.log();
        let from = from.unwrap_or_else(|| log.vector().clone());
        self.calls.watchers.watch(call, keys, from.clone(), log)?;
        Ok(from)
    }

    /// Answers with the present values of keys, and then with their position in the log, and begins to watch from this position.
    fn follow(&mut self, call: u64, keys: Keys, effects: &mut Vec<Effect>) {
        let mut say = |reply| effects.push(Effect::AnswerCaller(call, reply));
        let first = match &keys {
            Keys::Below(prefix) => prefix,
            Keys::Only(key) => key.as_str(),
        };
        if first.starts_with(LOCAL) {
            say(Reply::Refused(NO_NEWS.to_owned()));
            return effects.push(Effect::End(call));
        }
        match &keys {
            Keys::Below(prefix) => look::list(self.replica.state(), prefix, &mut say),
            Keys::Only(key) => say(look::entries(key, self.replica.state().versions(key))),
        }
        match self.watch(call, keys, None) {
            Ok(version) => say(Reply::Version(version)),
            Err(why) => {
                say(Reply::Refused(why.to_string()));
                effects.push(Effect::End(call));
            }
        }
    }

    fn receive(&mut self, now: Time, envelope: Envelope, mut asked: Asked, effects: &mut Vec<Effect>) {
        if self.disk.closed().is_none() {
            self.hear(now, &envelope);
            let input = replica::Input::Received(envelope.from, envelope.message, self.wall);
            self.feed(now, input, &mut asked, effects);
        }
        // If a question is not ended, the asker waits until its own time limit.
        effects.extend(asked.map(|(asked, _)| Effect::ReplyToPeer(asked, None)));
    }

    fn hear(&mut self, now: Time, envelope: &Envelope) {
        let known = self.heard.get(&envelope.from).map(|heard| (heard.member, heard.walls));
        let (member, walls) = if let Message::Hello(hello) = &envelope.message {
            (hello.member, Some((hello.wall, self.wall)))
        } else {
            known.unwrap_or_default()
        };
        if envelope.from != self.replica.address() && self.has_room_for(envelope.from) {
            self.heard.insert(envelope.from, KnownPeer { at: now, member, walls });
        }
    }

    /// Makes room for a replica that has sent a message. Returns whether there was room. If necessary, another
    /// replica is dropped: first a replica outside the team, and of these the replica whose last
    /// message is the oldest. A member is dropped only for another member.
    fn has_room_for(&mut self, from: ReplicaId) -> bool {
        if self.heard.len() < HEARD_MAX || self.heard.contains_key(&from) {
            return true;
        }
        let members = self.replica.members();
        let rank = |(origin, heard): (&ReplicaId, &KnownPeer)| (members.is_active(*origin), heard.at, *origin);
        let first = self.heard.iter().map(rank).min();
        let gives_way = first.filter(|(member, ..)| !member || members.is_active(from));
        gives_way.is_some_and(|(.., origin)| self.heard.remove(&origin).is_some())
    }

    /// Returns the transaction that the replica is asked to commit.
    fn request(
        &mut self,
        now: Time,
        call: u64,
        request: WriteRequest,
        effects: &mut Vec<Effect>,
    ) -> Option<CommitRequest> {
        let WriteRequest { draft, level, within } = request;
        if let Some(why) = self.refusal(call, &draft, &level) {
            effects.extend([Effect::AnswerCaller(call, Reply::Refused(why)), Effect::End(call)]);
            return None;
        }
        if let Some(note) = self.teams().unheard_by(now).filter(|_| !draft.is_local()) {
            effects.push(Effect::AnswerCaller(call, Reply::Note(note)));
        }
        if level != AckLevel::Local {
            self.calls.waiting.insert(call);
        }
        Some(CommitRequest { ticket: call, draft, level: level.to_replica(), until: now + within })
    }

    /// Returns why a transaction is refused without a try; nothing if it may be tried.
    fn refusal(&mut self, call: u64, draft: &Draft, level: &AckLevel) -> Option<String> {
        if let Some(why) = self.disk.closed() {
            return Some(why.to_owned());
        }
        let out_of_reach =
            || refuse::out_of_reach(&self.replica, &self.place.robot, level).filter(|_| !draft.is_local());
        if let Some(why) = refuse::namespaces(draft).or_else(out_of_reach) {
            return Some(why);
        }
        let schemas = self.derived.schemas.get_or_insert_with(|| Schemas::of(self.replica.state()));
        let breaches: Vec<String> = schemas.check(draft).iter().map(ToString::to_string).collect();
        // Users have nothing to do with writes of the node itself.
        (call != 0 && !breaches.is_empty()).then(|| format!("nothing was written: {}", breaches.join("; ")))
    }

    fn answer(&mut self, now: Time, call: u64, question: Question, effects: &mut Vec<Effect>) {
        if self.disk.holds_back(call, &question, effects) {
            return;
        }
        let readable = self.readable();
        let mut say = |reply| effects.push(Effect::AnswerCaller(call, reply));
        match question {
            Question::Get { key } => say(look::entries(&key, readable.versions(&key))),
            Question::List { prefix, at } => match readable.readable(&prefix, &at) {
                Ok(state) => look::list(&state, &prefix, &mut say),
                Err(why) => say(Reply::Refused(why)),
            },
            Question::History(filter) => readable.history(&filter, &mut say),
            Question::Conflicts { prefix } => readable.conflicts(&prefix, &mut say),
            Question::Diff { from, to, prefix } => readable.diff([&from, &to], &prefix, &mut say),
            Question::Version(moment) => say(readable.version(&moment)),
            Question::Export { prefix, at } => readable.export(&prefix, &at, &mut say),
            Question::Watch { keys, from } => match self.watch(call, keys, from) {
                Ok(version) => return say(Reply::Version(version)),
                Err(why) => say(Reply::Refused(why.to_string())),
            },
            Question::Follow { keys } => return self.follow(call, keys, effects),
            Question::Status => say(Reply::Status(Box::new(self.status(now)))),
            // `handle` takes all writes of a turn together.
            Question::Commit(_) | Question::Resolve(_) | Question::Own(_) => {}
            Question::Owners => {
                let owners = self.replica.owners().iter();
                say(Reply::Owners(owners.map(|(prefix, owner)| (prefix.to_owned(), owner.robot.clone())).collect()));
            }
            Question::Found
            | Question::Join { .. }
            | Question::Retire { .. }
            | Question::RetireOlder { .. }
            | Question::HealClock => {
                let reply = self.operate(now, question, effects);
                effects.push(Effect::AnswerCaller(call, reply));
            }
        }
        effects.push(Effect::End(call));
    }

    /// Passes an input to the replica, and translates the effects of the replica.
    fn feed(&mut self, now: Time, input: replica::Input, asked: &mut Asked, effects: &mut Vec<Effect>) {
        if self.disk.closed().is_some() {
            return;
        }
        let mut done = Vec::new();
        self.replica.handle(now, input, &mut done);
        self.announce(effects);
        for effect in done {
            self.translate(now, effect, asked, effects);
        }
    }

    /// Announces the name of the replica if the name has changed.
    fn announce(&mut self, effects: &mut Vec<Effect>) {
        let address = self.replica.address();
        if std::mem::replace(&mut self.announced, address) != address {
            effects.push(Effect::Address(address));
        }
    }

    fn translate(&mut self, now: Time, effect: replica::Effect, asked: &mut Asked, effects: &mut Vec<Effect>) {
        let from = self.replica.address();
        let envelope = |message| Envelope { from, message };
        match effect {
            replica::Effect::Persist(batch) => effects.push(Effect::Persist(batch)),
            replica::Effect::Broadcast(message) => effects.push(Effect::Broadcast(envelope(message))),
            replica::Effect::Send(to, message) => effects.push(match message.pattern() {
                Pattern::Request { within } => Effect::Ask(to, envelope(message), within),
                Pattern::Response => match asked.take_if(|(_, from)| *from == to) {
                    Some((asked, _)) => Effect::ReplyToPeer(asked, Some(envelope(message))),
                    None => Effect::Tell(to, envelope(message)),
                },
                Pattern::OneWay => Effect::Tell(to, envelope(message)),
            }),
            replica::Effect::Answer(call, answer) => self.answered(call, answer, effects),
            replica::Effect::Visible(_, frame) => self.visible(&frame),
            replica::Effect::Replaced => {
                self.replaced();
                self.calls.watchers.replaced();
            }
            replica::Effect::Renamed(..) => {}
            // The status shows this alarm while messages of the other team arrive. The log shows the time of the first message.
            replica::Effect::Alarm(Alarm::OtherTeam(origin, robot)) => {
                let is_new = self.other_team.hear(now, origin, &robot);
                let alarm = Alarm::OtherTeam(origin, robot);
                let words = || alarms::words(&alarm, self.replica.members(), &self.place.team);
                effects.extend(is_new.then(|| Effect::Alarm(words())));
            }
            replica::Effect::Alarm(alarm) => {
                self.alarms.take(&alarm, self.replica.members(), &self.place.team, effects);
            }
        }
    }

    /// Drops cached results that depend on keys which a transaction has written.
    fn visible(&mut self, frame: &EncodedTxn) {
        for write in frame.open().map(|txn| txn.writes).unwrap_or_default() {
            self.resettled |= Settings::concern(&self.place.robot, &write.key);
            self.derived.schemas.take_if(|_| write.key.as_str().starts_with(schema::SCHEMA));
        }
    }

    fn answered(&mut self, call: u64, answer: replica::Answer, effects: &mut Vec<Effect>) {
        let reply = match answer {
            replica::Answer::Committed(dot) => Reply::Committed(dot),
            replica::Answer::Reached(dot) => Reply::Reached(dot),
            replica::Answer::Pending(dot) => Reply::Pending(dot),
            replica::Answer::Refused(TxnError::NotOwner { owner, .. }) => Reply::NotOwner { owner },
            replica::Answer::Refused(why) => refuse::unmet_or_refused(&why),
        };
        // A caller that waits for more than the local disk gets a second answer.
        let more = matches!(reply, Reply::Committed(_)) && self.calls.waiting.contains(&call);
        effects.push(Effect::AnswerCaller(call, reply));
        if !more {
            self.calls.waiting.remove(&call);
            effects.push(Effect::End(call));
        }
    }
}
