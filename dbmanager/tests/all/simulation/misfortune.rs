//! Misfortunes of a simulated team, step by step.

use super::disk::Fate;
use super::{EPOCH_MS, Faults, World};
use dbmanager::logic::clock::Quality;
use dbmanager::logic::key::Key;
use dbmanager::logic::record::Records;
use dbmanager::logic::replica::{Config, Input, Replica};
use dbmanager::logic::txn::{Condition, Draft};
use dbmanager::logic::version_vector::ReplicaId;
use std::time::Duration;

const HOUR_MS: i64 = 3_600_000;
const DAY_MS: u64 = 86_400_000;

impl World {
    /// Chooses the anchor, which is never lost, and the robot with a bad disk. Robot 0 has no privilege.
    pub(crate) fn curse(&mut self, size: usize) {
        self.faults.anchor = self.below(size);
        self.faults.cursed = (self.faults.anchor + 1) % size;
        if self.faults.can_roll_back() {
            self.reference.can_roll_back = true;
            let cursed = self.faults.cursed;
            self.nodes[cursed].disk.lies = self.happens(50);
        }
    }

    /// Injects faults in this step, according to the rates of the seed.
    pub(crate) fn misfortune(&mut self) {
        let (node, other) = (self.below(self.nodes.len()), self.below(self.nodes.len()));
        let Faults { anchor, .. } = self.faults;
        self.trouble_links(node, other);
        if self.happens(self.faults.crash) {
            self.crash(node);
        }
        if self.happens(30) {
            self.restart(other);
        }
        if self.happens(self.faults.full) {
            self.nodes[node].disk.full = true;
        }
        if self.happens(30) {
            self.nodes[other].disk.full = false;
        }
        if self.happens(self.faults.disk_loss) && node != anchor {
            self.lose_disk(node);
        }
        if self.happens(self.faults.swap) && node != anchor && other != anchor && node != other {
            self.swap_disks(node, other);
        }
        if self.happens(self.faults.retire) && node != anchor {
            self.delete_and_retire(other, node);
        }
        if self.happens(self.faults.join) && self.nodes.len() < 6 {
            self.add(format!("r{}", self.nodes.len()), Records::new());
        }
        if self.happens(self.faults.clock) {
            self.trouble_clock(node);
        }
        if self.happens(self.faults.away) {
            self.be_away();
        }
        if self.happens(self.faults.restore) && node != anchor {
            self.restore_backup(node);
        }
        if self.happens(self.faults.clone) && node != anchor && self.nodes.len() < 6 {
            self.copy_disk(node);
        }
        if self.happens(self.faults.rollback) {
            self.roll_back();
        }
    }

    fn trouble_links(&mut self, node: usize, other: usize) {
        if self.happens(self.faults.links) && node != other {
            match self.below(4) {
                0 => self.cut(node, other),
                1 => self.network.cut_one_way(node, other),
                _ => self.network.heal(node, other),
            }
        }
        if self.happens(self.faults.links / 4) {
            if self.happens(50) { self.isolate(node) } else { (0..self.nodes.len()).for_each(|n| self.join_network(n)) }
        }
        if self.happens(self.faults.slow) {
            let rate = [6_250, 31_250, 125_000][self.below(3)];
            self.network.choke(node, rate);
        }
        if self.happens(self.faults.slow) {
            self.network.slow_down(other, Duration::from_millis(150));
        }
    }

    fn trouble_clock(&mut self, node: usize) {
        let elapsed = i64::try_from(self.now.nanos() / 1_000_000).expect("it is less than an age");
        let year_2099 = 73 * 365 * 24 * HOUR_MS;
        let jumps = [-(EPOCH_MS as i64) - elapsed, -HOUR_MS, 0, 10 * HOUR_MS, year_2099];
        let (jump, drift) = (jumps[self.below(5)], [-200, 0, 200][self.below(3)]);
        let frozen = self.happens(20).then(|| self.wall(node).millis);
        let qualities = [Quality::Unset, Quality::Battery, Quality::Network, Quality::Satellite];
        let quality = qualities[self.below(4)];
        *self.clock(node) = super::WallClock { offset_ms: jump, drift_ppm: drift, frozen, quality };
        if self.happens(20) {
            self.input(node, |_, wall| Input::HealClock(wall));
        }
    }

    /// Switches all robots off for up to 90 days. About half of them return at once, the others at some later time.
    fn be_away(&mut self) {
        (0..self.nodes.len()).for_each(|node| self.crash(node));
        let days = [1, 7, 90][self.below(3)];
        self.now = self.now + Duration::from_millis(days * DAY_MS);
        for node in 0..self.nodes.len() {
            if self.happens(50) {
                self.restart(node);
            }
        }
    }

