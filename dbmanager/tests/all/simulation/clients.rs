//! Clients of a simulated team: sessions that read and write at several robots, and remember what they have seen.

use super::history::{self, Anomaly, History, Op, Txn};
use super::reference::Id;
use super::{AckLevel, World};
use comms::logic::time::Time;
use dbmanager::logic::clock::Timestamp;
use dbmanager::logic::key::Key;
use dbmanager::logic::replica::{CommitRequest, Input, Replica};
use dbmanager::logic::txn::{Condition, Draft, EncodedTxn};
use dbmanager::logic::version_vector::{Dot, ReplicaId, VersionVector};
use std::collections::BTreeMap;
use std::time::Duration;

/// The number of clients.
const CLIENTS: usize = 4;
/// The number of keys that all clients use.
const KEYS: u64 = 5;
/// The anomalies that clients may see if a robot rebases writes that others have since deleted.
const REPEATED: [Anomaly; 6] = [
    Anomaly::FracturedRead,
    Anomaly::ReadYourWrites,
    Anomaly::MonotonicReads,
    Anomaly::MonotonicWrites,
    Anomaly::WritesFollowReads,
    Anomaly::WriteCoRead,
];
/// The anomalies that clients may see if a robot has returned, and its rebased transactions arrive before those of a
/// member that it had seen.
const AHEAD: [Anomaly; 3] = [Anomaly::FracturedRead, Anomaly::WriteCoRead, Anomaly::WriteCoInitRead];
/// How long clients wait for other robots to have a transaction.
const PATIENCE: Duration = Duration::from_secs(5);

/// One client.
#[derive(Clone, Debug, Default)]
struct Client {
    node: usize,
    era: u64,
    session: Option<usize>,
    /// The transactions that the client has seen, to be presented when it moves to another robot.
    token: VersionVector,
    /// The transactions that the last numbers of the token stood for, at the robot where the client saw them.
    meant: BTreeMap<ReplicaId, Id>,
}

/// All clients.
#[derive(Debug, Default)]
pub(crate) struct Clients {
    all: [Client; CLIENTS],
    pub(crate) history: History,
    /// The name of each transaction in the history.
    names: BTreeMap<usize, Id>,
    sessions: usize,
    value: u64,
    /// The value that a watcher at each robot has seen last, and its timestamp.
    winners: BTreeMap<(usize, u64), (u64, Timestamp)>,
}

impl Client {
    fn saw(&mut self, replica: &Replica) {
        self.token.join(replica.log().vector());
        for (origin, head) in replica.log().heads() {
            self.meant.insert(*origin, (Dot { origin: *origin, seq: head.seq }, head.hash.0));
        }
    }
}

impl Clients {
    /// Watchers at a robot start again.
    pub(crate) fn watch_anew(&mut self, node: usize) {
        self.winners.retain(|(at, _), _| *at != node);
    }

    /// Makes the watcher of a robot read the writes of a transaction.
    pub(crate) fn watch(&mut self, node: usize, replica: &Replica, frame: &EncodedTxn) {
        let Ok(txn) = frame.open() else { return };
        for write in &txn.writes {
            let Some(register) = register(&write.key) else { continue };
            let version = replica.state().get(&write.key);
            let Some((value, stamp)) = shown(replica, &write.key).zip(version.map(|version| version.stamp)) else {
                self.winners.remove(&(node, register));
                continue;
            };
            // After a deletion, an older value that the deletion had not seen may show again.
            let before = self.winners.insert((node, register), (value, stamp)).filter(|(_, before)| *before < stamp);
            self.history.replaced.extend(before.map(|(before, _)| (register, before, value)));
        }
    }
}

fn register(key: &Key) -> Option<u64> {
    key.as_str().strip_prefix("team/k")?.parse().ok()
}

fn key(register: u64) -> Key {
    Key::new(format!("team/k{register}")).expect("it is a key")
}

/// Returns the value that a read of a key shows.
fn shown(replica: &Replica, key: &Key) -> Option<u64> {
    let value = replica.state().get(key)?.value.as_ref()?;
    Some(u64::from_le_bytes(value.bytes[..].try_into().expect("all values here are numbers")))
}

impl World {
    /// A client reads and writes.
    pub(crate) fn somebody_acts(&mut self) {
        let client = self.below(CLIENTS);
        let node = self.place(client);
        let Some(replica) = self.nodes[node].replica.as_ref() else { return };
        let (count, fresh) = (1 + self.random.below(4), self.clients.all[client].session.is_none());
        if fresh {
            self.clients.sessions += 1;
            self.clients.all[client].session = Some(self.clients.sessions);
        }
        let (mut ops, mut draft) = (Vec::new(), Draft::new("anything"));
        for _ in 0..count {
            let register = self.random.below(KEYS);
            let key = key(register);
            if self.random.below(100) < 60 {
                ops.push(Op::Read(register, shown(replica, &key)));
            }
            match self.random.below(100) {
                0..20 => {
                    ops.push(Op::Delete(register));
                    draft = draft.delete(key);
                }
                20..75 => {
                    self.clients.value += 1;
                    ops.push(Op::Put(register, self.clients.value));
                    draft = draft.put(key, &self.clients.value.to_le_bytes());
                }
                _ => {}
            }
        }
        let conditional = self.random.below(100) < 10;
        if conditional {
            draft = draft.require(key(0), Condition::Exists);
        }
        let stranger = self.random.below(100) < 3;
        if stranger {
            draft = draft.put(Key::new("robot/somebody/else").expect("it is a key"), &[0; 8]);
        }
        let refused = stranger || conditional && shown(replica, &key(0)).is_none();
        // Reads come first: a transaction reads from its snapshot.
        ops.sort_by_key(|op| !matches!(op, Op::Read(..)));
        self.clients.all[client].saw(replica);
        let session = self.clients.all[client].session.unwrap_or_default();
        let writes = ops.iter().any(|op| !matches!(op, Op::Read(..)));
        let dot = if writes || refused { self.commit(node, draft) } else { None };
        if refused && dot.is_some() {
            self.reference
                .blame(format!("2.4: {node} has committed what does not meet its condition, or is another's"));
        }
        let index = self.clients.history.txns.len();
        self.clients.history.txns.push(Txn { session, aborted: writes && dot.is_none(), ops });
        if let Some(dot) = dot {
            let id = self.reference.id(node, dot);
            self.clients.names.extend(id.map(|id| (index, id)));
            self.clients.all[client].token.include(dot);
            self.clients.all[client].meant.extend(id.map(|id| (dot.origin, id)));
        }
    }

