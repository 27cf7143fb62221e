use super::super::config::{Settings, unix_locator};
use super::super::nearby::NearbyNode;
use super::super::open::{Opened, Redial, Search};
use super::*;
use std::collections::BTreeSet;
use std::io::{Read as _, Write as _};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use zenoh::Wait as _;
use zenoh::sample::SampleKind;
use zenoh::session::TransportEvent;

const WITHIN: Duration = Duration::from_secs(20);
/// Secret and public keys. Source: RFC 8032, section 7.1, tests 1 to 3.
const KEYS: [(&str, &str); 3] = [
    (
        "9d61b19deffd5a60ba844af492ec2cc44449c5697b326919703bac031cae7f60",
        "d75a980182b10ab7d54bfed3c964073a0ee172f3daa62325af021a68f707511a",
    ),
    (
        "4ccd089b28ff96da9db6c346ec114e0f5b8a319f35aba624da8cf6ed4fb8a6fb",
        "3d4017c3e843895a92b70aa74d1b7ebc9c982ccf2ec4968cc0cd55f12af4660c",
    ),
    (
        "c5aa8df43f9f837bedb7442f31dcb7b166d38535076f094b85ce3a2e0b4458f7",
        "fc51cd8e6218a1a38da47ed00230f0580816ed13ba3303ac5deb911548908025",
    ),
];

fn bytes(hex: &str) -> [u8; 32] {
    let byte = |at: usize| u8::from_str_radix(&hex[2 * at..2 * at + 2], 16).unwrap();
    std::array::from_fn(byte)
}

/// Trusts some of the keys.
#[derive(Debug)]
struct TrustsSome {
    own: usize,
    trusted: Mutex<BTreeSet<PublicKey>>,
    refused: SyncSender<String>,
    /// The revocations that were received from peers.
    heard: Mutex<Vec<Vec<u8>>>,
}

impl Identity for TrustsSome {
    fn key(&self) -> (Zeroizing<[u8; 32]>, PublicKey) {
        (Zeroizing::new(bytes(KEYS[self.own].0)), bytes(KEYS[self.own].1))
    }

    fn credential(&self) -> Vec<u8> {
        vec![u8::try_from(self.own).unwrap()]
    }

    fn judge(&self, key: &PublicKey, credential: &[u8]) -> Result<String, String> {
        let is_trusted = self.trusted.lock().unwrap().contains(key);
        is_trusted.then(|| format!("number {}", credential[0])).ok_or_else(|| "nobody knows it".to_owned())
    }

    fn revocations(&self) -> Vec<u8> {
        vec![u8::try_from(self.own).unwrap()]
    }

    fn hear(&self, revocations: &[u8]) -> bool {
        self.heard.lock().unwrap().push(revocations.to_vec());
        false
    }

    fn refused(&self, _: SocketAddr, why: &str) {
        self.refused.try_send(why.to_owned()).unwrap_or_default();
    }
}

/// A session with key `own`, which trusts some keys. Also returns the reasons of its refusals.
fn session(own: usize, trusted: &[usize]) -> (Opened, Arc<TrustsSome>, Receiver<String>) {
    let folder = std::env::temp_dir().join(format!("dca-tunnel-{}-{own}-{}", std::process::id(), now().nanos()));
    std::fs::create_dir(&folder).unwrap();
    let (refused, hears) = sync_channel(64);
    let trusted = Mutex::new(trusted.iter().map(|number| bytes(KEYS[*number].1)).collect());
    let identity = Arc::new(TrustsSome { own, trusted, refused, heard: Mutex::default() });
    let entrance = folder.join("s");
    let settings = Settings::data().listen(&[unix_locator(&entrance).unwrap()]);
    let listen = vec![([127, 0, 0, 1], 0).into()];
    let options = TunnelOptions { identity: Arc::clone(&identity) as _, listen, entrance };
    (Opened::open(settings, Redial::Listed, Search::Off, Some(options)).unwrap(), identity, hears)
}

/// Waits until a peer is refused for this reason.
fn expect(refused: &Receiver<String>, why: &str) {
    while refused.recv_timeout(WITHIN).expect("somebody is refused") != why {}
}

fn tcp(opened: &Opened) -> String {
    opened.locators().into_iter().find(|locator| locator.starts_with("tcp/")).unwrap()
}

