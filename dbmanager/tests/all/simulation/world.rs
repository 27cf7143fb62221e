//! A team in one thread: robots with disks and clocks, a network between them, clients, and injected misfortunes.
//!
//! Everything follows from the seed: the same seed gives the same run. `misfortune` injects faults, and `clients` read
//! and write. `reference` checks the invariants at any time, and `history` checks what clients have seen.

#[path = "clients.rs"]
mod clients;
#[path = "disk.rs"]
mod disk;
#[path = "history.rs"]
pub(crate) mod history;
#[path = "keys.rs"]
pub(crate) mod keys;
#[path = "misfortune.rs"]
mod misfortune;
#[path = "network.rs"]
pub(crate) mod network;
#[path = "observer.rs"]
mod observer;
#[path = "operator.rs"]
mod operator;
#[path = "reference.rs"]
mod reference;
#[path = "run.rs"]
mod run;
#[path = "swarm.rs"]
mod swarm;

use clients::Clients;
use comms::logic::random::Random;
use comms::logic::time::Time;
use dbmanager::logic::clock::{Quality, Wall};
use dbmanager::logic::record::{Batch, Records};
use dbmanager::logic::replica::{AckLevel, Alarm, Answer, Config, Effect, Input, Replica};
use dbmanager::logic::version_vector::{Dot, ReplicaId, VersionVector};
use disk::{Disk, Fate};
use keys::Revoked;
use network::Network;
use reference::Reference;
pub(crate) use run::{run, run_with_keys};
use std::collections::BTreeMap;
use std::rc::Rc;
use std::sync::Arc;
use std::time::Duration;
pub(crate) use swarm::Faults;

/// 2026 in milliseconds.
pub(crate) const EPOCH_MS: u64 = 1_790_000_000_000;
/// With more inputs than this at one time, the simulation is stuck in a loop.
const INPUTS_MAX: usize = 20_000;
/// The same limit per millisecond, on average.
const INPUTS_PER_MS_MAX: u64 = 10;
/// How long a repaired team may take until all robots have the same transactions, per percent of messages lost (I13).
const CONVERGENCE_MS: u64 = 120_000;

/// The error of a wall clock.
#[derive(Clone, Copy, Debug)]
pub(crate) struct WallClock {
    pub(crate) offset_ms: i64,
    /// How much too fast the clock runs, in parts per million.
    pub(crate) drift_ppm: i64,
    /// The reading at which the clock has stopped, in milliseconds; none if it runs.
    pub(crate) frozen: Option<u64>,
    pub(crate) quality: Quality,
}

struct Node {
    name: String,
    replica: Option<Replica>,
    disk: Disk,
    clock: WallClock,
    /// How often the robot was invited to the team. It makes new keys each time.
    invited: u32,
    /// How many bytes of the log are kept.
    log_size: usize,
    /// The witness recognises the disk as a copy, and nothing was written to the disk since.
    copied: bool,
    /// Increased whenever clients cannot rely on their earlier reads any more.
    era: u64,
    /// The origin and version vector of a robot that is not running.
    asleep: (ReplicaId, VersionVector),
}

/// The team.
pub(crate) struct World {
    random: Random,
    now: Time,
    faults: Faults,
    nodes: Vec<Node>,
    pub(crate) network: Network,
    clients: Clients,
    posted: u64,
    inputs: usize,
    reference: Reference,
    /// The revoked keys of the team; none if robots have no keys.
    revoked: Option<Revoked>,
    /// Tickets of callers that still wait for an answer: the robot, the level, and the number of lost disks at that
    /// time.
    owed: BTreeMap<u64, (usize, AckLevel, u32)>,
    /// How often a robot has lost data.
    losses: u32,
    /// The last member of the team has lost its disk, so no member can admit the waiting robots.
    memberless: bool,
    /// Copies of disks.
    backups: BTreeMap<usize, Records>,
    /// The dot of the commit that is being processed.
    committed: Option<Dot>,
    pub(crate) alarms: Vec<(usize, Alarm)>,
}

impl World {
    /// Returns a world without robots.
    pub(crate) fn new(seed: u64, faults: Faults) -> Self {
        let mut network = Network::new(seed ^ 0x2e7);
        (network.drop, network.duplicate) = (faults.drop, faults.duplicate);
        Self {
            random: Random::new(seed ^ 0xdca),
            now: Time::ZERO,
            faults,
            nodes: Vec::new(),
            network,
            clients: Clients::default(),
            posted: 0,
            inputs: 0,
            reference: Reference::default(),
            revoked: None,
            owed: BTreeMap::new(),
            losses: 0,
            memberless: false,
            backups: BTreeMap::new(),
            committed: None,
            alarms: Vec::new(),
        }
    }

