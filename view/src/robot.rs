//! A robot: the host of a node.

use crate::freshness::Freshness;
use crate::identity::RobotId;
use crate::text::{clean, is_name};
use comms::logic::time::Time;
use node::logic::database::question;
use node::logic::protocol::NodeStatus;
use node::logic::table::counted;
use std::fmt;
use std::time::Duration;

/// How many names of a list are kept with a robot.
const NAMES_MAX: usize = 64;

/// Whether the node of a robot answers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Presence {
    /// It answers.
    Here,
    /// It does not answer; the reason.
    Silent(String),
    /// Other nodes treat it as lost.
    Lost,
}

impl Presence {
    /// Returns it in words.
    pub fn word(&self) -> &'static str {
        match self {
            Self::Here => "here",
            Self::Silent(_) => "does not answer",
            Self::Lost => "lost",
        }
    }
}

/// How far other replicas are behind the database of a robot.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct DatabaseLag {
    /// How many robots lack something.
    pub behind: u64,
    /// The most transactions that one of them lacks.
    pub transactions: u64,
    /// How many keys have conflicts that are not settled.
    pub conflicts: u64,
}

/// `level`, `2 behind, 5 transactions`, `level, 1 conflict`
impl fmt::Display for DatabaseLag {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.behind {
            0 => f.write_str("level")?,
            behind => write!(f, "{behind} behind, {}", counted(self.transactions, "transaction"))?,
        }
        match self.conflicts {
            0 => Ok(()),
            conflicts => write!(f, ", {}", counted(conflicts, "conflict")),
        }
    }
}

/// A robot, by its node.
#[derive(Clone, Debug)]
pub struct Robot {
    /// Its host, and the nodes that it knows.
    pub id: RobotId,
    /// Whether its node answers.
    pub presence: Presence,
    /// When it has answered last.
    pub heard: Option<Time>,
    /// The process id of its node.
    pub pid: u32,
    /// The version of DCA.
    pub version: String,
    /// When its node was started, by the clock of the view.
    pub began: Time,
    /// The peers that may reach it over the network, and the policy for programs.
    pub guard: String,
    /// The user who has stopped everything, and the reason.
    pub estop: Option<String>,
    /// Deployments with their home here that have not begun, with the reason.
    pub waiting: Vec<String>,
    /// The state of its database.
    pub database: Option<DatabaseLag>,
    /// Since when no node lists it.
    pub(crate) unlisted: Option<Time>,
    pub(crate) changed: u64,
}

impl Robot {
    pub(crate) fn new(id: RobotId, presence: Presence, changed: u64) -> Self {
        Self {
            id,
            presence,
            heard: None,
            pid: 0,
            version: String::new(),
            began: Time::ZERO,
            guard: String::new(),
            estop: None,
            waiting: Vec::new(),
            database: None,
            unlisted: None,
            changed,
        }
    }

    /// Returns whether its data is live.
    pub fn freshness(&self, now: Time) -> Freshness {
        Freshness::of(self.heard, now)
    }

    /// Returns how long its node has run; none if it has never answered.
    pub fn up(&self, now: Time) -> Option<Duration> {
        self.heard.map(|_| now.since(self.began))
    }

    /// Takes a status in; returns whether anything but its age is new.
    pub(crate) fn take(&mut self, now: Time, status: &NodeStatus) -> bool {
        let began = now.before(status.up);
        // The clock of another host and the way here make it differ each time.
        let is_same_node = self.heard.is_some() && self.pid == status.pid && began.since(self.began).as_secs() < 5;
        let guards = [status.network.to_string(), status.policy.as_ref().map(ToString::to_string).unwrap_or_default()];
        let guard = guards.into_iter().filter(|word| !word.is_empty()).collect::<Vec<_>>().join(", ");
        let waiting = status.waiting.iter().filter(|one| is_name(&one.name)).take(NAMES_MAX);
        let new = Self {
            id: self.id.clone(),
            presence: Presence::Here,
            heard: Some(now),
            pid: status.pid,
            version: clean(&status.version),
            began: if is_same_node { self.began } else { began },
            guard: clean(&guard),
            estop: status.estop.as_ref().map(|estop| clean(&estop.to_string())),
            waiting: waiting.map(|one| format!("{} {}", one.name, one.state())).collect(),
            database: self.database.clone(),
            unlisted: None,
            changed: self.changed,
        };
        let is_new = !is_same_node
            || (&new.presence, &new.version, &new.guard) != (&self.presence, &self.version, &self.guard)
            || (&new.estop, &new.waiting) != (&self.estop, &self.waiting);
        *self = new;
        is_new
    }

    /// Takes the status of its database in; returns whether it is new.
    pub(crate) fn take_database(&mut self, status: &question::Status) -> bool {
        let behind = status.members.iter().filter(|member| member.lacks.transactions > 0);
        let lag = DatabaseLag {
            behind: behind.clone().fold(0, |count, _| count + 1),
            transactions: behind.map(|member| member.lacks.transactions).max().unwrap_or_default(),
            conflicts: status.contents.conflicts,
        };
        let is_new = self.database.as_ref() != Some(&lag);
        self.database = Some(lag);
        is_new
    }
}