/// Returns whether a message of `from` reaches `to` in time.
fn reaches(from: &Opened, to: &Opened) -> bool {
    let (heard_tx, heard) = sync_channel(1000);
    let on_sample = move |_: zenoh::sample::Sample| heard_tx.try_send(()).unwrap_or_default();
    let _subscriber = to.session.declare_subscriber("dca/test/tunnel").callback(on_sample).wait().unwrap();
    let began = now();
    while now() - began < WITHIN {
        from.session.put("dca/test/tunnel", vec![7; 100_000]).wait().unwrap();
        if heard.recv_timeout(Duration::from_millis(20)).is_ok() {
            return true;
        }
    }
    false
}

#[test]
fn who_is_trusted_is_linked_and_ends_with_the_trust() {
    let ((a, of_a, _), (b, _, _)) = (session(0, &[1]), session(1, &[0]));
    // Both sides dial at once, and repeatedly.
    a.keep(&b.id(), &[tcp(&b)]).unwrap();
    b.keep(&a.id(), &[tcp(&a)]).unwrap();
    assert!(reaches(&a, &b) && reaches(&b, &a));
    of_a.trusted.lock().unwrap().clear();
    a.judge_again();
    // Checks both ends: the other end learns of the link a moment later, and has nothing to dial before.
    let began = now();
    while (a.is_linked() || b.is_linked()) && now() - began < WITHIN {
        std::thread::yield_now();
    }
    assert!(!a.is_linked() && !b.is_linked(), "who is not trusted any more is cut off");
    assert!(b.dial(&a.id(), &[tcp(&a)], Duration::from_millis(500)).is_err());
    of_a.trusted.lock().unwrap().insert(bytes(KEYS[1].1));
    assert!(reaches(&a, &b), "who is trusted again is linked again");
    // A tunnel that is given up is made again.
    let (events_tx, events) = sync_channel(16);
    let on_event = move |event: TransportEvent| events_tx.try_send(event.kind()).unwrap_or_default();
    let info = b.session.info();
    let _listener = info.transport_events_listener().history(false).callback(on_event).wait().unwrap();
    a.cut(&b.id());
    assert_eq!(events.recv_timeout(WITHIN), Ok(SampleKind::Delete));
    assert_eq!(events.recv_timeout(WITHIN), Ok(SampleKind::Put));
    assert!(reaches(&a, &b));
    a.close();
    b.close();
}

/// A node whose keys were revoked while it was away is refused by all others. It learns why from the first node that
/// dials it.
#[test]
fn who_is_refused_hears_of_its_revocation() {
    let ((a, _, _), (b, of_b, _)) = (session(0, &[]), session(1, &[0]));
    a.keep(&b.id(), &[tcp(&b)]).unwrap();
    let began = now();
    while of_b.heard.lock().unwrap().is_empty() && now() - began < WITHIN {
        std::thread::yield_now();
    }
    assert_eq!(of_b.heard.lock().unwrap().first(), Some(&vec![0]));
    assert!(!a.is_linked() && !b.is_linked());
    a.close();
    b.close();
}

/// False places are repeatedly announced for a session. They accept a connection and send nothing.
#[test]
fn silent_places_keep_no_node_from_its_link() {
    let ((a, _, _), (b, _, _)) = (session(0, &[1]), session(1, &[0]));
    let silent: Vec<std::net::TcpListener> = (1..=30)
        .map(|machine| std::net::TcpListener::bind((std::net::Ipv4Addr::new(127, 0, 7, machine), 0)).unwrap())
        .collect();
    let (hear, of_b) = (a.ear(), b.id());
    let say = move |at: SocketAddr| hear(NearbyNode { session: of_b.clone(), name: String::new(), at });
    let say = Arc::new(say);
    let say_false = {
        let (say, places) = (Arc::clone(&say), silent.iter().map(|one| one.local_addr().unwrap()).collect::<Vec<_>>());
        move || places.iter().for_each(|place| say(*place))
    };
    let (events_tx, events) = sync_channel(16);
    let says_false = say_false.clone();
    let on_event = move |event: TransportEvent| {
        // While this end is still making the link, its place must not be forgotten either.
        says_false();
        says_false();
        events_tx.try_send(event.kind()).unwrap_or_default();
    };
    let info = a.session.info();
    let _listener = info.transport_events_listener().history(false).callback(on_event).wait().unwrap();
    // Before there is a link, the true place is one of many.
    say_false();
    say(tcp(&b).trim_start_matches("tcp/").parse().unwrap());
    assert_eq!(events.recv_timeout(WITHIN), Ok(SampleKind::Put));
    // After a cut the true place is dialled first, whatever is announced in the meantime.
    let began = now();
    a.cut(&b.id());
    say_false();
    assert_eq!(events.recv_timeout(WITHIN), Ok(SampleKind::Delete));
    assert_eq!(events.recv_timeout(WITHIN), Ok(SampleKind::Put));
    println!("again after {:?}", now() - began);
    a.close();
    b.close();
}

