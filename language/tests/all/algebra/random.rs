//! Larger random expressions under random words of events: current, stale and crossing ones, and stops.

use super::pair::{Pair, TAGS, converge};
use super::reference::{Asked, Declared, Event, Term};
use super::spec::{Spec, number};
use language::algebra::Program;
use proptest::collection::vec;
use proptest::prelude::*;
use proptest::test_runner::{RngSeed, TestRunner};

/// The number of members that leaves are drawn from: fewer than the leaves, so that some occur twice.
const MEMBERS: u32 = 10;

/// Runs `cases` random cases from a seed. Returns how many events were sent and how many times a group ended.
pub(crate) fn run(cases: u32, seed: u64) -> (u64, u64) {
    let config = ProptestConfig {
        cases,
        rng_seed: RngSeed::Fixed(seed),
        failure_persistence: None,
        ..ProptestConfig::default()
    };
    let (events, outcomes) = (std::cell::Cell::new(0), std::cell::Cell::new(0));
    let result = TestRunner::new(config).run(&(spec(), vec(any::<u16>(), 1..60)), |(spec, word)| {
        let (sent, ended) = follow(&spec, &word).map_err(TestCaseError::fail)?;
        events.set(events.get() + sent);
        outcomes.set(outcomes.get() + ended);
        Ok(())
    });
    if let Err(failure) = result {
        panic!("{failure}");
    }
    (events.get(), outcomes.get())
}

pub(crate) fn spec() -> impl Strategy<Value = Spec> {
    let declared =
        prop_oneof![4 => Just(Declared::Task), 2 => Just(Declared::Service), 1 => Just(Declared::ServiceGroup)];
    (term(), vec(declared, MEMBERS as usize)).prop_map(|(mut term, declared)| {
        number(&mut term);
        Spec { term, declared }
    })
}

pub(crate) fn term() -> impl Strategy<Value = Term> {
    unscoped().prop_map(|mut term| {
        scope(&mut term, 0);
        term
    })
}

/// Lets each name stand for a value that is kept around it.
fn scope(term: &mut Term, around: usize) {
    let mut inside = around;
    if let Term::Named(name, _) = term {
        *name = format!("p{around}");
        inside += 1;
    }
    if let Term::WithName(name, e) = term {
        match name.parse::<usize>().expect("a number of a test").checked_rem(around) {
            Some(number) => *name = format!("p{number}"),
            None => *term = Term::With(b"shelf".to_vec(), e.clone()),
        }
    }
    term.parts_mut().into_iter().for_each(|part| scope(part, inside));
}

fn unscoped() -> impl Strategy<Value = Term> {
    let leaf = prop_oneof![
        20 => (0..MEMBERS).prop_map(|member| Term::Leaf(member, vec![member])),
        1 => (0..MEMBERS).prop_map(|member| Term::Leaf(member, vec![])),
        1 => Just(Term::Skip),
        1 => Just(Term::Never),
        1 => Just(Term::Fail("f".into())),
        1 => Just(Term::Fail("the deadline `x` has passed".into())),
        2 => Just(Term::Wait(0)),
    ];
    leaf.prop_recursive(5, 12, 4, |inner| {
        let pair = || (inner.clone(), inner.clone()).prop_map(|(e, f)| (Box::new(e), Box::new(f)));
        let several = || vec(inner.clone(), 2..5);
        prop_oneof![
            2 => pair().prop_map(|(e, f)| Term::Seq(e, f)),
            2 => pair().prop_map(|(e, f)| Term::Cond(e, f)),
            2 => pair().prop_map(|(e, f)| Term::Rec(e, f)),
            2 => pair().prop_map(|(e, f)| Term::Else(e, f)),
            2 => pair().prop_map(|(e, f)| Term::Fin(e, f)),
            1 => inner.clone().prop_map(|e| Term::Tag(TAGS[0].to_owned(), Box::new(e))),
            2 => (given(), inner.clone()).prop_map(|(value, e)| Term::With(value, Box::new(e))),
            2 => inner.clone().prop_map(|e| Term::Named(String::new(), Box::new(e))),
            3 => (0..4_usize, inner.clone()).prop_map(|(number, e)| Term::WithName(number.to_string(), Box::new(e))),
            2 => (inner.clone(), several(), causes(), any::<bool>()).prop_map(|(e, es, causes, has_else)| catch(e, es, &causes, has_else)),
            2 => (1..3_usize, inner.clone()).prop_map(|(k, e)| Term::Repeat(TAGS[..k].iter().map(|&tag| tag.to_owned()).collect(), Box::new(e))),
            3 => several().prop_map(Term::Par),
            3 => several().prop_map(Term::Dis),
            1 => several().prop_map(Term::Ff),
            1 => (several(), 1..5_usize).prop_map(|(es, k)| Term::Any(k.min(es.len()), es)),
            2 => (several(), 1..5_usize).prop_map(|(es, k)| Term::Least(k.min(es.len()), es)),
            2 => (several(), any::<bool>()).prop_map(|(es, has_else)| Term::Match(arms(es, has_else))),
            2 => several().prop_map(|mut es| Term::Arec(Box::new(es.remove(0)), es)),
            2 => (resources(), inner.clone()).prop_map(|(taken, e)| Term::Using(0, taken, Box::new(e))),
            1 => (any::<bool>(), inner).prop_map(|(b, e)| Term::Shield(b.then_some(0), Box::new(e))),
        ]
    })
}

