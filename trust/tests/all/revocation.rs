//! Revoked members, and the members that revoke them.

use crate::world::{NOW, World};
use std::collections::{BTreeMap, BTreeSet};
use trust::identity::{KeyId, SecretKeys};
use trust::revocation::{Received, RevocationError, Revocations, RevokedSet, SETS_MAX};
use trust::team::{Credential, Judge, TrustError};

fn set(world: &World, number: u64, revoked: &[KeyId], by: (&SecretKeys, Option<&Credential>)) -> RevokedSet {
    let keys: BTreeMap<KeyId, _> = revoked.iter().map(|key| (*key, NOW)).collect();
    RevokedSet::sign(&world.team, number, keys, by.0, by.1.cloned()).expect("the input is good")
}

/// Acceptance test: a revocation reaches a robot through two meetings, and the robot refuses the revoked member from
/// then on.
#[test]
fn a_revocation_travels_from_member_to_member() {
    let world = World::new();
    let stolen = world.r1.1.certificate().subject();
    let signed = set(&world, 1, &[stolen], (&world.admin.0, Some(&world.admin.1)));
    let (mut second, mut third) = (Revocations::default(), Revocations::default());
    assert_eq!(second.receive(signed, &world.judge(NOW)), Ok(Received::New(1)));
    // The second meets the third. The operator is switched off.
    for held in second.sets() {
        let bytes = held.to_bytes();
        let read = RevokedSet::from_bytes(&bytes).unwrap();
        assert_eq!(read.to_bytes(), bytes);
        assert_eq!(third.receive(read.clone(), &world.judge(NOW)), Ok(Received::New(1)));
        assert_eq!(third.receive(read, &world.judge(NOW)), Ok(Received::Known));
    }
    assert_eq!(second, third);
    let judge = Judge { revoked: &third, ..world.judge(NOW) };
    assert!(matches!(world.r1.1.check(&judge), Err(TrustError::Revoked(_))));
    assert!(world.r2.1.check(&judge).is_ok());
}

#[test]
fn no_set_takes_anybody_back() {
    let world = World::new();
    let [first, second] = [&world.r1, &world.r2].map(|(_, credential)| credential.certificate().subject());
    let mut revoked = Revocations::default();
    let root = (&world.root, None);
    let mut receive = |number: u64, keys: &[KeyId]| {
        let received = revoked.receive(set(&world, number, keys, root), &world.judge(NOW));
        (received, revoked.clone())
    };
    assert_eq!(receive(2, &[first]).0, Ok(Received::New(1)));
    assert_eq!(receive(1, &[]).0, Ok(Received::Known));
    // A newer set without the key, and another set with the same number, do not undo the revocation either.
    let (received, both) = receive(2, &[second]);
    assert_eq!((received, both.sets().len()), (Ok(Received::New(1)), 2));
    assert_eq!(receive(3, &[]).0, Ok(Received::Known));
    let (received, later) = receive(4, &[second]);
    assert_eq!((received, later.sets().len(), later.number_of(&world.team.id())), (Ok(Received::New(0)), 2, 4));
    assert!(later.has(&first) && later.has(&second));
    // A set that has all keys of the others replaces them, regardless of its number.
    let (received, joined) = receive(1, &[first, second]);
    assert_eq!((received, joined.sets().len(), joined.keys().len()), (Ok(Received::New(0)), 1, 2));
}

/// Admins' sets do not reduce the room for those of the team's key. A member without room for more reports this, and
/// keeps what it has.
#[test]
fn what_is_held_has_an_end() {
    let world = World::new();
    let key = |number: usize| KeyId([u8::try_from(number).expect("it is small"); 32]);
    let mut revoked = Revocations::default();
    let by_admin = (&world.admin.0, Some(&world.admin.1));
    let many = |number: u64| -> Vec<KeyId> {
        let key =
            |index: u64| KeyId(std::array::from_fn(|at| (((number << 12) + index) >> (8 * (at % 8))).to_le_bytes()[0]));
        (0..4000).map(key).collect()
    };
    let full = (1..10).find(|number| {
        revoked.receive(set(&world, *number, &many(*number), by_admin), &world.judge(NOW)) == Err(RevocationError::Full)
    });
    assert_eq!(full, Some(7), "one MiB");
    for number in 0..SETS_MAX {
        let of_team = set(&world, 3, &[key(number)], (&world.root, None));
        assert_eq!(revoked.receive(of_team, &world.judge(NOW)), Ok(Received::New(1)));
    }
    let before = revoked.clone();
    let too_many = set(&world, 9, &[key(99)], (&world.root, None));
    assert_eq!(revoked.receive(too_many, &world.judge(NOW)), Err(RevocationError::Full));
    let nothing_new = set(&world, 9, &[key(0), key(1)], (&world.root, None));
    assert!(revoked == before && revoked.clone().receive(nothing_new, &world.judge(NOW)) == Ok(Received::New(0)));
    let all: Vec<KeyId> = (0..SETS_MAX).chain([99]).map(key).collect();
    assert_eq!(
        revoked.receive(set(&world, 4, &all, (&world.root, None)), &world.judge(NOW)),
        Ok(Received::New(1)),
        "one that joins them has room"
    );
}

