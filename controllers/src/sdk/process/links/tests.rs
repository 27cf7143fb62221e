//! The links of programs, over sockets of this machine.

use super::super::wire::fetch_all;
use super::*;
use crate::sdk::controller::About;
use crate::sdk::interface::PortInterface;
use comms::io::clock::Wakeup;
use comms::io::data::Priority;
use comms::io::session::Reach;
use comms::logic::key;
use comms::logic::switch::Arrival;
use std::borrow::Cow;
use std::io::{Read, Write};
use std::net::Shutdown;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicU64;
use std::sync::mpsc::{Receiver, sync_channel};

const LONG: Duration = Duration::from_secs(20);

/// Returns the interface of a program with the output `Out`.
fn interface() -> Interface {
    let ports = vec![PortInterface::wire("Out", Direction::Out, "Number")];
    let (exports, calls, inner) = Default::default();
    Interface { type_name: "Source", about: About::service("Sends numbers."), ports, exports, calls, inner }
}

/// Eight producers that do not answer take as long as one.
#[test]
fn pulls_have_one_deadline_together() {
    let folder = std::env::temp_dir().join(format!("dca-pulls-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let open = |name: &str| Arc::new(DataSession::open(&folder.join(name), Reach::Host).unwrap());
    let (producer, consumer) = (open("p.sock"), open("c.sock"));
    let keys: Vec<String> = (0..8).map(|wire| key::wire("pulls", 1, wire)).collect();
    let (release, held) = sync_channel::<()>(0);
    let held = Arc::new(Mutex::new(held));
    let silent = |key: &String| {
        let held = Arc::clone(&held);
        producer.answer(key, move || held.lock().unwrap().recv().ok().map(|()| Vec::new())).unwrap()
    };
    let responders: Vec<_> = keys.iter().map(silent).collect();
    // Earlier declarations are known as soon as this publisher is known.
    let publisher = consumer.publisher(&key::wire("pulls", 1, 99), Priority::Wire).unwrap();
    let subscriptions = producer.on_sample(&key::wire("pulls", 1, 99), |_| ()).unwrap();
    let location = producer.location();
    consumer.dial(&Dial { session: location.session, locators: location.local }, LONG).unwrap();
    assert!(publisher.wait_heard(LONG));
    let fetch = |key: String| Arc::new(Fetch::new("In", key, Arc::clone(&consumer), None));
    let fetches: Vec<_> = keys.into_iter().map(fetch).collect();
    let (began, within) = (now(), Duration::from_millis(500));
    let got = fetch_all(&fetches, within);
    let took = now() - began;
    assert_eq!(got, []);
    assert!(took >= within && took < within * 4, "{took:?}");
    drop((release, subscriptions, responders, publisher));
    std::fs::remove_dir_all(&folder).unwrap();
}

/// A round trip that takes longer than the wait for an answer. Each value arrives with a later call, none arrives
/// twice, and none arrives after a newer one.
#[test]
fn an_answer_that_is_late_is_taken_later() {
    let folder = std::env::temp_dir().join(format!("dca-late-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let open = |name: &str| Arc::new(DataSession::open(&folder.join(name), Reach::Host).unwrap());
    let (producer, consumer) = (open("p.sock"), open("c.sock"));
    relay(&folder.join("x.sock"), folder.join("p.sock"), Duration::from_millis(150));
    let key = key::wire("late", 1, 0);
    let count = AtomicU64::new(0);
    let number = move || count.fetch_add(1, Ordering::Relaxed);
    let _answering = producer.answer(&key, move || Some(number().to_le_bytes().to_vec())).unwrap();
    let _hearing = producer.on_sample(&key::wire("late", 1, 1), |_| ()).unwrap();
    // Earlier declarations are known as soon as the other end of this publisher is known.
    let publisher = consumer.publisher(&key::wire("late", 1, 1), Priority::Wire).unwrap();
    let locators = vec![format!("unixsock-stream/{}", folder.join("x.sock").display())];
    consumer.dial(&Dial { session: producer.location().session, locators }, LONG).unwrap();
    assert!(publisher.wait_heard(LONG));
    let fetch = Arc::new(Fetch::new("In", key, Arc::clone(&consumer), None));
    let (began, mut got) = (now(), Vec::new());
    while got.len() < 20 && now() - began < LONG {
        let values = fetch_all(std::slice::from_ref(&fetch), Duration::from_millis(20));
        got.extend(values.into_iter().map(|(_, bytes)| u64::from_le_bytes(bytes.try_into().unwrap())));
    }
    assert!(got.len() == 20 && got.is_sorted_by(|one, next| one < next), "{got:?}");
    std::fs::remove_dir_all(&folder).unwrap();
}

/// Carries connections from one socket to another, and delays every byte by `delay`. Its threads end with the test.
fn relay(at: &Path, to: PathBuf, delay: Duration) {
    let listener = UnixListener::bind(at).unwrap();
    std::thread::spawn(move || {
        for near in listener.incoming().map_while(Result::ok) {
            let far = UnixStream::connect(&to).unwrap();
            for (from, to) in [(&near, &far), (&far, &near)] {
                carry(from.try_clone().unwrap(), to.try_clone().unwrap(), delay);
            }
        }
    });
}

fn carry(mut from: UnixStream, mut to: UnixStream, delay: Duration) {
    let (sender, receiver) = sync_channel(4096);
    std::thread::spawn(move || {
        let mut bytes = vec![0; 65_536];
        while let Ok(size @ 1..) = from.read(&mut bytes)
            && sender.send((now() + delay, bytes[..size].to_vec())).is_ok()
        {}
    });
    std::thread::spawn(move || {
        for (due, bytes) in receiver {
            Wakeup::default().wait(Some(due));
            if to.write_all(&bytes).is_err() {
                break;
            }
        }
        to.shutdown(Shutdown::Both).unwrap_or_default();
    });
}

/// A program is started again, and its consumers are linked later. Each lacks the last value, and gets it once.
#[test]
fn a_consumer_that_comes_late_gets_the_last_value_once() {
    let folder = std::env::temp_dir().join(format!("dca-owed-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let open = |name: &str| DataSession::open(&folder.join(name), Reach::Host).unwrap();
    let (producer, consumer) = (open("p.sock"), open("c.sock"));
    let location = producer.location();
    consumer.dial(&Dial { session: location.session, locators: location.local }, LONG).unwrap();
    let (links, inbox, key) = (Links::default(), Arc::default(), key::wire("owed", 1, 0));
    let outgoing = Outgoing { wire: 0, port: "Out".into(), key: key.clone(), pull: false };
    let shape = Shape { latch: true, ..Shape::default() };
    let made = wire(&producer, None, &interface(), None, &outgoing, shape, &mut BTreeMap::new()).unwrap();
    links.watch(&made, &inbox);
    links.lock().wires.insert(0, made);
    let hear = || {
        let (heard_tx, heard) = sync_channel(64);
        let hear = move |arrival: Arrival<Cow<'_, [u8]>>, _: Option<_>| {
            if let Arrival::Value(bytes) = arrival {
                heard_tx.try_send(bytes.into_owned()).unwrap();
            }
        };
        (consumer.on_wire(&key, hear).unwrap(), heard)
    };
    // The loop of the producer.
    let run_until = |is_so: &dyn Fn() -> bool| {
        let until = now() + LONG;
        while !is_so() {
            assert!(now() < until, "it does not come about");
            inbox.wait(Some(now() + LONG / 1000));
            links.repeat_owed();
        }
    };
    let has_consumer = || links.lock().wires.values().all(Wire::has_consumer);
    let send = |value: &[u8]| links.send("Out", value.to_vec());
    let next = |heard: &Receiver<Vec<u8>>| heard.recv_timeout(LONG).unwrap();
    let open = vec![Opening { wire: 0, after: Vec::new() }];
    let repeat = Flip { close: vec![0], open, ..Flip::default() };

    links.switch(&[0], true);
    send(b"first");
    let (mut hearing, mut heard) = hear();
    run_until(&has_consumer);
    links.repeat_owed();
    assert_eq!(next(&heard), b"first");
    // The consumer is started again. Its node asks for the last value before or after the producer knows the consumer.
    for (round, is_early) in [true, false, true, true, false].into_iter().enumerate() {
        drop(hearing);
        run_until(&|| !has_consumer());
        let value = [u8::try_from(round).unwrap()];
        send(&value);
        if is_early {
            links.flip(&repeat);
        }
        (hearing, heard) = hear();
        run_until(&has_consumer);
        links.repeat_owed();
        if !is_early {
            links.flip(&repeat);
        }
        send(b"next");
        assert_eq!((next(&heard), next(&heard)), (value.to_vec(), b"next".to_vec()));
    }
    std::fs::remove_dir_all(&folder).unwrap();
}

/// Waits until something is so.
fn wait_until(is_so: &dyn Fn() -> bool) {
    let (wakeup, until) = (Wakeup::default(), now() + LONG);
    while !is_so() {
        assert!(now() < until, "it does not come about");
        wakeup.wait(Some(now() + LONG / 1000));
    }
}

/// A producer counts values that its consumer on another host cannot get, until the next message reaches it.
#[test]
fn values_without_a_connected_consumer_are_counted_until_it_is_told() {
    let folder = std::env::temp_dir().join(format!("dca-undelivered-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let open = |name: &str| DataSession::open(&folder.join(name), Reach::Host).unwrap();
    let path = |name: &str| DirectPath::open(&folder.join(name), None).unwrap();
    let (producer, consumer) = (open("p.sock"), open("c.sock"));
    let (near, own) = (path("p.wire"), path("c.wire"));
    let location = producer.location();
    consumer.dial(&Dial { session: location.session, locators: location.local }, LONG).unwrap();
    let (links, keys) = (Links::default(), [0, 1].map(|wire| key::wire("undelivered", 1, wire)));
    for (number, key) in (0..).zip(&keys) {
        let outgoing = Outgoing { wire: number, port: "Out".into(), key: key.clone(), pull: false };
        let (shape, memories) = (Shape::default(), &mut BTreeMap::new());
        let made = wire(&producer, Some(&near), &interface(), None, &outgoing, shape, memories).unwrap();
        links.lock().wires.insert(number, made);
    }
    let has_consumer = |wire: u32| links.lock().wires[&wire].has_consumer();
    let send = |count: usize| (0..count).for_each(|_| links.send("Out", vec![0]));
    let far = || {
        let hearing = consumer.on_wire(&keys[0], |_: Arrival<Cow<'_, [u8]>>, _: Option<_>| ()).unwrap();
        wait_until(&|| has_consumer(0));
        hearing
    };

    links.switch(&[0, 1], true);
    send(3);
    assert_eq!(links.undelivered(), [], "no consumer has come yet");
    let place = Dial { session: "p".into(), locators: vec![near.locator()] }.direct().unwrap();
    let form = agreement::form(&PortInterface::wire("In", Direction::In, "Number"));
    let inlet = own.inlet(&place, LONG, &keys[1], form, None, |_, _| ()).unwrap();
    wait_until(&|| has_consumer(1));
    let mut hearing = far();
    send(1);
    assert_eq!(links.undelivered(), []);
    // The consumer on this host ends.
    drop(inlet);
    wait_until(&|| !has_consumer(1));
    for next in ["value", "boundary"] {
        drop(hearing);
        wait_until(&|| !has_consumer(0));
        send(2);
        assert_eq!(links.undelivered(), [(0, 2)]);
        hearing = far();
        assert_eq!(links.undelivered(), [(0, 2)], "the consumer does not know of them");
        match next {
            "value" => send(1),
            _ => links.switch(&[0], false),
        }
        assert_eq!(links.undelivered(), [], "the consumer counts them after a {next}");
    }
    links.switch(&[0], true);
    drop(hearing);
    wait_until(&|| !has_consumer(0));
    send(1);
    links.switch(&[0, 1], false);
    send(1);
    assert_eq!(links.undelivered(), [(0, 1)], "closed wires send nothing");
    links.clear();
    std::fs::remove_dir_all(&folder).unwrap();
}

/// A program that is gone uses up the time of a restarted program. A producer on this host still gets a direct wire.
#[test]
fn a_program_that_is_gone_takes_no_direct_wire_away() {
    let folder = std::env::temp_dir().join(format!("dca-gone-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let path = |name: &str| DirectPath::open(&folder.join(name), None).unwrap();
    let (session, producer, own) = (DataSession::open_observer(None).unwrap(), path("p.wire"), path("c.wire"));
    let ports = ["Far", "Near"].map(|name| PortInterface::wire(name, Direction::In, "Number")).to_vec();
    let nobody = format!("unixsock-stream/{}", folder.join("nobody").display());
    let incoming = |wire: u32, port: &str, locators: &[String]| Incoming {
        wire,
        port: port.into(),
        key: key::wire("gone", 1, wire),
        producer: Dial { session: format!("a{wire}"), locators: locators.to_vec() },
        pull: false,
    };
    let orders = LinkOrders {
        instance: "sink".into(),
        robot: "c1".into(),
        incoming: vec![
            incoming(0, "Far", std::slice::from_ref(&nobody)),
            incoming(1, "Near", &[nobody.clone(), producer.locator()]),
        ],
        outgoing: Vec::new(),
        devices: Vec::new(),
    };
    let links = Links::new(None, Some(Arc::new(own)));
    links.rejoin();
    let interface = Interface { ports, ..interface() };
    links.make(&Arc::new(session), &interface, orders, &Arc::default()).unwrap();
    let is_direct = |wire| matches!(links.lock().inputs.get(&wire), Some((_, WireInput::Direct(_))));
    assert_eq!([is_direct(0), is_direct(1)], [false, true]);
    links.clear();
    std::fs::remove_dir_all(&folder).unwrap();
}

/// Links with a round trip of up to 3 s can be made, and stay.
#[test]
fn links_are_made_over_2900_ms_of_round_trip() {
    let folder = std::env::temp_dir().join(format!("dca-far-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let open = |name: &str| Arc::new(DataSession::open(&folder.join(name), Reach::Host).unwrap());
    let (producer, consumer) = (open("p.sock"), open("c.sock"));
    relay(&folder.join("x.sock"), folder.join("p.sock"), Duration::from_millis(1450));
    let key = key::wire("far", 1, 0);
    let publisher = producer.publisher(&key, Priority::Wire).unwrap();
    let _hearing = consumer.on_sample(&key, |_| ()).unwrap();
    let locators = vec![format!("unixsock-stream/{}", folder.join("x.sock").display())];
    let patience = DialBudget::Each(DIAL_WITHIN);
    let linked = patience.dial(&consumer, &Dial { session: producer.location().session, locators });
    assert_eq!((linked, publisher.wait_heard(patience.left())), (Ok(()), true));
    std::fs::remove_dir_all(&folder).unwrap();
}
