//! A node that is killed again and again. It takes over the running programs, reports and stops. It takes nothing new,
//! because that may be what kills it.

use super::Agent;
use comms::logic::human::span;
use comms::logic::time::Time;
use std::time::Duration;

/// How often a node may be killed,
const KILLS_MAX: usize = 5;
/// within this time. After that, it takes nothing new on for the same time.
const WITHIN: Duration = Duration::from_secs(60);

impl Agent {
    /// Takes note that this agent was made again from its inputs, and how long it was gone.
    pub(super) fn adopted(&mut self, now: Time, away: Duration) {
        // The user who started this node again wants it to stay.
        (self.run.leaving, self.run.lingers_until) = (false, None);
        self.coordinators.values_mut().for_each(|coordinator| coordinator.adopted(away));
        self.participants.values_mut().for_each(|participant| participant.adopted(away));
        self.run.adoptions.push_back(now);
        while self.run.adoptions.len() > KILLS_MAX + 1 {
            self.run.adoptions.pop_front();
        }
    }

    /// Returns why this node takes nothing new on, if it is killed again and again.
    pub(super) fn crash_loop(&self, now: Time) -> Option<String> {
        let first = self.run.adoptions.front().filter(|_| self.run.adoptions.len() > KILLS_MAX)?;
        let last = self.run.adoptions.back()?;
        let until = *last + WITHIN;
        let seconds = until.since(now).as_millis().div_ceil(1000);
        (*last - *first < WITHIN && now < until).then(|| {
            format!(
                "its node was killed {} times within {} and takes nothing new on for {seconds} s; what runs goes on, and \
                 can be stopped",
                self.run.adoptions.len(),
                span(WITHIN),
            )
        })
    }
}
