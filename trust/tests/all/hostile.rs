//! Valid bytes that are manipulated by seeds: bits are flipped, and pieces are cut out, duplicated, or taken from other bytes. Nothing
//! panics, no member becomes trusted, and every value that can be read is written again as the same bytes.
//!
//! `HOSTILE=1000000 cargo test --release -p trust --test all hostile` runs this many of each kind. `fuzz/targets` has the same checks for
//! cargo-fuzz.

use crate::bundle::bundle;
use crate::world::{NOW, World, keys};
use trust::audit::{Decision, Entry, Log, Verifier};
use trust::certificate::{Certificate, DAY, Renewal};
use trust::delegation::Delegation;
use trust::heads::Heads;
use trust::identity::KeyId;
use trust::invite::Invite;
use trust::request::{Audience, Context, Replays, Request, check};
use trust::revocation::{Revocations, RevokedSet};
use trust::role::Action;
use trust::team::{Credential, Judge};
use zeroize::Zeroizing;

/// How many manipulations of each kind are tried.
fn rounds() -> u64 {
    std::env::var("HOSTILE").ok().and_then(|rounds| rounds.parse().ok()).unwrap_or(3000)
}

/// Random numbers by a seed. Source: G. Marsaglia, *Xorshift RNGs*, 2003.
struct Seeded(u64);

impl Seeded {
    fn below(&mut self, end: usize) -> usize {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        usize::try_from(self.0 % (end.max(1) as u64)).expect("it is below a usize")
    }

    /// Manipulates bytes; `other` is another valid value, from which pieces may be taken.
    fn work_on(&mut self, good: &[u8], other: &[u8]) -> Vec<u8> {
        let mut bytes = good.to_vec();
        for _ in 0..=self.below(4) {
            let (at, to) = (self.below(bytes.len()), self.below(bytes.len()));
            let (from, until) = (at.min(to), at.max(to));
            match self.below(7) {
                0 | 1 if !bytes.is_empty() => bytes[at] ^= 1 << self.below(8),
                2 if !bytes.is_empty() => bytes[at] = [0, 1, 0x7f, 0xff, b'\n', b' '][self.below(6)],
                3 => drop(bytes.drain(from..until)),
                4 => bytes.truncate(at),
                5 if bytes.len() < 1 << 16 => {
                    let piece = bytes[from..until].to_vec();
                    bytes.splice(at..at, piece);
                }
                _ => {
                    let from = self.below(other.len());
                    let piece = &other[from..(from + self.below(64)).min(other.len())];
                    bytes.splice(at.min(bytes.len())..at.min(bytes.len()), piece.iter().copied());
                }
            }
        }
        bytes
    }

    fn each(good: &[u8], other: &[u8], mut try_it: impl FnMut(&[u8])) {
        for seed in 1..=rounds() {
            let changed = Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15)).work_on(good, other);
            if changed != good {
                try_it(&changed);
            }
        }
    }

    fn each_text(good: &str, other: &str, mut try_it: impl FnMut(&str)) {
        Self::each(good.as_bytes(), other.as_bytes(), |bytes| try_it(&String::from_utf8_lossy(bytes)));
    }
}

fn context<'a>(world: &'a World, judge: Judge<'a>) -> Context<'a> {
    let own = world.r1.1.certificate();
    Context { judge, node: own.subject(), name: &own.claims().name, deployment: None, epoch_min: 0 }
}

fn request(world: &World, body: &[u8]) -> Vec<u8> {
    let (audience, action, id, not_after) = (Audience::Team, Action::Deploy, [1; 16], NOW.plus(60));
    let (team, sequence, epoch, not_before) = (world.team.id(), 7, 3, NOW);
    let request = Request { team, audience, action, id, sequence, epoch, not_before, not_after };
    request.sign(body, &world.deployer.0, &world.deployer.1)
}

#[test]
fn hostile_signed_requests() {
    let world = World::new();
    let (good, other) = (request(&world, b"plan"), request(&world, b"other"));
    let mut replays = Replays::default();
    Seeded::each(&good, &other, |bytes| {
        assert!(check(bytes, b"plan", &context(&world, world.judge(NOW)), &mut replays).is_err());
        drop((Request::peek(bytes), Request::mark(bytes)));
    });
    assert_eq!(replays, Replays::default(), "a refusal spends no number");
    assert!(check(&good, b"plan", &context(&world, world.judge(NOW)), &mut replays).is_ok());
}

#[test]
fn hostile_certificates() {
    let world = World::new();
    let (good, other) = (world.deployer.1.certificate().to_bytes(), world.r2.1.certificate().to_bytes());
    let admin = world.admin.1.certificate();
    Seeded::each(&good, &other, |bytes| {
        let Ok(read) = Certificate::from_bytes(bytes) else { return };
        assert_eq!(read.to_bytes(), bytes, "a certificate has one form");
        assert!(Credential::new(read, Some(admin.clone())).check(&world.judge(NOW)).is_err());
    });
}

