//! The faults of a seed: a random selection, so that no fault hides another (Groce et al., *Swarm Testing*, 2012).

use comms::logic::random::Random;

/// The rates of faults in percent: of messages, of writes to the disk, or of steps.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Faults {
    /// Messages lost.
    pub(crate) drop: u64,
    /// Messages delivered twice.
    pub(crate) duplicate: u64,
    /// Links that are cut or repaired, in one direction or both, per step.
    pub(crate) links: u64,
    /// Radios and robots that become slow, per step.
    pub(crate) slow: u64,
    /// Robots that crash, per step.
    pub(crate) crash: u64,
    /// Writes to the disk during which a robot crashes.
    pub(crate) crash_in_write: u64,
    /// Writes to the disk that report an error, whether they were done or not.
    pub(crate) error: u64,
    /// Disks that become full, per step.
    pub(crate) full: u64,
    /// Disks lost for good, per step.
    pub(crate) disk_loss: u64,
    /// Exchanges of the disks of two robots, per step.
    pub(crate) swap: u64,
    /// Robots retired, per step.
    pub(crate) retire: u64,
    /// Robots that join, per step.
    pub(crate) join: u64,
    /// Whether a further robot founds a second team before it receives messages of the others.
    pub(crate) second_team: bool,
    /// Clocks that jump, drift, freeze or are no longer trusted, per step.
    pub(crate) clock: u64,
    /// Switching off all robots for days, per step; some stay off longer.
    pub(crate) away: u64,
    /// Robots restored from a backup, which their witness notices, per step.
    pub(crate) restore: u64,
    /// Robots whose disk is copied to another robot, whose witness notices this, per step.
    pub(crate) clone: u64,
    /// Set-backs of one robot that has a bad disk and no witness: its flushes lie, and it is restored from backups.
    /// Per step.
    pub(crate) rollback: u64,
    /// The anchor: a robot that is never retired, and whose disk is never lost.
    pub(crate) anchor: usize,
    /// The robot with the bad disk.
    pub(crate) cursed: usize,
}

impl Faults {
    /// Returns a random selection of all faults.
    pub(crate) fn swarm(random: &mut Random) -> Self {
        let mut chance = |most: u64| if random.below(2) == 0 { 0 } else { 1 + random.below(most) };
        let faults = Self {
            drop: chance(30),
            duplicate: chance(20),
            links: chance(30),
            slow: chance(6),
            crash: chance(8),
            crash_in_write: chance(4),
            error: chance(3),
            full: chance(3),
            disk_loss: chance(3),
            swap: chance(2),
            retire: chance(6),
            join: chance(2),
            clock: chance(5),
            away: chance(2),
            restore: chance(3),
            clone: chance(2),
            rollback: chance(6),
            ..Self::default()
        };
        // A robot whose disk loses data must not meet others that have lost its messages: such a loss cannot be
        // repaired.
        let lossy = Self { rollback: 0, ..faults };
        let honest = Self { disk_loss: 0, swap: 0, retire: 0, join: 0, restore: 0, clone: 0, ..faults };
        if random.below(4) > 0 { lossy } else { honest }
    }

    /// Returns whether a robot may lose transactions, and then rebase writes that others have since overwritten.
    /// Deleted values may then return: there are too many versions, never too few.
    pub(crate) fn can_repeat(&self) -> bool {
        self.rollback + self.restore + self.clone > 0
    }

    /// Returns whether a store may be set back without a witness.
    pub(crate) fn can_roll_back(&self) -> bool {
        self.rollback > 0
    }
}
