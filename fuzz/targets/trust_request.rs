//! A signed request from a stranger: it is refused, and a refusal spends no number.
#![no_main]

use libfuzzer_sys::fuzz_target;
use std::sync::LazyLock;
use trust::identity::{Entropy, KeyId, SecretKeys};
use trust::name::UnixTime;
use trust::request::{Context, Replays, check};
use trust::revocation::Revocations;
use trust::team::{Judge, Team};

/// A team with a secret key: a stranger cannot sign for it with any bytes.
static TEAM: LazyLock<Team> = LazyLock::new(|| {
    let root = SecretKeys::generate(&mut Entropy::new(&[1; 32]));
    Team::found("acme".parse().expect("a name"), &root)
});

fuzz_target!(|bytes: &[u8]| {
    let revoked = Revocations::default();
    let judge = Judge { team: &TEAM, revoked: &revoked, now: UnixTime(1_800_000_000), grace: 0 };
    let name = TEAM.name();
    let context = Context { judge, node: KeyId([1; 32]), name, deployment: None, epoch_min: 0 };
    let mut replays = Replays::default();
    assert!(check(bytes, b"", &context, &mut replays).is_err());
    assert_eq!(replays, Replays::default());
});
