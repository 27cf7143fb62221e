//! Histories with one error each: the checker has to find exactly that one.

use super::world::history::Op::{Delete, Put, Read};
use super::world::history::{Anomaly, History, Op, Txn, check, lost_updates};

const X: u64 = 0;
const Y: u64 = 1;

/// Returns the history of these committed transactions, each with its session.
fn history(txns: &[(usize, &[Op])]) -> History {
    let txn = |(session, ops): &(usize, &[Op])| Txn { session: *session, aborted: false, ops: ops.to_vec() };
    History { txns: txns.iter().map(txn).collect(), ..History::default() }
}

fn expect(history: &History, anomalies: &[Anomaly]) {
    assert_eq!(check(history).into_iter().collect::<Vec<_>>(), anomalies);
}

#[test]
fn good_histories_are_good() {
    expect(&history(&[]), &[]);
    let concurrent: [(usize, &[Op]); 4] = [
        (0, &[Put(X, 1), Put(Y, 2)]),
        (1, &[Put(X, 3)]),
        (2, &[Read(X, Some(3)), Read(Y, Some(2))]),
        (2, &[Read(X, Some(3)), Delete(X)]),
    ];
    expect(&history(&concurrent), &[]);
    expect(&history(&[(0, &[Put(X, 1)]), (0, &[Delete(X)]), (1, &[Read(X, None)])]), &[]);
    expect(&history(&[(0, &[Put(X, 1), Read(X, Some(1)), Put(X, 2), Read(X, Some(2))])]), &[]);
}

#[test]
fn a_value_that_nobody_wrote() {
    expect(&history(&[(0, &[Read(X, Some(9))])]), &[Anomaly::ThinAirRead]);
}

#[test]
fn g1a_a_value_of_a_refused_transaction() {
    let mut history = history(&[(0, &[Put(X, 1)]), (1, &[Read(X, Some(1))])]);
    history.txns[0].aborted = true;
    expect(&history, &[Anomaly::AbortedRead]);
}

#[test]
fn g1b_a_value_that_its_writer_overwrote() {
    expect(&history(&[(0, &[Put(X, 1), Put(X, 2)]), (1, &[Read(X, Some(1))])]), &[Anomaly::IntermediateRead]);
}

#[test]
fn a_transaction_that_does_not_see_its_own_write() {
    expect(&history(&[(0, &[Put(X, 1)]), (0, &[Put(X, 2), Read(X, Some(1))])]), &[Anomaly::Internal]);
    expect(&history(&[(0, &[Delete(X), Read(X, Some(1))]), (1, &[Put(X, 1)])]), &[Anomaly::Internal]);
}

#[test]
fn g0_two_that_overwrote_each_other() {
    let mut history = history(&[(0, &[Put(X, 1), Put(Y, 1)]), (1, &[Put(X, 2), Put(Y, 2)])]);
    history.replaced = [(X, 1, 2), (Y, 2, 1)].into();
    expect(&history, &[Anomaly::DirtyWrite, Anomaly::CircularInformation]);
}

#[test]
fn g1c_one_sees_what_it_was_overwritten_by() {
    let mut history = history(&[(0, &[Put(X, 1), Put(Y, 1)]), (1, &[Read(X, Some(1)), Put(Y, 2)])]);
    history.replaced = [(Y, 2, 1)].into();
    expect(&history, &[Anomaly::CircularInformation]);
}

#[test]
fn half_of_a_transaction() {
    let mut history =
        history(&[(0, &[Put(Y, 1)]), (1, &[Put(X, 2), Put(Y, 2)]), (2, &[Read(X, Some(2)), Read(Y, Some(1))])]);
    expect(&history, &[]);
    history.replaced = [(Y, 1, 2)].into();
    expect(&history, &[Anomaly::FracturedRead]);
}

#[test]
fn sessions_go_forward_only() {
    let mut wrote = history(&[(0, &[Put(X, 1)]), (1, &[Put(X, 2)]), (1, &[Read(X, Some(1))])]);
    wrote.replaced = [(X, 1, 2)].into();
    expect(&wrote, &[Anomaly::ReadYourWrites]);
    let mut read = history(&[(0, &[Put(X, 1)]), (1, &[Put(X, 2)]), (2, &[Read(X, Some(2))]), (2, &[Read(X, Some(1))])]);
    read.replaced = [(X, 1, 2)].into();
    expect(&read, &[Anomaly::MonotonicReads]);
    let mut writes = history(&[(0, &[Put(X, 1)]), (0, &[Put(X, 2)])]);
    writes.replaced = [(X, 2, 1)].into();
    expect(&writes, &[Anomaly::MonotonicWrites]);
    let mut follows = history(&[(0, &[Put(X, 1)]), (1, &[Read(X, Some(1))]), (1, &[Put(X, 2)])]);
    follows.replaced = [(X, 2, 1)].into();
    expect(&follows, &[Anomaly::WritesFollowReads]);
}

#[test]
fn what_was_behind_a_deletion_that_gave_way() {
    let seen = |deletion: &[Op]| {
        let reads = [Read(X, Some(1))];
        let txns: [(usize, &[Op]); 5] = [(0, &[Put(X, 1)]), (1, &[Put(X, 2)]), (2, deletion), (1, &reads), (1, &reads)];
        History { replaced: [(X, 1, 2)].into(), brought: [X].into(), ..history(&txns) }
    };
    expect(&seen(&[Delete(X)]), &[]);
    expect(&History { brought: [Y].into(), ..seen(&[Delete(X)]) }, &[Anomaly::ReadYourWrites]);
    expect(&seen(&[Read(X, Some(1)), Delete(X)]), &[Anomaly::ReadYourWrites]);
    expect(&seen(&[]), &[Anomaly::ReadYourWrites]);
}

#[test]
fn causes_in_a_circle() {
    let history = history(&[(0, &[Read(X, Some(2))]), (0, &[Put(Y, 1)]), (1, &[Read(Y, Some(1))]), (1, &[Put(X, 2)])]);
    expect(&history, &[Anomaly::CyclicCo]);
}

#[test]
fn what_the_own_past_has_overwritten() {
    let history = history(&[
        (0, &[Put(X, 1)]),
        (1, &[Read(X, Some(1)), Put(X, 2), Put(Y, 2)]),
        (2, &[Read(Y, Some(2))]),
        (2, &[Read(X, Some(1))]),
    ]);
    expect(&history, &[Anomaly::WriteCoRead]);
}

#[test]
fn nothing_where_the_own_past_has_something() {
    let txns: [(usize, &[Op]); 4] =
        [(0, &[Put(X, 1)]), (0, &[Put(Y, 1)]), (1, &[Read(Y, Some(1))]), (1, &[Read(X, None)])];
    expect(&history(&txns), &[Anomaly::WriteCoInitRead]);
    let mut deleted = history(&txns);
    deleted.txns.push(Txn { session: 2, aborted: false, ops: vec![Delete(X)] });
    expect(&deleted, &[]);
    deleted.txns.insert(0, Txn { session: 0, aborted: false, ops: vec![Delete(X)] });
    deleted.txns.pop();
    expect(&deleted, &[Anomaly::WriteCoInitRead]);
}

#[test]
fn two_updates_of_one_value() {
    let update = |value| [Read(X, Some(1)), Put(X, value)];
    let history = history(&[(0, &[Put(X, 1)]), (1, &update(2)), (2, &update(3)), (3, &[Read(X, Some(1)), Put(Y, 4)])]);
    expect(&history, &[]);
    assert_eq!(lost_updates(&history), [(1, 2, X)]);
}