    /// Adds robots until there are `count`, and waits until they are members. No faults happen in this time.
    pub(crate) fn gather(&mut self, count: usize) {
        let before = std::mem::take(&mut self.faults);
        self.network.drop = 0;
        while self.nodes.len() < count {
            let name = format!("r{}", self.nodes.len());
            self.add(name, Records::new());
            if self.nodes.len() == 1 {
                self.input(0, |_, wall| Input::Found(wall));
            }
        }
        self.run_for(30_000);
        (self.faults, self.network.drop) = (before, before.drop);
    }

    /// Adds a robot with these records on its disk, and starts it.
    pub(crate) fn add(&mut self, name: String, records: Records) {
        self.seat(name, records);
        self.restart(self.nodes.len() - 1);
    }

    fn seat(&mut self, name: String, records: Records) {
        let clock = WallClock { offset_ms: 0, drift_ppm: 0, frozen: None, quality: Quality::Network };
        let log_size = [0, 2000, 1 << 20][self.below(3)];
        let asleep = (ReplicaId::default(), VersionVector::default());
        self.nodes.push(Node {
            name,
            replica: None,
            disk: Disk::with(records),
            clock,
            log_size,
            copied: false,
            invited: 0,
            era: 0,
            asleep,
        });
    }

    fn below(&mut self, bound: usize) -> usize {
        usize::try_from(self.random.below(bound as u64)).expect("it is below a length")
    }

    fn happens(&mut self, percent: u64) -> bool {
        self.random.below(100) < percent
    }

    pub(crate) fn clock(&mut self, node: usize) -> &mut WallClock {
        &mut self.nodes[node].clock
    }

    /// Returns the replica of a running robot.
    pub(crate) fn replica(&self, node: usize) -> &Replica {
        self.nodes[node].replica.as_ref().expect("it runs")
    }

    pub(crate) fn wall(&self, node: usize) -> Wall {
        let WallClock { offset_ms, drift_ppm, frozen, quality } = self.nodes[node].clock;
        let elapsed = i64::try_from(self.now.nanos() / 1_000_000).expect("it is less than an age");
        let shown = EPOCH_MS.saturating_add_signed(elapsed + elapsed / 1_000_000 * drift_ppm + offset_ms);
        Wall { millis: frozen.unwrap_or(shown), quality }
    }

    /// Starts a robot from its disk. A store that is damaged, for example after a lying flush, is put aside.
    pub(crate) fn restart(&mut self, node: usize) {
        if self.nodes[node].replica.is_some() {
            return;
        }
        let seed = self.random.next();
        let Node { name, disk, log_size, copied, .. } = &mut self.nodes[node];
        let open = if *copied { Replica::open_copied } else { Replica::open };
        let config = Config { robot: name.clone(), seed, log_size: *log_size };
        match open(config, disk.records()) {
            Ok(replica) => {
                let keys = self.keys(node);
                let signed = keys.map(|keys| Arc::new(keys) as _);
                self.nodes[node].replica = Some(match signed {
                    Some(keys) => replica.signed_by(keys),
                    None => replica,
                });
            }
            Err(_) if disk.doubtful => {
                self.lose_disk(node);
                return self.restart(node);
            }
            Err(error) => return self.reference.blame(format!("{name} does not open: {error}")),
        }
        self.watch_anew(node);
        self.input(node, |_, wall| Input::Tick(wall));
    }

    /// Notes that clients at a robot can no longer rely on their reads there.
    fn forgets(&mut self, node: usize) {
        self.nodes[node].era += 1;
        self.losses += 1;
    }

    fn watch_anew(&mut self, node: usize) {
        let cut = self.nodes[node].replica.as_ref().map(|replica| replica.log().vector().clone()).unwrap_or_default();
        self.clients.watch_anew(node);
        self.reference.replaced(node, cut);
        if let Some(replica) = self.nodes[node].replica.as_ref() {
            self.reference.means(node, replica);
            self.reference.note_all_conflicts(replica);
        }
    }

    /// Stops a robot at once.
    pub(crate) fn crash(&mut self, node: usize) {
        if let Some(replica) = self.nodes[node].replica.take() {
            self.nodes[node].asleep = (replica.origin(), replica.log().vector().clone());
            self.owed.retain(|_, (at, ..)| *at != node);
        }
    }

    /// Waits until nothing changes any more, and checks the result. Links are repaired if links were a fault.
    pub(crate) fn settle(&mut self) -> Result<(), String> {
        self.converge()?;
        let replicas = self.nodes.iter().enumerate().filter_map(|(at, node)| Some((at, node.replica.as_ref()?)));
        self.reference.check(&replicas.collect::<Vec<_>>())
    }

