use super::*;
use crate::program::ProgramIdentity;
use crate::visitor::VisitorIdentity;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::sync_channel;
use trust::certificate::{Certificate, Claims, DAY};
use trust::name::UnixTime;
use trust::revocation::RevokedSet;
use trust::role::Role;

struct Desk {
    root: SecretKeys,
    team: Team,
    folder: PathBuf,
}

fn keys() -> SecretKeys {
    SecretKeys::generate(&mut crate::random().unwrap())
}

impl Desk {
    fn new(name: &str) -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let number = COUNT.fetch_add(1, Ordering::Relaxed);
        let root = keys();
        let team = Team::found(name.parse().unwrap(), &root);
        let folder = std::env::temp_dir().join(format!("dca-member-{}-{number}", std::process::id()));
        Self { root, team, folder }
    }

    fn credential(&self, keys: &SecretKeys, role: Role, (begins, ends): (u64, u64)) -> Credential {
        let not_after = UnixTime(ends);
        let claims = Claims {
            team: self.team.id(),
            name: "r1".parse().unwrap(),
            role,
            keys: *keys.public(),
            not_before: UnixTime(begins),
            not_after,
            renewable_until: not_after,
            serial: [0; 16],
        };
        Credential::new(Certificate::issue(claims, &self.root).unwrap(), None)
    }

    /// A node whose certificate is valid from `begins` to `ends`, in days from now.
    fn node(&self, name: &str, begins: i64, ends: i64) -> Member {
        let (keys, state) = (keys(), self.folder.join(name));
        let at = |days: i64| crate::now().0.saturating_add_signed(days * i64::try_from(DAY).unwrap());
        Member::begin(&state, &keys, &self.team, false, &self.credential(&keys, Role::Member, (at(begins), at(ends))))
            .unwrap();
        Member::open(&state).unwrap().unwrap()
    }
}

impl Drop for Desk {
    fn drop(&mut self) {
        drop(std::fs::remove_dir_all(&self.folder));
    }
}

fn judged(by: &Member, other: &Member) -> Result<String, String> {
    by.judge(&other.key().1, &other.credential())
}

#[test]
fn only_nodes_of_the_team_are_let_in_and_only_in_time() {
    let (acme, other) = (Desk::new("acme"), Desk::new("acme"));
    let (own, friend) = (acme.node("own", 0, 30), acme.node("friend", -1, 30));
    assert_eq!(judged(&own, &friend), Ok("r1".to_owned()));
    let check = |other: &Member, why: &str| {
        let refused = judged(&own, other).unwrap_err();
        assert!(refused.contains(why), "{refused}");
    };
    check(&other.node("stranger", 0, 30), "another team");
    check(&acme.node("old", -40, -10), "has ended");
    check(&acme.node("early", 2, 30), "not valid yet");
    assert_eq!(judged(&own, &acme.node("offline", -30, -5)), Ok("r1".to_owned()), "within the grace");
    // The credentials of another node, of a user, and of a program.
    let stolen = own.judge(&keys_of(&keys()), &friend.credential()).unwrap_err();
    assert!(stolen.contains("to another key"), "{stolen}");
    let user = keys();
    let credential = acme.credential(&user, Role::Admin, (crate::now().0, crate::now().0 + DAY));
    let refused = own.judge(&keys_of(&user), &credential.to_bytes()).unwrap_err();
    assert!(refused.contains("is not a node"), "{refused}");
    let program = of(&acme, &friend, "friend");
    assert!(own.judge(&program.key().1, &program.credential()).is_err(), "a program is not a node");
    let visitor = VisitorIdentity::open(&acme.folder.join("friend.visitors")).unwrap();
    assert!(own.judge(&visitor.key().1, &visitor.credential()).is_err(), "a visitor is not a node");
    assert!(visitor.judge(&friend.key().1, &friend.credential()).is_err(), "a node is not a program");
}

/// A program of a node, for which the node has vouched.
fn of(acme: &Desk, node: &Member, name: &str) -> ProgramIdentity {
    let file = |what: &str| acme.folder.join(format!("{name}.{what}"));
    node.vouch(&file("visitors"), &file("programs")).unwrap();
    let program = ProgramIdentity::open(&file("programs"), |_| ()).unwrap();
    program.take_delegation(&node.vouch_for(&program.keys().public(), name).unwrap());
    program
}

