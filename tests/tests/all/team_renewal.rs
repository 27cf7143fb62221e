//! Nodes with certificates that last a minute. A node with the right to renew renews the certificates of the others
//! before they end, and other nodes cannot.

use dca_tests::cluster::{Cluster, Ended, Host, Network, SOON, wait_until};
use dca_tests::made_team::{MadeTeam, keys};
use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt as _;
use team::member::Member;
use trust::bundle::Bundle;
use trust::locked::{Cost, LockedKeys};
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
    // `c1` has 15 of 60 s left, `c2` may renew, and `c3` is a member like `c1` but needs no renewal.
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
    // A restarted node has the renewed certificate, and others see it.
    let member = Member::open(&first.state().join("c1")).expect("its folder").expect("it is a member");
    assert!(member.validity().0 >= until);
    let third = cluster.host(&network, 3);
    let all = || third.ask(&["nodes"]).out.lines().filter(|line| line.starts_with('c')).count();
    assert!(wait_until(SOON, || all() == 3).is_some(), "{}", third.ask(&["nodes"]));
    drop(nodes);
}

/// A user has a certificate that is about to end. A node with the right to renew renews it, and the user is then
/// believed with the new certificate.
#[test]
fn a_user_is_renewed_by_who_may() {
    let Some(network) = Network::new(2) else { return };
    let (cluster, team) = (Cluster::new(), MadeTeam::default());
    let now = team::now();
    let desk = cluster.host(&network, 1);
    for (number, (name, role)) in (1..).zip([("c1", Role::Member), ("c2", Role::Renewer)]) {
        let (own, host) = (keys(), cluster.host(&network, number));
        let credential = team.certify_between(name, (role, &own), (UnixTime(now.0 - 10), now.plus(3600)));
        team.begin(&host.state().join(name), &own, &credential);
    }
    let (user, folder) = (keys(), cluster.folder().join("keys"));
    let ends = now.plus(20);
    let credential = team.certify_between("dan", (Role::Deployer, &user), (UnixTime(now.0 - 100), ends));
    let mut bundle = Bundle::new(team.team.clone());
    bundle.add(credential.certificate().clone()).expect("there is room");
    let entropy = &mut team::random().expect("the system has random bytes");
    let locked = LockedKeys::lock(&user, "correct horse battery", Cost::TEST, entropy).expect("a passphrase");
    fs::create_dir_all(folder.join("acme")).expect("a folder of ours");
    let passphrase = folder.join("passphrase");
    let files = [
        (folder.join("own.key"), locked.to_bytes()),
        (folder.join("acme/team"), bundle.to_text().into_bytes()),
        (passphrase.clone(), b"correct horse battery\n".to_vec()),
    ];
    for (path, bytes) in files {
        fs::write(&path, bytes).expect("a file of ours");
        fs::set_permissions(&path, Permissions::from_mode(0o600)).expect("a file of ours");
    }
    let keys =
        ["--keys", &folder.display().to_string(), "--passphrase", &passphrase.display().to_string()].map(str::to_owned);
    let run_dir = desk.run_dir().display().to_string();
    let dan = |arguments: &[&str]| -> Ended {
        desk.ask(&arguments.iter().copied().chain(keys.iter().map(String::as_str)).collect::<Vec<_>>())
    };
    let _c1 = desk.node("c1", &[]);
    let alone = dan(&["team", "renew", "--run-dir", &run_dir]);
    assert_eq!(alone.code, Some(1), "{alone}");
    assert!(
        alone
            .err
            .contains("the certificate was not renewed: `c1`: `c1` may not renew; `dca team invite NAME --renewer`"),
        "{alone}"
    );
    let _c2 = cluster.host(&network, 2).node("c2", &[]);
    let renewed = || dan(&["team", "renew", "--run-dir", &run_dir]);
    let took = wait_until(SOON, || renewed().out.contains(", renewed by `c2`"));
    assert!(took.is_some(), "{}", renewed());
    assert!(wait_until(SOON, || team::now() > ends).is_some(), "the certificate itself has ended");
    let listed = dan(&["team"]);
    assert!(listed.out.contains("renewed"), "{listed}");
    // The signatures of the renewed user are valid.
    let written = dan(&["db", "put", "team/gain", "1.5"]);
    assert_eq!(written.code, Some(0), "{written}");
    let audit = fs::read_to_string(cluster.host(&network, 2).state().join("c2/team/audit")).expect("an audit log");
    assert!(audit.contains("\tdone\tdan\trenew the certificate of `dan` until "), "{audit}");
    let own = fs::read_to_string(desk.state().join("c1/team/audit")).expect("an audit log");
    assert!(own.contains("\tdone\tdan\twrite"), "{own}");
}