    /// Makes one robot retire another. Half of the time it has just deleted a value: then it matters whether the other
    /// robot still counts for garbage collection.
    fn delete_and_retire(&mut self, by: usize, node: usize) {
        if self.happens(50) {
            let register = self.random.below(5);
            self.delete_register(by, register);
            let pause = [0, 100, 2000][self.below(3)];
            self.run_for(pause);
        }
        self.retire(by, node);
    }

    /// Exchanges the disks of two robots. Neither may open the other's store. Half of the time the operator exchanges
    /// the disks back, otherwise both robots start with new ones.
    fn swap_disks(&mut self, node: usize, other: usize) {
        let seed = self.random.next();
        for (robot, found) in [(node, other), (other, node)] {
            self.crash(robot);
            let name = self.nodes[robot].name.clone();
            let config = Config { robot: name.clone(), seed, log_size: 0 };
            let same = self.nodes[found].name == name;
            let records = self.nodes[found].disk.records();
            if !records.is_empty() && !same && Replica::open(config, records).is_ok() {
                self.reference.blame(format!("{robot} opens the store of {found}"));
            }
        }
        if self.happens(50) {
            self.lose_disk(node);
            self.lose_disk(other);
        }
    }

    /// Sets the bad disk back: a power cut loses data that its flushes had only promised, or a backup is restored.
    fn roll_back(&mut self) {
        let node = self.faults.cursed;
        let mut random = self.random.clone();
        let (records, _) = self.nodes[node].disk.after_power_cut(&mut random);
        self.random = random;
        let records = if self.nodes[node].disk.lies { Some(records) } else { self.exchange_backup(node) };
        if let Some(records) = records {
            self.restore(node, records);
        }
    }

    /// Returns the earlier copy of a disk, and removes it. If there is none, makes one.
    fn exchange_backup(&mut self, node: usize) -> Option<Records> {
        let backup = self.backups.remove(&node);
        if backup.is_none() {
            self.backups.insert(node, self.nodes[node].disk.copy());
        }
        backup
    }

    /// Restores a robot from a backup; its witness notices this.
    fn restore_backup(&mut self, node: usize) {
        if let Some(records) = self.exchange_backup(node) {
            self.restore(node, records);
            self.restart_copied(node);
        }
    }

    /// Gives a copy of the disk to a robot of the same name; its witness notices this. The new robot knows the store
    /// of the first one. When both are running, the two are told apart.
    fn copy_disk(&mut self, node: usize) {
        let (name, records) = (self.nodes[node].name.clone(), self.nodes[node].disk.copy());
        if !records.is_empty() {
            let invited = self.nodes[node].invited;
            self.seat(name, records);
            let copy = self.nodes.len() - 1;
            self.nodes[copy].invited = invited;
            self.restart_copied(copy);
        }
    }

    /// Returns the replica with these records; `None` if they are not a valid store.
    fn look_at(&self, node: usize, records: &Records) -> Option<Replica> {
        if records.is_empty() {
            return None;
        }
        let config = Config { robot: self.nodes[node].name.clone(), seed: 1, log_size: 0 };
        Replica::open(config, records).ok()
    }

    /// Decides about a write to the disk.
    pub(crate) fn fate(&mut self, node: usize) -> Fate {
        let Faults { crash_in_write, error, .. } = self.faults;
        if self.nodes[node].disk.full {
            Fate::Full
        } else if std::mem::take(&mut self.nodes[node].disk.broken) {
            Fate::Error
        } else if self.happens(crash_in_write) {
            if self.happens(50) { Fate::CrashBefore } else { Fate::CrashAfter }
        } else if self.happens(error) {
            Fate::Error
        } else {
            Fate::Done
        }
    }

    /// From now on only messages may be lost. Broken links and disks are repaired, and all robots run.
    pub(crate) fn be_kind(&mut self) {
        let Faults { drop, links, slow, restore, clone, rollback, anchor, cursed, .. } = self.faults;
        if links + slow > 0 {
            self.network.mend();
        }
        self.faults = Faults { drop, links, restore, clone, rollback, anchor, cursed, ..Faults::default() };
        for node in 0..self.nodes.len() {
            self.nodes[node].disk.full = false;
            self.restart(node);
        }
    }

    /// Changes a disk. Data that was only on this disk may be lost.
    fn change_disk(&mut self, node: usize, change: impl FnOnce(&mut super::Disk)) {
        self.crash(node);
        let copies: Vec<Records> = self.nodes.iter().map(|node| node.disk.copy()).collect();
        let before = self.look_at(node, &copies[node]);
        change(&mut self.nodes[node].disk);
        self.forgets(node);
        let Some(before) = before else { return };
        let after = self.nodes[node].disk.copy();
        self.nodes[node].asleep = self
            .look_at(node, &after)
            .map_or_else(Default::default, |replica| (replica.origin(), replica.log().vector().clone()));
        let others = copies.iter().enumerate().filter(|(other, _)| *other != node);
        let others = others.filter_map(|(other, records)| self.look_at(other, records));
        let left: Vec<Replica> = others.chain(self.look_at(node, &after)).collect();
        self.memberless |= before.is_member() && !left.iter().any(Replica::is_member);
        if let Err(why) = self.reference.forgive(&before, &left.iter().collect::<Vec<_>>()) {
            self.reference.blame(why);
        }
    }

