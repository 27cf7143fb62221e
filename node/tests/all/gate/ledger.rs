//! The ledger of a gate on the disk: appended records are there, a torn record was not carried out, and a damaged one
//! is refused.

use super::world::{User, World, plan};
use super::{call, deploy, order, prepare, stop};
use node::logic::gate::{Found, Gate, Ledger, Refusal};
use node::logic::protocol::{Request, Signed};
use trust::request::{Refusal as Unsound, ReplayError};
use trust::revocation::Revocations;
use trust::role::Role;

fn read(bytes: &[u8]) -> Option<Found> {
    Ledger::from_bytes(bytes, &Revocations::default()).ok()
}

/// A gate that has accepted a call and an order, with the bytes of its ledger before, between and after.
fn accepted() -> (World, Gate, [Signed; 2], [Vec<u8>; 3]) {
    let world = World::new();
    let (dan, mut gate): (User, Gate) = (world.user("dan", Role::Deployer), world.gate("c2"));
    let mut bytes = Ledger::default().to_bytes();
    let empty = bytes.clone();
    let stopped = dan.sign(&stop(), "c2");
    call(&mut gate, &world, Request::Signed(Box::new(stopped.clone()))).expect("dan may stop");
    bytes.extend(gate.take_news());
    let one = bytes.clone();
    let deployed = dan.sign(&deploy(plan()), "c1");
    order(&mut gate, &world, 5, &prepare().signed(Some(&deployed))).expect("dan may deploy");
    bytes.extend(gate.take_news());
    assert!(gate.take_news().is_empty(), "what is taken is not given twice");
    (world, gate, [stopped, deployed], [empty, one, bytes])
}

#[test]
fn what_is_added_is_there_after_a_restart() {
    let (world, gate, [stopped, deployed], [_, _, bytes]) = accepted();
    let found = read(&bytes).unwrap();
    assert!(found.is_whole);
    assert_eq!(found.ledger, *gate.ledger());
    assert_eq!(read(&gate.ledger().to_bytes()).unwrap().ledger, *gate.ledger(), "a new file says the same");
    let mut gate = world.gate_with("c2", found.ledger);
    let is_used = |refused| matches!(refused, Err(Refusal::Request(Unsound::Replay(ReplayError::Used(_)))));
    assert!(is_used(call(&mut gate, &world, Request::Signed(Box::new(stopped))).map(drop)));
    assert!(is_used(order(&mut gate, &world, 6, &prepare().signed(Some(&deployed)))));
    assert!(gate.take_news().is_empty(), "what is refused adds nothing");
}

/// A power cut leaves the beginning of a record, or zeros in its place. Earlier records count.
#[test]
fn half_a_record_at_the_end_does_not_count() {
    let (_, _, _, [empty, one, two]) = accepted();
    for (before, after) in [(&empty, &one), (&one, &two)] {
        let expected = read(before).unwrap().ledger;
        for end in before.len() + 1..after.len() {
            let found = read(&after[..end]).unwrap_or_else(|| panic!("cut at {end}"));
            assert!(!found.is_whole, "{end}");
            assert_eq!(found.ledger, expected, "{end}");
        }
        for zeros in [1, 11, 12, 500, 5000] {
            let found = read(&[&before[..], &vec![0; zeros]].concat()).unwrap();
            assert!(!found.is_whole && found.ledger == expected, "{zeros}");
        }
    }
}

/// Nothing that was accepted is forgotten because a byte has changed.
#[test]
fn a_damaged_ledger_is_refused() {
    let (_, _, _, [.., bytes]) = accepted();
    for place in 0..bytes.len() {
        for bit in [1, 0x80] {
            let mut changed = bytes.clone();
            changed[place] ^= bit;
            assert!(read(&changed).is_none(), "byte {place}");
        }
    }
    assert!(read(b"").is_none() && read(b"dca ledger 1\n").is_none());
}
