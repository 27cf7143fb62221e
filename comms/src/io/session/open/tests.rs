use super::super::config::unix_locator;
use super::*;
use crate::io::clock::now;
use std::sync::mpsc::sync_channel;

/// A link may exist as soon as a session begins to listen and to dial. Its loss is still noticed.
#[test]
fn the_loss_of_the_very_first_link_is_heard() {
    let path = std::env::temp_dir().join(format!("dca-open-{}.sock", std::process::id()));
    let locator = unix_locator(&path).unwrap();
    let listening = Settings::node().listen(std::slice::from_ref(&locator));
    let node = Opened::open(listening, Redial::Found, Search::Off, None).unwrap();
    // The open of a client returns only after it is linked.
    let client = Opened::open(Settings::client(&locator), Redial::Listed, Search::Off, None).unwrap();
    let (events_tx, events) = sync_channel(4);
    let on_event = move |event: TransportEvent| {
        events_tx.try_send((event.kind(), event.transport().zid().to_string())).unwrap();
    };
    let info = client.session.info();
    let _listener = info.transport_events_listener().history(true).callback(on_event).wait().unwrap();
    let within = Duration::from_secs(20);
    assert_eq!(events.recv_timeout(within), Ok((SampleKind::Put, node.id())));
    let id = node.id();
    node.close();
    assert_eq!(events.recv_timeout(within), Ok((SampleKind::Delete, id)));
    client.close();
}

/// Returns a session that listens on a TCP port of this machine.
fn on_tcp() -> Opened {
    let locators = ["tcp/127.0.0.1:0".to_owned()];
    Opened::open(Settings::data().listen(&locators), Redial::Listed, Search::Off, None).unwrap()
}

/// A node's locators also contain the socket on its own machine, which does not exist on other machines.
#[test]
fn a_socket_that_is_not_there_hides_no_other_place() {
    let (a, b) = (on_tcp(), on_tcp());
    let nowhere = "unixsock-stream//nowhere/at/all".to_owned();
    b.dial(&a.id(), &[nowhere, a.locators().remove(0)], Duration::from_secs(20)).unwrap();
    a.close();
    b.close();
}

/// Relays between the returned place and another one. A message to the returned sender closes the far end of each connection,
/// and leaves the near end open.
fn relay(to: String) -> (String, std::sync::mpsc::SyncSender<()>) {
    use std::net::{Shutdown, TcpListener, TcpStream};
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let place = format!("tcp/{}", listener.local_addr().unwrap());
    let (half_tx, half) = sync_channel(1);
    std::thread::spawn(move || {
        let far_ends = Arc::new(Mutex::new(Vec::<TcpStream>::new()));
        let noted = Arc::clone(&far_ends);
        std::thread::spawn(move || {
            for near in listener.incoming().map_while(Result::ok) {
                let Ok(far) = TcpStream::connect(to.trim_start_matches("tcp/")) else { continue };
                noted.lock().unwrap().push(far.try_clone().unwrap());
                let (mut near_read, mut far_write) = (near.try_clone().unwrap(), far.try_clone().unwrap());
                let (mut far_read, mut near_write) = (far, near);
                std::thread::spawn(move || std::io::copy(&mut far_read, &mut near_write));
                std::thread::spawn(move || {
                    drop(std::io::copy(&mut near_read, &mut far_write));
                    // Taken and not passed on.
                    std::io::copy(&mut near_read, &mut std::io::sink())
                });
            }
        });
        for () in half {
            far_ends.lock().unwrap().drain(..).for_each(|far| far.shutdown(Shutdown::Both).unwrap());
        }
    });
    (place, half_tx)
}

/// One side loses the session and starts again, while the other side still uses the old session, which it has dialled itself.
#[test]
fn a_session_that_one_side_has_lost_begins_anew_on_both() {
    let (a, b) = (on_tcp(), on_tcp());
    let (heard_tx, heard) = sync_channel(1000);
    let key = "dca/test/anew";
    let on_sample = move |_: zenoh::sample::Sample| heard_tx.try_send(()).unwrap_or_default();
    let _subscriber = a.session.declare_subscriber(key).callback(on_sample).wait().unwrap();
    let (place, half) = relay(b.locators().remove(0));
    let within = Duration::from_secs(20);
    a.dial(&b.id(), &[place], within).unwrap();
    b.keep(&a.id(), &a.locators()).unwrap();
    let began = now();
    let hears = || {
        while heard.try_recv().is_ok() {}
        while now() - began < 2 * within {
            b.session.put(key, "x").wait().unwrap();
            if heard.recv_timeout(Duration::from_millis(20)).is_ok() {
                return true;
            }
        }
        false
    };
    assert!(hears());
    // The events that each side observes of its session with the other side.
    let [(_of_a, at_a), (_of_b, at_b)] = [&a, &b].map(|side| {
        let (events_tx, events) = sync_channel(16);
        let on_event = move |event: TransportEvent| events_tx.try_send(event.kind()).unwrap_or_default();
        let info = side.session.info();
        (info.transport_events_listener().history(false).callback(on_event).wait().unwrap(), events)
    });
    half.send(()).unwrap();
    for (side, events) in [("who has lost it", at_b), ("who has not", at_a)] {
        for expected in [SampleKind::Delete, SampleKind::Put] {
            assert_eq!(events.recv_timeout(within), Ok(expected), "{side} begins anew");
        }
    }
    assert!(hears(), "who has begun anew is not told who listens");
    a.close();
    b.close();
}