/// An admin's revocations remain valid after a restart, even if the admin was revoked since.
#[test]
fn what_was_kept_counts_whatever_became_of_its_signer() {
    let world = World::new();
    let (admin, target) = (world.admin.1.certificate().subject(), world.r1.1.certificate().subject());
    let mut revoked = Revocations::default();
    revoked.receive(set(&world, 1, &[target], (&world.admin.0, Some(&world.admin.1))), &world.judge(NOW)).unwrap();
    revoked.receive(set(&world, 1, &[admin], (&world.root, None)), &world.judge(NOW)).unwrap();
    for sets in [revoked.sets().to_vec(), revoked.sets().iter().rev().cloned().collect()] {
        let mut again = Revocations::default();
        for set in sets {
            again.restore(set, &world.team).unwrap();
        }
        assert_eq!(again, revoked);
    }
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
    // A revoked admin cannot revoke any more, and members that this admin has admitted are not trusted.
    let admin = world.admin.1.certificate().subject();
    revoked.receive(set(&world, 1, &[admin], (&world.root, None)), &judge).unwrap();
    let late = set(&world, 9, &target, (&world.admin.0, Some(&world.admin.1)));
    assert!(matches!(revoked.receive(late, &judge), Err(RevocationError::Trust(TrustError::Revoked(_)))));
    assert!(matches!(world.r2.1.check(&Judge { revoked: &revoked, ..judge }), Err(TrustError::Revoked(_))));
}

/// For any order and repetition of the sets, the same keys are revoked in the end.
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

/// Several copies of the team's key and an admin sign sets with any numbers, even equal ones. Members receive some of
/// them, possibly repeatedly, are restarted from their disks, and meet. At any time, each member knows every set that
/// it has ever received. In the end all members hold the same sets.
#[test]
fn members_that_meet_come_to_hold_the_same() {
    let world = World::new();
    let mut state = 0x9e37_79b9_7f4a_7c15_u64;
    let mut random = move |below: usize| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        usize::try_from(state >> 33).expect("it fits") % below
    };
    for _ in 0..60 {
        let signers =
            [(&world.root, None), (&world.root, None), (&world.root, None), (&world.admin.0, Some(&world.admin.1))];
        let mut sets = Vec::new();
        for _ in 0..=random(6) {
            let keys: Vec<KeyId> = (0..6).filter(|_| random(3) == 0).map(|number| KeyId([number; 32])).collect();
            let number = u64::try_from(random(3)).expect("it is small");
            sets.push(set(&world, number, &keys, signers[random(signers.len())]));
        }
        let mut members: [(Revocations, BTreeSet<KeyId>); 3] = Default::default();
        let all: BTreeSet<KeyId> = sets.iter().flat_map(|set| set.keys().keys().copied()).collect();
        for step in 0..40 {
            // Each set is received by at least one member.
            let index = if step < sets.len() { step } else { random(sets.len()) };
            let (at, other) = (random(3), random(3));
            match random(3) {
                1 if step >= sets.len() => members[at].0 = restarted(&world, &members[at].0),
                2 if step >= sets.len() => meet(&world, &mut members, (at, other)),
                _ => {
                    members[at].1.extend(sets[index].keys().keys());
                    members[at].0.receive(sets[index].clone(), &world.judge(NOW)).unwrap();
                }
            }
            for (revoked, heard) in &members {
                assert!(revoked.keys() == heard);
                let none_has_another = |set: &RevokedSet| {
                    let has = |other: &RevokedSet| set.keys().keys().all(|key| other.keys().contains_key(key));
                    let is_of_same = |other: &&RevokedSet| other.is_of_the_team() == set.is_of_the_team();
                    revoked.sets().iter().filter(is_of_same).filter(|other| has(other)).count() == 1
                };
                assert!(revoked.sets().iter().all(none_has_another));
            }
        }
        for pair in [(0, 1), (1, 2), (0, 2)] {
            meet(&world, &mut members, pair);
        }
        assert!(members.iter().all(|(revoked, _)| *revoked == members[0].0 && *revoked.keys() == all));
    }
}

fn restarted(world: &World, revoked: &Revocations) -> Revocations {
    let mut again = Revocations::default();
    for set in revoked.sets() {
        let set = RevokedSet::from_bytes(&set.to_bytes()).expect("it was written so");
        again.restore(set, &world.team).expect("it was held");
    }
    again
}

fn meet(world: &World, members: &mut [(Revocations, BTreeSet<KeyId>)], (first, second): (usize, usize)) {
    for (from, to) in [(first, second), (second, first)] {
        let (told, known) = members[from].clone();
        members[to].1.extend(known);
        for set in told.sets() {
            members[to].0.receive(set.clone(), &world.judge(NOW)).expect("it is the team's");
        }
    }
}
