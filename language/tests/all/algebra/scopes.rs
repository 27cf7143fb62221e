//! Laws, non-laws and histories of `match`, `shield`, `using` and `::`.

use super::laws::{TASKS, UpTo, any_operands, law, leaf, many, no_law, pairs, triples, two, with_constants};
use super::pair::{Pair, tagged};
use super::reference::{Declared, Event, Outcome, Reason, Term};
use super::spec::{Spec, number};
use language::algebra::{Event as Told, Outcome as Ended, Program, State, TAG_MAX, Value, step};

fn shield(e: &Term) -> Term {
    Term::Shield(None, Box::new(e.clone()))
}

fn using(resource: &str, e: &Term) -> Term {
    Term::Using(0, vec![resource.to_owned()], Box::new(e.clone()))
}

fn matching(arms: &[(Option<&str>, Term)]) -> Term {
    Term::Match(arms.iter().map(|(tag, e)| (tag.map(str::to_owned), e.clone())).collect())
}

#[test]
fn a_shield_of_a_shield_is_one_shield() {
    for p in with_constants(0) {
        law(&shield(&shield(&p)), &shield(&p), UpTo::Nothing);
    }
    law(&shield(&Term::Skip), &Term::Skip, UpTo::Nothing);
}

#[test]
fn a_shield_of_a_sequence_is_more_than_two_shields() {
    let (p, q) = (leaf(0), leaf(1));
    no_law(&shield(&p), &p);
    no_law(&shield(&two(Term::Seq, &p, &q)), &two(Term::Seq, &shield(&p), &shield(&q)));
    no_law(&shield(&many(Term::Dis, &[&p, &q])), &many(Term::Dis, &[&shield(&p), &shield(&q)]));
    // A stop that could not be confirmed before is reported by one shield, and forgotten by a join of two.
    no_law(&shield(&many(Term::Par, &[&p, &q])), &many(Term::Par, &[&shield(&p), &shield(&q)]));
}

#[test]
fn using_something_alone_changes_nothing() {
    for p in with_constants(0) {
        law(&using("r", &p), &p, UpTo::Nothing);
    }
    pairs(any_operands, |p, q| {
        let both = |r, s| many(Term::Par, &[&using(r, p), &using(s, q)]);
        law(&both("r", "s"), &many(Term::Par, &[p, q]), UpTo::Nothing);
    });
}

#[test]
fn using_together_is_not_using_in_turn() {
    let (p, q) = (leaf(0), leaf(1));
    let both = many(Term::Par, &[&using("r", &p), &using("r", &q)]);
    no_law(&both, &many(Term::Par, &[&p, &q]));
    // `;` would not start `q` after an abort of `p`.
    no_law(&both, &two(Term::Seq, &p, &q));
    let nested = |r, s, e| using(r, &using(s, e));
    let crossed = many(Term::Par, &[&nested("r", "s", &p), &nested("s", "r", &q)]);
    let together = |e: &Term| Term::Using(0, vec!["r".to_owned(), "s".to_owned()], Box::new(e.clone()));
    // If both start in one reaction, one of them gets both resources at once.
    law(&crossed, &many(Term::Par, &[&together(&p), &together(&q)]), UpTo::Nothing);
}

#[test]
fn a_match_takes_the_arm_of_its_tag_and_takes_the_tag_off() {
    triples(with_constants, |p, q, r| {
        let arms = [(Some("found"), q.clone()), (None, r.clone())];
        // Values are empty here, so nothing is found.
        law(&two(Term::Cond, p, &matching(&arms)), &two(Term::Seq, p, r), UpTo::Nothing);
    });
    for p in with_constants(0) {
        law(&matching(&[(None, p.clone())]), &p, UpTo::Nothing);
    }
    let arms = [(Some("found"), leaf(1)), (Some("missing"), leaf(2))];
    let mut history = History::of(two(Term::Cond, &leaf(0), &matching(&arms)));
    assert_eq!(history.send(&[Event::Start(vec![]), Event::Done(0, 1, tagged("missing", b"pose"))]), None);
    assert_eq!(history.running(), [2]);
    assert_eq!(history.send(&[Event::Done(2, 1, vec![])]), Some(Outcome::Done(vec![])));
    let lost = [Event::Start(vec![]), Event::Done(0, 2, tagged("lost", b""))];
    assert_eq!(history.send(&lost), Some(Outcome::Aborted(Reason::NoMatch)));
}

