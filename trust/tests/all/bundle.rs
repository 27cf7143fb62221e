//! The public text of a team.

use crate::world::{NOW, World, claims, keys};
use std::collections::BTreeMap;
use trust::bundle::{Bundle, BundleError};
use trust::certificate::{Certificate, DAY};
use trust::identity::SecretKeys;
use trust::revocation::{Received, RevocationError, RevokedSet};
use trust::role::Role;
use trust::team::Team;

pub(crate) fn bundle(world: &World) -> Bundle {
    let mut bundle = Bundle::new(world.team.clone());
    for (_, credential) in [&world.admin, &world.deployer, &world.viewer] {
        bundle.add(credential.certificate().clone()).expect("the input is good");
    }
    let gone: BTreeMap<_, _> = [(world.viewer.1.certificate().subject(), NOW)].into();
    let set = RevokedSet::sign(&world.team, 1, gone, &world.root, None).expect("the input is good");
    bundle.revoke(set).expect("the team has signed it");
    bundle
}

fn standings(bundle: &Bundle, days: u64) -> Vec<String> {
    let holders = bundle.holders(NOW.plus(days * DAY));
    let text = |standing: Result<_, trust::team::TrustError>| {
        standing.map_or_else(|error| error.to_string(), |_| "trusted".into())
    };
    holders
        .into_iter()
        .map(|holder| format!("{}: {}", holder.certificate.claims().name, text(holder.standing)))
        .collect()
}

#[test]
fn it_says_who_is_trusted() {
    let world = World::new();
    let bundle = Bundle::from_text(&bundle(&world).to_text()).unwrap();
    assert_eq!(standings(&bundle, 0), ["ann: trusted", "dan: trusted", "vic: the key of `vic` is revoked"]);
    assert_eq!(standings(&bundle, 40)[1], "dan: the certificate of `dan` has ended; renew it");
    let vic = world.viewer.1.certificate().subject();
    assert!(bundle.has_revoked(&vic) && bundle.named(&"dan".parse().unwrap()).count() == 1);
}

#[test]
fn a_newer_certificate_takes_the_place_of_the_older() {
    let world = World::new();
    let mut bundle = bundle(&world);
    let newer = claims(&world.team, "dan", Role::Operator, &world.deployer.0);
    bundle.add(Certificate::issue(newer, &world.root).unwrap()).unwrap();
    let roles: Vec<Role> = bundle.named(&"dan".parse().unwrap()).map(|found| found.claims().role).collect();
    assert_eq!(roles, [Role::Operator]);
}

#[test]
fn a_line_that_the_team_has_not_signed_is_refused() {
    let world = World::new();
    let good = bundle(&world).to_text();
    let stranger = keys(70);
    let mut other = Bundle::new(world.team.clone());
    other.add(Certificate::issue(claims(&world.team, "eve", Role::Admin, &stranger), &stranger).unwrap()).unwrap();
    assert_eq!(Bundle::from_text(&other.to_text()), Err(BundleError::Signature(3)));
    let forged = RevokedSet::sign(&world.team, 2, BTreeMap::new(), &stranger, None).unwrap();
    let by_admin = RevokedSet::sign(&world.team, 2, BTreeMap::new(), &world.admin.0, Some(world.admin.1.clone()));
    for (set, why) in [(forged, "a stranger"), (by_admin.unwrap(), "only the team's own key")] {
        assert_eq!(bundle(&world).revoke(set.clone()), Err(RevocationError::Signer), "{why}");
    }
    let (of_stranger, gone) = (Team::found("acme".parse().unwrap(), &stranger), BTreeMap::new());
    let mut other = Bundle::new(of_stranger.clone());
    other.revoke(RevokedSet::sign(&of_stranger, 2, gone, &stranger, None).unwrap()).unwrap();
    let (theirs, mut lines) = (other.to_text(), good.lines().collect::<Vec<_>>());
    (lines[0], lines[5]) = ("dca-team 1", theirs.lines().nth(2).unwrap());
    assert_eq!(Bundle::from_text(&lines[..6].join("\n")), Err(BundleError::Signature(6)));
    // Lines in another order, repeated lines, and lines of another kind.
    let lines: Vec<&str> = good.lines().collect();
    let with = |order: &[usize]| {
        let text: String = order.iter().map(|index| format!("{}\n", lines[*index])).collect();
        text.replacen("dca-team 2", "dca-team 1", 1)
    };
    assert!(Bundle::from_text(&with(&[0, 1, 2, 3, 4, 5])).is_ok());
    assert_eq!(Bundle::from_text(&with(&[0, 1, 3, 2])), Err(BundleError::Signature(3)), "the admin is not known yet");
    assert_eq!(Bundle::from_text(&with(&[0, 1, 2, 2])), Err(BundleError::Line(4)));
    assert_eq!(Bundle::from_text(&with(&[0, 1, 5, 2])), Err(BundleError::Line(4)));
    assert_eq!(Bundle::from_text(&with(&[1])), Err(BundleError::Begin));
    assert_eq!(Bundle::from_text(&with(&[0])), Err(BundleError::Line(2)));
    assert_eq!(Bundle::from_text(&with(&[0, 1, 6])), Err(BundleError::Line(3)), "version 1 has no last line");
    assert_eq!(Bundle::from_text(&good.to_uppercase()), Err(BundleError::Begin));
    assert_eq!(Bundle::from_text(&"x".repeat(9 << 20)), Err(BundleError::TooLong));
}