    /// Waits until all robots run, are members, and have the same transactions (T7, I13).
    pub(crate) fn converge(&mut self) -> Result<(), String> {
        self.be_kind();
        let until = self.now + Duration::from_millis(CONVERGENCE_MS * (1 + self.faults.drop / 4));
        while self.now < until {
            let told = self.alarms.len();
            self.run_for(2_000);
            self.reference.verdict()?;
            self.make_one_team(told);
            self.found_anew();
            // Also compares the hashes: a robot that has another transaction under the same number has not met the
            // others yet.
            let has = |node: &Node| node.replica.as_ref().map(|of| (of.log().vector().clone(), of.log().chains()));
            let first = has(&self.nodes[0]);
            let same = |node: &Node| node.replica.as_ref().is_some_and(Replica::is_member) && has(node) == first;
            if self.nodes.iter().all(same) {
                return Ok(());
            }
        }
        let state = |node: &Node| {
            let replica = node.replica.as_ref()?;
            let member = if replica.is_member() { "member" } else { "no member" };
            Some(format!("{} is {member} as {} {}", node.name, replica.address(), replica.log().vector()))
        };
        Err(format!("T7, I13: no convergence: {:#?}", self.nodes.iter().map(state).collect::<Vec<_>>()))
    }

    /// Checks the invariants after each step.
    fn check_step(&mut self) -> Result<(), String> {
        self.reference.verdict()?;
        let running: Vec<&Replica> = self.nodes.iter().filter_map(|node| node.replica.as_ref()).collect();
        for (index, replica) in running.iter().enumerate() {
            running[index + 1..].iter().try_for_each(|other| self.reference.same_state(replica, other))?;
        }
        let looked_at = self.random.below(40);
        match usize::try_from(looked_at).ok().and_then(|index| running.get(index)) {
            Some(replica) => self.reference.check_versions(replica),
            None => Ok(()),
        }
    }

    /// Retires the origins that no robot has any more, and checks that all unneeded data is removed then (I15).
    fn clean_up(&mut self) -> Result<(), String> {
        self.network.drop = 0;
        loop {
            let before = self.replica(0).log().vector().clone();
            let live: Vec<ReplicaId> = (0..self.nodes.len()).map(|node| self.replica(node).origin()).collect();
            let members: Vec<ReplicaId> = self.replica(0).members().active().map(|(origin, _)| origin).collect();
            for ghost in members.into_iter().filter(|origin| !live.contains(origin)) {
                // If robots have keys, each retires its own previous origin.
                let robot = self.replica(0).members().robot(ghost).filter(|_| self.revoked.is_some());
                let by = robot.and_then(|robot| self.nodes.iter().position(|node| node.name == robot));
                self.input(by.unwrap_or(0), |_, wall| Input::Retire(ghost, wall));
            }
            self.run_for(45_000);
            self.settle()?;
            // In the meantime a slow robot may have returned, or may have been admitted and lost its disk after its
            // request.
            if *self.replica(0).log().vector() == before {
                break;
            }
        }
        self.check_limits()?;
        match self.owed.first_key_value() {
            Some((ticket, (node, level, _))) => Err(format!("I12: ticket {ticket} at {node} has no answer, {level:?}")),
            None => Ok(()),
        }
    }

    /// I15: no deletion is kept that every member has, and the log is not longer than requested.
    pub(crate) fn check_limits(&self) -> Result<(), String> {
        for Node { name, replica, log_size, .. } in &self.nodes {
            let Some(replica) = replica else { continue };
            let deleted = replica.state().scan("").filter(|(_, versions)| versions.iter().all(|v| v.value.is_none()));
            let (deleted, size) = (deleted.count(), replica.log().size());
            if deleted > 0 || size > *log_size {
                let pinned = replica.stable().pinned_by;
                return Err(format!("I15: {name} keeps {deleted} deletions, {size} of {log_size} bytes, {pinned:?}"));
            }
        }
        Ok(())
    }

