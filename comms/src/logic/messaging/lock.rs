//! A resource lock: one client at a time, by priority, for the time of a lease.
//!
//! The server measures the lease on its own clock, from the grant or the last renewal that has arrived. A holder that
//! dies or is cut off stops renewing, so its lease ends, and the next client gets the lock with a greater fencing
//! number. From then on the [`FencingCheck`] refuses the old number, even if its holder still believes that it has the
//! lock. If two hosts cannot reach each other, only the host with the server can grant the lock. A partition costs
//! availability, never exclusion.
//!
//! Invariants: no fencing number is granted twice, even by a restarted server, because a number is on the disk before
//! it is granted ([`LockEffect::Persist`]). A restarted server grants nothing for the time of one lease, since it does
//! not know which client held the lock.

mod numbers;

use super::fencing::{FencingCheck, Refusal};
use super::header::count;
use super::wire::{Denied, LockAnswer, LockCounters, LockRequest, LockStatus};
use crate::logic::time::Time;
use numbers::FencingNumbers;
use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::time::Duration;

/// The client number of a program that only asks for the status. No other client has this number.
pub const NOBODY: u64 = 0;
/// For how many clients the lock remembers their last ended request.
const CLIENTS_MAX: usize = 1024;

/// The declaration of a lock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LockSettings {
    /// How long a grant lasts without a renewal.
    pub lease: Duration,
    /// How long a holder may keep the lock when a client of greater priority wants it; none if it may keep the lock.
    pub preempt_after: Option<Duration>,
    /// How many clients wait at most.
    pub waiting_max: usize,
}

/// An input of a lock.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum LockInput {
    /// A client asks.
    Request(LockRequest),
    /// The reservation of all numbers before this one is on the disk, so they may be granted.
    Persisted(u64),
    /// The time of [`ResourceLock::deadline`] has come.
    Tick,
}

/// An effect of a lock.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum LockEffect {
    /// Write this number to the disk, then give [`LockInput::Persisted`]. No number from it on was granted yet.
    Persist(u64),
    /// Answer a client, which may have asked long ago.
    Answer {
        /// The client to answer.
        client: u64,
        /// The answer.
        answer: LockAnswer,
    },
}

/// The lock of one resource.
#[derive(Clone, Debug)]
pub struct ResourceLock {
    settings: LockSettings,
    fencing: FencingCheck,
    numbers: FencingNumbers,
    /// Nothing is granted before this time.
    quarantine: Time,
    holder: Option<Holder>,
    /// By priority and arrival.
    waiting: BTreeMap<(Reverse<u8>, u64), Waiter>,
    arrival: u64,
    /// For each client, its last ended request, the reason, and the time when it ended.
    ended: BTreeMap<u64, (u64, Denied, Time)>,
    counters: LockCounters,
    #[cfg(test)]
    pub(super) fault: Option<Fault>,
}

/// A deliberate bug that the schedules of the tests must find. No program has it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Fault {
    /// A holder whose lease is over is still let through.
    StaysOpen,
    /// A number is granted before it is on the disk.
    GrantsUnwritten,
    /// A renewal by a former holder is accepted.
    RenewsAnybody,
    /// A preempted holder keeps its number.
    PreemptsOnPaper,
}

#[derive(Clone, Debug)]
struct Holder {
    client: u64,
    name: String,
    request: u64,
    priority: u8,
    fence: u64,
    until: Time,
    /// Whether a client with a greater priority waits for the lock.
    is_wanted: bool,
}

#[derive(Clone, Debug)]
struct Waiter {
    client: u64,
    name: String,
    request: u64,
    heard: Time,
}

impl ResourceLock {
    /// Returns a lock whose server starts at `now`. No number from `first` on was granted yet; 1 for a new lock.
    pub fn new(settings: LockSettings, first: u64, now: Time) -> Self {
        let first = first.max(1);
        Self {
            settings,
            fencing: FencingCheck::closed(first),
            numbers: FencingNumbers::from(first),
            quarantine: if first > 1 { now + settings.lease } else { now },
            holder: None,
            waiting: BTreeMap::new(),
            arrival: 0,
            ended: BTreeMap::new(),
            counters: LockCounters::default(),
            #[cfg(test)]
            fault: None,
        }
    }