#[test]
fn a_tag_is_a_length_and_as_many_bytes() {
    let value = Value::tagged("found", b"pose").unwrap();
    assert_eq!((value.bytes(), value.tag()), (&b"\x05foundpose"[..], Some("found")));
    assert_eq!(Value::tagged("", b""), None);
    assert_eq!(Value::tagged(&"t".repeat(TAG_MAX + 1), b""), None);
    assert!(Value::tagged(&"t".repeat(TAG_MAX), b"").is_some());
    for bytes in [&b""[..], b"\x00found", b"\x06found", b"\x02\xff\xff", &[65; 70]] {
        assert_eq!(Value::new(bytes).tag(), None, "{bytes:?}");
    }
}

#[test]
fn a_source_that_is_done_at_once_keeps_its_pool_full() {
    let mut history = History::of(Term::Arec(Box::new(Term::Skip), vec![leaf(0), leaf(1)]));
    assert_eq!(history.send(&[Event::Start(vec![])]), None);
    assert_eq!(history.running(), [0, 1]);
    assert_eq!(history.send(&[Event::Done(1, 1, vec![])]), None);
    assert_eq!(history.running(), [0, 1]);
    let mut empty = History::of(Term::Arec(Box::new(Term::Skip), vec![Term::Skip; 3]));
    assert_eq!(empty.send(&[Event::Start(vec![])]), Some(Outcome::Aborted(Reason::Instant)));
}

/// `P ::[2] Q`: the third value waits, and the source with it; after a failure, the running members come to their end.
#[test]
fn a_pool_has_as_many_places_as_it_says() {
    let mut history = History::of(Term::Arec(Box::new(leaf(0)), vec![leaf(1), leaf(2)]));
    let found = |n| Event::Done(0, n, vec![b'0' + u8::try_from(n).unwrap()]);
    assert_eq!(history.send(&[Event::Start(vec![]), found(1), found(2)]), None);
    assert_eq!(history.running(), [0, 1, 2]);
    assert_eq!(history.send(&[found(3)]), None);
    assert_eq!(history.running(), [1, 2]);
    assert_eq!(history.send(&[Event::Done(1, 1, vec![])]), None);
    assert_eq!(history.running(), [0, 1, 2]);
    assert_eq!(history.send(&[Event::Aborted(2, 1, b"why".to_vec()), Event::Stopped(0, 4)]), None);
    assert_eq!(history.running(), [1]);
    let why = Outcome::Aborted(Reason::Reported(2, b"why".to_vec()));
    assert_eq!(history.send(&[Event::Done(1, 2, vec![])]), Some(why));
}