/// Programs without a wire to this program are members of the team, but may not link.
#[test]
fn a_program_lets_those_link_who_have_a_wire_with_it_and_those_who_look() {
    let acme = Desk::new("acme");
    let (here, there) = (acme.node("here", 0, 30), acme.node("there", 0, 30));
    let (strangers, heard) = sync_channel(8);
    let [partner, third] = ["partner", "third"].map(|name| of(&acme, &there, name));
    here.vouch(&acme.folder.join("v"), &acme.folder.join("p")).unwrap();
    let own = ProgramIdentity::open(&acme.folder.join("p"), move |who| strangers.send(who).unwrap()).unwrap();
    let judged = |other: &dyn Identity| own.judge(&other.key().1, &other.credential());
    let awaits = |other: &dyn Identity| own.awaits(&other.key().1, &other.credential());
    let news = awaits(&partner).expect("it may get a wire");
    own.let_in([&partner.keys().public()[..], b"nonsense"].into_iter());
    assert!(news.has_changed().unwrap() && awaits(&partner).is_none());
    assert_eq!(judged(&partner), Ok("partner on r1".to_owned()));
    let why = judged(&third).unwrap_err();
    assert_eq!(why, "it has no wire with this program: third on r1");
    own.refused(([10, 0, 0, 4], 7).into(), &why);
    own.refused(([10, 0, 0, 4], 7).into(), "nonsense");
    assert_eq!(heard.try_iter().collect::<Vec<_>>(), ["third on r1 at 10.0.0.4"]);
    // Its key with the credential of another program, and a node itself.
    assert!(own.judge(&third.key().1, &partner.credential()).unwrap_err().contains("to another key"));
    assert!(judged(&there).is_err() && awaits(&there).is_none());
    // A visitor comes from a machine, and calls with the credentials that the node there gives to all its clients.
    let visitor = VisitorIdentity::open(&acme.folder.join("third.visitors")).unwrap();
    assert_eq!(judged(&visitor), Ok("a visitor from r1".to_owned()));
    assert_eq!(own.visit_problem(&visitor.sign_visit(&[3; 32]), &[3; 32]), None);
    assert!(own.visit_problem(&visitor.sign_visit(&[3; 32]), &[4; 32]).is_some());
    assert!(visitor.judge(&third.key().1, &third.credential()).is_ok());
    // No node has vouched for this program yet, or only for another key.
    let unknown = ProgramIdentity::open(&acme.folder.join("p"), |_| ()).unwrap();
    unknown.take_delegation(&here.vouch_for(&third.keys().public(), "unknown").unwrap());
    own.let_in([&unknown.keys().public()[..]].into_iter());
    assert!(judged(&unknown).is_err());
}

fn keys_of(keys: &SecretKeys) -> PublicKey {
    *keys.public().signing()
}

#[test]
fn what_is_revoked_is_kept_told_and_counts_for_programs() {
    let acme = Desk::new("acme");
    let (first, second, third) = (acme.node("first", 0, 30), acme.node("second", 0, 30), acme.node("third", 0, 30));
    let gone = third.credential.certificate().subject();
    let set = RevokedSet::sign(&acme.team, 1, [(gone, crate::now())].into(), &acme.root, None).unwrap();
    let other = Desk::new("acme");
    let forged = RevokedSet::sign(&acme.team, 2, [(gone, crate::now())].into(), &other.root, None).unwrap();
    assert!(first.revoke(forged).is_err() && judged(&first, &third).is_ok());
    let mut changes = second.changes();
    assert_eq!((first.revoke(set.clone()).unwrap(), first.revoke(set).unwrap()), (true, false));
    assert!(second.hear(&first.revocations()) && !second.hear(&first.revocations()));
    assert!(changes.has_changed().unwrap());
    changes.mark_unchanged();
    assert!(!second.hear(b"nonsense") && !changes.has_changed().unwrap());
    drop(second);
    let second = Member::open(&acme.folder.join("second")).unwrap().unwrap();
    assert!(judged(&second, &third).unwrap_err().contains("is revoked"), "after a restart");
    let [ours, theirs] = [(&second, "second"), (&third, "third")].map(|(node, name)| of(&acme, node, name));
    ours.let_in([&theirs.keys().public()[..]].into_iter());
    assert!(ours.judge(&theirs.key().1, &theirs.credential()).unwrap_err().contains("is revoked"));
}

