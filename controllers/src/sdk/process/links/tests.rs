//! The links of programs, over sockets of this machine.

use super::super::wire::fetch_all;
use super::*;
use comms::io::clock::Wakeup;
use comms::io::data::Priority;
use comms::io::session::Reach;
use comms::logic::key;
use std::io::{Read, Write};
use std::net::Shutdown;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicU64;
use std::sync::mpsc::sync_channel;

const LONG: Duration = Duration::from_secs(20);

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
