//! Heads of audit logs that members sign for each other.

use crate::world::{NOW, keys};
use trust::audit::{AuditError, Decision, Entry, Head, Log, Verifier};
use trust::heads::{HEADS_MAX, HeadError, Heads, PAIRS_MAX};
use trust::identity::KeyId;
use trust::name::{Name, UnixTime};

const TEAM: KeyId = KeyId([3; 32]);
const NODE: KeyId = KeyId([4; 32]);

fn name(text: &str) -> Name {
    text.parse().expect("the input is good")
}

fn add(log: &mut Log, what: &str) -> String {
    let (decision, who, reason) = (Decision::Done, "dan", "");
    log.add(&Entry { at: NOW, decision, who, what, request: [0; 16], reason })
}

/// The position of a log, signed by its own node.
fn told(log: &Log, at: UnixTime) -> Head {
    Head::sign(log.position().expect("it has a record"), at, &keys(9))
}

#[test]
fn a_member_signs_no_log_that_was_cut_or_rewritten() {
    let (member, r2) = (keys(5), name("r2"));
    let (mut log, _) = Log::begin(TEAM, NODE, None);
    assert_eq!(log.position(), None, "there is nothing to sign");
    let (mut heads, mut at) = (Heads::default(), NOW);
    let mut sign = |log: &Log| {
        at = at.plus(1);
        heads.countersign(&told(log, at), &name("r1"), NOW, &r2, &member)
    };
    add(&mut log, "one");
    let early = log;
    add(&mut log, "two");
    let (first, is_new) = sign(&log).unwrap();
    assert!(is_new && first.by() == member.public().id());
    assert_eq!(sign(&log), Ok((first, false)), "the same once more");
    assert_eq!(sign(&early), Err(HeadError::Cut { found: 1, signed: 2 }));
    let mut other = early;
    add(&mut other, "2");
    assert_eq!(sign(&other), Err(HeadError::Rewritten { number: 2 }));
    add(&mut log, "three");
    assert!(sign(&log).unwrap().1);
}

/// A relay repeats a head that a node has signed before. This does not show that the log of that node was cut off.
#[test]
fn a_head_that_is_sent_again_is_no_sign_of_a_cut() {
    let (member, names) = (keys(5), [name("r1"), name("r2")]);
    let (mut log, _) = Log::begin(TEAM, NODE, None);
    let mut heads = Heads::default();
    add(&mut log, "one");
    let (first, early) = (told(&log, NOW), log);
    add(&mut log, "two");
    let second = told(&log, NOW.plus(1));
    let sign = |heads: &mut Heads, head: &Head| heads.countersign(head, &names[0], NOW, &names[1], &member);
    assert!(sign(&mut heads, &first).unwrap().1 && sign(&mut heads, &second).unwrap().1);
    assert_eq!(sign(&mut heads, &first), Err(HeadError::Old));
    // The same holds after a restart. A later head by the node itself is still accepted.
    let mut read = Heads::from_text(&heads.to_text()).unwrap();
    assert_eq!(sign(&mut read, &first), Err(HeadError::Old));
    let cut = told(&early, NOW.plus(2));
    assert_eq!(sign(&mut read, &cut), Err(HeadError::Cut { found: 1, signed: 2 }));
}

/// A node signs a head while its clock is ahead. With the right clock, its log is signed again after the next record, and a cut is
/// found.
#[test]
fn signing_goes_on_after_a_clock_was_ahead() {
    let (member, names) = (keys(5), [name("r1"), name("r2")]);
    let (mut log, _) = Log::begin(TEAM, NODE, None);
    let mut heads = Heads::default();
    let sign = |heads: &mut Heads, head: &Head| heads.countersign(head, &names[0], NOW, &names[1], &member);
    add(&mut log, "one");
    let early = log;
    add(&mut log, "two");
    let ahead = told(&log, NOW.plus(10 * 86_400));
    assert!(sign(&mut heads, &ahead).unwrap().1);
    add(&mut log, "three");
    assert!(sign(&mut heads, &told(&log, NOW.plus(100))).unwrap().1, "it has grown");
    assert_eq!(sign(&mut heads, &ahead), Err(HeadError::Old), "a copy");
    assert_eq!(sign(&mut heads, &told(&early, NOW.plus(200))), Err(HeadError::Cut { found: 1, signed: 3 }));
}