/// Two copies of the operator's keys continue from the same number, and two nodes receive one set each. Nothing is lost when the nodes
/// meet, when a node is killed, or when its file is put back. An older set removes nothing.
#[test]
fn two_sets_of_one_number_are_both_kept() {
    let acme = Desk::new("acme");
    let (first, second) = (acme.node("first", 0, 30), acme.node("second", 0, 30));
    let [gone, lost] = [keys(), keys()].map(|keys| keys.public().id());
    let set = |number: u64, gone: &[KeyId]| {
        let gone: BTreeMap<KeyId, UnixTime> = gone.iter().map(|key| (*key, crate::now())).collect();
        RevokedSet::sign(&acme.team, number, gone, &acme.root, None).unwrap()
    };
    let at = |name: &str| Member::open(&acme.folder.join(name)).unwrap().unwrap();
    assert!(first.revoke(set(3, &[gone])).unwrap() && second.revoke(set(3, &[lost])).unwrap());
    assert!(second.hear(&first.revocations()) && first.hear(&second.revocations()));
    assert!(!second.hear(&first.revocations()) && !first.hear(&second.revocations()), "they know the same");
    assert_eq!(first.revocations(), second.revocations());
    // A later set without a key does not undo the revocation of that key, not even after a restart.
    let held = first.tell_revoked(&[set(4, &[lost]).to_bytes(), set(1, &[]).to_bytes()]).unwrap();
    assert_eq!(held.len(), 2, "the one with number 3 that is in number 4 is not needed");
    for member in [&first, &at("first"), &second, &at("second")] {
        assert!(member.with_judge(|judge| judge.revoked.has(&gone) && judge.revoked.has(&lost)));
    }
    assert_eq!(first.revocations(), at("first").revocations(), "memory and disk");
    // A removed file is rewritten at the next message.
    std::fs::remove_file(acme.folder.join("first").join(FOLDER).join(REVOKED)).unwrap();
    assert_eq!(first.tell_revoked(&[]).unwrap(), held);
    assert_eq!(first.revocations(), at("first").revocations());
    let joined = set(5, &[gone, lost]).to_bytes();
    assert_eq!(first.tell_revoked(std::slice::from_ref(&joined)).unwrap(), [joined], "it stands for all before");
}

/// A set that is not on the disk is not reported as known.
#[test]
fn a_disk_that_refuses_is_told() {
    let acme = Desk::new("acme");
    let first = acme.node("first", 0, 30);
    let set = RevokedSet::sign(&acme.team, 1, [(keys().public().id(), crate::now())].into(), &acme.root, None).unwrap();
    let (folder, away) = (acme.folder.join("first").join(FOLDER), acme.folder.join("away"));
    std::fs::rename(&folder, &away).unwrap();
    assert!(first.tell_revoked(&[set.to_bytes()]).is_err() && first.tell_revoked(&[]).is_err());
    // The set still applies, and is stored once the disk accepts it.
    assert!(first.with_judge(|judge| set.keys().keys().all(|key| judge.revoked.has(key))));
    std::fs::rename(&away, &folder).unwrap();
    assert_eq!(first.tell_revoked(&[]).unwrap(), [set.to_bytes()]);
    let kept = Member::open(&acme.folder.join("first")).unwrap().unwrap();
    assert_eq!(kept.revocations(), first.revocations());
    std::fs::rename(&folder, &away).unwrap();
    assert!(first.tell_revoked(&[set.to_bytes()]).is_err(), "it is known, but is nowhere after a restart");
    std::fs::rename(&away, &folder).unwrap();
}

/// A node whose disk is full when it receives a revocation no longer trusts the revoked member. It stores the set when it receives it
/// again.
#[test]
fn a_disk_that_refuses_takes_no_revocation_away() {
    let acme = Desk::new("acme");
    let (first, second) = (acme.node("first", 0, 30), acme.node("second", 0, 30));
    let gone = keys().public().id();
    let set = RevokedSet::sign(&acme.team, 1, [(gone, crate::now())].into(), &acme.root, None).unwrap();
    first.revoke(set).unwrap();
    let (folder, away) = (acme.folder.join("second").join(FOLDER), acme.folder.join("away"));
    std::fs::rename(&folder, &away).unwrap();
    assert!(second.hear(&first.revocations()), "it is new");
    assert!(second.with_judge(|judge| judge.revoked.has(&gone)));
    std::fs::rename(&away, &folder).unwrap();
    assert!(!second.hear(&first.revocations()));
    let again = Member::open(&acme.folder.join("second")).unwrap().unwrap();
    assert!(again.with_judge(|judge| judge.revoked.has(&gone)));
}