#[test]
fn a_text_of_which_a_part_was_lost_is_refused() {
    let world = World::new();
    let good = bundle(&world).to_text();
    assert!(Bundle::from_text(good.trim_end()).is_ok() && Bundle::from_text(&good.replace('\n', "\r\n")).is_ok());
    let lines: Vec<&str> = good.lines().collect();
    for gone in 1..lines.len() {
        let kept = |index: &usize| *index != gone;
        let text: String = (0..lines.len()).filter(kept).map(|index| format!("{}\n", lines[index])).collect();
        assert_eq!(Bundle::from_text(&text), Err(BundleError::Cut), "without line {}", gone + 1);
    }
    for length in "dca-team 2\n".len()..good.trim_end().len() {
        assert_eq!(Bundle::from_text(&good[..length]), Err(BundleError::Cut), "the first {length} bytes");
    }
    assert_eq!(Bundle::from_text(&format!("{good}{good}")), Err(BundleError::Cut));
}

/// Two copies of a team that were changed separately are merged.
#[test]
fn two_that_went_on_alone_are_joined() {
    let world = World::new();
    let gone = |number: u64, keys: &[&SecretKeys]| {
        let gone = keys.iter().map(|keys| (keys.public().id(), NOW)).collect();
        RevokedSet::sign(&world.team, number, gone, &world.root, None).unwrap()
    };
    let (mut first, mut second) = (bundle(&world), bundle(&world));
    let viewer = &world.viewer.0;
    first.revoke(gone(2, &[viewer, &world.r1.0])).unwrap();
    second.revoke(gone(2, &[viewer, &world.r2.0])).unwrap();
    let (new, role) = (keys(71), |role| claims(&world.team, "dan", role, &world.deployer.0));
    second.add(Certificate::issue(claims(&world.team, "new", Role::Viewer, &new), &world.root).unwrap()).unwrap();
    let younger = trust::certificate::Claims { not_before: NOW.plus(5), ..role(Role::Operator) };
    first.add(Certificate::issue(younger, &world.root).unwrap()).unwrap();
    let before = first.clone();
    first.merge(&second).unwrap();
    for keys in [viewer, &world.r1.0, &world.r2.0] {
        assert!(first.has_revoked(&keys.public().id()));
    }
    assert!(first.credential_of(&new.public().id()).is_some());
    let of_dan: Vec<Role> = first.named(&"dan".parse().unwrap()).map(|found| found.claims().role).collect();
    assert_eq!(of_dan, [Role::Operator], "the younger certificate");
    let read = Bundle::from_text(&first.to_text()).unwrap();
    assert_eq!((&read, read.revocations().sets().len()), (&first, 2));
    second.merge(&before).unwrap();
    assert_eq!(first.revocations(), second.revocations());
    let twice = first.to_text().replace("dca-team 2", "dca-team 1");
    let lines: Vec<&str> = twice.lines().collect();
    let doubled = [&lines[..lines.len() - 1], &lines[lines.len() - 2..lines.len() - 1]].concat().join("\n");
    assert_eq!(Bundle::from_text(&doubled), Err(BundleError::Line(lines.len())));
    // The next revocation contains both sets.
    assert_eq!(first.revoke(gone(3, &[viewer, &world.r1.0, &world.r2.0])), Ok(Received::New(0)));
    assert_eq!(first.revocations().sets().len(), 1);
    let stranger = Team::found("acme".parse().unwrap(), &keys(9));
    assert_eq!(first.merge(&Bundle::new(stranger)), Err(BundleError::Signature(2)));
}