/// A manipulated credential gives no more rights than its holder has, and no other name. At most a renewal is lost.
#[test]
fn hostile_capabilities() {
    let world = World::new();
    let renewal = Renewal::issue(world.r1.1.certificate(), NOW.plus(20 * DAY), 30 * DAY, &world.r2.0);
    let renewed = Credential { renewal: Some((renewal, world.r2.1.chain.clone())), ..world.r1.1.clone() };
    let judge = world.judge(NOW.plus(20 * DAY));
    let actions =
        [Action::Deploy, Action::Stop, Action::Start, Action::Write, Action::Invite, Action::Revoke, Action::Renew];
    let mine = |good: &Credential, read: &Credential| read.certificate() == good.certificate();
    for good in [&renewed, &world.viewer.1, &world.deployer.1] {
        Seeded::each(&good.to_bytes(), &world.r2.1.to_bytes(), |bytes| {
            let Ok(read) = Credential::from_bytes(bytes) else { return };
            assert_eq!(read.to_bytes(), bytes, "a credential has one form");
            if let Ok(standing) = read.check(&judge) {
                assert!(mine(good, &read), "somebody else is trusted");
                // A renewal that is not valid is treated as missing.
                let plain = Credential { renewal: None, ..good.clone() };
                assert!(Ok(standing) == good.check(&judge) || Ok(standing) == plain.check(&judge));
                let gains =
                    |action: &Action| good.require(*action, &judge).is_err() && read.require(*action, &judge).is_ok();
                assert!(!actions.iter().any(gains));
            }
        });
    }
    let vouched = Delegation::sign([9; 32], "a", NOW, &world.r1.0, world.r1.1.clone()).to_bytes();
    let other = Delegation::sign([8; 32], "", NOW, &world.r2.0, world.r2.1.clone()).to_bytes();
    Seeded::each(&vouched, &other, |bytes| {
        let Ok(read) = Delegation::from_bytes(bytes) else { return };
        assert!(read.check(&world.judge(NOW)).is_err() || read.key() == &[9; 32], "nobody else is vouched for");
    });
}

#[test]
fn hostile_lines_of_invitations() {
    let world = World::new();
    let invite = |secret| {
        let addresses = vec!["10.0.0.1:7450".parse().unwrap()];
        Invite {
            team: world.team.id(),
            secret: Zeroizing::new([secret; 16]),
            expires: NOW.plus(900),
            addresses,
            founds: false,
        }
    };
    let (good, other) = (invite(5).to_line(), invite(6).to_line());
    Seeded::each_text(&good, &other, |line| {
        let Ok(read) = Invite::from_line(line) else { return };
        // Surrounding blanks and look-alike letters do not make a different line.
        assert_eq!(*read.to_line(), *good, "{line}");
    });
}

#[test]
fn hostile_revocations() {
    let world = World::new();
    let gone = |number: u8| [(keys(number).public().id(), NOW)].into();
    let set = |number, of| RevokedSet::sign(&world.team, number, gone(of), &world.root, None).unwrap();
    let (good, other) = (set(1, 5), set(2, 6));
    Seeded::each(&good.to_bytes(), &other.to_bytes(), |bytes| {
        let Ok(read) = RevokedSet::from_bytes(bytes) else { return };
        assert_eq!(read.to_bytes(), bytes, "a set has one form");
        let mut revoked = Revocations::default();
        assert!(revoked.receive(read, &world.judge(NOW)).is_err() && revoked == Revocations::default());
    });
    let text = bundle(&world).to_text();
    Seeded::each_text(&text, &text, |text| drop(trust::bundle::Bundle::from_text(text)));
}

#[test]
fn hostile_audit_logs_and_heads() {
    let member = keys(5);
    let (mut log, first) = Log::begin(KeyId([3; 32]), KeyId([4; 32]), None);
    let entry = |who| {
        let (decision, what, reason) = (Decision::Failed, "deploy `door`", "no room");
        Entry { at: NOW, decision, who, what, request: [7; 16], reason }
    };
    let lines: Vec<String> =
        std::iter::once(first).chain(["dan", "eve", "dan"].map(|who| log.add(&entry(who)))).collect();
    let head = log.countersign(NOW, &member);
    Seeded::each_text(&lines.join("\n"), &lines[2], |text| {
        let mut verifier = Verifier::new(vec![head.clone()]).unwrap();
        let read = text.lines().try_for_each(|line| verifier.line(line));
        let is_same = text.lines().eq(lines.iter().map(String::as_str));
        assert!(is_same || read.is_err() || verifier.finish().is_err(), "{text}");
    });
    let mut heads = Heads::default();
    heads.keep(head, &"r2".parse().unwrap()).unwrap();
    let text = heads.to_text();
    Seeded::each_text(&text, &text, |text| {
        let Ok(read) = Heads::from_text(text) else { return };
        let mut signed = read.of(KeyId([4; 32])).map(|(_, head)| head.position().number);
        assert!(signed.all(|number| number == 3), "nobody has signed anything else");
    });
}
