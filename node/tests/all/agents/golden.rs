//! The bytes of messages between nodes about a deployment that changes while it runs, and about revocations. If one of
//! the tests fails, `WIRE_VERSION` has to go up.

use comms::logic::switch::{Expect, Flip, Opening};
use comms::logic::time::Time;
use language::algebra::{Event, StepRecord, Value};
use node::logic::protocol::{
    Answer, Body, Change, ChangeOrder, ChangeReply, LeafFacts, Message, Report, Request, SetsSwitched, SwitchRequest,
    ToCoordinator, ToParticipant,
};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::fmt::Debug;
use std::time::Duration;

fn check<T: Serialize + DeserializeOwned + PartialEq + Debug>(message: &T, golden: &str) {
    let bytes = postcard::to_stdvec(message).expect("it can be written");
    let hex: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
    assert_eq!(hex, golden, "{message:?}");
    assert_eq!(postcard::from_bytes::<T>(&bytes).as_ref(), Ok(message));
}

fn facts() -> Vec<LeafFacts> {
    vec![LeafFacts { owns: vec!["arm".into()], needs: vec!["ft".into()], signals: true, ..LeafFacts::plain(300) }]
}

#[test]
fn golden_revocations() {
    check(&Request::Revocations(vec![vec![7]]), "1d010107");
    check(&Answer::Revocations(vec![vec![7]]), "17010107");
}

#[test]
fn golden_inquiries() {
    check(&Message::about_none(Body::Inquiry { number: 300 }), "000007ac02");
    check(&Message::about_none(Body::Reported { number: 300 }), "000008ac02");
    check(&Message::about_none(Body::CheckIn { number: 300 }), "000009ac02");
    check(&Message::about_none(Body::CheckedIn { number: 300 }), "00000aac02");
    check(&Answer::Behind(vec!["c2".into()]), "1801026332");
}

#[test]
fn golden_changes() {
    check(&ChangeOrder::Link { number: 300 }, "02ac02");
    check(&ChangeOrder::LinkAlso { number: 300, facts: facts() }, "05ac0201ac0200010361726d0102667401");
    check(&ChangeReply::Applied { number: 300 }, "01ac02");
    check(&ChangeReply::Joined { number: 300, facts: facts() }, "05ac0201ac0200010361726d0102667401");
    let step = StepRecord { event: Event::Start(Value::new(&[7])), commands: vec![], outcome: None, is_cut: true };
    let stepped = ToCoordinator::Stepped { group: 1, number: 300, steps: vec![step], changes: 2 };
    check(&stepped, "0801ac0201000101070000000102");
}

#[test]
fn golden_aligned_starts() {
    let [asked, shown] = [300, 3].map(Time::from_nanos);
    check(&ToParticipant::ReadClock { asked }, "1aac02");
    check(&ToParticipant::GoAt { start: asked }, "1bac02");
    check(&ToCoordinator::ClockRead { asked, shown }, "0aac0203");
    let (lead, within) = (Duration::new(0, 300), Duration::new(3, 4));
    check(&Report::Aligned { lead, within }, "0d00ac020304");
    check(&ToCoordinator::BeganLate { by: within }, "0b0304");
    check(&Report::BeganLate { host: "c2".into(), by: within }, "0e0263320304");
}

#[test]
fn golden_switches() {
    let flip = Flip { generation: 300, close: vec![3], open: vec![Opening { wire: 4, after: vec![3] }] };
    check(&ToParticipant::Flip { group: 1, generation: 300, flip }, "1201ac02ac02010301040103");
    let expect = Expect { generation: 300, close: vec![3], open: vec![4] };
    check(&ToParticipant::Expect { group: 1, leaf: 2, expect }, "130102ac0201030104");
    check(&ToParticipant::Expecting { group: 1, leaf: 2, generation: 300 }, "140102ac02");
    let (lost, late, missing) = (300, 1, vec![4]);
    check(&ToParticipant::Taken { group: 1, leaf: 2, generation: 300, lost, late, missing }, "150102ac02ac02010104");
    check(&ToParticipant::SwitchSets { group: 1, slot: 2, sets: vec![3], call: 300 }, "1601020103ac02");
    let flip = Flip { generation: 300, close: vec![5], open: vec![] };
    let expect = Expect { generation: 300, close: vec![3], open: vec![] };
    check(&ToParticipant::ExpectAnd { group: 1, leaf: 2, expect, then: flip }, "170102ac02010300ac02010500");
    check(&ToParticipant::Succeed { group: 1, leaf: 2, activation: 300, value: vec![7] }, "180102ac020107");
    check(&ToParticipant::Succeeding { group: 1, leaf: 2, is_handed_over: true }, "19010201");
    check(&ToParticipant::Repeat { wires: vec![3, 300] }, "1d0203ac02");
    let switched = || SetsSwitched {
        closed: vec!["a".into()],
        opened: vec!["b".into()],
        took: Duration::new(3, 4),
        lost: 300,
        late: 1,
        unconfirmed: vec!["m".into()],
    };
    check(&ToCoordinator::SetsSwitched { call: 300, switched: Ok(switched()) }, "09ac02000101610101620304ac020101016d");
    check(&ToCoordinator::SetsSwitched { call: 300, switched: Err("x".into()) }, "09ac02010178");
    check(&Change::Switched(switched()), "0e0101610101620304ac020101016d");
    check(&Answer::Switched(Err("x".into())), "13010178");
    let request = SwitchRequest { name: "d".into(), process: "m".into(), labels: vec!["a".into()] };
    check(&request, "0164016d010161");
}
