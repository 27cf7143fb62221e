//! Every form: its exact bytes, which other versions have to read, and the result of damaging them.

use crate::world::{NOW, World, keys};
use expect_test::expect_file;
use std::collections::BTreeMap;
use trust::audit::{Decision, Entry, Head, Log, Verifier};
use trust::bundle::Bundle;
use trust::certificate::{Certificate, DAY, Renewal};
use trust::identity::{Entropy, KeyId, PublicKeys};
use trust::invite::{Hello, Invite, Inviter, Joiner, Message, OpenInvite};
use trust::locked::{Cost, LockedKeys};
use trust::name::UnixTime;
use trust::policy::Policy;
use trust::request::{Audience, Context, ReplayWrite, Replays, Request, check};
use trust::revocation::RevokedSet;
use trust::role::{Action, Role};
use trust::seal::{Place, Sealed, Secret};
use trust::team::{Credential, Team};
use zeroize::Zeroizing;

/// Reads bytes, and returns the value written again.
type Again = fn(&[u8]) -> Option<Vec<u8>>;

fn forms() -> Vec<(&'static str, Vec<u8>, Again)> {
    let world = World::new();
    let renewal = Renewal::issue(world.r1.1.certificate(), NOW.plus(20 * DAY), 30 * DAY, &world.r2.0);
    let renewed = Credential { renewal: Some((renewal.clone(), world.r2.1.chain.clone())), ..world.r1.1.clone() };
    let gone: BTreeMap<KeyId, UnixTime> = [(KeyId([1; 32]), NOW), (KeyId([2; 32]), NOW.plus(1))].into();
    let by_admin = Some(world.admin.1.clone());
    let revoked = RevokedSet::sign(&world.team, 4, gone, &world.admin.0, by_admin).expect("the input is good");
    let (mut log, _) = Log::begin(world.team.id(), KeyId([4; 32]), None);
    log.add(&record());
    let mut entropy = Entropy::new(&[9; 32]);
    let secret = Secret::new(Zeroizing::new(b"hunter2".to_vec())).expect("the input is good");
    let place = Place { team: world.team.id(), path: "team/camera" };
    let readers = [*world.r1.0.public(), *world.r2.0.public()];
    let sealed = Sealed::seal(&secret, &place, &readers, &mut entropy).expect("the input is good");
    let locked = LockedKeys::lock(&world.root, "correct horse", Cost::TEST, &mut entropy).expect("the input is good");
    let mut forms: Vec<(&'static str, Vec<u8>, Again)> = vec![
        ("team", world.team.to_bytes(), |bytes| Some(Team::from_bytes(bytes).ok()?.to_bytes())),
        ("certificate", world.admin.1.certificate().to_bytes(), |bytes| {
            Some(Certificate::from_bytes(bytes).ok()?.to_bytes())
        }),
        ("renewal", renewal.to_bytes(), |bytes| Some(Renewal::from_bytes(bytes).ok()?.to_bytes())),
        ("credential", renewed.to_bytes(), |bytes| Some(Credential::from_bytes(bytes).ok()?.to_bytes())),
        ("revoked", revoked.to_bytes(), |bytes| Some(RevokedSet::from_bytes(bytes).ok()?.to_bytes())),
        ("sealed", sealed.to_bytes(), |bytes| Some(Sealed::from_bytes(bytes).ok()?.to_bytes())),
        ("locked", locked.to_bytes(), |bytes| Some(LockedKeys::from_bytes(bytes).ok()?.to_bytes())),
        ("head", log.countersign(NOW, &world.r2.0).to_bytes(), |bytes| Some(Head::from_bytes(bytes).ok()?.to_bytes())),
    ];
    forms.extend(joining(&world).into_iter().map(|(name, message)| {
        let again: Again = |bytes| Some(Message::from_bytes(bytes).ok()?.to_bytes());
        (name, message.to_bytes(), again)
    }));
    forms
}

fn record() -> Entry<'static> {
    let (who, what, reason) = ("dan", "deploy", "it came too late");
    Entry { at: NOW, decision: Decision::Refused, who, what, request: [7; 16], reason }
}

