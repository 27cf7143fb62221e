//! Nodes with certificates of a minute: one that may renews those of the others before they end, and nobody else has a hand in it.

use dca_tests::cluster::{Cluster, Host, Network, SOON, wait_until};
use dca_tests::made_team::{MadeTeam, keys};
use std::fs;
use team::member::Member;
use trust::name::UnixTime;
use trust::role::Role;
use trust::team::Credential;

/// Returns the credential that a node has on its disk.
fn kept(host: &Host, name: &str) -> Credential {
    let bytes = fs::read(host.state().join(name).join("team/credential")).expect("it is a member");
    Credential::from_bytes(&bytes).expect("a credential")
}

#[test]
fn a_certificate_is_renewed_by_who_may_before_it_ends() {
    let Some(network) = Network::new(3) else { return };
    let (cluster, team) = (Cluster::new(), MadeTeam::default());
    let now = team::now();
    // `c1` has 15 of 60 s left, `c2` may renew, and `c3` is a member as `c1` with nothing to be done.
    let lives = [("c1", Role::Member, 45, 15), ("c2", Role::Renewer, 45, 3600), ("c3", Role::Member, 45, 3600)];
    let mut nodes = Vec::new();
    for (number, (name, role, since, left)) in (1..).zip(lives) {
        let (own, host) = (keys(), cluster.host(&network, number));
        let credential = team.certify_between(name, (role, &own), (UnixTime(now.0 - since), now.plus(left)));
        team.begin(&host.state().join(name), &own, &credential);
        nodes.push(host.node(name, &[]));
    }
    let first = cluster.host(&network, 1);
    let renewed = || kept(&first, "c1").renewal.map(|(renewal, by)| (renewal.not_after(), by));
    let took = wait_until(SOON, || renewed().is_some());
    assert!(took.is_some(), "{}", first.ask(&["nodes"]));
    let (until, by) = renewed().expect("it is renewed");
    assert_eq!(by.certificate.claims().name.as_str(), "c2", "nobody else may");
    assert!(until > now.plus(15) && until <= team::now().plus(60), "its life is that of the certificate: {until:?}");
    assert!(kept(&cluster.host(&network, 3), "c3").renewal.is_none(), "who has enough is not renewed");
    let audit = || fs::read_to_string(first.state().join("c1/team/audit")).unwrap_or_default();
    let line = "\tdone\tc2\trenew the certificate of `c1` until ";
    assert!(wait_until(SOON, || audit().contains(line)).is_some(), "{}", audit());
    // A node that is started again has the renewed one, and others see it.
    let member = Member::open(&first.state().join("c1")).expect("its folder").expect("it is a member");
    assert!(member.validity().0 >= until);
    let third = cluster.host(&network, 3);
    let all = || third.ask(&["nodes"]).out.lines().filter(|line| line.starts_with('c')).count();
    assert!(wait_until(SOON, || all() == 3).is_some(), "{}", third.ask(&["nodes"]));
    drop(nodes);
}
