//! Who is revoked, and by whom.

use crate::world::{NOW, World};
use std::collections::BTreeMap;
use trust::identity::{KeyId, SecretKeys};
use trust::revocation::{Received, RevocationError, Revocations, RevokedSet};
use trust::team::{Credential, Judge, TrustError};

fn set(world: &World, number: u64, revoked: &[KeyId], by: (&SecretKeys, Option<&Credential>)) -> RevokedSet {
    let keys: BTreeMap<KeyId, _> = revoked.iter().map(|key| (*key, NOW)).collect();
    RevokedSet::sign(&world.team, number, keys, by.0, by.1.cloned()).expect("the input is good")
}

/// Acceptance: a revocation reaches a robot over a chain of two meetings, and the revoked one is refused from then on.
#[test]
fn a_revocation_travels_from_member_to_member() {
    let world = World::new();
    let stolen = world.r1.1.certificate().subject();
    let signed = set(&world, 1, &[stolen], (&world.admin.0, Some(&world.admin.1)));
    let (mut second, mut third) = (Revocations::default(), Revocations::default());
    assert_eq!(second.receive(signed, &world.judge(NOW)), Ok(Received::New(1)));
    // The second meets the third. The operator is switched off.
    let numbers: BTreeMap<KeyId, u64> = third.numbers().collect();
    for newer in second.newer_than(&numbers) {
        let bytes = newer.to_bytes();
        let read = RevokedSet::from_bytes(&bytes).unwrap();
        assert_eq!(read.to_bytes(), bytes);
        assert_eq!(third.receive(read.clone(), &world.judge(NOW)), Ok(Received::New(1)));
        assert_eq!(third.receive(read, &world.judge(NOW)), Ok(Received::Known));
    }
    assert!(second.newer_than(&third.numbers().collect()).is_empty());
    let judge = Judge { revoked: &third, ..world.judge(NOW) };
    assert!(matches!(world.r1.1.check(&judge), Err(TrustError::Revoked(_))));
    assert!(world.r2.1.check(&judge).is_ok());
}

#[test]
fn an_old_set_is_refused_and_takes_nobody_back() {
    let world = World::new();
    let [first, second] = [&world.r1, &world.r2].map(|(_, credential)| credential.certificate().subject());
    let mut revoked = Revocations::default();
    let root = (&world.root, None);
    revoked.receive(set(&world, 2, &[first], root), &world.judge(NOW)).unwrap();
    let old = revoked.receive(set(&world, 1, &[], root), &world.judge(NOW));
    assert_eq!(old, Err(RevocationError::Old { found: 1, known: 2 }));
    // A newer one without the key, and another one with the same number, take nobody back either.
    assert_eq!(revoked.receive(set(&world, 2, &[second], root), &world.judge(NOW)), Ok(Received::New(1)));
    assert_eq!(revoked.receive(set(&world, 3, &[], root), &world.judge(NOW)), Ok(Received::New(0)));
    assert!(revoked.has(&first) && revoked.has(&second));
}

#[test]
fn only_the_team_and_its_admins_revoke() {
    let world = World::new();
    let target = [world.r1.1.certificate().subject()];
    let mut revoked = Revocations::default();
    let judge = world.judge(NOW);
    let by_deployer = set(&world, 1, &target, (&world.deployer.0, Some(&world.deployer.1)));
    assert!(matches!(revoked.receive(by_deployer, &judge), Err(RevocationError::Trust(TrustError::Role { .. }))));
    let by_nobody = set(&world, 1, &target, (&world.r2.0, None));
    assert_eq!(revoked.receive(by_nobody, &judge), Err(RevocationError::Signer));
    let with_borrowed = set(&world, 1, &target, (&world.r2.0, Some(&world.admin.1)));
    assert_eq!(revoked.receive(with_borrowed, &judge), Err(RevocationError::Signer));
    assert_eq!(revoked, Revocations::default());
    // An admin that is revoked revokes nobody any more, and nobody whom it has admitted is trusted.
    let admin = world.admin.1.certificate().subject();
    revoked.receive(set(&world, 1, &[admin], (&world.root, None)), &judge).unwrap();
    let late = set(&world, 9, &target, (&world.admin.0, Some(&world.admin.1)));
    assert!(matches!(revoked.receive(late, &judge), Err(RevocationError::Trust(TrustError::Revoked(_)))));
    assert!(matches!(world.r2.1.check(&Judge { revoked: &revoked, ..judge }), Err(TrustError::Revoked(_))));
}

/// Whatever the order in which sets arrive, and however often, the same keys are revoked in the end.
#[test]
fn the_order_does_not_matter() {
    let world = World::new();
    let ids: Vec<KeyId> = (0..6).map(|number| KeyId([number; 32])).collect();
    let by_admin = (&world.admin.0, Some(&world.admin.1));
    let sets = [
        set(&world, 1, &ids[..1], (&world.root, None)),
        set(&world, 2, &ids[..2], (&world.root, None)),
        set(&world, 1, &ids[2..4], by_admin),
        set(&world, 1, &ids[3..6], by_admin),
    ];
    let mut seen: Option<Revocations> = None;
    for first in 0..4 {
        for second in 0..4 {
            let mut revoked = Revocations::default();
            for index in [first, second, 0, 1, 2, 3] {
                drop(revoked.receive(sets[index].clone(), &world.judge(NOW)));
            }
            assert!(ids.iter().all(|id| revoked.has(id)));
            assert_eq!(*seen.get_or_insert_with(|| revoked.clone()), revoked);
        }
    }
}
