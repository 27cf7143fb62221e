use super::*;
use proptest::prelude::*;
use std::collections::BTreeSet;

const NOW: Time = Time::ZERO;

fn inbox(limit: usize) -> PortInbox<u64> {
    PortInbox::new([("speech".to_owned(), limit)])
}

fn value(text: u8, priority: u8) -> Offer<u64> {
    Offer { port: 0, value: vec![text], priority, receipt: None }
}

fn message(number: u64, priority: u8, way: u64) -> Offer<u64> {
    let receipt = Some(Expected { id: MessageId { life: 1, number }, way });
    Offer { receipt, ..value(0, priority) }
}

#[test]
fn the_highest_priority_goes_first_and_the_last_one_gives_way() {
    let mut inbox = inbox(2);
    for (text, priority) in [(1, 0), (2, 5), (3, 5), (4, 9)] {
        assert_eq!(inbox.offer(NOW, value(text, priority)), []);
    }
    let taken: Vec<PortMessage> = std::iter::from_fn(|| inbox.next_for_node()).collect();
    let texts: Vec<(u8, u64)> = taken.iter().map(|message| (message.value[0], message.lost)).collect();
    assert_eq!(texts, [(4, 2), (2, 0)], "the node is told of both losses, once");
}

#[test]
fn a_receipt_says_what_the_node_has_said() {
    let mut inbox = inbox(1);
    assert_eq!(inbox.offer(NOW, message(1, 0, 10)), []);
    let handed = inbox.next_for_node().expect("one message waits");
    assert!(handed.has_receipt);
    assert_eq!(inbox.offer(NOW, message(1, 0, 11)), [], "it is on its way");
    let accepted = |way| Given { way, receipt: Receipt::Accepted };
    assert_eq!(inbox.fate(NOW, handed.number, MessageFate::Taken), Some(accepted(11)));
    assert_eq!(inbox.offer(NOW, message(1, 0, 12)), [accepted(12)], "it was taken before");
    assert_eq!(inbox.fate(NOW, handed.number, MessageFate::Taken), None);
    // A rejected message may be sent again.
    for (way, fate, why) in
        [(20, MessageFate::Full, Rejected::Full { capacity: 1 }), (21, MessageFate::Idle, Rejected::Idle)]
    {
        assert_eq!(inbox.offer(NOW, message(2, 0, way)), []);
        let number = inbox.next_for_node().expect("one message waits").number;
        let given = Given { way, receipt: Receipt::Rejected(why) };
        assert_eq!(inbox.fate(NOW, number, fate), Some(given));
    }
}

proptest! {
    /// Compared with a list of all messages: each is taken once, or refused to its sender, or it is a lost value and
    /// is counted.
    #[test]
    fn no_message_is_taken_twice_or_vanishes(
        steps in prop::collection::vec((0_u8..4, 1_u64..30, 0_u8..3), 1..200)
    ) {
        let mut inbox = inbox(3);
        let (mut handed, mut taken, mut accepted, mut values) = (Vec::new(), Vec::new(), BTreeSet::new(), 0_u64);
        let mut open: BTreeMap<u64, u64> = BTreeMap::new();
        let (mut way, mut values_taken, mut lost_before, mut ways) = (0, 0_u64, 0, BTreeMap::new());
        for (what, number, priority) in steps {
            let mut given: Vec<Given<u64>> = Vec::new();
            match what {
                0 => {
                    way += 1;
                    ways.insert(way, number);
                    open.insert(number, way);
                    let offer = Offer { value: vec![u8::try_from(number).unwrap()], ..message(number, priority, way) };
                    given.extend(inbox.offer(NOW, offer));
                }
                1 => {
                    values += 1;
                    given.extend(inbox.offer(NOW, value(0, priority)));
                }
                2 => {
                    let next = inbox.next_for_node();
                    lost_before += next.as_ref().map_or(0, |message| message.lost);
                    handed.extend(next);
                }
                _ if handed.is_empty() => {}
                _ => {
                    let message: PortMessage = handed.remove(0);
                    let fate = if number % 3 == 0 { MessageFate::Full } else { MessageFate::Taken };
                    match (message.has_receipt, fate) {
                        (false, _) => values_taken += 1,
                        (true, MessageFate::Taken) => taken.push(message.value[0]),
                        (true, MessageFate::Full | MessageFate::Idle) => {}
                    }
                    given.extend(inbox.fate(NOW, message.number, fate));
                }
            }
            for Given { way, receipt } in given {
                let number = ways[&way];
                if receipt == Receipt::Accepted {
                    accepted.insert(u8::try_from(number).unwrap());
                }
                if open.get(&number) == Some(&way) {
                    open.remove(&number);
                }
            }
            prop_assert!(inbox.handed.len() <= HANDED_MAX && inbox.waiting.len() <= 3);
        }
        let once: BTreeSet<u8> = taken.iter().copied().collect();
        prop_assert_eq!(once.len(), taken.len(), "each is taken once");
        prop_assert_eq!(&once, &accepted);
        let still = inbox.waiting.values().chain(inbox.handed.values());
        let (with, without): (Vec<_>, Vec<_>) = still.partition(|offer| offer.receipt.is_some());
        prop_assert_eq!(with.len(), open.len(), "the others wait, or were told no");
        let lost = inbox.ports[0].lost + lost_before;
        prop_assert_eq!(values, values_taken + lost + u64::try_from(without.len()).unwrap());
    }
}
