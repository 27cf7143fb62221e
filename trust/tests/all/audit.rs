//! Logs that were manipulated.

use crate::world::{NOW, keys};
use trust::audit::{AuditError, Decision, Entry, FIELD_MAX, Head, LINE_MAX, Log, Verifier};
use trust::identity::KeyId;

const TEAM: KeyId = KeyId([3; 32]);
const NODE: KeyId = KeyId([4; 32]);

fn entry(number: u64) -> Entry<'static> {
    let (decision, reason) =
        if number.is_multiple_of(2) { (Decision::Done, "") } else { (Decision::Refused, "too late") };
    Entry { at: NOW.plus(number), decision, who: "user dan", what: "deploy door", request: [7; 16], reason }
}

fn log(count: u64) -> (Log, Vec<String>) {
    let (mut log, first) = Log::begin(TEAM, NODE, None);
    let records: Vec<String> = (0..count).map(|number| log.add(&entry(number))).collect();
    (log, [vec![first], records].concat())
}

fn verify(lines: &[String], heads: Vec<Head>) -> Result<Log, AuditError> {
    let mut verifier = Verifier::new(heads)?;
    lines.iter().try_for_each(|line| verifier.line(line))?;
    verifier.finish()
}

#[test]
fn the_first_line_that_does_not_fit_is_named() {
    let (end, lines) = log(6);
    assert_eq!(verify(&lines, Vec::new()), Ok(end));
    for at in 1..lines.len() {
        let number = at as u64;
        let mut changed = lines.clone();
        changed[at] = changed[at].replace("dan", "eve");
        assert_eq!(verify(&changed, Vec::new()), Err(AuditError::Hash { line: number + 1, number }));
        let mut missing = lines.clone();
        missing.remove(at);
        let expected = AuditError::Number { line: number + 1, found: number + 1, expected: number };
        let is_last = at + 1 == lines.len();
        assert_eq!(verify(&missing, Vec::new()).err(), (!is_last).then_some(expected));
        let mut doubled = lines.clone();
        doubled.insert(at, lines[at].clone());
        assert!(verify(&doubled, Vec::new()).is_err());
    }
}

#[test]
fn every_byte_counts() {
    let (_, lines) = log(3);
    for (index, line) in lines.iter().enumerate() {
        for at in 0..line.len() {
            let mut changed = lines.clone();
            let other = if &line[at..=at] == "0" { "1" } else { "0" };
            changed[index].replace_range(at..=at, other);
            assert!(verify(&changed, Vec::new()).is_err(), "line {index}, byte {at}");
        }
    }
}

#[test]
fn a_cut_end_is_missed_by_who_has_signed_it() {
    let (end, lines) = log(6);
    let member = keys(5);
    let head = Head::from_bytes(&end.countersign(NOW, &member).to_bytes()).unwrap();
    assert!(verify(&lines, vec![head.clone()]).is_ok());
    let error = verify(&lines[..4], vec![head.clone()]).unwrap_err();
    let expected = AuditError::Truncated { last: "record 3".to_owned(), number: 6, by: member.public().id() };
    assert_eq!(error, expected);
    assert!(verify(&lines[..1], vec![head.clone()]).unwrap_err().to_string().contains("ends with nothing"));
    // Rewritten from the third record on: the log is consistent in itself, but does not match the signature.
    let (mut other, mut forged) = log(2);
    forged.extend((10..14).map(|number| other.add(&entry(number))));
    assert_eq!(verify(&forged, vec![head.clone()]), Err(AuditError::Forked { number: 6, by: member.public().id() }));
    let (_, stranger) = Log::begin(TEAM, KeyId([5; 32]), None);
    assert_eq!(verify(&[stranger], vec![head]), Err(AuditError::OtherLog));
}

#[test]
fn a_log_goes_on_in_another_file() {
    let (end, _) = log(6);
    let (mut next, first) = Log::begin(TEAM, NODE, Some(&end));
    let record = next.add(&entry(6));
    assert!(record.starts_with("7\t"));
    assert_eq!(verify(&[first, record], Vec::new()), Ok(next));
}

#[test]
fn fields_cannot_make_lines() {
    let (mut log, first) = Log::begin(TEAM, NODE, None);
    let nasty = format!("a\tb\nc\r\u{1b}[2J\u{2028}{}", "ü".repeat(400));
    let line = log.add(&Entry { who: &nasty, what: &nasty, reason: &nasty, ..entry(0) });
    assert!(line.lines().count() == 1 && line.len() < LINE_MAX && !line.contains('\u{1b}'));
    assert_eq!(line.matches('ü').count(), 3 * (FIELD_MAX - 11));
    assert_eq!(verify(&[first, line], Vec::new()), Ok(log));
}
