//! A team with nodes and users. Everything follows from numbers, so it is always the same.

use comms::logic::codec;
use language::plan::Plan;
use language::{Options, Source, compile};
use node::logic::gate::{Gate, Ledger, action, audience};
use node::logic::protocol::{Request, Signed};
use std::cell::Cell;
use std::collections::BTreeMap;
use trust::certificate::{Certificate, Claims, DAY};
use trust::identity::{Entropy, KeyId, SecretKeys};
use trust::name::UnixTime;
use trust::request::{self, Audience};
use trust::revocation::{Revocations, RevokedSet};
use trust::role::{Action, Role};
use trust::team::{Credential, Judge, Team};

pub(crate) const NOW: UnixTime = UnixTime(1_800_000_000);

const SPEC: &str = r#"
module First(host) { exec "first"; plain; }
module Second(host) { exec "second"; plain; }
process main() {
    host { "c1" }
    instantiated_processes { first instof First("c1"); second instof Second("c2"); }
    internal_event_actions { first ; second }
}
"#;

/// Returns the plan of a mission with its home on `c1` and a program on each of `c1` and `c2`.
pub(crate) fn plan() -> Plan {
    let compiled = compile(&Source::new("test.dca", SPEC), &[], &Options::named("test"));
    compiled.plan.unwrap_or_else(|| panic!("{:#?}", compiled.diagnostics))
}

pub(crate) struct World {
    root: SecretKeys,
    team: Team,
    revoked: Revocations,
}

/// A user with a number for each request.
pub(crate) struct User {
    team: KeyId,
    keys: SecretKeys,
    credential: Credential,
    number: Cell<u64>,
}

fn keys(name: &str) -> SecretKeys {
    let mut seed = [0; 32];
    name.bytes().zip(&mut seed).for_each(|(byte, place)| *place = byte);
    SecretKeys::generate(&mut Entropy::new(&seed))
}

impl World {
    pub(crate) fn new() -> Self {
        Self::of_team(1)
    }

    pub(crate) fn of_team(number: u8) -> Self {
        let root = SecretKeys::generate(&mut Entropy::new(&[number; 32]));
        let team = Team::found("acme".parse().expect("a name"), &root);
        Self { root, team, revoked: Revocations::default() }
    }

    pub(crate) fn judge(&self, now: UnixTime) -> Judge<'_> {
        Judge { team: &self.team, revoked: &self.revoked, now, grace: 7 * DAY }
    }

    pub(crate) fn key(&self, name: &str) -> KeyId {
        keys(name).public().id()
    }

    pub(crate) fn gate(&self, host: &str) -> Gate {
        self.gate_with(host, Ledger::default())
    }

    pub(crate) fn gate_with(&self, host: &str, ledger: Ledger) -> Gate {
        Gate::new(self.key(host), host.parse().expect("a name"), ledger)
    }

    pub(crate) fn user(&self, name: &str, role: Role) -> User {
        let keys = keys(name);
        let claims = Claims {
            team: self.team.id(),
            name: name.parse().expect("a name"),
            role,
            keys: *keys.public(),
            not_before: NOW,
            not_after: NOW.plus(30 * DAY),
            renewable_until: NOW.plus(365 * DAY),
            serial: [8; 16],
        };
        let credential = Credential::new(Certificate::issue(claims, &self.root).expect("good claims"), None);
        User { team: self.team.id(), keys, credential, number: Cell::new(0) }
    }

    pub(crate) fn revoke(&mut self, user: &User) {
        let gone = BTreeMap::from([(user.keys.public().id(), NOW)]);
        let set = RevokedSet::sign(&self.team, 1, gone, &self.root, None).expect("a good set");
        let mut revoked = Revocations::default();
        revoked.receive(set, &self.judge(NOW)).expect("it is the team's");
        self.revoked = revoked;
    }
}

impl User {
    pub(crate) fn sign(&self, asked: &Request, host: &str) -> Signed {
        self.sign_with(asked, host, &|_| {})
    }

    pub(crate) fn sign_as(&self, asked: &Request, action: Action) -> Signed {
        let request = self.request(action, Audience::Team);
        self.signed(&request, asked)
    }

    /// Signs a request with something changed.
    pub(crate) fn sign_with(&self, asked: &Request, host: &str, change: &dyn Fn(&mut request::Request)) -> Signed {
        let mut request = self.request(action(asked).expect("it is signed"), audience(asked, host).expect("a name"));
        change(&mut request);
        self.signed(&request, asked)
    }

    pub(crate) fn audience(&self, signed: &Signed) -> Audience {
        request::Request::peek(&signed.head).expect("it is a request").0.audience
    }

    fn request(&self, action: Action, audience: Audience) -> request::Request {
        self.number.set(self.number.get() + 1);
        let (sequence, not_after) = (self.number.get(), NOW.plus(60));
        request::Request {
            team: self.team,
            audience,
            action,
            id: [1; 16],
            sequence,
            epoch: 3,
            not_before: NOW,
            not_after,
        }
    }

    fn signed(&self, request: &request::Request, asked: &Request) -> Signed {
        let body = codec::encode(asked).expect("it is short");
        Signed { head: request.sign(&body, &self.keys, &self.credential), body }
    }
}
