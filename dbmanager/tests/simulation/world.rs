//! A team in one thread: robots with disks, a network between them, and somebody who breaks things.

#[path = "reference.rs"]
mod reference;

use comms::logic::time::Time;
use dbmanager::logic::clock::{Quality, Wall};
use dbmanager::logic::cut::Origin;
use dbmanager::logic::key::Key;
use dbmanager::logic::message::Message;
use dbmanager::logic::mutant::Mutant;
use dbmanager::logic::random::Random;
use dbmanager::logic::record::Records;
use dbmanager::logic::replica::{Answer, Config, Effect, Input, Level, Replica, Request};
use dbmanager::logic::txn::{Condition, Draft};
use reference::Reference;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// 2026 in milliseconds.
const EPOCH_MS: u64 = 1_790_000_000_000;
/// Inputs at one time after which a world counts as running in circles.
const INPUTS_MAX: usize = 20_000;

/// What goes wrong, in percent of the occasions.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Faults {
    /// Messages lost.
    pub(crate) drop: u64,
    /// Messages delivered twice.
    pub(crate) duplicate: u64,
    /// Links cut or healed, per step.
    pub(crate) links: u64,
    /// Robots that crash, per step.
    pub(crate) crash: u64,
    /// Writes to the disk in which a robot crashes.
    pub(crate) crash_in_write: u64,
    /// Disks lost for good, per step.
    pub(crate) disk_loss: u64,
    /// Robots retired, per step.
    pub(crate) retire: u64,
    /// Clocks that jump, per step.
    pub(crate) clock: u64,
}

struct Node {
    name: String,
    replica: Option<Replica>,
    disk: Records,
    wall_offset_ms: i64,
    quality: Quality,
}

/// The team.
pub(crate) struct World {
    random: Random,
    now: Time,
    faults: Faults,
    mutant: Mutant,
    nodes: Vec<Node>,
    cuts: BTreeSet<(usize, usize)>,
    mail: BTreeMap<(Time, u64), (usize, Origin, Message)>,
    posted: u64,
    value: u64,
    inputs: usize,
    reference: Reference,
}

/// Runs one seed; returns how many transactions there were.
pub(crate) fn run(seed: u64, mutant: Mutant) -> Result<usize, String> {
    let mut random = Random::new(seed);
    let mut chance = |most: u64| if random.below(2) == 0 { 0 } else { 1 + random.below(most) };
    let faults = Faults {
        drop: chance(30),
        duplicate: chance(20),
        links: chance(30),
        crash: chance(8),
        crash_in_write: chance(4),
        disk_loss: chance(3),
        retire: chance(3),
        clock: chance(5),
    };
    let mut world = World::new(seed, faults, mutant);
    world.gather(2 + usize::try_from(seed % 4).unwrap());
    for _ in 0..80 {
        world.misfortune();
        let node = world.below(world.nodes.len());
        world.commit_something(node);
        let pause = [1, 20, 400, 4000][world.below(4)];
        world.run_for(pause);
        world.reference.verdict()?;
    }
    world.settle()?;
    Ok(world.reference.len())
}

impl World {
    /// Returns a world without robots.
    pub(crate) fn new(seed: u64, faults: Faults, mutant: Mutant) -> Self {
        Self {
            random: Random::new(seed ^ 0xdca),
            now: Time::ZERO,
            faults,
            mutant,
            nodes: Vec::new(),
            cuts: BTreeSet::new(),
            mail: BTreeMap::new(),
            posted: 0,
            value: 1_000_000,
            inputs: 0,
            reference: Reference::default(),
        }
    }

    /// Adds robots until there are `count`, and waits until they are members.
    pub(crate) fn gather(&mut self, count: usize) {
        let before = std::mem::take(&mut self.faults);
        while self.nodes.len() < count {
            let name = format!("r{}", self.nodes.len());
            self.add(name, Records::new());
            if self.nodes.len() == 1 {
                self.input(0, |_, wall| Input::Found(wall));
            }
        }
        self.run_for(30_000);
        self.faults = before;
    }