    /// Takes an input.
    pub fn handle(&mut self, now: Time, input: LockInput, effects: &mut Vec<LockEffect>) {
        self.expire(now);
        match input {
            LockInput::Request(LockRequest::Acquire { client, name, request, priority }) => {
                self.acquire(now, Waiter { client, name, request, heard: now }, priority, effects);
            }
            LockInput::Request(LockRequest::Renew { client, request }) => self.renew(now, client, request, effects),
            LockInput::Request(LockRequest::Release { client, request }) => {
                self.release(now, client, request);
                effects.push(LockEffect::Answer { client, answer: LockAnswer::Released { request } });
            }
            LockInput::Persisted(number) => self.numbers.persisted(number),
            LockInput::Request(LockRequest::Look) => {
                effects.push(LockEffect::Answer { client: NOBODY, answer: LockAnswer::Status(self.status(now)) });
            }
            LockInput::Tick => {}
        }
        self.grant(now, effects);
    }

    /// Returns the time at which the lock has to be called with [`LockInput::Tick`]; none if it waits for nothing.
    pub fn deadline(&self) -> Option<Time> {
        let is_due = self.holder.is_none() && !self.waiting.is_empty() && !self.numbers.is_persisting();
        let grant = is_due.then_some(self.quarantine);
        let expiry = self.holder.as_ref().map(|holder| holder.until);
        let forgotten = self.waiting.values().map(|waiter| waiter.heard + self.settings.lease).min();
        [grant, expiry, forgotten].into_iter().flatten().min()
    }

    /// Lets a command through to the resource, or refuses it. Only the holder's number is let through, and only before
    /// the lease is over.
    ///
    /// # Errors
    /// Why the number is refused.
    pub fn admit(&mut self, now: Time, number: Option<u64>) -> Result<(), Refusal> {
        self.expire(now);
        self.fencing.admit(number)
    }

    /// Returns the fencing number of the present holder.
    pub fn held(&mut self, now: Time) -> Option<u64> {
        self.expire(now);
        self.holder.as_ref().map(|holder| holder.fence)
    }

    /// Returns the status of the lock.
    pub fn status(&self, now: Time) -> LockStatus {
        let holder = self.holder.as_ref();
        LockStatus {
            holder: holder.map(|holder| holder.name.clone()),
            fence: holder.map(|holder| holder.fence),
            left: holder.map(|holder| holder.until.since(now)),
            lease: self.settings.lease,
            waiting: self.waiting.values().map(|waiter| waiter.name.clone()).collect(),
            counters: self.counters,
        }
    }

    fn acquire(&mut self, now: Time, waiter: Waiter, priority: u8, effects: &mut Vec<LockEffect>) {
        let (client, request) = (waiter.client, waiter.request);
        let mut deny = |why| {
            effects.push(LockEffect::Answer { client, answer: LockAnswer::Denied { request, why } });
        };
        if let Some(holder) = &self.holder
            && (holder.client, holder.request) == (client, request)
        {
            let answer = self.granted(now, request);
            return effects.extend(answer.map(|answer| LockEffect::Answer { client, answer }));
        }
        if let Some((ended, why, _)) = self.ended.get(&client)
            && request <= *ended
        {
            return deny(*why);
        }
        // A newer request of a client replaces its older request.
        self.release(now, client, request.saturating_sub(1));
        let place = self.waiting.iter().find(|(_, other)| other.client == client).map(|(&place, _)| place);
        match place {
            Some(place) if place.0.0 == priority => {
                self.waiting.insert(place, waiter);
            }
            Some(place) => {
                self.waiting.remove(&place);
                self.waiting.insert((Reverse(priority), place.1), waiter);
            }
            None if self.waiting.len() >= self.settings.waiting_max => return deny(Denied::TooManyWait),
            None => {
                self.arrival += 1;
                self.waiting.insert((Reverse(priority), self.arrival), waiter);
            }
        }
        self.preempt(now, priority);
        self.grant(now, effects);
        let ahead = self.waiting.values().position(|other| other.client == client);
        if let Some(ahead) = ahead {
            let holder = self.holder.as_ref().map_or(String::new(), |holder| holder.name.clone());
            let answer = LockAnswer::Waiting { request, ahead: count(ahead), holder, lease: self.settings.lease };
            effects.push(LockEffect::Answer { client, answer });
        }
    }

    fn preempt(&mut self, now: Time, priority: u8) {
        if let (Some(holder), Some(grace)) = (&mut self.holder, self.settings.preempt_after)
            && priority > holder.priority
            && !holder.is_wanted
        {
            holder.is_wanted = true;
            holder.until = holder.until.min(now + grace);
        }
        self.expire(now);
    }