    /// Lets `millis` milliseconds pass.
    pub(crate) fn run_for(&mut self, millis: u64) {
        let end = self.now + Duration::from_millis(millis);
        let posted_max = self.posted + INPUTS_MAX as u64 + INPUTS_PER_MS_MAX * millis;
        self.inputs = 0;
        loop {
            let mail = self.network.next();
            let due = |node: &Node| node.replica.as_ref().and_then(Replica::deadline);
            let tick = self.nodes.iter().enumerate().filter_map(|(index, node)| Some((due(node)?, index))).min();
            let next = [mail, tick.map(|(at, _)| at)].into_iter().flatten().min().unwrap_or(end);
            if next > end {
                break;
            }
            if next > self.now {
                (self.now, self.inputs) = (next, 0);
            }
            self.inputs += 1;
            if self.inputs > INPUTS_MAX || self.posted > posted_max {
                self.reference.blame("running in circles".to_owned());
                break;
            }
            match (mail, tick) {
                (Some(at), _) if at <= self.now => {
                    let Some(envelope) = self.network.take() else { continue };
                    let message = Rc::unwrap_or_clone(envelope.message);
                    self.input(envelope.to, |_, wall| Input::Received(envelope.from, message, wall));
                }
                (_, Some((at, node))) if at <= self.now => self.input(node, |_, wall| Input::Tick(wall)),
                _ => break,
            }
        }
        self.now = self.now.max(end);
    }

    /// Gives an input to a replica, and executes the effects.
    pub(crate) fn input(&mut self, node: usize, make: impl FnOnce(u64, Wall) -> Input) {
        self.posted += 1;
        let input = make(self.posted, self.wall(node));
        let now = self.now;
        let Some(replica) = self.nodes[node].replica.as_mut() else { return };
        let (before, mut effects) = (replica.log().vector().clone(), Vec::new());
        replica.handle(now, input, &mut effects);
        if let Some(Effect::Persist(batch)) = effects.iter().find(|effect| matches!(effect, Effect::Persist(_))) {
            let replaced = effects.iter().any(|effect| matches!(effect, Effect::Replaced));
            self.truncated(node, (batch, replaced));
        }
        let mut shown = Vec::new();
        let mut effects = effects.into_iter();
        while let Some(effect) = effects.next() {
            match effect {
                Effect::Persist(batch) => match self.fate(node) {
                    Fate::Done => self.write(node, batch),
                    Fate::CrashBefore | Fate::Full => return self.crash(node),
                    Fate::Error if self.happens(50) => return self.crash(node),
                    Fate::CrashAfter | Fate::Error => {
                        self.write(node, batch);
                        effects.for_each(|effect| self.note_untold(node, &before, effect));
                        return self.crash(node);
                    }
                },
                Effect::Broadcast(message) => {
                    let message = Rc::new(message);
                    (0..self.nodes.len()).filter(|to| *to != node).for_each(|to| self.post(node, to, &message));
                }
                Effect::Send(address, message) => {
                    let is = |node: &Node| node.replica.as_ref().is_some_and(|replica| replica.address() == address);
                    let to = (0..self.nodes.len()).filter(|to| *to != node && is(&self.nodes[*to]));
                    let message = Rc::new(message);
                    to.collect::<Vec<_>>().into_iter().for_each(|to| self.post(node, to, &message));
                }
                Effect::Answer(ticket, answer) => self.answered(node, ticket, answer),
                Effect::Alarm(alarm) => self.alarm(node, alarm),
                Effect::Visible(dot, frame) => {
                    self.reference.visible(node, dot, &frame);
                    shown.push(frame);
                }
                Effect::Renamed(from, to) => self.reference.renamed(node, from, to),
                Effect::Replaced => self.taken_over(node, &before, effects.as_slice()),
            }
        }
        let Some(replica) = self.nodes[node].replica.as_ref() else { return };
        for frame in &shown {
            self.reference.note_conflicts(replica, frame);
            self.clients.watch(node, replica, frame);
        }
    }

    fn write(&mut self, node: usize, batch: Batch) {
        self.nodes[node].disk.write(batch);
        self.nodes[node].copied = false;
    }

    /// Notes a transaction that is on the disk, although its client got no answer.
    fn note_untold(&mut self, node: usize, before: &VersionVector, effect: Effect) {
        match effect {
            Effect::Visible(dot, frame) => drop(self.reference.happened(node, dot, &frame)),
            Effect::Renamed(from, to) => self.reference.renamed(node, from, to),
            Effect::Answer(_, Answer::Committed(dot)) => self.committed = Some(dot),
            Effect::Replaced => {
                self.reference.means(node, self.nodes[node].replica.as_ref().expect("it runs"));
                self.reference.left_behind |= !self.replica(node).log().vector().dominates(before);
                self.forgets(node);
            }
            Effect::Persist(batch) => self.write(node, batch),
            Effect::Answer(..) | Effect::Alarm(_) | Effect::Broadcast(_) | Effect::Send(..) => {}
        }
    }

    fn post(&mut self, from: usize, to: usize, message: &Rc<dbmanager::logic::message::Message>) {
        let Some(address) = self.nodes[from].replica.as_ref().map(Replica::address) else { return };
        self.network.post(self.now, (from, address), to, message);
    }
}
