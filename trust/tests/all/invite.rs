//! Two machines that have never met before.

use crate::world::{NOW, World, keys};
use proptest::prelude::*;
use std::net::SocketAddr;
use trust::TextError;
use trust::identity::{Entropy, KeyId};
use trust::invite::{Invite, Inviter, InviterEffect, JoinError, Joiner, Message, Offer, OpenInvite, Proof};
use trust::name::UnixTime;
use trust::role::Role;
use trust::team::{Standing, Team};
use zeroize::Zeroizing;

fn invite(team: &Team) -> Invite {
    let addresses =
        ["192.168.7.1:7450", "[fe80::1]:7450"].map(|text| text.parse().expect("the input is good")).to_vec();
    Invite { team: team.id(), secret: Zeroizing::new([5; 16]), expires: NOW.plus(900), addresses, founds: false }
}

fn inviter(world: &World) -> Inviter {
    let mut inviter = Inviter::new(world.team.clone(), keys(2), Some(world.admin.1.clone()));
    let open = OpenInvite { expires: NOW.plus(900), role: Role::Member, name: None };
    inviter.open(invite(&world.team).hash(), open, NOW).expect("the input is good");
    inviter
}

fn joiner(invite: Invite) -> (Joiner, [u8; 32]) {
    let (joiner, hello) =
        Joiner::begin(invite, "r9".parse().expect("the input is good"), keys(30), NOW, Entropy::new(&[31; 32]))
            .expect("the input is good");
    let Message::Hello(hello) = hello else { panic!("{hello:?}") };
    (joiner, hello.nonce)
}

const OWN: [u8; 32] = [77; 32];

fn offer(inviter: &Inviter, nonce: [u8; 32]) -> Offer {
    let hello = trust::invite::Hello { nonce };
    match Message::from_bytes(&inviter.hello(&hello, OWN).to_bytes()) {
        Ok(Message::Offer(offer)) => *offer,
        other => panic!("{other:?}"),
    }
}

fn proof(message: &Message) -> Proof {
    match Message::from_bytes(&message.to_bytes()) {
        Ok(Message::Proof(proof)) => *proof,
        other => panic!("{other:?}"),
    }
}

fn entropy() -> Entropy {
    Entropy::new(&[32; 32])
}

#[test]
fn a_robot_joins_with_one_line() {
    let world = World::new();
    let line = invite(&world.team).to_line();
    let (mut joiner, nonce) =
        joiner(Invite::from_line(&format!(" {}\n", line.to_uppercase().replace("DCA1", "dca1"))).unwrap());
    let mut inviter = inviter(&world);
    let message = joiner.offered(offer(&inviter, nonce), NOW).unwrap();
    let proof = proof(&message);
    let effects = inviter.proven((&nonce, &OWN), &proof, NOW, &mut entropy()).unwrap();
    let [InviterEffect::Spend(hash, given), InviterEffect::Reply(Message::Welcome(welcome))] = effects.as_slice()
    else {
        panic!("{effects:?}");
    };
    assert_eq!((*hash, &**given), (invite(&world.team).hash(), &welcome.certificate));
    // The answer was lost: the same robot gets it again, and no second invitation is used up.
    let again = inviter.proven((&nonce, &OWN), &proof, NOW, &mut entropy()).unwrap();
    assert_eq!(again, effects[1..]);
    let (own, team, credential) = joiner.welcomed((**welcome).clone(), NOW).unwrap();
    assert_eq!((own.public(), &team), (keys(30).public(), &world.team));
    assert!(matches!(credential.check(&world.judge(NOW)), Ok(Standing::Valid(_))));
    assert_eq!(credential.certificate().claims().name.as_str(), "r9");
    assert_eq!(team.id().fingerprint(), world.team.id().fingerprint());
}

#[test]
fn a_line_is_good_once_and_for_a_while() {
    let world = World::new();
    let mut inviter = inviter(&world);
    let (mut first, nonce) = joiner(invite(&world.team));
    let first = proof(&first.offered(offer(&inviter, nonce), NOW).unwrap());
    inviter.proven((&nonce, &OWN), &first, NOW, &mut entropy()).unwrap();
    let (mut second, hello) =
        Joiner::begin(invite(&world.team), "r8".parse().unwrap(), keys(40), NOW, Entropy::new(&[41; 32])).unwrap();
    let Message::Hello(hello) = hello else { panic!() };
    let second = proof(&second.offered(offer(&inviter, hello.nonce), NOW).unwrap());
    let refused = inviter.proven((&hello.nonce, &OWN), &second, NOW, &mut entropy());
    assert_eq!(refused, Err(JoinError::NoInvite));
    let late = Joiner::begin(invite(&world.team), "r8".parse().unwrap(), keys(40), NOW.plus(901), entropy());
    assert_eq!(late.unwrap_err(), JoinError::Expired);
    let mut other = self::inviter(&world);
    let refused = other.proven((&hello.nonce, &OWN), &second, NOW.plus(901), &mut entropy());
    assert_eq!(refused, Err(JoinError::NoInvite), "the inviter's clock decides");
}

