//! Nodes that renew each other's certificates, over a year, while the operator's machine is off.

use crate::world::{NOW, World, keys};
use std::collections::BTreeMap;
use trust::certificate::DAY;
use trust::identity::SecretKeys;
use trust::name::UnixTime;
use trust::renewal::{RenewalError, accept, ask, asked, due, end, renew};
use trust::revocation::{Revocations, RevokedSet};
use trust::role::Kind;
use trust::team::{Credential, Judge, Standing, TrustError};

type Node = (SecretKeys, Credential);

fn renewed(asker: &Node, by: &Node, judge: &Judge<'_>) -> Result<Credential, RenewalError> {
    renew(Kind::Node, &asker.1, &by.0, &by.1, judge)
}

/// `r1` may not renew others, `r2` may, and no member renews `r2`. At the end `r2` is in its grace period, and can
/// still renew `r1`.
#[test]
fn a_year_without_the_operator() {
    let world = World::new();
    let (mut r1, r2) = (world.r1, world.r2);
    let (mut asked, mut now) = (0, NOW);
    let (team, nobody) = (world.team, Revocations::default());
    let judge = |now| Judge { team: &team, revoked: &nobody, now, grace: 365 * DAY };
    // They meet every three days.
    while now < NOW.plus(364 * DAY) {
        assert!(matches!(r1.1.check(&judge(now)), Ok(Standing::Valid(_))), "day {}", now.since(NOW) / DAY);
        if due(&r1.1, &judge(now)).is_some_and(|due| now >= due) {
            let offered = renewed(&r1, &r2, &judge(now)).unwrap();
            accept(&r1.1, &offered, &judge(now)).unwrap();
            (r1.1, asked) = (offered, asked + 1);
        } else {
            assert_eq!(due(&r1.1, &judge(now)).is_some(), end(&r1.1, &judge(now)) < NOW.plus(365 * DAY));
        }
        now = now.plus(3 * DAY);
    }
    assert!((12..=20).contains(&asked), "asked {asked} times");
    let last = judge(NOW.plus(364 * DAY));
    assert_eq!(end(&r1.1, &last), NOW.plus(365 * DAY), "the issuer has said so");
    assert_eq!(due(&r1.1, &last), None);
    assert!(r1.1.check(&Judge { grace: 0, ..judge(NOW.plus(366 * DAY)) }).is_err());
}

#[test]
fn nobody_is_renewed_early_late_or_by_the_wrong_one() {
    let mut world = World::new();
    let (r1, r2) = ((keys(5), world.r1.1.clone()), (keys(6), world.r2.1.clone()));
    let early = renewed(&r1, &r2, &world.judge(NOW.plus(14 * DAY)));
    assert_eq!(early, Err(RenewalError::Early));
    let now = NOW.plus(20 * DAY);
    let own = renewed(&r2, &r2, &world.judge(now));
    assert_eq!(own, Err(RenewalError::Own));
    let by_member = renewed(&r2, &r1, &world.judge(now));
    assert!(matches!(by_member, Err(RenewalError::Trust(TrustError::Role { .. }))));
    let user = renewed(&world.viewer, &r2, &world.judge(now));
    assert_eq!(user, Err(RenewalError::Kind));
    // A member that was offline for longer than the grace period is no longer trusted.
    let late = renewed(&r1, &r2, &world.judge(NOW.plus(38 * DAY)));
    assert!(matches!(late, Err(RenewalError::Trust(TrustError::Expired(_)))));
    let in_grace = renewed(&r1, &r2, &world.judge(NOW.plus(36 * DAY))).unwrap();
    assert!(matches!(in_grace.check(&world.judge(NOW.plus(36 * DAY))), Ok(Standing::Valid(_))));
    // An offered renewal has to be for this certificate, and valid for longer.
    let good = renewed(&r1, &r2, &world.judge(now)).unwrap();
    assert_eq!(accept(&r2.1, &good, &world.judge(now)), Err(RenewalError::Useless));
    assert_eq!(accept(&good, &r1.1, &world.judge(now)), Err(RenewalError::Useless));
    assert_eq!(accept(&r1.1, &good, &world.judge(now)), Ok(()));
    // A revoked node cannot be renewed, and a revoked renewer's renewals are not valid any more: the node asks
    // another renewer.
    let gone = BTreeMap::from([(r2.1.certificate().subject(), now)]);
    let set = RevokedSet::sign(&world.team, 1, gone, &world.root, None).unwrap();
    let mut revoked = Revocations::default();
    revoked.receive(set, &world.judge(now)).unwrap();
    world.revoked = revoked;
    assert!(matches!(good.check(&world.judge(now)), Ok(Standing::Valid(end)) if end == NOW.plus(30 * DAY)));
    assert_eq!(due(&good, &world.judge(now)), Some(UnixTime(NOW.0 + 20 * DAY)));
    assert!(matches!(good.check(&world.judge(NOW.plus(40 * DAY))), Err(TrustError::Revoked(_))));
    assert!(matches!(renewed(&r1, &r2, &world.judge(now)), Err(RenewalError::Trust(TrustError::Revoked(_)))));
}

#[test]
fn a_user_asks_for_itself_and_now() {
    let world = World::new();
    let ((viewer_keys, viewer), (r2_keys, r2)) = (&world.viewer, &world.r2);
    let now = NOW.plus(20 * DAY);
    let bytes = ask(viewer, viewer_keys, now);
    assert_eq!(asked(&bytes, now.plus(200)).as_ref(), Ok(viewer));
    for other in [UnixTime(now.0 - 600), now.plus(600)] {
        assert_eq!(asked(&bytes, other), Err(RenewalError::Time));
    }
    // With the certificate of another user, or changed anywhere, the request is refused.
    assert_eq!(asked(&ask(viewer, r2_keys, now), now), Err(RenewalError::Signature));
    for at in 0..bytes.len() {
        let mut wrong = bytes.clone();
        wrong[at] ^= 1;
        assert!(asked(&wrong, now).is_err() || asked(&wrong, now).is_ok_and(|other| other != *viewer), "byte {at}");
        assert!(asked(&bytes[..at], now).is_err(), "up to {at}");
    }
    let judge = world.judge(now);
    let good = renew(Kind::User, viewer, r2_keys, r2, &judge).unwrap();
    assert_eq!(accept(viewer, &good, &judge), Ok(()));
    assert!(matches!(good.check(&world.judge(NOW.plus(40 * DAY))), Ok(Standing::Valid(_))), "its own would be over");
    assert_eq!(renew(Kind::User, r2, r2_keys, r2, &judge), Err(RenewalError::Kind));
}
