//! The reports of the home of a mission, and the time for which they may break off: the home may be out of reach for a moment,
//! which the mission itself survives.

use comms::logic::time::Time;
use node::logic::protocol::{Deployment, Report, Request};
use std::time::Duration;

/// How long the home node has to be back when its answers are cut off: as long as the other hosts of the deployment wait.
pub(super) const BACK_WITHIN: Duration = Duration::from_secs(5);
/// How long the streams of the home have to last until the home is treated as back. A cut after this time is a new cut.
const STEADY: Duration = Duration::from_secs(1);

/// The reports of the home of a mission.
#[derive(Debug)]
pub(super) struct Home {
    host: String,
    /// The deployment, once the home has taken it on.
    deployment: Option<Deployment>,
    /// How many reports have come.
    seen: u64,
    /// When the reports broke off; none while they come.
    cut_off: Option<Time>,
    /// When the home was asked again last.
    resumed: Option<Time>,
}

impl Home {
    /// Returns the home at a host that has not reported anything yet; `deployment` runs already, if it is known.
    pub(super) const fn new(host: String, deployment: Option<Deployment>) -> Self {
        Self { host, deployment, seen: 0, cut_off: None, resumed: None }
    }

    /// Returns the host.
    pub(super) fn host(&self) -> &str {
        &self.host
    }

    /// Returns the deployment, once the home has taken it on.
    pub(super) const fn deployment(&self) -> Option<&Deployment> {
        self.deployment.as_ref()
    }

    /// Takes a report.
    pub(super) fn take(&mut self, report: &Report) {
        self.seen += if let Report::Omitted { count } = report { *count } else { 1 };
        self.cut_off = None;
        if let Report::Accepted { deployment } = report {
            self.deployment = Some(deployment.clone());
        }
    }

    /// Returns whether the reports have broken off, and no report has come since.
    pub(super) const fn is_cut_off(&self) -> bool {
        self.cut_off.is_some()
    }

    /// Takes note that the reports break off. Returns by when the home has to be back.
    pub(super) fn cut(&mut self, now: Time) -> Time {
        if self.resumed.is_some_and(|at| now - at > STEADY) {
            self.cut_off = None;
        }
        *self.cut_off.get_or_insert(now) + BACK_WITHIN
    }

    /// Takes note that the home is there again and is asked. Returns the request for the missed reports, and all later ones.
    pub(super) fn resume(&mut self, now: Time, deployment: Deployment) -> Request {
        self.resumed = Some(now);
        Request::Watch { deployment, seen: self.seen }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: u64) -> Time {
        Time::from_nanos(millis * 1_000_000)
    }

    /// A home that comes and goes without a report has to be back 5 s after the first cut. A cut after a steady stream is a
    /// new one.
    #[test]
    fn a_home_that_comes_and_goes_gets_no_more_time() {
        let deployment = Deployment { name: "door".into(), epoch: 1 };
        let mut home = Home::new("c1".into(), None);
        home.take(&Report::Accepted { deployment: deployment.clone() });
        home.take(&Report::Omitted { count: 3 });
        assert_eq!((home.deployment(), home.is_cut_off()), (Some(&deployment), false));
        assert_eq!(home.cut(at(1000)), at(6000));
        assert_eq!(
            home.resume(at(2000), deployment.clone()),
            Request::Watch { deployment: deployment.clone(), seen: 4 }
        );
        assert_eq!(home.cut(at(2500)), at(6000));
        assert!(home.is_cut_off());
        home.resume(at(3000), deployment);
        assert_eq!(home.cut(at(4500)), at(9500));
    }
}