fn joining(world: &World) -> [(&'static str, Message); 5] {
    let invite = invite(world);
    let mut inviter = Inviter::new(world.team.clone(), keys(2), Some(world.admin.1.clone()));
    inviter
        .open(invite.hash(), OpenInvite { expires: invite.expires, role: Role::Member, name: None }, NOW)
        .expect("the input is good");
    let (mut joiner, hello) =
        Joiner::begin(invite, "r9".parse().expect("the input is good"), keys(30), NOW, Entropy::new(&[31; 32]))
            .expect("the input is good");
    let Message::Hello(Hello { nonce }) = hello else { panic!() };
    let offer = inviter.hello(&Hello { nonce }, [77; 32]);
    let Message::Offer(offered) = offer.clone() else { panic!() };
    let proof = joiner.offered(*offered, NOW).expect("the input is good");
    let Message::Proof(proven) = proof.clone() else { panic!() };
    let effects =
        inviter.proven((&nonce, &[77; 32]), &proven, NOW, &mut Entropy::new(&[32; 32])).expect("the input is good");
    let Some(trust::invite::InviterEffect::Reply(welcome)) = effects.last().cloned() else { panic!() };
    [("hello", hello), ("offer", offer), ("proof", proof), ("welcome", welcome), ("refused", Message::Refused)]
}

fn invite(world: &World) -> Invite {
    let addresses = vec!["10.0.0.1:7450".parse().expect("the input is good")];
    Invite { team: world.team.id(), secret: Zeroizing::new([5; 16]), expires: NOW.plus(900), addresses, founds: false }
}

fn request(world: &World) -> (Request, Vec<u8>) {
    let request = Request {
        team: world.team.id(),
        audience: Audience::Deployment("door".parse().expect("the input is good")),
        action: Action::Deploy,
        id: [1; 16],
        sequence: 7,
        epoch: 3,
        not_before: NOW,
        not_after: NOW.plus(60),
    };
    let bytes = request.sign(b"plan", &world.deployer.0, &world.deployer.1);
    (request, bytes)
}

fn hex(bytes: &[u8]) -> String {
    let lines = bytes.chunks(40).map(|line| line.iter().map(|byte| format!("{byte:02x}")).collect::<String>());
    lines.map(|line| line + "\n").collect()
}

#[test]
fn the_bytes_of_every_form_stay() {
    let world = World::new();
    for (name, bytes, again) in forms() {
        assert_eq!(again(&bytes).as_ref(), Some(&bytes), "{name}");
        expect_file![format!("../golden/{name}.hex")].assert_eq(&hex(&bytes));
    }
    expect_file!["../golden/request.hex"].assert_eq(&hex(&request(&world).1));
    let (mut log, first) = Log::begin(world.team.id(), KeyId([4; 32]), None);
    let texts = [
        invite(&world).to_line().to_string(),
        world.root.public().to_text(),
        world.team.id().to_string(),
        world.team.id().fingerprint(),
        first,
        log.add(&record()),
        log.countersign(NOW, &world.r2.0).to_text(),
        crate::bundle::bundle(&world).to_text(),
    ];
    expect_file!["../golden/texts.txt"].assert_eq(&(texts.join("\n") + "\n"));
}

/// Random numbers from a seed, by splitmix64 (S. Vigna, public domain).
struct Dice(u64);

impl Dice {
    fn below(&mut self, limit: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut mixed = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        usize::try_from((mixed >> 33) % limit.max(1) as u64).expect("the input is good")
    }

    fn damage(&mut self, bytes: &mut Vec<u8>) {
        for _ in 0..=self.below(4) {
            let at = self.below(bytes.len());
            let value = u8::try_from(self.below(256)).expect("the input is good");
            match self.below(6) {
                0 => bytes.truncate(at),
                1 => bytes.insert(at, value),
                2 => bytes.extend_from_within(at..),
                3 if !bytes.is_empty() => drop(bytes.remove(at)),
                _ if !bytes.is_empty() => bytes[at] ^= value,
                _ => {}
            }
        }
    }
}

/// For any input, nothing panics, and a value that can be read is written again as the same bytes: a value has one
/// form.
#[test]
fn damaged_forms_are_refused_or_are_other_forms() {
    let mut dice = Dice(15);
    for (name, bytes, again) in forms() {
        for round in 0..600 {
            let mut damaged = bytes.clone();
            dice.damage(&mut damaged);
            if let Some(written) = again(&damaged) {
                assert_eq!(written, damaged, "{name}, round {round}");
            }
        }
        assert_eq!(again(&vec![0; 1 << 20]), None, "{name} has a limit");
    }
}

#[test]
fn damaged_requests_texts_and_logs_panic_nowhere() {
    let world = World::new();
    let door = "door".parse().unwrap();
    let node = world.r1.1.certificate().subject();
    let name = world.r1.1.certificate().claims().name.clone();
    let context = Context { judge: world.judge(NOW), node, name: &name, deployment: Some(&door), epoch_min: 0 };
    let (mut dice, (_, good)) = (Dice(16), request(&world));
    let (mut log, first) = Log::begin(world.team.id(), node, None);
    let lines = format!("{first}\n{}\n{}\n", log.add(&record()), log.add(&record()));
    let line = invite(&world).to_line().to_string();
    let key = world.root.public().to_text();
    let bundle = crate::bundle::bundle(&world).to_text();
    let policy = "folders = [\"/opt\"]\nrealtime = 3\n";
    for _ in 0..600 {
        let mut bytes = good.clone();
        dice.damage(&mut bytes);
        let mut replays = Replays::default();
        let accepted = check(&bytes, b"plan", &context, &mut replays).is_ok();
        assert!(!accepted || bytes == good);
        let restored = replays.restore(&ReplayWrite { signer: node, bytes });
        assert!(restored.is_err(), "a request is not a record");
        let mut text = |text: &str| {
            let mut bytes = text.as_bytes().to_vec();
            dice.damage(&mut bytes);
            String::from_utf8_lossy(&bytes).into_owned()
        };
        drop((Invite::from_line(&text(&line)), PublicKeys::from_text(&text(&key)), Policy::parse(&text(policy))));
        let damaged = text(&bundle);
        assert!(Bundle::from_text(&damaged).is_ok_and(|read| read.to_text() == damaged) || damaged != bundle);
        let mut verifier = Verifier::new(Vec::new()).unwrap();
        let fits = text(&lines).lines().try_for_each(|line| verifier.line(line));
        drop((fits, verifier.finish()));
    }
}