    /// Returns the robot of a client. If that robot has lost transactions that the client saw there, the client's
    /// session starts again. A client moves only to a robot that has everything that it has seen.
    fn place(&mut self, client: usize) -> usize {
        let (moves, other) = (self.happens(30), self.below(self.nodes.len()));
        let Client { node, era, .. } = self.clients.all[client];
        if self.nodes[node].era != era {
            self.begin_anew(client, other);
        } else if moves && self.has_all(other, &self.clients.all[client].token) {
            if self.means_others(other, &self.clients.all[client].meant) {
                self.begin_anew(client, other);
            }
            let client = &mut self.clients.all[client];
            (client.node, client.era) = (other, self.nodes[other].era);
        }
        self.clients.all[client].node
    }

    fn begin_anew(&mut self, client: usize, node: usize) {
        self.clients.all[client] = Client { node, era: self.nodes[node].era, ..Client::default() };
    }

    /// Returns whether a robot has different transactions under the numbers of a token. Such a robot accepts the
    /// token, but lacks the transactions of the client. A number that was used twice is noticed only when robots
    /// meet.
    fn means_others(&self, node: usize, meant: &BTreeMap<ReplicaId, Id>) -> bool {
        let Some(replica) = self.nodes[node].replica.as_ref().filter(|_| self.faults.can_roll_back()) else {
            return false;
        };
        let chain = self.reference.chain(replica).unwrap_or_default();
        meant.values().any(|(dot, link)| chain.get(dot).is_some_and(|there| there != link))
    }

    fn has_all(&self, node: usize, token: &VersionVector) -> bool {
        self.nodes[node].replica.as_ref().is_some_and(|replica| replica.log().vector().dominates(token))
    }

    /// Deletes a key outside of any session.
    pub(crate) fn delete_register(&mut self, node: usize, register: u64) {
        if self.commit(node, Draft::new("delete").delete(key(register))).is_some() {
            self.clients.sessions += 1;
            let (session, ops) = (self.clients.sessions, vec![Op::Delete(register)]);
            self.clients.history.txns.push(Txn { session, aborted: false, ops });
        }
    }

    /// Commits, waits for a level, and returns the dot of the transaction, which is then on the disk.
    pub(crate) fn commit(&mut self, node: usize, draft: Draft) -> Option<Dot> {
        let named = self.below(self.nodes.len());
        let names = [self.nodes[named].name.clone()].into_iter().collect();
        let levels = [AckLevel::Local, AckLevel::Replicated(1), AckLevel::On(names), AckLevel::Everywhere];
        let level = levels[self.below(4)].clone();
        self.commit_at(node, draft, level)
    }

    /// Commits at a level.
    pub(crate) fn commit_at(&mut self, node: usize, draft: Draft, level: AckLevel) -> Option<Dot> {
        let until: Time = self.now + PATIENCE;
        self.committed = None;
        if self.nodes[node].replica.is_some() && level != AckLevel::Local {
            self.owed.insert(self.posted + 1, (node, level.clone(), self.losses));
        }
        self.input(node, |ticket, wall| Input::Commit(vec![CommitRequest { ticket, draft, level, until }], wall));
        self.committed.take()
    }

    /// Checks that clients have seen no anomaly, that every lost update is shown as a conflict (I10), and that no
    /// update is lost at one robot.
    pub(crate) fn check_history(&self) -> Result<(), String> {
        let Clients { history, names, .. } = &self.clients;
        let chain = self.reference.chain(self.replica(0))?;
        let brought = self.reference.brought_in().filter_map(register).collect();
        let mut anomalies = history::check(&History { brought, ..history.clone() });
        if self.faults.can_repeat() {
            anomalies.retain(|anomaly| !REPEATED.contains(anomaly));
        }
        if self.reference.left_behind {
            anomalies.retain(|anomaly| !AHEAD.contains(anomaly));
        }
        if !anomalies.is_empty() {
            return Err(format!("history: {anomalies:?}"));
        }
        for (first, second, register) in history::lost_updates(history) {
            let (Some(a), Some(b)) = (names.get(&first), names.get(&second)) else { continue };
            if a.0.origin == b.0.origin && !self.faults.can_repeat() {
                return Err(format!("history: {} and {} of one robot have both overwritten {register}", a.0, b.0));
            }
            let survive = [a, b].iter().all(|id| self.reference.has((self.replica(0), &chain), **id));
            if survive && !self.reference.is_listed(&key(register), *a, *b) {
                return Err(format!(
                    "I10: {} and {} have both overwritten {register}, and no conflict shows",
                    a.0, b.0
                ));
            }
        }
        Ok(())
    }
}