/// Removing the file does not make a node trust revoked members again: the node does not start.
#[test]
fn a_node_that_has_heard_who_is_revoked_does_not_start_without_that() {
    let acme = Desk::new("acme");
    let first = acme.node("first", 0, 30);
    let (state, path) = (acme.folder.join("first"), acme.folder.join("first").join(FOLDER).join(REVOKED));
    let why = || format!("{:#}", Member::open(&state).unwrap_err());
    assert!(path.is_file(), "it begins with none, which is written");
    // Without the file no key is revoked, and the remaining files do not show that any was.
    std::fs::remove_file(&path).unwrap();
    drop(Member::open(&state).unwrap().unwrap());
    std::os::unix::fs::symlink("/nowhere/revoked", &path).unwrap();
    assert!(why().contains("leads nowhere"), "{}", why());
    std::fs::remove_file(&path).unwrap();
    let gone = keys().public().id();
    first.revoke(RevokedSet::sign(&acme.team, 1, [(gone, crate::now())].into(), &acme.root, None).unwrap()).unwrap();
    let kept = std::fs::read(&path).unwrap();
    // The audit log is complete once the node has ended.
    drop(first);
    folder::write(&path, &kept[..kept.len() / 2]).unwrap();
    assert!(
        why().contains("is broken: copy this file from another node") && why().ends_with("not a list of revocations")
    );
    std::fs::remove_file(&path).unwrap();
    assert!(why().contains("is missing, but the audit log says"), "{}", why());
    folder::write(&path, &kept).unwrap();
    assert!(Member::open(&state).unwrap().unwrap().with_judge(|judge| judge.revoked.has(&gone)));
}

#[test]
fn who_works_at_a_revoked_robot_still_hears_its_node() {
    let acme = Desk::new("acme");
    let (friend, lost) = (acme.node("friend", 0, 30), acme.node("lost", 0, 30));
    let gone = [(lost.credential.certificate().subject(), crate::now())].into();
    let set = RevokedSet::sign(&acme.team, 1, gone, &acme.root, None).unwrap();
    for (node, name) in [(&friend, "of-friend"), (&lost, "of-lost")] {
        node.vouch(&acme.folder.join(name), &acme.folder.join("programs")).unwrap();
        node.revoke(set.clone()).unwrap();
    }
    let [elsewhere, here] =
        ["of-friend", "of-lost"].map(|name| VisitorIdentity::open(&acme.folder.join(name)).unwrap());
    let proof = lost.sign(&[3; 32], true).unwrap();
    assert_eq!(here.check(&proof, &[3; 32]), Author::Member("r1".to_owned()));
    assert_ne!(here.check(&proof, &[4; 32]), Author::Member("r1".to_owned()), "it has not signed that");
    let refused = elsewhere.check(&proof, &[3; 32]);
    assert!(matches!(&refused, Author::Nobody(why) if why.contains("is revoked")), "{refused:?}");
}

#[test]
fn a_broken_folder_is_no_node_without_a_team() {
    let acme = Desk::new("acme");
    drop(acme.node("r1", 0, 30));
    let state = acme.folder.join("r1");
    assert!(Member::open(&acme.folder.join("r2")).unwrap().is_none());
    std::fs::write(state.join(FOLDER).join(KEYS), [7; SECRET_LEN]).unwrap();
    assert!(Member::open(&state).unwrap_err().to_string().contains("is broken"));
    std::fs::remove_file(state.join(FOLDER).join(KEYS)).unwrap();
    assert!(Member::open(&state).unwrap_err().to_string().contains("is missing"));
    std::fs::remove_file(state.join(FOLDER).join(CREDENTIAL)).unwrap();
    assert!(Member::open(&state).unwrap_err().to_string().contains("was cut short"));
    // The same holds for an empty folder, and for a link to a disk that is not mounted.
    std::fs::remove_dir_all(state.join(FOLDER)).unwrap();
    std::fs::create_dir(state.join(FOLDER)).unwrap();
    assert!(Member::open(&state).unwrap_err().to_string().contains("was cut short, or is a link that leads nowhere"));
    std::fs::remove_dir(state.join(FOLDER)).unwrap();
    std::os::unix::fs::symlink("/nowhere/team", state.join(FOLDER)).unwrap();
    assert!(Member::open(&state).unwrap_err().to_string().contains("was cut short, or is a link that leads nowhere"));
    std::fs::remove_file(state.join(FOLDER)).unwrap();
    let why = Member::open(&state).unwrap_err().to_string();
    assert!(why.starts_with("the last team of this node was `acme`") && why.contains("in-team"), "{why}");
    std::fs::remove_file(state.join("in-team")).unwrap();
    assert!(Member::open(&state).unwrap().is_none());
}

/// A node that moves to another team notes the new team.
#[test]
fn a_node_notes_the_team_of_its_last_start() {
    let noted = {
        let (acme, other) = (Desk::new("acme"), Desk::new("other"));
        drop(acme.node("r1", 0, 30));
        let (from, to) = (acme.folder.join("r1").join(FOLDER), other.folder.join("r1").join(FOLDER));
        drop(other.node("r1", 0, 30));
        std::fs::remove_dir_all(&from).unwrap();
        std::fs::rename(to, &from).unwrap();
        drop(Member::open(&acme.folder.join("r1")).unwrap().unwrap());
        std::fs::read_to_string(acme.folder.join("r1").join("in-team")).unwrap()
    };
    assert_eq!(noted, "other");
}
