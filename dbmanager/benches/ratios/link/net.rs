//! Replicas and lines between them, in virtual time. A line carries a fixed number of bytes per second, one message
//! after another.

use crate::Failure;
use crate::robot::config;
use comms::logic::time::Time;
use dbmanager::logic::clock::{Quality, Wall};
use dbmanager::logic::message::Message;
use dbmanager::logic::record::Records;
use dbmanager::logic::replica::{Effect, Input, Replica};
use dbmanager::logic::version_vector::{ReplicaId, VersionVector};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// The reading of all wall clocks.
pub(super) const WALL: Wall = Wall { millis: 1_790_000_000_000, quality: Quality::Network };
/// How long anything may take.
const TIME_MAX: Duration = Duration::from_secs(3600);
/// How long a team has to find all its members.
const GATHERED_AFTER: Duration = Duration::from_secs(60);

/// A line in one direction.
#[derive(Clone, Copy, Debug)]
pub(super) struct Line {
    /// Bytes a second.
    pub(super) rate: u64,
    /// How long a byte is in transit.
    pub(super) delay: Duration,
}

/// The replicas, and the messages in transit between them.
pub(super) struct Net {
    now: Time,
    line: Line,
    replicas: Vec<Replica>,
    cuts: BTreeSet<(usize, usize)>,
    mail: BTreeMap<(Time, u64), (usize, ReplicaId, Message)>,
    /// The time until which each line is busy. All lines to a robot that is reached over the air share one entry.
    busy: BTreeMap<(Option<usize>, usize), Time>,
    air: Option<usize>,
    longest_on_air: Duration,
    posted: u64,
    bytes: u64,
}

impl Net {
    /// Returns a team whose robots know each other.
    pub(super) fn team(count: usize, line: Line) -> Result<Self, Failure> {
        let mut net = Self {
            now: Time::ZERO,
            line: Line { rate: 1_000_000_000, ..line },
            replicas: Vec::new(),
            cuts: BTreeSet::new(),
            mail: BTreeMap::new(),
            busy: BTreeMap::new(),
            air: None,
            longest_on_air: Duration::ZERO,
            posted: 0,
            bytes: 0,
        };
        for robot in 0..count {
            net.replicas.push(Replica::open(config(&format!("r{robot}"), robot as u64 + 1), &Records::new())?);
            net.tell(robot, if robot == 0 { Input::Found(WALL) } else { Input::Tick(WALL) })?;
        }
        net.run_for(GATHERED_AFTER)?;
        if !net.replicas.iter().all(Replica::is_member) {
            return Err("the team has not gathered".into());
        }
        net.line = line;
        Ok(net)
    }

    /// Returns the time.
    pub(super) fn now(&self) -> Time {
        self.now
    }

    /// Returns how many bytes were sent, over all receivers.
    pub(super) fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Returns the version vector of a robot.
    pub(super) fn cut_of(&self, robot: usize) -> VersionVector {
        self.replicas[robot].log().vector().clone()
    }

    /// Returns for how long the longest message to the robot on the air has occupied the air.
    pub(super) fn longest_on_air(&self) -> Duration {
        self.longest_on_air
    }

    /// Makes all other robots reach this robot over one shared line.
    pub(super) fn share_air(&mut self, robot: usize) {
        self.air = Some(robot);
    }

    /// Cuts the line between two robots.
    pub(super) fn cut(&mut self, a: usize, b: usize) {
        self.cuts.insert((a.min(b), a.max(b)));
    }

    /// Restores the line between two robots, and tells them; returns the time.
    pub(super) fn meet(&mut self, a: usize, b: usize) -> Result<Time, Failure> {
        self.cuts.remove(&(a.min(b), a.max(b)));
        self.tell(a, Input::Appeared(WALL))?;
        self.tell(b, Input::Appeared(WALL))?;
        Ok(self.now)
    }

    /// Lets time pass.
    pub(super) fn run_for(&mut self, span: Duration) -> Result<(), Failure> {
        let end = self.now + span;
        while self.step(end)? {}
        self.now = end;
        Ok(())
    }

    /// Lets time pass until `is_so` returns true.
    pub(super) fn run_until(&mut self, is_so: impl Fn(&Self) -> bool) -> Result<(), Failure> {
        let end = self.now + TIME_MAX;
        while !is_so(self) {
            if !self.step(end)? {
                return Err("it takes for ever".into());
            }
        }
        Ok(())
    }

    /// Processes the next event, if it is before `end`.
    fn step(&mut self, end: Time) -> Result<bool, Failure> {
        let mail = self.mail.first_key_value().map(|((at, _), _)| *at);
        let due = |(robot, replica): (usize, &Replica)| Some((replica.deadline()?.max(self.now), robot));
        let tick = self.replicas.iter().enumerate().filter_map(due).min();
        match (mail, tick) {
            (Some(at), tick) if at <= end && tick.is_none_or(|(due, _)| at <= due) => {
                self.now = self.now.max(at);
                if let Some((_, (to, from, message))) = self.mail.pop_first() {
                    self.tell(to, Input::Received(from, message, WALL))?;
                }
                Ok(true)
            }
            (_, Some((at, robot))) if at <= end => {
                self.now = at;
                self.tell(robot, Input::Tick(WALL))?;
                Ok(true)
            }
            _ => Ok(false),
        }
    }

    /// Gives an input to a robot, and executes the effects.
    pub(super) fn tell(&mut self, robot: usize, input: Input) -> Result<(), Failure> {
        let mut effects = Vec::new();
        self.replicas[robot].handle(self.now, input, &mut effects);
        for effect in effects {
            if let Effect::Broadcast(message) = effect {
                for to in (0..self.replicas.len()).filter(|to| *to != robot) {
                    self.post(robot, to, &message)?;
                }
            } else if let Effect::Send(address, message) = effect {
                let to = self.replicas.iter().position(|replica| replica.address() == address);
                if let Some(to) = to.filter(|to| *to != robot) {
                    self.post(robot, to, &message)?;
                }
            }
        }
        Ok(())
    }

    fn post(&mut self, from: usize, to: usize, message: &Message) -> Result<(), Failure> {
        if self.cuts.contains(&(from.min(to), from.max(to))) {
            return Ok(());
        }
        let address = self.replicas[from].address();
        let size = u64::try_from(postcard::to_stdvec(&(address, message))?.len())?;
        let on_air = self.air == Some(to);
        let busy = self.busy.entry(((!on_air).then_some(from), to)).or_default();
        let takes = Duration::from_nanos(size * 1_000_000_000 / self.line.rate);
        *busy = (*busy).max(self.now) + takes;
        if on_air {
            self.longest_on_air = self.longest_on_air.max(takes);
        }
        self.posted += 1;
        self.bytes += size;
        self.mail.insert((*busy + self.line.delay, self.posted), (to, address, message.clone()));
        Ok(())
    }
}
