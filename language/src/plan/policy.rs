//! The policies of a leaf: its program's limits on the host, and its reaction to losses around it.

use serde::{Deserialize, Serialize};
use std::time::Duration;

/// The highest real-time priority of a program: higher ones belong to the host.
pub const REALTIME_MAX: u8 = 49;
/// The shortest pause of a back-off: a start takes as long.
pub const BACKOFF_MIN: Duration = Duration::from_millis(10);
/// The longest pause of a back-off.
pub const BACKOFF_MAX: Duration = Duration::from_secs(3600);

/// The policies of one leaf. The default value is the default of a node.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Policy {
    /// Whether its program is restarted when it has ended without a request.
    pub restart: Restart,
    /// The longest time to stop after the loss of its agent. The node's grace applies if this is absent.
    pub agent_loss: Option<Duration>,
    /// The reaction while the hosts of its supervisors cannot be reached.
    pub link_loss: LinkLoss,
    /// The limits of the program's resources.
    pub usage: Usage,
    /// The longest time without a sign of life.
    pub watchdog: Watchdog,
    /// The longest time until the program can run, at its start and in each `Init`. The node's own bound applies if this is
    /// absent.
    pub ready_within: Option<Duration>,
    /// How long it stays away each time before it is started again. The node's own pauses apply if this is absent.
    pub backoff: Option<Backoff>,
    /// How another program takes its place while the deployment runs.
    pub replacement: Replacement,
}

/// How a program gives way to another one while its deployment runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Replacement {
    /// It is ended, and then the next one is started.
    #[default]
    BreakBeforeMake,
    /// The next program is started while this program runs, and takes over its connections between
    /// two values. Then this program is ended.
    Overlap,
}

/// The pauses before a program that has died again and again is started once more. The first time it is started at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Backoff {
    /// Before the second start in a row; doubled for each after it. At least [`BACKOFF_MIN`].
    pub first: Duration,
    /// No pause is longer. At least `first`, at most [`BACKOFF_MAX`].
    pub longest: Duration,
}

impl Backoff {
    /// Returns whether both pauses are in their ranges.
    pub fn is_valid(&self) -> bool {
        BACKOFF_MIN <= self.first && self.first <= self.longest && self.longest <= BACKOFF_MAX
    }

    /// Returns the pause after this number of short-lived starts in a row; none after none.
    pub fn pause(&self, in_a_row: u32) -> Duration {
        let Some(doublings) = in_a_row.checked_sub(1) else { return Duration::ZERO };
        let factor = 1_u32.checked_shl(doublings).unwrap_or(u32::MAX);
        self.first.saturating_mul(factor).min(self.longest)
    }
}

/// How long a program may give no sign of life before it is ended as hung.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Watchdog {
    /// As long as a node allows without a policy: a bound for controllers, none for plain programs.
    #[default]
    Usual,
    /// For ever.
    Never,
    /// For this long.
    Within(Duration),
}

/// Whether a program is started again, a few times in a minute.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Restart {
    /// The program is never started again.
    #[default]
    Temporary,
    /// After a failure: a signal, an exit code, or any end of a controller without a request.
    Transient,
    /// Always, even when it has ended with exit code 0.
    Permanent,
}

/// The reaction of a program to hosts of its supervisors that cannot be reached.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum LinkLoss {
    /// The program stops when these hosts are lost, and leaves when its home is lost.
    #[default]
    Leave,
    /// The program continues.
    Keep,
    /// The program stops by its own rules, this time after one of these hosts became missing.
    SafeStopAfter(Duration),
    /// The program continues its activation, and begins no other.
    Hold,
}

/// The limits of a program on its host. A missing limit means all that its host gives.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Usage {
    /// Addressable memory, in bytes.
    pub memory: Option<u64>,
    /// Processor time, all in all.
    pub cpu: Option<Duration>,
    /// Open files and sockets.
    pub files: Option<u64>,
    /// Niceness, -20 to 19.
    pub nice: Option<i8>,
    /// The real-time class.
    pub realtime: Option<Realtime>,
    /// Processes and threads at one time.
    pub pids: Option<u64>,
    /// The share of the processors, in thousandths of one.
    pub cpu_share: Option<u32>,
    /// The longest file that it may write, in bytes.
    pub file_size: Option<u64>,
}

/// First in, first out, before everything that is not real-time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Realtime {
    /// 1 to [`REALTIME_MAX`].
    pub priority: u8,
    /// Whether it runs without when the kernel refuses, rather than not at all.
    pub is_optional: bool,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pauses_double_up_to_the_longest_whatever_the_count() {
        let (first, longest) = (Duration::from_millis(100), Duration::from_secs(30));
        let backoff = Backoff { first, longest };
        let pauses = [0, 1, 2, 3, 9, 10, 33, u32::MAX].map(|count| backoff.pause(count).as_millis());
        assert_eq!(pauses, [0, 100, 200, 400, 25_600, 30_000, 30_000, 30_000]);
        assert!(backoff.is_valid() && Backoff { longest: first, first }.is_valid());
        let wrong = [(9, 100), (200, 100), (100, 3_600_001)];
        let of =
            |(first, longest)| Backoff { first: Duration::from_millis(first), longest: Duration::from_millis(longest) };
        assert!(wrong.into_iter().map(of).all(|backoff| !backoff.is_valid()));
    }
}