    fn renew(&mut self, now: Time, client: u64, request: u64, effects: &mut Vec<LockEffect>) {
        let is_held = self.holder.as_ref().is_some_and(|holder| (holder.client, holder.request) == (client, request));
        let renews_anybody = self.has(Fault::RenewsAnybody);
        if let Some(holder) = self.holder.as_mut().filter(|_| is_held || renews_anybody) {
            if !holder.is_wanted {
                holder.until = now + self.settings.lease;
            }
            let answer = self.granted(now, request);
            return effects.extend(answer.map(|answer| LockEffect::Answer { client, answer }));
        }
        let ended = self.ended.get(&client).filter(|(ended, ..)| request <= *ended);
        let why = ended.map_or(Denied::NotHeld, |(_, why, _)| *why);
        effects.push(LockEffect::Answer { client, answer: LockAnswer::Denied { request, why } });
    }

    /// Withdraws all requests of a client up to `request`, waiting or granted.
    fn release(&mut self, now: Time, client: u64, request: u64) {
        self.waiting.retain(|_, waiter| waiter.client != client || waiter.request > request);
        if self.holder.as_ref().is_some_and(|holder| holder.client == client && holder.request <= request) {
            self.end_hold(now, Denied::Released);
        }
        if request > 0 {
            self.remember(now, client, request, Denied::Released);
        }
    }

    fn expire(&mut self, now: Time) {
        let lease = self.settings.lease;
        self.waiting.retain(|_, waiter| now < waiter.heard + lease);
        let Some(holder) = self.holder.as_ref().filter(|holder| holder.until <= now) else { return };
        let why = if holder.is_wanted { Denied::Preempted } else { Denied::Expired };
        *(if holder.is_wanted { &mut self.counters.preempted } else { &mut self.counters.expired }) += 1;
        self.end_hold(now, why);
    }

    fn end_hold(&mut self, now: Time, why: Denied) {
        let Some(holder) = self.holder.take() else { return };
        let fault = if why == Denied::Preempted { Fault::PreemptsOnPaper } else { Fault::StaysOpen };
        if !self.has(fault) {
            self.fencing.close(holder.fence);
        }
        self.remember(now, holder.client, holder.request, why);
    }

    fn remember(&mut self, now: Time, client: u64, request: u64, why: Denied) {
        if self.ended.get(&client).is_some_and(|(ended, ..)| *ended >= request) {
            return;
        }
        if self.ended.len() >= CLIENTS_MAX && !self.ended.contains_key(&client) {
            let oldest = self.ended.iter().min_by_key(|(_, (_, _, at))| *at).map(|(&client, _)| client);
            oldest.and_then(|oldest| self.ended.remove(&oldest));
        }
        self.ended.insert(client, (request, why, now));
    }

    /// Gives a free lock to the first waiting client.
    fn grant(&mut self, now: Time, effects: &mut Vec<LockEffect>) {
        if self.holder.is_some() || self.waiting.is_empty() || now < self.quarantine {
            return;
        }
        effects.extend(self.numbers.reserve().map(LockEffect::Persist));
        if !self.numbers.is_reserved() && !self.has(Fault::GrantsUnwritten) {
            return;
        }
        let Some(((Reverse(priority), _), waiter)) = self.waiting.pop_first() else { return };
        let Waiter { client, name, request, .. } = waiter;
        let (fence, until) = (self.numbers.take(), now + self.settings.lease);
        self.counters.grants += 1;
        self.fencing.open(fence);
        self.holder = Some(Holder { client, name, request, priority, fence, until, is_wanted: false });
        effects.extend(self.granted(now, request).map(|answer| LockEffect::Answer { client, answer }));
    }

    #[cfg_attr(not(test), expect(clippy::unused_self, reason = "only a lock in a test can have a fault"))]
    fn has(&self, fault: Fault) -> bool {
        #[cfg(test)]
        let planted = self.fault;
        #[cfg(not(test))]
        let planted = None;
        planted == Some(fault)
    }

    fn granted(&self, now: Time, request: u64) -> Option<LockAnswer> {
        self.holder.as_ref().map(|holder| LockAnswer::Granted {
            request,
            fence: holder.fence,
            lease: self.settings.lease,
            left: holder.until.since(now),
            is_wanted: holder.is_wanted,
        })
    }
}

#[cfg(test)]
mod tests;
