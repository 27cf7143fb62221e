//! The identity of robots and deployments.
//!
//! A name alone does not tell them apart. The nodes inside two commands do not know of each other, so both may have a node
//! `c1`. Each home counts its own epochs, so two homes may both have a deployment `door@1`.

use node::logic::protocol::Deployment;
use std::fmt;

/// The nodes that know of each other.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Fleet {
    /// The nodes that stay on their machines.
    #[default]
    Standing,
    /// The nodes inside one command of this machine, such as `dca run`, with the process id of the command.
    Command(u32),
}

impl Fleet {
    /// Returns the process id of the command that the nodes are inside of.
    pub fn command(self) -> Option<u32> {
        match self {
            Self::Standing => None,
            Self::Command(pid) => Some(pid),
        }
    }
}

/// Nothing, or ` (command 4711)` behind a name.
impl fmt::Display for Fleet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.command().map_or(Ok(()), |pid| write!(f, " (command {pid})"))
    }
}

/// A robot among all that a view knows.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct RobotId {
    /// Its host.
    pub host: String,
    /// The nodes that it knows.
    pub fleet: Fleet,
}

/// `c1`, or `c1 (command 4711)`
impl fmt::Display for RobotId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{}", self.host, self.fleet)
    }
}

/// A deployment among all that a view knows.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct MissionId {
    /// Its name and epoch.
    pub deployment: Deployment,
    /// The host of `main`.
    pub home: String,
    /// The nodes that it runs on.
    pub fleet: Fleet,
}

impl MissionId {
    /// Returns the robot of one of its hosts.
    pub fn robot(&self, host: &str) -> RobotId {
        RobotId { host: host.to_owned(), fleet: self.fleet }
    }

    /// Returns a text that no other deployment has.
    pub fn key(&self) -> String {
        format!("{} {}{}", self.deployment, self.home, self.fleet)
    }
}

/// `door@3`, or `door@3 (command 4711)`
impl fmt::Display for MissionId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{}", self.deployment, self.fleet)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_stands_behind_a_name() {
        let id = |epoch, fleet| MissionId {
            deployment: Deployment { name: "door".into(), epoch },
            home: "c1".into(),
            fleet,
        };
        let check = |fleet, texts: [&str; 3]| {
            let id = id(3, fleet);
            assert_eq!([id.robot("c2").to_string(), id.to_string(), id.key()], texts);
        };
        check(Fleet::Standing, ["c2", "door@3", "door@3 c1"]);
        check(Fleet::Command(47), ["c2 (command 47)", "door@3 (command 47)", "door@3 c1 (command 47)"]);
    }
}