    fn add(&mut self, name: String, disk: Records) {
        let node = Node { name, replica: None, disk, wall_offset_ms: 0, quality: Quality::Network };
        self.nodes.push(node);
        self.restart(self.nodes.len() - 1);
    }

    fn below(&mut self, bound: usize) -> usize {
        usize::try_from(self.random.below(bound as u64)).unwrap()
    }

    fn happens(&mut self, percent: u64) -> bool {
        self.random.below(100) < percent
    }

    fn wall(&self, node: usize) -> Wall {
        let Node { wall_offset_ms, quality, .. } = self.nodes[node];
        let millis = (EPOCH_MS + self.now.nanos() / 1_000_000).saturating_add_signed(wall_offset_ms);
        Wall { millis, quality }
    }

    /// Starts a robot from its disk.
    pub(crate) fn restart(&mut self, node: usize) {
        if self.nodes[node].replica.is_some() {
            return;
        }
        let seed = self.random.next();
        let log_size = [0, 2000, 1 << 20][self.below(3)];
        let Node { name, disk, .. } = &self.nodes[node];
        let config = Config { robot: name.clone(), seed, log_size, mutant: self.mutant };
        match Replica::open(config, disk) {
            Ok(replica) => self.nodes[node].replica = Some(replica),
            Err(error) => self.reference.blame(format!("{name} does not open: {error}")),
        }
        self.reference.restarted(node, self.nodes[node].replica.as_ref());
        self.input(node, |_, wall| Input::Tick(wall));
    }

    /// Stops a robot where it stands.
    pub(crate) fn crash(&mut self, node: usize) {
        self.nodes[node].replica = None;
    }

    /// Destroys the disk of a robot.
    pub(crate) fn lose_disk(&mut self, node: usize) {
        self.crash(node);
        self.nodes[node].disk.clear();
        self.reference.disk_lost(node);
    }

    /// Returns a copy of a disk.
    pub(crate) fn backup(&self, node: usize) -> Records {
        self.nodes[node].disk.clone()
    }

    /// Stops a robot and puts back a copy of its disk.
    pub(crate) fn restore(&mut self, node: usize, disk: Records) {
        self.crash(node);
        self.nodes[node].disk = disk;
        self.reference.disk_lost(node);
    }

    /// Adds a robot with a copy of the disk of another.
    pub(crate) fn add_clone(&mut self, of: usize, disk: Records) {
        let name = self.nodes[of].name.clone();
        self.add(name, disk);
    }

    /// Cuts a link.
    pub(crate) fn cut(&mut self, a: usize, b: usize) {
        self.cuts.insert((a.min(b), a.max(b)));
    }

    /// Mends a link.
    pub(crate) fn heal(&mut self, a: usize, b: usize) {
        self.cuts.remove(&(a.min(b), a.max(b)));
    }

    /// Cuts all links of a robot, to those that come later too.
    pub(crate) fn isolate(&mut self, node: usize) {
        (0..10).filter(|other| *other != node).for_each(|other| self.cut(node, other));
    }

    /// Mends all links of a robot.
    pub(crate) fn join_network(&mut self, node: usize) {
        self.cuts.retain(|(a, b)| *a != node && *b != node);
    }

    /// Has one robot retire another.
    pub(crate) fn retire(&mut self, by: usize, node: usize) {
        let Some(target) = self.nodes[node].replica.as_ref().map(Replica::origin) else { return };
        self.input(by, |_, wall| Input::Retire(target, wall));
    }

    /// Commits a value.
    pub(crate) fn put(&mut self, node: usize, key: &str, value: u64) {
        let key = Key::new(key).unwrap();
        self.commit(node, Draft::new("put").put(key, &value.to_le_bytes()));
    }

    /// Commits a value where none is.
    pub(crate) fn create(&mut self, node: usize, key: &str, value: u64) {
        let key = Key::new(key).unwrap();
        self.commit(node, Draft::new("create").require(key.clone(), Condition::Absent).put(key, &value.to_le_bytes()));
    }

