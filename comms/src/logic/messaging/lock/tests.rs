mod schedules;

use super::*;

fn settings() -> LockSettings {
    LockSettings { lease: Duration::from_millis(100), preempt_after: Some(Duration::from_millis(20)), waiting_max: 2 }
}

fn at(ms: u64) -> Time {
    Time::ZERO + Duration::from_millis(ms)
}

fn acquire(client: u64, request: u64, priority: u8) -> LockInput {
    LockInput::Request(LockRequest::Acquire { client, name: client.to_string(), request, priority })
}

/// Handles an input like a server with a fast disk; returns the answers.
fn handle(lock: &mut ResourceLock, now: Time, input: LockInput) -> Vec<(u64, LockAnswer)> {
    let (mut effects, mut answers) = (Vec::new(), Vec::new());
    lock.handle(now, input, &mut effects);
    while let Some(effect) = effects.pop() {
        match effect {
            LockEffect::Persist(number) => lock.handle(now, LockInput::Persisted(number), &mut effects),
            LockEffect::Answer { client, answer } => answers.push((client, answer)),
        }
    }
    answers
}

fn granted(request: u64, fence: u64, left: u64, is_wanted: bool) -> LockAnswer {
    let (lease, left) = (Duration::from_millis(100), Duration::from_millis(left));
    LockAnswer::Granted { request, fence, lease, left, is_wanted }
}

#[test]
fn the_next_one_gets_it_when_the_lease_is_over() {
    let mut lock = ResourceLock::new(settings(), 1, at(0));
    assert!(handle(&mut lock, at(0), acquire(7, 1, 0)).contains(&(7, granted(1, 1, 100, false))));
    assert!(matches!(handle(&mut lock, at(10), acquire(8, 1, 0))[..], [(8, LockAnswer::Waiting { ahead: 0, .. })]));
    assert_eq!((lock.admit(at(20), Some(1)), lock.deadline()), (Ok(()), Some(at(100))));
    // A waiting client that does not ask again within a lease is removed. Client 8 asks again.
    handle(&mut lock, at(60), acquire(8, 1, 0));
    assert_eq!(handle(&mut lock, at(99), LockInput::Tick), []);
    assert_eq!(handle(&mut lock, at(100), LockInput::Tick), [(8, granted(1, 2, 100, false))]);
    assert_eq!(lock.admit(at(100), Some(1)), Err(Refusal::Over { number: 1, floor: 2 }));
    assert_eq!(lock.admit(at(100), Some(2)), Ok(()));
    let renew = LockInput::Request(LockRequest::Renew { client: 7, request: 1 });
    let expired = LockAnswer::Denied { request: 1, why: Denied::Expired };
    assert_eq!(handle(&mut lock, at(101), renew), [(7, expired.clone())]);
    // The answer is the same if this request comes a second time.
    assert_eq!(handle(&mut lock, at(102), acquire(7, 1, 9)), [(7, expired)]);
    let status = lock.status(at(150));
    assert_eq!((status.holder.as_deref(), status.fence, status.counters.expired), (Some("8"), Some(2), 1));
    assert_eq!((status.left, status.waiting), (Some(Duration::from_millis(50)), Vec::<String>::new()));
}

#[test]
fn it_is_given_by_priority_and_taken_away_where_that_is_declared() {
    let mut lock = ResourceLock::new(settings(), 1, at(0));
    handle(&mut lock, at(0), acquire(1, 1, 5));
    handle(&mut lock, at(1), acquire(2, 1, 5));
    assert!(matches!(handle(&mut lock, at(2), acquire(3, 1, 6))[..], [(3, LockAnswer::Waiting { ahead: 0, .. })]));
    let too_many = LockAnswer::Denied { request: 1, why: Denied::TooManyWait };
    assert_eq!(handle(&mut lock, at(2), acquire(4, 1, 9)), [(4, too_many)]);
    // The holder is told that it is preempted, and has 20 ms.
    let renew = |request| LockInput::Request(LockRequest::Renew { client: 1, request });
    assert_eq!(handle(&mut lock, at(12), renew(1)), [(1, granted(1, 1, 10, true))]);
    assert_eq!((lock.admit(at(21), Some(1)), lock.deadline()), (Ok(()), Some(at(22))));
    assert_eq!(handle(&mut lock, at(22), LockInput::Tick), [(3, granted(1, 2, 100, false))]);
    let preempted = LockAnswer::Denied { request: 1, why: Denied::Preempted };
    assert_eq!(handle(&mut lock, at(23), renew(1)), [(1, preempted)]);
    let release = LockInput::Request(LockRequest::Release { client: 3, request: 1 });
    let released = (3, LockAnswer::Released { request: 1 });
    let answers = handle(&mut lock, at(24), release);
    assert!(answers.contains(&released) && answers.contains(&(2, granted(1, 3, 100, false))), "{answers:?}");
    let mut kept = ResourceLock::new(LockSettings { preempt_after: None, ..settings() }, 1, at(0));
    handle(&mut kept, at(0), acquire(1, 1, 5));
    handle(&mut kept, at(1), acquire(3, 1, 6));
    assert_eq!(handle(&mut kept, at(60), renew(1)), [(1, granted(1, 1, 100, false))]);
    assert_eq!(kept.status(at(60)).counters.preempted, 0);
}

#[test]
fn a_server_that_was_started_again_waits_for_a_lease_and_counts_on() {
    let mut lock = ResourceLock::new(settings(), 65, at(1000));
    assert!(matches!(handle(&mut lock, at(1000), acquire(1, 1, 0))[..], [(1, LockAnswer::Waiting { .. })]));
    assert_eq!(lock.admit(at(1000), Some(64)), Err(Refusal::Over { number: 64, floor: 65 }));
    assert_eq!(lock.deadline(), Some(at(1100)));
    let renew = LockInput::Request(LockRequest::Renew { client: 9, request: 4 });
    let unknown = LockAnswer::Denied { request: 4, why: Denied::NotHeld };
    assert_eq!(handle(&mut lock, at(1001), renew), [(9, unknown)]);
    handle(&mut lock, at(1050), acquire(1, 1, 0));
    assert_eq!(handle(&mut lock, at(1100), LockInput::Tick), [(1, granted(1, 65, 100, false))]);
}

#[test]
fn nothing_is_granted_that_is_not_on_the_disk() {
    let mut lock = ResourceLock::new(settings(), 1, at(0));
    let mut effects = Vec::new();
    lock.handle(at(0), acquire(1, 1, 0), &mut effects);
    assert_eq!(effects[0], LockEffect::Persist(65));
    assert!(matches!(effects[1..], [LockEffect::Answer { answer: LockAnswer::Waiting { .. }, .. }]));
    assert_eq!(lock.held(at(1)), None);
    effects.clear();
    lock.handle(at(2), LockInput::Persisted(65), &mut effects);
    assert_eq!(effects, [LockEffect::Answer { client: 1, answer: granted(1, 1, 100, false) }]);
    assert_eq!(lock.held(at(2)), Some(1));
}
