//! A team whose keys are in the test. It makes any members and users, without the ceremonies.

use crate::cluster::Host;
use std::fs;
use std::path::Path;
use std::sync::Arc;
use team::member::Member;
use trust::certificate::{Certificate, Claims, DAY};
use trust::identity::SecretKeys;
use trust::name::UnixTime;
use trust::role::Role;
use trust::team::{Credential, Team};

/// A team and its key.
#[derive(Debug)]
pub struct MadeTeam {
    /// The key of the team.
    pub root: SecretKeys,
    /// The team.
    pub team: Team,
}

/// Returns new keys.
///
/// # Panics
/// Panics if the system has no random bytes.
pub fn keys() -> SecretKeys {
    SecretKeys::generate(&mut team::random().expect("the system has random bytes"))
}

impl Default for MadeTeam {
    fn default() -> Self {
        let root = keys();
        let team = Team::found("acme".parse().expect("a name"), &root);
        Self { root, team }
    }
}

impl MadeTeam {
    /// Returns a certificate that is valid for a month.
    ///
    /// # Panics
    /// Panics if `name` is not a valid name.
    pub fn certify(&self, name: &str, role: Role, keys: &SecretKeys) -> Credential {
        let now = team::now();
        self.certify_between(name, (role, keys), (UnixTime(now.0 - 10), now.plus(30 * DAY)))
    }

    /// Returns a certificate that is valid between these times and can be renewed for a year.
    ///
    /// # Panics
    /// Panics if `name` is not a valid name, or if the times are not in order.
    pub fn certify_between(
        &self,
        name: &str,
        (role, keys): (Role, &SecretKeys),
        (not_before, not_after): (UnixTime, UnixTime),
    ) -> Credential {
        let claims = Claims {
            team: self.team.id(),
            name: name.parse().expect("a name"),
            role,
            keys: *keys.public(),
            not_before,
            not_after,
            renewable_until: not_before.plus(365 * DAY),
            serial: [8; 16],
        };
        Credential::new(Certificate::issue(claims, &self.root).expect("good claims"), None)
    }

    /// Makes a node of this host a member, with the state folder that [`Host::node`] gives it.
    ///
    /// # Panics
    /// Panics if the folder of its state cannot be made.
    pub fn admit(&self, host: &Host, name: &str) {
        self.admit_at(&host.state().join(name), name);
    }

    /// Returns a member for which a test itself acts, with its state in a folder.
    ///
    /// # Panics
    /// Panics if the folder cannot be made.
    pub fn member(&self, state: &Path, name: &str) -> Arc<Member> {
        self.admit_at(state, name);
        Arc::new(Member::open(state).expect("a folder of ours").expect("it is in a team"))
    }

    fn admit_at(&self, state: &Path, name: &str) {
        let own = keys();
        let credential = self.certify(name, Role::Member, &own);
        self.begin(state, &own, &credential);
    }

    /// Makes the node with this state folder a member with these keys and this credential.
    ///
    /// # Panics
    /// Panics if the folder of its state cannot be made.
    pub fn begin(&self, state: &Path, keys: &SecretKeys, credential: &Credential) {
        fs::create_dir_all(state).expect("a folder of ours");
        Member::begin(state, keys, &self.team, false, credential).expect("a folder of ours");
    }
}
