//! The disk of a simulated robot: its durable records (the platter), and the records that a lying flush has left in its
//! cache.

use comms::logic::random::Random;
use dbmanager::logic::record::{Batch, Records};

/// The fate of a write that the replica has to wait for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Fate {
    /// The batch is written, and the driver continues.
    Done,
    /// The robot crashes before the batch is written.
    CrashBefore,
    /// The robot crashes after the write, without an answer.
    CrashAfter,
    /// The sync reports an error (EIO), and it is unknown whether the data is written.
    Error,
    /// The disk is full (ENOSPC).
    Full,
}

/// One disk.
#[derive(Clone, Debug, Default)]
pub(crate) struct Disk {
    platter: Records,
    /// The batches that were acknowledged to the driver, but that a power cut would lose.
    cache: Vec<Batch>,
    /// Whether flushes are acknowledged without being done.
    pub(crate) lies: bool,
    /// Whether the disk is full.
    pub(crate) full: bool,
    /// Whether the next write reports an error.
    pub(crate) broken: bool,
    /// Whether some writes were lost, so that the store may be damaged.
    pub(crate) doubtful: bool,
}

impl Disk {
    /// Returns a disk with these records.
    pub(crate) fn with(platter: Records) -> Self {
        Self { platter, ..Self::default() }
    }

    /// Writes a batch and flushes. If the disk lies, the batch stays in the cache.
    pub(crate) fn write(&mut self, batch: Batch) {
        if self.lies {
            self.cache.push(batch);
        } else {
            batch.apply(&mut self.platter);
        }
    }

    /// Returns the records that a program reads when it starts now.
    pub(crate) fn records(&mut self) -> &Records {
        for batch in std::mem::take(&mut self.cache) {
            batch.apply(&mut self.platter);
        }
        &self.platter
    }

    /// Returns a copy of the records on the disk.
    pub(crate) fn copy(&self) -> Records {
        let mut records = self.platter.clone();
        self.cache.iter().for_each(|batch| batch.apply(&mut records));
        records
    }

    /// Returns the records after a power cut at this moment, and whether they are a valid earlier state. If not, one
    /// batch in the middle is missing.
    pub(crate) fn after_power_cut(&self, random: &mut Random) -> (Records, bool) {
        let count = self.cache.len() as u64;
        let kept = usize::try_from(random.below(count + 1)).expect("it is a length");
        let hole = random.below(4) == 0 && kept + 1 < self.cache.len();
        let mut records = self.platter.clone();
        for (index, batch) in self.cache.iter().enumerate() {
            if index < kept || hole && index > kept {
                batch.apply(&mut records);
            }
        }
        (records, !hole)
    }

    /// Replaces everything.
    pub(crate) fn replace(&mut self, records: Records) {
        (self.platter, self.doubtful) = (records, true);
        self.cache.clear();
    }

    /// Removes the store, like an operator of a damaged one.
    pub(crate) fn clear(&mut self) {
        self.platter.clear();
        self.cache.clear();
        self.doubtful = false;
    }
}