    /// Commits a deletion.
    pub(crate) fn delete(&mut self, node: usize, key: &str) {
        self.commit(node, Draft::new("delete").delete(Key::new(key).unwrap()));
    }

    /// Returns what a read shows.
    pub(crate) fn value(&self, node: usize, key: &str) -> Option<u64> {
        let state = self.nodes[node].replica.as_ref().unwrap().state();
        let value = state.get(&Key::new(key).unwrap())?.value.as_ref()?;
        Some(u64::from_le_bytes(value.bytes[..].try_into().unwrap()))
    }

    /// Returns how many versions of a key there are, deletions included.
    pub(crate) fn siblings(&self, node: usize, key: &str) -> usize {
        self.nodes[node].replica.as_ref().unwrap().state().versions(&Key::new(key).unwrap()).len()
    }

    fn commit(&mut self, node: usize, draft: Draft) {
        let level = [Level::Local, Level::Replicated(1), Level::Everywhere][self.below(3)].clone();
        let until = self.now + Duration::from_secs(5);
        self.input(node, |ticket, wall| Input::Commit(vec![Request { ticket, draft, level, until }], wall));
    }

    fn commit_something(&mut self, node: usize) {
        let mut draft = Draft::new("anything");
        for _ in 0..1 + self.below(3) {
            let key = Key::new(format!("team/k{}", self.below(5))).unwrap();
            self.value += 1;
            let value = self.value.to_le_bytes();
            draft = if self.happens(35) { draft.delete(key) } else { draft.put(key, &value) };
        }
        if self.happens(10) {
            draft = draft.require(Key::new("team/k0").unwrap(), Condition::Exists);
        }
        self.commit(node, draft);
    }

    fn misfortune(&mut self) {
        let node = self.below(self.nodes.len());
        let other = self.below(self.nodes.len());
        if self.happens(self.faults.links) && node != other {
            if self.happens(50) { self.cut(node, other) } else { self.heal(node, other) }
        }
        if self.happens(self.faults.links / 4) {
            if self.happens(50) { self.isolate(node) } else { self.cuts.clear() }
        }
        if self.happens(self.faults.crash) {
            self.crash(node);
        }
        if self.happens(30) {
            self.restart(other);
        }
        // The first robot keeps its disk and its place, so that there is always somebody to come back to.
        if self.happens(self.faults.disk_loss) && node != 0 {
            self.lose_disk(node);
        }
        if self.happens(self.faults.retire) && node != 0 {
            self.retire(0, node);
        }
        if self.happens(self.faults.clock) {
            let hour = 3_600_000;
            let jumps = [-(EPOCH_MS as i64), -hour, 0, 10 * hour, 73 * 365 * 24 * hour];
            let jump = jumps[self.below(5)];
            self.nodes[node].wall_offset_ms = jump;
            self.nodes[node].quality = [Quality::Unset, Quality::Network, Quality::Satellite][self.below(3)];
            if self.happens(20) {
                self.input(node, |_, wall| Input::HealClock(wall));
            }
        }
    }

    /// Waits until nothing is new any more, and checks what there is then. In a world of its own the links are mended.
    pub(crate) fn settle(&mut self) -> Result<(), String> {
        self.converge()?;
        let replicas = self.nodes.iter().filter_map(|node| node.replica.as_ref());
        self.reference.check(&replicas.collect::<Vec<_>>())
    }

    /// Waits until all robots run, are members, and have the same.
    pub(crate) fn converge(&mut self) -> Result<(), String> {
        let before = self.faults;
        self.faults = Faults { drop: before.drop, ..Faults::default() };
        if before.links > 0 {
            self.cuts.clear();
        }
        for node in 0..self.nodes.len() {
            self.restart(node);
        }
        for _ in 0..60 {
            self.run_for(10_000);
            self.reference.verdict()?;
            let first = self.nodes[0].replica.as_ref().map(|replica| replica.log().cut().clone());
            let same = |node: &Node| {
                let replica = node.replica.as_ref();
                replica.is_some_and(Replica::is_member) && replica.map(|replica| replica.log().cut()) == first.as_ref()
            };
            if self.nodes.iter().all(same) {
                self.faults = before;
                return Ok(());
            }
        }
        let state = |node: &Node| {
            let replica = node.replica.as_ref()?;
            Some(format!("{} member {} {}", node.name, replica.is_member(), replica.log().cut()))
        };
        Err(format!("T7: no convergence: {:#?}", self.nodes.iter().map(state).collect::<Vec<_>>()))
    }