/// Old heads are kept, so a log that was rewritten and has grown since is detected.
#[test]
fn some_heads_of_all_times_are_kept() {
    let (member, r2) = (keys(5), name("r2"));
    let (mut log, first) = Log::begin(TEAM, NODE, None);
    let (mut heads, mut lines) = (Heads::default(), vec![first]);
    for number in 0..500 {
        lines.push(add(&mut log, "something"));
        let at = NOW.plus(60 * number);
        heads.countersign(&told(&log, at), &name("r1"), at, &r2, &member).unwrap();
    }
    let by_member = |head: &Head| head.by() == member.public().id();
    let numbers: Vec<u64> =
        heads.of(NODE).filter(|(_, head)| by_member(head)).map(|(_, head)| head.position().number).collect();
    assert!(numbers.len() == HEADS_MAX && numbers[0] == 1 && numbers[HEADS_MAX - 1] == 500, "{numbers:?}");
    assert!(numbers.windows(2).all(|pair| pair[1] - pair[0] < 250), "{numbers:?}");
    let read = Heads::from_text(&heads.to_text()).unwrap();
    assert_eq!(read, heads);
    let kept: Vec<Head> = read.of(NODE).map(|(_, head)| head.clone()).collect();
    let verify = |lines: &[String]| {
        let mut verifier = Verifier::new(kept.clone())?;
        lines.iter().try_for_each(|line| verifier.line(line))?;
        verifier.finish()
    };
    assert_eq!(verify(&lines), Ok(log));
    let (mut forged, first) = Log::begin(TEAM, NODE, None);
    let forged: Vec<String> = std::iter::once(first).chain((0..600).map(|_| add(&mut forged, "nothing"))).collect();
    assert!(matches!(verify(&forged), Err(AuditError::Forked { .. })));
    assert!(matches!(verify(&lines[..400]), Err(AuditError::Truncated { number: 500, .. })));
}

#[test]
fn heads_of_others_have_a_limit_and_a_form() {
    let (r2, mut heads) = (name("r2"), Heads::default());
    let (mut log, _) = Log::begin(TEAM, NODE, None);
    add(&mut log, "one");
    let position = log.position().unwrap();
    for number in 0..PAIRS_MAX {
        let mut of = position;
        of.log.0[..8].copy_from_slice(&(number as u64).to_le_bytes());
        assert_eq!(heads.keep(Head::sign(of, NOW, &keys(5)), &r2), Ok(true));
        assert_eq!(heads.keep(Head::sign(of, NOW, &keys(5)), &r2), Ok(false));
    }
    assert_eq!(heads.keep(Head::sign(position, NOW, &keys(6)), &r2), Err(HeadError::Full));
    for (text, line) in [("x r2", 1), ("\n", 1), (&format!("{}r2", heads.to_text()), PAIRS_MAX + 1)] {
        assert_eq!(Heads::from_text(text), Err(HeadError::Line { line }));
    }
    let changed = heads.to_text().replacen("r2", "two words", 1);
    assert_eq!(Heads::from_text(&changed), Err(HeadError::Line { line: 1 }));
}

/// A log that continues in another file: a signature on the end of the first file also applies to the second.
#[test]
fn the_end_of_the_file_before_is_signed_too() {
    let (mut log, _) = Log::begin(TEAM, NODE, None);
    add(&mut log, "one");
    let head = Head::sign(log.position().unwrap(), NOW, &keys(5));
    let verify = |before: &Log| {
        let (_, line) = Log::begin(TEAM, NODE, Some(before));
        let mut verifier = Verifier::new(vec![head.clone()])?;
        verifier.line(&line)?;
        verifier.finish().map(drop)
    };
    assert_eq!(verify(&log), Ok(()));
    let (mut other, _) = Log::begin(TEAM, NODE, None);
    add(&mut other, "two");
    assert_eq!(verify(&other), Err(AuditError::Forked { number: 1, by: keys(5).public().id() }));
}
