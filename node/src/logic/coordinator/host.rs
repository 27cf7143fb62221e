//! A host of a deployment, as the home sees it.
//!
//! ```text
//!                      reach              part
//! host fails           Failed             unchanged; ignored unless it is `Active`
//! host is back         Failed → Back      unchanged
//! it released all      Back → Here        Left; from a host in `Failed` only `Active` → `Left`
//! it could not         Here → Failed      Unable
//! asked to rejoin      Back               Active
//! it has rejoined      Here               Active     (a new record)
//! ```
//! A report from a host in `Failed` may be older than the failure, or another node may have forged it. So the home uses
//! a report only after the host has been reached again.

use super::rejoin::Rejoin;
use crate::logic::protocol::Why;
use serde::{Deserialize, Serialize};

/// A host of a deployment.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct HostPart {
    reach: Reach,
    part: Part,
    /// The progress of its rejoining.
    pub(super) rejoin: Option<Rejoin>,
}

/// Whether the home can rely on a host.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
enum Reach {
    #[default]
    Here,
    /// The host failed. It may still hold something of the deployment.
    Failed,
    /// The host failed and has been reached again. It may still hold something of the deployment.
    Back,
}

/// The part of a host in the deployment, as it reported last.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
enum Part {
    #[default]
    Active,
    /// Nothing of the deployment is left on the host.
    Left,
    /// The host could not end everything.
    Unable,
}

impl HostPart {
    /// Returns whether the host has not reported that it left.
    pub(super) fn is_active(&self) -> bool {
        self.part == Part::Active
    }

    /// Returns whether the host takes part and can be reached.
    pub(super) fn takes_part(&self) -> bool {
        (self.reach, self.part) == (Reach::Here, Part::Active)
    }

    /// Returns whether the host failed, and has not taken part again since.
    pub(super) fn has_failed(&self) -> bool {
        self.reach != Reach::Here
    }

    /// Returns whether the host is to take part again.
    pub(super) fn comes_back(&self) -> bool {
        self.rejoin.is_some()
    }

    /// Returns whether the host was asked to rejoin, and has neither refused nor rejoined yet.
    pub(super) fn is_asked(&self) -> bool {
        self.rejoin.as_ref().is_some_and(Rejoin::is_asked)
    }

    /// Notes the failure of the host; returns whether the failure matters to the deployment.
    pub(super) fn fail(&mut self) -> bool {
        if self.is_active() {
            (self.reach, self.rejoin) = (Reach::Failed, None);
        }
        self.is_active()
    }

    /// Notes the return of the host; returns whether the host is to release everything. A host that was only missing
    /// while it rejoined continues to rejoin.
    pub(super) fn is_back(&mut self) -> bool {
        if self.has_failed() {
            self.reach = Reach::Back;
        }
        self.has_failed() && !self.is_asked()
    }

    /// Takes the report that the host released everything; returns whether the home relies on the report.
    pub(super) fn released(&mut self) -> bool {
        if self.reach == Reach::Failed {
            if self.is_active() {
                self.part = Part::Left;
            }
            return false;
        }
        (self.reach, self.part) = (Reach::Here, Part::Left);
        true
    }

    /// Takes the report that the host could not end everything.
    pub(super) fn is_unable(&mut self) {
        self.part = Part::Unable;
        if self.reach == Reach::Here {
            self.reach = Reach::Failed;
        }
    }

    /// Notes that the host is asked to take part again: from now on it may hold something of the deployment.
    pub(super) fn rejoins(&mut self) {
        (self.reach, self.part) = (Reach::Back, Part::Active);
    }

    /// Returns why its release is unconfirmed at the end; nothing if the release is confirmed. `is_late` means that the
    /// host was asked and did not answer.
    pub(super) fn unconfirmed(&self, is_late: bool) -> Option<Why> {
        match self.part {
            Part::Unable => Some(Why::Unable),
            Part::Active | Part::Left if is_late => Some(Why::Late),
            Part::Active | Part::Left => self.has_failed().then_some(Why::Lost),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_report_of_a_failed_host_counts_after_its_return() {
        let mut host = HostPart::default();
        assert!(host.fail());
        assert!(!host.released(), "it may be older than the failure");
        assert_eq!((host.is_active(), host.unconfirmed(false)), (false, Some(Why::Lost)));
        assert!(!host.fail(), "it has left");
        assert!(host.is_back() && host.released());
        assert_eq!(host.unconfirmed(false), None);
        assert!(!host.is_back());
    }

    #[test]
    fn a_host_that_could_not_end_everything_is_unconfirmed_until_it_could() {
        let mut host = HostPart::default();
        host.is_unable();
        assert!(host.has_failed() && !host.fail() && !host.released());
        assert_eq!(host.unconfirmed(true), Some(Why::Unable));
        assert!(host.is_back() && host.released());
        assert_eq!(host.unconfirmed(false), None);
    }

    #[test]
    fn a_host_that_is_asked_to_rejoin_may_hold_something() {
        let mut host = HostPart::default();
        assert!(host.released());
        host.rejoins();
        assert_eq!(
            (host.is_active(), host.unconfirmed(false), host.unconfirmed(true)),
            (true, Some(Why::Lost), Some(Why::Late))
        );
    }
}
