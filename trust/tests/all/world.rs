//! A team with an admin, a deployer, a viewer and two robots. All keys come from fixed numbers, so the team is always
//! the same.

use trust::certificate::{Certificate, Claims, DAY};
use trust::identity::{Entropy, SecretKeys};
use trust::name::UnixTime;
use trust::revocation::Revocations;
use trust::role::Role;
use trust::team::{Credential, Judge, Team};

pub(crate) const NOW: UnixTime = UnixTime(1_800_000_000);

pub(crate) fn keys(number: u8) -> SecretKeys {
    SecretKeys::generate(&mut Entropy::new(&[number; 32]))
}

pub(crate) struct World {
    pub(crate) root: SecretKeys,
    pub(crate) team: Team,
    pub(crate) admin: (SecretKeys, Credential),
    pub(crate) deployer: (SecretKeys, Credential),
    pub(crate) viewer: (SecretKeys, Credential),
    pub(crate) r1: (SecretKeys, Credential),
    pub(crate) r2: (SecretKeys, Credential),
    pub(crate) revoked: Revocations,
}

impl World {
    pub(crate) fn new() -> Self {
        let root = keys(1);
        let team = Team::found("acme".parse().expect("the input is good"), &root);
        let admin_keys = keys(2);
        let admin =
            Certificate::issue(claims(&team, "ann", Role::Admin, &admin_keys), &root).expect("the input is good");
        let by_admin = |number: u8, name: &str, role: Role| {
            let own = keys(number);
            let certificate =
                Certificate::issue(claims(&team, name, role, &own), &admin_keys).expect("the input is good");
            (own, Credential::new(certificate, Some(admin.clone())))
        };
        let (deployer, viewer) = (by_admin(3, "dan", Role::Deployer), by_admin(4, "vic", Role::Viewer));
        let (r1, r2) = (by_admin(5, "r1", Role::Member), by_admin(6, "r2", Role::Renewer));
        let admin = (admin_keys, Credential::new(admin, None));
        Self { root, team, admin, deployer, viewer, r1, r2, revoked: Revocations::default() }
    }

    pub(crate) fn judge(&self, now: UnixTime) -> Judge<'_> {
        Judge { team: &self.team, revoked: &self.revoked, now, grace: 7 * DAY }
    }
}

pub(crate) fn claims(team: &Team, name: &str, role: Role, keys: &SecretKeys) -> Claims {
    Claims {
        team: team.id(),
        name: name.parse().expect("the input is good"),
        role,
        keys: *keys.public(),
        not_before: NOW,
        not_after: NOW.plus(30 * DAY),
        renewable_until: NOW.plus(365 * DAY),
        serial: [8; 16],
    }
}