    /// Destroys the disk of a robot.
    pub(crate) fn lose_disk(&mut self, node: usize) {
        // The robot's keys were on that disk.
        self.nodes[node].invited = 1 + self.nodes.iter().map(|node| node.invited).max().unwrap_or_default();
        self.change_disk(node, super::Disk::clear);
    }

    /// Allows forks: a robot has no witness beside its store.
    pub(crate) fn expect_forks(&mut self) {
        self.faults.rollback = 1;
    }

    /// Returns a copy of a disk.
    pub(crate) fn backup(&self, node: usize) -> Records {
        self.nodes[node].disk.copy()
    }

    /// Stops a robot, restores a copy of its disk, and starts it.
    pub(crate) fn restore(&mut self, node: usize, records: Records) {
        self.change_disk(node, |disk| disk.replace(records));
    }

    /// Adds a robot with a copy of another robot's disk.
    pub(crate) fn add_clone(&mut self, of: usize, records: Records) {
        let name = self.nodes[of].name.clone();
        self.add(name, records);
    }

    /// Cuts a link.
    pub(crate) fn cut(&mut self, a: usize, b: usize) {
        self.network.cut_one_way(a, b);
        self.network.cut_one_way(b, a);
    }

    /// Mends a link.
    pub(crate) fn heal(&mut self, a: usize, b: usize) {
        self.network.heal(a, b);
    }

    /// Cuts all links of a robot, including those to robots that join later.
    pub(crate) fn isolate(&mut self, node: usize) {
        (0..10).filter(|other| *other != node).for_each(|other| self.cut(node, other));
    }

    /// Mends all links of a robot.
    pub(crate) fn join_network(&mut self, node: usize) {
        self.network.heal_all_of(node);
    }

    /// Adds a robot that is cut off, begins a new team and writes. Then reconnects it. Returns its number.
    pub(crate) fn found_apart(&mut self, key: &str, value: u64) -> usize {
        let node = self.nodes.len();
        self.isolate(node);
        self.add(format!("r{node}"), Records::new());
        self.input(node, |_, wall| Input::Found(wall));
        self.put(node, key, value);
        self.join_network(node);
        node
    }

    /// Makes one robot retire another.
    pub(crate) fn retire(&mut self, by: usize, node: usize) {
        let Some(target) = self.nodes[node].replica.as_ref().map(Replica::origin) else { return };
        self.revoke(node);
        self.input(by, |_, wall| Input::Retire(target, wall));
    }

    /// Makes one robot retire an origin.
    pub(crate) fn retire_origin(&mut self, by: usize, origin: ReplicaId) {
        self.input(by, |_, wall| Input::Retire(origin, wall));
    }

    /// Returns the origin of a robot that does not run.
    pub(crate) fn asleep(&self, node: usize) -> ReplicaId {
        self.nodes[node].asleep.0
    }

    /// Makes a disk full, or frees space on it.
    pub(crate) fn fill_disk(&mut self, node: usize, full: bool) {
        self.nodes[node].disk.full = full;
    }

    /// Makes the next write to a disk report an error.
    pub(crate) fn break_next_write(&mut self, node: usize) {
        self.nodes[node].disk.broken = true;
    }

    /// Starts a robot from a disk that its witness recognises as a copy.
    pub(crate) fn restart_copied(&mut self, node: usize) {
        self.nodes[node].copied = true;
        self.restart(node);
    }

    /// Commits a value.
    pub(crate) fn put(&mut self, node: usize, key: &str, value: u64) {
        let key = Key::new(key).expect("it is a key");
        self.commit(node, Draft::new("put").put(key, &value.to_le_bytes()));
    }

    /// Commits a value at a key without one.
    pub(crate) fn create(&mut self, node: usize, key: &str, value: u64) {
        let key = Key::new(key).expect("it is a key");
        self.commit(node, Draft::new("create").require(key.clone(), Condition::Absent).put(key, &value.to_le_bytes()));
    }

    /// Commits a deletion.
    pub(crate) fn delete(&mut self, node: usize, key: &str) {
        self.commit(node, Draft::new("delete").delete(Key::new(key).expect("it is a key")));
    }

    /// Returns the value that a read shows.
    pub(crate) fn value(&self, node: usize, key: &str) -> Option<u64> {
        let value = self.replica(node).state().get(&Key::new(key).expect("it is a key"))?.value.as_ref()?;
        Some(u64::from_le_bytes(value.bytes[..].try_into().expect("all values here are numbers")))
    }

    /// Returns the number of versions of a key, including deletions.
    pub(crate) fn siblings(&self, node: usize, key: &str) -> usize {
        self.replica(node).state().versions(&Key::new(key).expect("it is a key")).len()
    }
}