fn arms(es: Vec<Term>, has_else: bool) -> Vec<(Option<String>, Term)> {
    let tags = TAGS.iter().map(|&tag| Some(tag.to_owned()));
    let mut arms: Vec<_> = tags.zip(es).collect();
    if let (true, Some(last)) = (has_else, arms.last_mut()) {
        last.0 = None;
    }
    arms
}

fn catch(e: Term, es: Vec<Term>, causes: &[Asked], has_else: bool) -> Term {
    let mut arms: Vec<_> = causes.iter().cloned().map(Some).zip(es).collect();
    if let (true, Some(last)) = (has_else, arms.last_mut()) {
        last.0 = None;
    }
    Term::Catch(Box::new(e), arms)
}

/// Different failures, in any order.
fn causes() -> impl Strategy<Value = Vec<Asked>> {
    let all = vec![
        Asked::Reported,
        Asked::Busy,
        Asked::Unconfirmed,
        Asked::ServiceEnded,
        Asked::NoMatch,
        Asked::Timeout,
        Asked::Crash,
        Asked::HostLost,
        Asked::Text("f".into()),
        Asked::Text("a round of a loop took no time".into()),
    ];
    proptest::sample::subsequence(all, 1..=4).prop_shuffle()
}

/// A value without a tag, or with one, which a `match` looks at.
fn given() -> impl Strategy<Value = Vec<u8>> {
    prop_oneof![Just(b"shelf".to_vec()), Just([b"\x01".as_slice(), TAGS[0].as_bytes()].concat()), Just(vec![])]
}

/// One or two of three things, so that many wait for each other.
fn resources() -> impl Strategy<Value = Vec<String>> {
    proptest::sample::subsequence(vec!["r", "s", "t"], 1..=2)
        .prop_map(|taken| taken.into_iter().map(str::to_owned).collect())
}

/// Follows a word, whose numbers choose among the events of the present state, through both interpreters, then stops
/// the group and answers for its leaves.
fn follow(spec: &Spec, word: &[u16]) -> Result<(u64, u64), String> {
    let program = Program::compile(&spec.group());
    let mut pair = Pair::new(spec, &program);
    let (mut sent, mut ended) = (0, 0);
    pair.send(&Event::Start(b"first".to_vec()))?;
    for &choice in word {
        let event = choose(&pair, usize::from(choice));
        ended += u64::from(pair.send(&event)?.is_some());
        sent += 1;
    }
    sent += converge(pair)?;
    Ok((sent, ended))
}

/// Reports of failures: nothing, a text, a limit, and the reasons without a text.
fn reports() -> [Vec<u8>; 10] {
    let text = |text: &str| [&[u8::try_from(text.len()).expect("a short text")], text.as_bytes()].concat();
    let marks = [vec![0, 1], vec![0, 2], vec![0, 3], vec![0, 4], vec![0, 5]];
    let [a, b, c, d, e] = marks;
    [vec![], b"0".to_vec(), text("f"), text("g"), text("the deadline `x` has passed"), a, b, c, d, e]
}

/// Most choices move the group on; of 16, one is a stop, two are unexpected events.
fn choose(pair: &Pair<'_>, choice: usize) -> Event {
    let (kind, which) = (choice % 16, choice / 16);
    let moving: Vec<Event> = pair.events().into_iter().filter(|event| *event != Event::Stop).collect();
    let mut events = match kind {
        0 => vec![Event::Stop],
        1 | 2 => pair.events_stale(),
        _ if pair.state.is_idle() => vec![Event::Start(vec![])],
        _ => moving,
    };
    let mut event = events.swap_remove(which % events.len());
    if let Event::Done(_, _, value) = &mut event
        && which.is_multiple_of(3)
    {
        value.clear();
    }
    if let Event::Aborted(_, _, report) = &mut event {
        *report = reports()[which % reports().len()].clone();
    }
    event
}

#[test]
fn random_expressions_agree() {
    let (events, outcomes) = run(20_000, 1);
    assert!(
        events > 500_000 && outcomes > 100_000,
        "the words must get somewhere: {events} events, {outcomes} outcomes"
    );
}