/// A link that is given up ends at both sides, whichever side has dialled, and is then made again.
#[test]
fn a_link_that_is_given_up_is_made_anew() {
    let (a, b, within) = (on_tcp(), on_tcp(), Duration::from_secs(20));
    b.dial(&a.id(), &a.locators(), within).unwrap();
    for (gives_up, other) in [(&a, &b), (&b, &a)] {
        let began = now();
        let is_known = || lock(&gives_up.dialler.links).ends.contains_key(&other.id());
        while !is_known() && now() - began < within {
            std::thread::yield_now();
        }
        let listening = [&a, &b].map(|side| {
            let (events_tx, events) = sync_channel(16);
            let on_event = move |event: TransportEvent| events_tx.try_send(event.kind()).unwrap_or_default();
            let info = side.session.info();
            (info.transport_events_listener().history(false).callback(on_event).wait().unwrap(), events)
        });
        gives_up.cut(&other.id());
        for expected in [SampleKind::Delete, SampleKind::Put] {
            assert!(listening.iter().all(|(_, events)| events.recv_timeout(within) == Ok(expected)), "{expected:?}");
        }
    }
    a.close();
    b.close();
}

/// An address that accepts a connection and sends nothing delays dialling. The peer is still dialled at another address.
#[test]
fn who_was_dialled_in_vain_is_dialled_again() {
    let silent = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let path = std::env::temp_dir().join(format!("dca-again-{}.sock", std::process::id()));
    let locator = unix_locator(&path).unwrap();
    let node = Opened::open(Settings::data().listen(std::slice::from_ref(&locator)), Redial::Listed, Search::Off, None)
        .unwrap();
    let other = Opened::open(Settings::data(), Redial::Listed, Search::Off, None).unwrap();
    let wrong = format!("tcp/{}", silent.local_addr().unwrap());
    let said = other.dial(&node.id(), &[wrong], Duration::from_millis(200));
    assert!(said.is_err_and(|why| why.starts_with("nothing answers")));
    drop(silent);
    assert_eq!(other.dial(&node.id(), &[locator], Duration::from_secs(20)), Ok(()));
    other.close();
    node.close();
}

/// A node that is busy with a long answer sends nothing else. Its link is not cut.
#[test]
fn a_link_over_which_something_comes_is_not_cut() {
    // Nodes send a keep-alive each 7.5 s, so nothing else arrives in the meantime.
    let open = || {
        let settings = Settings::node().listen(&["tcp/127.0.0.1:0".to_owned()]);
        Opened::open(settings, Redial::Listed, Search::Off, None).unwrap()
    };
    let (a, b, within) = (open(), open(), Duration::from_secs(20));
    a.dial(&b.id(), &b.locators(), within).unwrap();
    let heard = a.session.declare_subscriber("x").wait().unwrap();
    while b.session.put("x", "").wait().is_err()
        || heard.recv_timeout(Duration::from_millis(50)).ok().flatten().is_none()
    {}
    let (events_tx, events) = sync_channel(16);
    let on_event = move |event: TransportEvent| events_tx.try_send(event.kind()).unwrap_or_default();
    let _listener = a.session.info().transport_events_listener().history(false).callback(on_event).wait().unwrap();
    let window = Duration::from_millis(200);
    a.cut_if_silent(&b.id(), window);
    let (mut before, mut longest) = (now(), Duration::ZERO);
    for _ in 0..20 {
        b.session.put("x", "").wait().unwrap();
        let came = heard.recv_timeout(within).unwrap().is_some() && events.recv_timeout(window / 10).is_err();
        longest = longest.max(now().since(before));
        before = now();
        if longest > window / 2 {
            eprintln!("skipped: this machine stood still for {longest:?}, which looks like a silent link");
            return;
        }
        assert!(came, "the link stands");
    }
    a.cut_if_silent(&b.id(), window);
    assert_eq!(events.recv_timeout(within), Ok(SampleKind::Delete));
    a.close();
    b.close();
}