/// The paper wishes for "preventing a timeout from happening while placing" and "monitoring the availability of exclusive
/// resources": `timeout # (FindA : using(arm) shield PlaceA, ..)` with three objects.
///
/// Source: Petersson, Austin, Christensen, "DCA: a distributed control architecture for robotics", section 2.1.1.
#[test]
fn tidying_up_places_one_object_at_a_time_and_is_not_cut_short() {
    let (timeout, find, place) = (leaf(0), [1, 2, 3].map(leaf), [4, 5, 6].map(leaf));
    let tidy = |i: usize| two(Term::Cond, &find[i], &using("arm", &shield(&place[i])));
    let all = many(Term::Par, &[&tidy(0), &tidy(1), &tidy(2)]);
    let mut history = History::of(many(Term::Dis, &[&timeout, &all]));
    let found = |i| Event::Done(i, 1, vec![b'0' + u8::try_from(i).unwrap()]);
    assert_eq!(history.send(&[Event::Start(vec![]), found(3), found(1)]), None);
    assert_eq!(history.running(), [0, 2, 6]);
    assert_eq!(history.send(&[Event::Done(6, 1, vec![])]), None);
    assert_eq!(history.running(), [0, 2, 4]);
    // The time is up: placing goes on, searching does not.
    assert_eq!(history.send(&[Event::Done(0, 1, vec![])]), None);
    assert_eq!(history.running(), [4]);
    assert_eq!(history.send(&[Event::Stopped(2, 1)]), None);
    assert_eq!(history.send(&[Event::Done(4, 1, vec![])]), Some(Outcome::Done(vec![])));
}

#[test]
fn a_shield_with_a_bound_stops_in_the_end() {
    let mut history = History::of(Term::Shield(Some(0), Box::new(leaf(0))));
    assert_eq!(history.send(&[Event::Start(vec![]), Event::Stop]), None);
    assert_eq!(history.running(), [0]);
    assert_eq!(history.send(&[Event::Elapsed(0, 1)]), None);
    assert_eq!(history.running(), []);
    assert_eq!(history.send(&[Event::Stopped(0, 1)]), Some(Outcome::Killed));
    let again = [Event::Start(vec![]), Event::Stop, Event::Aborted(0, 2, vec![])];
    assert_eq!(history.send(&again), Some(Outcome::Killed));
}

/// Two loops that hand something to each other in no time: each event lets them do so a few times, no more.
#[test]
fn grants_in_one_reaction_are_counted() {
    let turn = |resource| two(Term::Rec, &using(resource, &Term::Skip), &Term::Skip);
    let mut term = many(Term::Ff, &[&using("r", &leaf(0)), &turn("r"), &turn("r")]);
    number(&mut term);
    let program = Program::compile(&Spec { term, declared: vec![Declared::Task] }.group());
    let (mut state, mut commands) = (State::new(&program), Vec::new());
    assert_eq!(step(&program, &mut state, Told::Start(Value::EMPTY), &mut commands), None);
    let waiting = |state: &State| state.waiting(&program).map(|names| names.count()).collect::<Vec<_>>();
    assert_eq!((waiting(&state), program.resources()), (vec![1, 1], &["r".to_owned()][..]));
    let Some(language::algebra::Command::Activate { member, activation, .. }) = commands.pop() else {
        panic!("the first has what it wants")
    };
    let done = Told::Done { member, activation, value: Value::EMPTY };
    assert_eq!(step(&program, &mut state, done, &mut commands), None);
    assert_eq!(waiting(&state), [1, 1]);
    assert_eq!(step(&program, &mut state, Told::Stop, &mut commands), Some(Ended::Stopped));
}

/// Both interpreters under a fixed word of events.
struct History {
    spec: Spec,
    program: Program,
    sent: Vec<Event>,
}

impl History {
    fn of(mut term: Term) -> Self {
        number(&mut term);
        let spec = Spec { term, declared: vec![Declared::Task; TASKS as usize + 1] };
        Self { program: Program::compile(&spec.group()), spec, sent: Vec::new() }
    }

    /// Sends more events; returns the outcome of the last.
    fn send(&mut self, events: &[Event]) -> Option<Outcome> {
        self.sent.extend_from_slice(events);
        self.replay().1
    }

    /// Returns the members that are active and not asked to stop.
    fn running(&self) -> Vec<u32> {
        self.replay().0.machine.members().0.into_iter().collect()
    }

    fn replay(&self) -> (Pair<'_>, Option<Outcome>) {
        let mut pair = Pair::new(&self.spec, &self.program);
        let mut outcome = None;
        for event in &self.sent {
            outcome = pair.send(event).expect("the reference agrees");
        }
        (pair, outcome)
    }
}