#[test]
fn a_stranger_comes_to_nothing() {
    let ((a, _, refused), (stranger, _, _)) = (session(0, &[1]), session(2, &[0]));
    assert!(stranger.dial(&a.id(), &[tcp(&a)], Duration::from_millis(500)).is_err());
    expect(&refused, "nobody knows it");
    assert!(!a.is_linked() && !stranger.is_linked());
    // Also refused: a peer that uses zenoh without TLS, or sends nonsense.
    let plain = Opened::open(Settings::data(), Redial::Listed, Search::Off, None).unwrap();
    assert!(plain.dial(&a.id(), &[tcp(&a)], Duration::from_millis(500)).is_err());
    expect(&refused, "it speaks no TLS with a key of its own");
    let mut garbage = std::net::TcpStream::connect(tcp(&a).trim_start_matches("tcp/")).unwrap();
    garbage.write_all(&[0x5a; 64]).unwrap();
    garbage.set_read_timeout(Some(WITHIN)).unwrap();
    let ended = garbage.read_to_end(&mut Vec::new()).map_err(|error| error.kind());
    assert!(matches!(ended, Ok(_) | Err(ConnectionReset)), "{ended:?}: nobody hangs up");
    for opened in [a, stranger, plain] {
        opened.close();
    }
}

/// A peer stops waiting for a suspended process. If a member has connected from its address before, that is not
/// recorded.
#[test]
fn a_member_that_gives_up_waiting_is_no_stranger() {
    let ((a, _, refused), (b, _, _)) = (session(0, &[1]), session(1, &[0]));
    let gives_up = || {
        let mut stream = std::net::TcpStream::connect(tcp(&a).trim_start_matches("tcp/")).unwrap();
        stream.write_all(&[0x16, 3, 1]).unwrap();
    };
    gives_up();
    assert_eq!(refused.recv_timeout(WITHIN).unwrap(), HUNG_UP);
    b.dial(&a.id(), &[tcp(&a)], WITHIN).unwrap();
    assert!(reaches(&b, &a));
    gives_up();
    // A later peer is refused for its own reason.
    let (stranger, _, _) = session(2, &[0]);
    assert!(stranger.dial(&a.id(), &[tcp(&a)], Duration::from_millis(500)).is_err());
    assert_eq!(refused.recv_timeout(WITHIN).unwrap(), "nobody knows it");
    for opened in [a, b, stranger] {
        opened.close();
    }
}

#[test]
fn who_trusts_does_not_dial_who_is_not_trusted() {
    let ((a, _, refused), (b, _, _)) = (session(0, &[1]), session(1, &[]));
    assert!(a.dial(&b.id(), &[tcp(&b)], Duration::from_millis(500)).is_err());
    assert!(b.dial(&a.id(), &[tcp(&a)], Duration::from_millis(500)).is_err());
    drop(refused);
    assert!(!a.is_linked() && !b.is_linked());
    a.close();
    b.close();
}

#[test]
fn many_who_say_nothing_keep_nobody_out() {
    let ((a, _, _), (b, _, _)) = (session(0, &[1]), session(1, &[0]));
    let place = tcp(&a);
    let silent: Vec<_> = (0..600)
        .map(|_| {
            let mut stream = std::net::TcpStream::connect(place.trim_start_matches("tcp/")).unwrap();
            // The beginning of a TLS record, and no more.
            stream.write_all(&[0x16, 3, 1]).unwrap();
            stream
        })
        .collect();
    b.dial(&a.id(), &[place], WITHIN).unwrap();
    assert!(reaches(&b, &a));
    drop(silent);
    a.close();
    b.close();
}