#[test]
fn the_joiner_speaks_to_the_right_team_alone() {
    let world = World::new();
    let nonce = joiner(invite(&world.team)).1;
    let good = offer(&inviter(&world), nonce);
    let refused = |offer: Offer| joiner(invite(&world.team)).0.offered(offer, NOW).unwrap_err();
    let other = Team::found("acme".parse().unwrap(), &keys(50));
    let impostor = Inviter::new(other, keys(50), None);
    assert_eq!(refused(offer(&impostor, nonce)), JoinError::OtherTeam);
    // An inviter with the right team's name and keys, but without its secret key; a member without the right to
    // invite; an answer to another joiner.
    let thief = Inviter::new(world.team.clone(), keys(51), None);
    assert_eq!(refused(offer(&thief, nonce)), JoinError::Signature);
    let viewer = Inviter::new(world.team.clone(), keys(4), Some(world.viewer.1.clone()));
    assert!(matches!(refused(offer(&viewer, nonce)), JoinError::Inviter(_)));
    assert_eq!(refused(offer(&inviter(&world), [1; 32])), JoinError::Signature);
    assert_eq!(refused(Offer { nonce: [1; 32], ..good }), JoinError::Signature);
}

#[test]
fn who_listens_can_neither_use_nor_change_a_proof() {
    let world = World::new();
    let (mut joiner, nonce) = joiner(invite(&world.team));
    let mut inviter = inviter(&world);
    let good = proof(&joiner.offered(offer(&inviter, nonce), NOW).unwrap());
    let thief = keys(60);
    let cases = [
        Proof { keys: *thief.public(), ..good.clone() },
        Proof { name: "r7".parse().unwrap(), ..good.clone() },
        Proof { signature: [1; 64], ..good.clone() },
    ];
    for changed in cases {
        assert_eq!(inviter.proven((&nonce, &OWN), &changed, NOW, &mut entropy()), Err(JoinError::NoInvite));
    }
    // The proof is not valid in another conversation.
    assert_eq!(inviter.proven((&nonce, &[1; 32]), &good, NOW, &mut entropy()), Err(JoinError::NoInvite));
    assert!(inviter.proven((&nonce, &OWN), &good, NOW, &mut entropy()).is_ok());
}

#[test]
fn wrong_proofs_do_not_keep_the_right_one_out() {
    let world = World::new();
    let (mut joiner, nonce) = joiner(invite(&world.team));
    let mut inviter = inviter(&world);
    let good = proof(&joiner.offered(offer(&inviter, nonce), NOW).unwrap());
    let wrong = Proof { signature: [1; 64], ..good.clone() };
    for _ in 0..100 {
        assert_eq!(inviter.proven((&nonce, &OWN), &wrong, NOW, &mut entropy()), Err(JoinError::NoInvite));
    }
    assert!(inviter.proven((&nonce, &OWN), &good, NOW, &mut entropy()).is_ok());
}

#[test]
fn a_typing_mistake_is_told() {
    let line = invite(&World::new().team).to_line();
    assert_eq!(line.len(), 148, "{}", *line);
    for at in "dca1-".len()..line.len() {
        let other = if &line[at..=at] == "7" { "8" } else { "7" };
        let wrong = format!("{}{other}{}", &line[..at], &line[at + 1..]);
        assert!(Invite::from_line(&wrong).is_err(), "character {at}");
        assert!(Invite::from_line(&line[..at]).is_err(), "up to {at}");
    }
    assert_eq!(Invite::from_line("dca2-x").unwrap_err(), TextError::Prefix("dca1-"));
    assert!(!format!("{:?}", invite(&World::new().team)).contains("5, 5"));
}

proptest! {
    #[test]
    fn lines_come_back(team: [u8; 32], secret: [u8; 16], expires: u64, founds: bool, addresses in prop::collection::vec(any::<SocketAddr>(), 0..=4)) {
        let plain = |address: &SocketAddr| SocketAddr::new(address.ip(), address.port());
        let addresses: Vec<SocketAddr> = addresses.iter().map(plain).collect();
        let invite = Invite { team: KeyId(team), secret: Zeroizing::new(secret), expires: UnixTime(expires), addresses, founds };
        let read = Invite::from_line(&invite.to_line()).unwrap();
        prop_assert_eq!((read.team, read.secret, read.expires, read.addresses), (invite.team, invite.secret, invite.expires, invite.addresses));
        prop_assert_eq!(read.founds, founds);
    }
}
