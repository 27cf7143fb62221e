//! The roles of members in a team, and their rights.

use crate::wire::FormError;
use std::fmt;
use std::str::FromStr;

/// The kind of a certificate's subject.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// The node of a robot.
    Node,
    /// A person, or a machine that acts for people.
    User,
    /// A program that a node has started.
    Program,
}

/// The roles of members.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Role {
    /// A user who may only watch.
    Viewer,
    /// A user who may stop and start existing deployments.
    Operator,
    /// A user who may decide what is deployed.
    Deployer,
    /// A user who may decide about the members of the team. Only the team's key can make admins.
    Admin,
    /// A build machine, which may deploy.
    Ci,
    /// A node.
    Member,
    /// A node that may also renew certificates of others, up to the time that their issuer has set.
    Renewer,
    /// A program.
    Program,
}

/// The actions that a request may have.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Action {
    /// Stop everything at once. Every member may do this.
    Estop,
    /// Watch running programs, and read the database.
    Watch,
    /// Stop a deployment or a program.
    Stop,
    /// Start an existing deployment.
    Start,
    /// Deploy a spec, or change a running one.
    Deploy,
    /// Write the database.
    Write,
    /// Take a robot or user into the team.
    Invite,
    /// Revoke a key.
    Revoke,
    /// Renew a certificate.
    Renew,
    /// Begin a database, and decide which robots have a copy of it.
    Found,
    /// Call a procedure of a running program.
    Operate,
}

const KINDS: [(Kind, u8, &str); 3] = [(Kind::Node, 1, "node"), (Kind::User, 2, "user"), (Kind::Program, 3, "program")];
const ROLES: [(Role, u8, &str); 8] = [
    (Role::Viewer, 1, "viewer"),
    (Role::Operator, 2, "operator"),
    (Role::Deployer, 3, "deployer"),
    (Role::Admin, 4, "admin"),
    (Role::Ci, 5, "ci"),
    (Role::Member, 6, "member"),
    (Role::Renewer, 7, "renewer"),
    (Role::Program, 8, "program"),
];
const ACTIONS: [(Action, u8, &str); 11] = [
    (Action::Estop, 1, "stop everything"),
    (Action::Watch, 2, "look"),
    (Action::Stop, 3, "stop"),
    (Action::Start, 4, "start"),
    (Action::Deploy, 5, "deploy"),
    (Action::Write, 6, "write the database"),
    (Action::Invite, 7, "invite"),
    (Action::Revoke, 8, "revoke"),
    (Action::Renew, 9, "renew"),
    (Action::Found, 10, "decide who has the database"),
    (Action::Operate, 11, "operate"),
];

impl Kind {
    pub(crate) fn number(self) -> u8 {
        KINDS.iter().find(|row| row.0 == self).expect("every kind has a row").1
    }

    pub(crate) fn from_number(number: u8) -> Result<Self, FormError> {
        KINDS.iter().find(|row| row.1 == number).map(|row| row.0).ok_or(FormError::Field("kind"))
    }
}

impl Role {
    pub(crate) fn number(self) -> u8 {
        ROLES.iter().find(|row| row.0 == self).expect("every role has a row").1
    }

    pub(crate) fn from_number(number: u8) -> Result<Self, FormError> {
        ROLES.iter().find(|row| row.1 == number).map(|row| row.0).ok_or(FormError::Field("role"))
    }

    /// Reads a role of a kind.
    ///
    /// # Errors
    /// If the kind has no such role; the text lists its roles.
    pub fn named(kind: Kind, text: &str) -> Result<Self, String> {
        among(|role| role.kind() == kind, text)
    }

    /// Returns the kind of subject that can have this role.
    #[must_use]
    pub const fn kind(self) -> Kind {
        match self {
            Self::Viewer | Self::Operator | Self::Deployer | Self::Admin | Self::Ci => Kind::User,
            Self::Member | Self::Renewer => Kind::Node,
            Self::Program => Kind::Program,
        }
    }

    /// Returns whether this role has the right to an action.
    #[must_use]
    pub fn may(self, action: Action) -> bool {
        use Action::{Deploy, Estop, Found, Invite, Operate, Renew, Revoke, Start, Stop, Watch, Write};
        let also: &[Action] = match self {
            Self::Viewer | Self::Member => &[Watch],
            Self::Operator => &[Watch, Stop, Start, Operate],
            Self::Deployer => &[Watch, Stop, Start, Operate, Deploy, Write],
            Self::Admin => &[Watch, Stop, Start, Operate, Deploy, Write, Invite, Revoke, Renew, Found],
            Self::Ci => &[Watch, Stop, Start, Operate, Deploy],
            Self::Renewer => &[Watch, Renew],
            Self::Program => &[],
        };
        action == Estop || also.contains(&action)
    }
}

impl Action {
    pub(crate) fn number(self) -> u8 {
        ACTIONS.iter().find(|row| row.0 == self).expect("every action has a row").1
    }

    pub(crate) fn from_number(number: u8) -> Result<Self, FormError> {
        ACTIONS.iter().find(|row| row.1 == number).map(|row| row.0).ok_or(FormError::Field("action"))
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(KINDS.iter().find(|row| row.0 == *self).expect("every kind has a row").2)
    }
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(ROLES.iter().find(|row| row.0 == *self).expect("every role has a row").2)
    }
}

impl fmt::Display for Action {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(ACTIONS.iter().find(|row| row.0 == *self).expect("every action has a row").2)
    }
}

impl FromStr for Role {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        among(|_| true, text)
    }
}

fn among(may_be: impl Fn(Role) -> bool, text: &str) -> Result<Role, String> {
    let rows = ROLES.iter().filter(|row| may_be(row.0));
    let found = rows.clone().find(|row| row.2 == text).map(|row| row.0);
    found.ok_or_else(|| format!("`{text}` is not one of {}", rows.map(|row| row.2).collect::<Vec<_>>().join(", ")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_role_may_do_what_the_table_says() {
        let table = "\
viewer    stop everything, look
operator  stop everything, look, stop, start, operate
deployer  stop everything, look, stop, start, deploy, write the database, operate
admin     stop everything, look, stop, start, deploy, write the database, invite, revoke, renew, decide who has the database, operate
ci        stop everything, look, stop, start, deploy, operate
member    stop everything, look
renewer   stop everything, look, renew
program   stop everything
";
        let row = |role: Role| {
            let actions: Vec<&str> = ACTIONS.iter().filter(|row| role.may(row.0)).map(|row| row.2).collect();
            format!("{role:<9} {}\n", actions.join(", "))
        };
        assert_eq!(ROLES.iter().map(|entry| row(entry.0)).collect::<String>(), table);
    }

    #[test]
    fn a_role_of_another_kind_is_refused_with_those_there_are() {
        let refused = |kind, text| Role::named(kind, text).unwrap_err();
        assert_eq!(refused(Kind::Node, "admin"), "`admin` is not one of member, renewer");
        assert_eq!(refused(Kind::User, "member"), "`member` is not one of viewer, operator, deployer, admin, ci");
    }

    #[test]
    fn numbers_come_back() {
        for (role, number, text) in ROLES {
            assert_eq!((Role::from_number(number), text.parse()), (Ok(role), Ok(role)));
        }
        assert!(KINDS.iter().all(|row| Kind::from_number(row.1) == Ok(row.0)));
        assert!(ACTIONS.iter().all(|row| Action::from_number(row.1) == Ok(row.0)));
        assert!(Role::from_number(0).is_err() && Kind::from_number(4).is_err() && Action::from_number(12).is_err());
    }
}
