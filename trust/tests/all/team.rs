//! Members that are trusted, and members that are not.

use crate::world::{NOW, World, claims, keys};
use trust::certificate::{Certificate, Claims, ClaimsError, DAY, LIFE_MAX, RENEWABLE_MAX, Renewal};
use trust::name::UnixTime;
use trust::role::{Action, Role};
use trust::team::{Credential, SKEW, Standing, Team, TrustError};

#[test]
fn everybody_of_the_team_is_trusted_for_what_the_role_allows() {
    let world = World::new();
    let judge = world.judge(NOW);
    for (_, credential) in [&world.admin, &world.deployer, &world.viewer, &world.r1, &world.r2] {
        assert_eq!(credential.check(&judge), Ok(Standing::Valid(NOW.plus(30 * DAY))));
        assert!(credential.require(Action::Estop, &judge).is_ok(), "stopping everything is everybody's");
    }
    assert!(world.deployer.1.require(Action::Deploy, &judge).is_ok());
    let refused = world.viewer.1.require(Action::Deploy, &judge).unwrap_err();
    assert_eq!(refused.to_string(), "`vic` has the role viewer, which may not deploy");
}

/// Refused: a key of another team, a chain that is too long, an issuer without the role, a wrong issuer, a changed claim.
#[test]
fn nobody_else_can_issue() {
    let world = World::new();
    let judge = world.judge(NOW);
    let own = keys(20);
    let by = |issuer: &trust::identity::SecretKeys, role| {
        Certificate::issue(claims(&world.team, "eve", role, &own), issuer).unwrap()
    };
    let admin = world.admin.1.certificate().clone();
    let deployer = world.deployer.1.certificate().clone();
    let stranger = Certificate::issue(claims(&world.team, "eve", Role::Admin, &own), &own).unwrap();
    let cases = [
        (by(&own, Role::Viewer), None),
        (by(&own, Role::Viewer), Some(stranger)),
        (by(&world.deployer.0, Role::Viewer), Some(deployer)),
        (by(&world.admin.0, Role::Admin), Some(admin.clone())),
        (by(&own, Role::Viewer), Some(admin.clone())),
        (by(&world.admin.0, Role::Viewer), None),
    ];
    for (number, (certificate, issuer)) in cases.into_iter().enumerate() {
        let refused = Credential::new(certificate, issuer).check(&judge).unwrap_err();
        let is_right = matches!(refused, TrustError::Issuer(_) | TrustError::Signature(_));
        assert!(is_right, "case {number}: {refused}");
    }
    let other = Team::found("acme".parse().unwrap(), &own);
    let certificate = Certificate::issue(claims(&other, "eve", Role::Admin, &own), &own).unwrap();
    assert!(matches!(Credential::new(certificate, None).check(&judge), Err(TrustError::OtherTeam(_))));
    // A certificate that lasts longer than its issuer's.
    let far = Claims { renewable_until: NOW.plus(400 * DAY), ..claims(&world.team, "eve", Role::Viewer, &own) };
    let far = Certificate::issue(far, &world.admin.0).unwrap();
    assert!(matches!(Credential::new(far, Some(admin)).check(&judge), Err(TrustError::Issuer(_))));
}

#[test]
fn no_byte_of_a_certificate_can_be_changed() {
    let world = World::new();
    let certificate = world.admin.1.certificate().to_bytes();
    for at in 0..certificate.len() * 8 {
        let mut changed = certificate.clone();
        changed[at / 8] ^= 1 << (at % 8);
        if let Ok(read) = Certificate::from_bytes(&changed) {
            assert!(Credential::new(read, None).check(&world.judge(NOW)).is_err(), "bit {at}");
        }
    }
}

#[test]
fn lives_are_short() {
    let world = World::new();
    let with = |change: &dyn Fn(&mut Claims)| {
        let mut claims = claims(&world.team, "eve", Role::Viewer, &keys(20));
        change(&mut claims);
        Certificate::issue(claims, &world.root).map(drop)
    };
    assert_eq!(with(&|claims| claims.not_after = NOW), Err(ClaimsError::Order));
    assert_eq!(with(&|claims| claims.renewable_until = NOW), Err(ClaimsError::Order));
    assert_eq!(with(&|claims| claims.not_after = NOW.plus(LIFE_MAX + 1)), Err(ClaimsError::Life));
    assert_eq!(with(&|claims| claims.renewable_until = NOW.plus(RENEWABLE_MAX + 1)), Err(ClaimsError::Renewable));
    assert_eq!(with(&|claims| claims.renewable_until = UnixTime(u64::MAX)), Err(ClaimsError::Renewable));
}

#[test]
fn a_node_has_a_grace_and_a_user_has_none() {
    let world = World::new();
    let end = NOW.plus(30 * DAY);
    let cases = [
        (NOW.0 - SKEW - 1, Err("not valid yet"), Err("not valid yet")),
        (NOW.0 - SKEW, Ok(Standing::Valid(end)), Ok(Standing::Valid(end))),
        (end.0 + SKEW, Ok(Standing::Valid(end)), Ok(Standing::Valid(end))),
        (end.0 + SKEW + 1, Ok(Standing::Grace(end.plus(SKEW + 7 * DAY))), Err("has ended")),
        (end.0 + SKEW + 7 * DAY + 1, Err("has ended"), Err("has ended")),
    ];
    for (now, node, user) in cases {
        for ((_, credential), expected) in [(&world.r1, node), (&world.viewer, user)] {
            let found = credential.check(&world.judge(UnixTime(now))).map_err(|error| error.to_string());
            match (&found, expected) {
                (Err(error), Err(part)) => assert!(error.contains(part), "{now}: {error}"),
                (found, expected) => assert_eq!(found.clone().ok(), expected.ok(), "{now}"),
            }
        }
    }
}

/// While the operator's machine is off for weeks, a renewer keeps the others in the team, and another renewer keeps this
/// renewer in it.
#[test]
fn members_renew_each_other_up_to_the_time_that_was_set() {
    let world = World::new();
    let later = NOW.plus(60 * DAY);
    let renewed = |who: &Credential, by: &(trust::identity::SecretKeys, Credential), now: UnixTime| {
        let renewal = Renewal::issue(who.certificate(), now, 30 * DAY, &by.0);
        Credential { renewal: Some((renewal, by.1.chain.clone())), ..who.clone() }
    };
    let r1 = renewed(&world.r1.1, &world.r2, later);
    assert_eq!(r1.check(&world.judge(later)), Ok(Standing::Valid(later.plus(30 * DAY))));
    let back = Credential::from_bytes(&r1.to_bytes()).unwrap();
    assert_eq!(back, r1);
    // Refused: a member without the right to renew, the member itself, and a renewal for another certificate.
    let cases = [
        renewed(&world.r2.1, &world.r1, later),
        renewed(&world.r2.1, &world.r2, later),
        Credential { renewal: r1.renewal.clone(), ..world.viewer.1.clone() },
    ];
    for credential in cases {
        assert!(matches!(credential.check(&world.judge(later)), Err(TrustError::Renewal(_))));
    }
    // A renewal cannot go beyond the time that the issuer has set.
    let last = renewed(&world.r1.1, &world.r2, NOW.plus(364 * DAY));
    assert_eq!(last.check(&world.judge(NOW.plus(364 * DAY))), Ok(Standing::Valid(NOW.plus(365 * DAY))));
    let never = renewed(&world.r1.1, &world.r2, NOW.plus(400 * DAY));
    assert!(never.check(&world.judge(NOW.plus(400 * DAY))).is_err());
}