    /// Lets so many milliseconds pass.
    pub(crate) fn run_for(&mut self, millis: u64) {
        let end = self.now + Duration::from_millis(millis);
        self.inputs = 0;
        loop {
            let mail = self.mail.first_key_value().map(|((at, _), _)| *at);
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
            if self.inputs > INPUTS_MAX {
                self.reference.blame("running in circles".to_owned());
                break;
            }
            match (mail, tick) {
                (Some(at), _) if at <= self.now => {
                    let Some((_, (node, from, message))) = self.mail.pop_first() else { continue };
                    self.input(node, |_, wall| Input::Received(from, message, wall));
                }
                (_, Some((at, node))) if at <= self.now => self.input(node, |_, wall| Input::Tick(wall)),
                _ => break,
            }
        }
        self.now = self.now.max(end);
    }

    fn input(&mut self, node: usize, make: impl FnOnce(u64, Wall) -> Input) {
        self.posted += 1;
        let input = make(self.posted, self.wall(node));
        let now = self.now;
        let Some(replica) = self.nodes[node].replica.as_mut() else { return };
        let mut effects = Vec::new();
        replica.handle(now, input, &mut effects);
        let (before, dies) = (self.happens(50), self.happens(self.faults.crash_in_write));
        let mut effects = effects.into_iter();
        while let Some(effect) = effects.next() {
            match effect {
                Effect::Persist(_) if dies && before => return self.crash(node),
                Effect::Persist(batch) => {
                    batch.apply(&mut self.nodes[node].disk);
                    if dies {
                        // It is on the disk, although nobody was told.
                        effects.for_each(|effect| {
                            if let Effect::Visible(dot, frame) = effect {
                                drop(self.reference.happened(dot, &frame));
                            } else if let Effect::Renamed(from, to) = effect {
                                self.reference.renamed(from, to);
                            }
                        });
                        return self.crash(node);
                    }
                }
                Effect::Broadcast(message) => {
                    (0..self.nodes.len()).filter(|to| *to != node).for_each(|to| self.post(node, to, &message));
                }
                Effect::Send(address, message) => {
                    let is = |node: &Node| node.replica.as_ref().is_some_and(|replica| replica.address() == address);
                    let to = (0..self.nodes.len()).filter(|to| *to != node && is(&self.nodes[*to]));
                    to.collect::<Vec<_>>().into_iter().for_each(|to| self.post(node, to, &message));
                }
                Effect::Answer(_, Answer::Committed(dot)) => self.reference.acknowledged(node, dot),
                Effect::Answer(..) | Effect::Alarm(_) => {}
                Effect::Visible(dot, frame) => self.reference.visible(node, dot, &frame),
                Effect::Renamed(from, to) => self.reference.renamed(from, to),
                Effect::Replaced => self.reference.replaced(node, self.nodes[node].replica.as_ref()),
            }
        }
    }

    fn post(&mut self, from: usize, to: usize, message: &Message) {
        let Some(address) = self.nodes[from].replica.as_ref().map(Replica::address) else { return };
        if self.cuts.contains(&(from.min(to), from.max(to))) {
            return;
        }
        let copies = if self.happens(self.faults.duplicate) { 2 } else { 1 };
        for _ in 0..copies {
            if !self.happens(self.faults.drop) {
                self.posted += 1;
                let at = self.now + Duration::from_micros(200 + self.random.below(80_000));
                self.mail.insert((at, self.posted), (to, address, message.clone()));
            }
        }
    }
}
