//! The exact bytes of each message. If one of these tests fails, the version of the messages has to be increased.

use super::super::fencing::Refusal;
use super::super::header::{Malformed, sample};
use super::super::queue::Rejected;
use super::*;
use crate::logic::codec::{decode, encode};

fn check<T: Enveloped + PartialEq + std::fmt::Debug>(message: &T, golden: &str) {
    let bytes = encode(message).unwrap();
    let hex: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
    assert_eq!(hex, golden, "{message:?}");
    assert_eq!(decode::<T>(&bytes).as_ref(), Ok(message));
}

fn counters() -> QueueCounters {
    QueueCounters { depth: 1, depth_max: 2, accepted: 3, taken: 4, dropped: 5, rejected: 6, repeated: 7 }
}

#[test]
fn golden_queues() {
    let mut message = sample(300, 2, 5);
    message.header.category = "m".into();
    message.header.sender = "s".into();
    message.header.recipient = "r".into();
    message.header.marker = 9;
    (message.fence, message.data, message.type_name) = (Some(4), vec![1, 2], "T".into());
    check(&QueueRequest::Put(message), "44430100140000016dac020201730172050901540104020102");
    check(&QueueRequest::Look, "44430100140001");
    let answer = |rejected| QueueAnswer::Receipt(Receipt::Rejected(rejected));
    check(&QueueAnswer::Receipt(Receipt::Accepted), "4443010015000000");
    check(&answer(Rejected::Full { capacity: 300 }), "444301001500000100ac02");
    check(&answer(Rejected::WrongType { expected: "A".into(), found: "B".into() }), "44430100150000010101410142");
    check(&answer(Rejected::Malformed(Malformed::Name { part: "p".into(), size: 3 })), "44430100150000010200017003");
    check(&answer(Rejected::Malformed(Malformed::Data { size: 3, size_max: 2 })), "444301001500000102010302");
    check(&answer(Rejected::Malformed(Malformed::Number)), "44430100150000010202");
    check(&answer(Rejected::TooOld), "444301001500000103");
    check(&answer(Rejected::Senders), "444301001500000104");
    check(&answer(Rejected::Fenced(Refusal::NoLock)), "44430100150000010500");
    check(&answer(Rejected::Fenced(Refusal::Over { number: 1, floor: 2 })), "444301001500000105010102");
    check(&answer(Rejected::Fenced(Refusal::Unknown { number: 1 })), "4443010015000001050201");
    check(&answer(Rejected::Idle), "444301001500000106");
    for (full, golden) in [
        (Full::Reject, "44430100150001015401660800016c010203040506070161"),
        (Full::DropLowest, "44430100150001015401660801016c010203040506070161"),
        (Full::DropOldest, "44430100150001015401660802016c010203040506070161"),
    ] {
        let (type_name, fields, lock, counters) = ("T".into(), "f".into(), "l".into(), counters());
        let last_sender = "a".into();
        let status = QueueStatus { type_name, fields, capacity: 8, full, lock, counters, last_sender };
        check(&QueueAnswer::Status(status), golden);
    }
}

#[test]
fn golden_routers() {
    let filter = || Filter { category: Some("c".into()), sender: None, priority_min: Some(3), marker: Some(300) };
    let queue = || "q".to_owned();
    check(
        &RouterRequest::Subscribe { queue: queue(), type_name: "T".into(), filters: vec![filter()] },
        "44430100160000017101540101016300010301ac02",
    );
    check(&RouterRequest::Unsubscribe { queue: queue() }, "444301001600010171");
    check(&RouterRequest::Look, "44430100160002");
    check(&RouterAnswer::Subscribed { is_known: true, lost: 300 }, "4443010017000001ac02");
    check(&RouterAnswer::Unsubscribed, "44430100170001");
    check(&RouterAnswer::Refused(RouterRefusal::Full { max: 1 }), "444301001700020001");
    check(
        &RouterAnswer::Refused(RouterRefusal::WrongType { sent: "A".into(), taken: "B".into() }),
        "444301001700020101410142",
    );
    check(&RouterAnswer::Refused(RouterRefusal::Filters { max: 1, size_max: 2 }), "44430100170002020102");
    let subscriber = SubscriberStatus {
        queue: queue(),
        filters: vec![filter()],
        matched: 1,
        delivered: 2,
        lost: 3,
        refused: 4,
        waiting: 5,
        is_unreachable: true,
    };
    let counters = RouterCounters { published: 7, dropped_subscribers: 8 };
    let (type_name, fields, subscribers) = ("T".into(), "f".into(), vec![subscriber]);
    check(
        &RouterAnswer::Status(RouterStatus { type_name, fields, counters, subscribers }),
        "444301001700030154016607080101710101016300010301ac02010203040501",
    );
}

#[test]
fn golden_locks() {
    let request = 2;
    check(&LockRequest::Acquire { client: 300, name: "n".into(), request, priority: 5 }, "44430100180000ac02016e0205");
    check(&LockRequest::Renew { client: 300, request }, "44430100180001ac0202");
    check(&LockRequest::Release { client: 300, request }, "44430100180002ac0202");
    check(&LockRequest::Look, "44430100180003");
    let (lease, left) = (Duration::from_millis(500), Duration::from_nanos(3));
    check(
        &LockAnswer::Granted { request, fence: 7, lease, left, is_wanted: true },
        "4443010019000002070080cab5ee01000301",
    );
    check(&LockAnswer::Waiting { request, ahead: 1, holder: "h".into(), lease }, "44430100190001020101680080cab5ee01");
    for (why, golden) in [
        (Denied::Expired, "444301001900020200"),
        (Denied::Preempted, "444301001900020201"),
        (Denied::Released, "444301001900020202"),
        (Denied::NotHeld, "444301001900020203"),
        (Denied::TooManyWait, "444301001900020204"),
    ] {
        check(&LockAnswer::Denied { request, why }, golden);
    }
    check(&LockAnswer::Released { request }, "4443010019000302");
    let status = LockStatus {
        holder: Some("h".into()),
        fence: Some(7),
        left: Some(left),
        lease,
        waiting: vec!["w".into()],
        counters: LockCounters { grants: 1, expired: 2, preempted: 3 },
    };
    check(&LockAnswer::Status(status), "4443010019000401016801070100030080cab5ee01010177010203");
}
