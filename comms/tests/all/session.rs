//! Node sessions over Unix sockets: calls, streams, messages and presence, also through a client of another node.

#![expect(clippy::unwrap_used, reason = "a test stops where something is not as it should be")]

use comms::io::clock;
use comms::io::session::{CallError, NodeOptions, Presence, Reach, Request, Server, Session};
use comms::logic::key::{self, HostName};
use comms::logic::port::Policy;
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::net::{UnixListener, UnixStream};

const LONG: Duration = Duration::from_secs(20);

struct Dir(PathBuf);

impl Dir {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("dca-session-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }
    fn socket(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }
}

impl Drop for Dir {
    fn drop(&mut self) {
        std::fs::remove_dir_all(&self.0).unwrap();
    }
}

async fn node(dir: &Dir, name: &str, peers: &[&str]) -> Session {
    let peers = peers.iter().map(|peer| format!("unixsock-stream/{}", dir.socket(peer).display())).collect();
    let name = HostName::parse(name).unwrap();
    let socket = dir.socket(name.as_str());
    Session::open_node(NodeOptions { name, socket, reach: Reach::Host, port: 0, peers }).await.unwrap()
}

/// Serves until its session closes: it echoes, counts, refuses, and leaves one call without an answer.
async fn serve(mut server: Server, host: &str) {
    let mut hanging = Vec::new();
    while let Some(mut request) = server.next().await {
        let (to, verb) = key::parse_rpc(request.key()).unwrap();
        assert_eq!(to, host);
        match verb.as_str() {
            "echo" => assert!(request.reply(request.payload().to_vec()).await),
            "count" => {
                let end = request.payload()[0];
                count(&mut request, end).await;
                request.finish();
            }
            "nothing" => request.finish(),
            "part" => count(&mut request, 3).await,
            "give up" => {
                count(&mut request, 1).await;
                request.break_off("it is too much");
            }
            "refuse" => request.refuse("not today"),
            "hang" => hanging.push(request),
            "linger" => {
                request.still_here();
                assert!(request.reply(vec![1]).await);
                request.still_here();
                hanging.push(request);
            }
            _ => {}
        }
    }
}

async fn count(request: &mut Request, end: u8) {
    for number in 0..end {
        assert!(request.reply(vec![number]).await);
    }
}

async fn call(session: &Session, host: &str, verb: &str, payload: &[u8]) -> Result<Vec<u8>, CallError> {
    session.call(&key::rpc(host, verb), payload.to_vec(), LONG).await
}

async fn appears(session: &Session, host: &str) {
    let mut watch = session.watch(&key::live_any()).unwrap();
    while let Some(presence) = watch.next().await {
        if matches!(presence, Presence::Appeared(key) if key::parse_live(&key).unwrap().0 == host) {
            return;
        }
    }
    panic!("the session closed");
}

async fn check_calls(session: &Session, host: &str) {
    assert_eq!(call(session, host, "echo", b"hello").await.unwrap(), b"hello");
    let large = vec![9; 300_000];
    assert_eq!(call(session, host, "echo", &large).await.unwrap(), large);
    assert_eq!(call(session, host, "refuse", b"").await.unwrap_err().to_string(), "not today");
    assert!(matches!(call(session, host, "ignore", b"").await, Err(CallError::Unreachable { .. })));
    assert!(matches!(call(session, "nobody", "echo", b"").await, Err(CallError::Unreachable { .. })));
    let hang = session.call(&key::rpc(host, "hang"), Vec::new(), Duration::from_millis(100)).await;
    assert!(matches!(hang, Err(CallError::Timeout { .. })), "{hang:?}");

    let mut replies = session.call_stream(&key::rpc(host, "count"), vec![200], LONG).unwrap();
    for number in 0..200 {
        assert_eq!(replies.next().await, Some(Ok(vec![number])));
    }
    assert_eq!(replies.next().await, None);
    let nothing = session.call_stream(&key::rpc(host, "nothing"), Vec::new(), LONG).unwrap().next().await;
    assert_eq!(nothing, None);
    check_broken(session, host).await;
    let mut replies = session.call_stream(&key::rpc("nobody", "count"), vec![1], LONG).unwrap();
    assert!(matches!(replies.next().await, Some(Err(CallError::Unreachable { .. }))));
    assert_eq!(replies.next().await, None);

    // The message that the server is still there is not an answer. Without it the call ends.
    let silence_max = Duration::from_millis(300);
    let mut replies = session.call_stream(&key::rpc(host, "linger"), Vec::new(), silence_max).unwrap();
    assert_eq!(replies.next().await, Some(Ok(vec![1])));
    assert!(matches!(replies.next().await, Some(Err(CallError::Silent { .. }))));
    assert_eq!(replies.next().await, None);
}

/// A stream that ends without its mark is not complete.
async fn check_broken(session: &Session, host: &str) {
    for (verb, came, part) in [("part", 3, "in the middle"), ("give up", 1, "it is too much")] {
        let mut replies = session.call_stream(&key::rpc(host, verb), Vec::new(), LONG).unwrap();
        for number in 0..came {
            assert_eq!(replies.next().await, Some(Ok(vec![number])));
        }
        let end = replies.next().await;
        let Some(Err(CallError::Broken { count, why, .. })) = &end else { panic!("{end:?}") };
        assert!(*count == u64::from(came) && why.contains(part), "{end:?}");
        assert_eq!(replies.next().await, None);
    }
}

/// The most bytes that wait for a caller or are in transit to it.
const WAITING_MAX: usize = 1 << 20;

/// A server waits for a caller that takes its answers slowly, or not at all. It notices when the caller has ended.
#[tokio::test(flavor = "multi_thread")]
async fn a_server_gives_no_more_than_its_caller_takes() {
    const SIZE: usize = 10_000;
    let dir = Dir::new("credit");
    let a = node(&dir, "a", &[]).await;
    let client = Session::open_client(&dir.socket("a")).await.unwrap();
    let mut server = a.serve(&key::rpc_any("a")).unwrap();
    let given = Arc::new(AtomicUsize::new(0));
    for caller in [&a, &client] {
        let mut replies = caller.call_stream(&key::rpc("a", "many"), Vec::new(), LONG).unwrap();
        let mut request = server.next().await.unwrap();
        given.store(0, Ordering::Relaxed);
        let count = Arc::clone(&given);
        let mut giving = tokio::task::JoinSet::new();
        giving.spawn(async move {
            while request.reply(vec![7; SIZE]).await {
                count.fetch_add(1, Ordering::Relaxed);
            }
            request.left().await;
        });
        for taken in 0..1000 {
            let waiting = given.load(Ordering::Relaxed).saturating_sub(taken) * SIZE;
            assert!(waiting < WAITING_MAX, "{waiting} bytes after {taken} answers");
            assert_eq!(replies.next().await.unwrap().unwrap().len(), SIZE);
        }
        drop(replies);
        giving.join_next().await.unwrap().unwrap();
    }
    client.close().await;
    a.close().await;
}

/// A session sends its pending answers before it closes.
#[tokio::test(flavor = "multi_thread")]
async fn answers_that_are_complete_are_taken_before_a_session_closes() {
    let dir = Dir::new("answered");
    let a = node(&dir, "a", &[]).await;
    let client = Session::open_client(&dir.socket("a")).await.unwrap();
    let mut server = a.serve(&key::rpc_any("a")).unwrap();
    let mut replies = client.call_stream(&key::rpc("a", "many"), Vec::new(), LONG).unwrap();
    let mut request = server.next().await.unwrap();
    for _ in 0..20 {
        assert!(request.reply(vec![7; 10_000]).await);
    }
    request.finish();
    let closing = async {
        a.answered().await;
        drop(server);
        a.close().await;
    };
    let taking = async {
        let mut count = 0;
        while let Some(answer) = replies.next().await {
            assert_eq!(answer.unwrap().len(), 10_000);
            count += 1;
        }
        count
    };
    assert_eq!(tokio::join!(closing, taking).1, 20);
    client.close().await;
}

/// Two sessions may serve one key, like two nodes of the same name. A stream stays with the server that began it, and
/// a client can choose the server that it is linked to.
#[tokio::test(flavor = "multi_thread")]
async fn of_two_servers_of_one_key_one_gives_all_answers_of_a_stream() {
    const PIECES: u8 = 40;
    let dir = Dir::new("same");
    let (a, b) = (node(&dir, "a", &["b"]).await, node(&dir, "b", &["a"]).await);
    let served = key::rpc_any("same");
    let mut tasks = tokio::task::JoinSet::new();
    for (session, first) in [(&a, 0), (&b, 100)] {
        let mut server = session.serve(&served).unwrap();
        tasks.spawn(async move {
            while let Some(mut request) = server.next().await {
                assert_eq!(request.key(), key::rpc("same", "count"));
                for number in 0..PIECES {
                    assert!(request.reply(vec![first + number; 5000]).await);
                }
                request.finish();
            }
        });
    }
    let _tokens = [a.announce(&key::live("a", 1)).unwrap(), b.announce(&key::live("b", 2)).unwrap()];
    tokio::join!(appears(&a, "b"), appears(&b, "a"));
    for (socket, first) in [("a", 0), ("b", 100)] {
        let client = Session::open_client(&dir.socket(socket)).await.unwrap();
        let called = key::rpc("same", "count");
        let here = client.at_the_other_end(&called).unwrap();
        for key in [&called, &here].repeat(20) {
            let mut replies = client.call_stream(key, Vec::new(), LONG).unwrap();
            let mut taken = Vec::new();
            while let Some(answer) = replies.next().await {
                taken.push(answer.unwrap()[0]);
            }
            let begun = if *key == here { first } else { taken[0] };
            assert_eq!(taken, (begun..begun + PIECES).collect::<Vec<_>>());
        }
        client.close().await;
    }
    a.close().await;
    b.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn nodes_and_a_client() {
    let dir = Dir::new("calls");
    // `a` is given the address of `b` before `b` exists.
    let a = node(&dir, "a", &["b"]).await;
    let b = node(&dir, "b", &[]).await;
    // A node serves before it announces itself.
    let server = b.serve(&key::rpc_any("b")).unwrap();
    let _here = b.announce(&key::live("b", 1)).unwrap();
    appears(&a, "b").await;
    let client = Session::open_client(&dir.socket("a")).await.unwrap();
    tokio::select! {
        () = serve(server, "b") => unreachable!(),
        () = async {
            check_calls(&a, "b").await;
            check_calls(&client, "b").await;
        } => {}
    }
    client.close().await;

    let mut inbox = b.subscribe(&key::inbox("b"), Policy::reject(100)).unwrap();
    appears(&b, "b").await;
    let mut sent = 0;
    // `a` learns of the inbox slightly after it was made. Earlier messages are lost, and senders repeat them if
    // necessary.
    let first = loop {
        a.put(&key::inbox("b"), vec![sent]).unwrap();
        sent += 1;
        if let Ok(got) = tokio::time::timeout(Duration::from_millis(50), inbox.next()).await {
            break got.unwrap();
        }
    };
    assert_eq!(first.0, key::inbox("b"));
    a.put(&key::inbox("b"), vec![sent; 100_000]).unwrap();
    while inbox.next().await.unwrap().1 != vec![sent; 100_000] {}
    a.close().await;
    b.close().await;
}

/// Relays bytes from one socket to another, and back, with a delay.
async fn relay(from: PathBuf, to: PathBuf, delay: Duration) {
    let listener = UnixListener::bind(from).unwrap();
    let mut carrying = tokio::task::JoinSet::new();
    loop {
        let (near, _) = listener.accept().await.unwrap();
        let Ok(far) = UnixStream::connect(&to).await else { continue };
        let ((near_read, near_write), (far_read, far_write)) = (near.into_split(), far.into_split());
        carrying.spawn(carry(near_read, far_write, delay));
        carrying.spawn(carry(far_read, near_write, delay));
    }
}

async fn carry(mut from: impl AsyncRead + Unpin, mut to: impl AsyncWrite + Unpin, delay: Duration) {
    let (sender, mut receiver) = tokio::sync::mpsc::channel(4096);
    let reading = async move {
        loop {
            let mut bytes = vec![0; 65_536];
            let size = from.read(&mut bytes).await.unwrap_or(0);
            bytes.truncate(size);
            let due = clock::now() + delay;
            if sender.send((due, bytes)).await.is_err() || size == 0 {
                return;
            }
        }
    };
    let writing = async move {
        while let Some((due, bytes)) = receiver.recv().await {
            clock::sleep_until(due).await;
            if bytes.is_empty() || to.write_all(&bytes).await.is_err() {
                return;
            }
        }
    };
    tokio::join!(reading, writing);
}

/// A satellite with a delay of 1.5 s in each direction: the link is made, and stays.
#[tokio::test(flavor = "multi_thread")]
async fn a_link_with_a_way_of_3_s_there_and_back_comes_up() {
    let dir = Dir::new("far");
    let b = node(&dir, "b", &[]).await;
    let _here = b.announce(&key::live("b", 1)).unwrap();
    let far = relay(dir.socket("relay"), dir.socket("b"), Duration::from_millis(1500));
    let test = async {
        let a = node(&dir, "a", &["relay"]).await;
        let mut watch = a.watch(&key::live_any()).unwrap();
        let appeared = tokio::time::timeout(LONG, watch.next()).await;
        assert_eq!(appeared.unwrap(), Some(Presence::Appeared(key::live("b", 1))));
        let longer = tokio::time::timeout(Duration::from_secs(6), watch.next()).await;
        assert!(longer.is_err(), "it is gone again: {longer:?}");
        a.close().await;
    };
    tokio::select! {
        () = far => unreachable!(),
        () = test => {}
    }
    b.close().await;
}

/// The other process of the tests below. As a test it does nothing.
#[tokio::test(flavor = "multi_thread")]
async fn other_node() {
    let Some(socket) = std::env::var_os("DCA_TEST_SOCKET") else { return };
    let options = NodeOptions {
        port: 0,
        name: HostName::parse("other").unwrap(),
        socket: Path::new(&socket).to_owned(),
        reach: Reach::Host,
        peers: Vec::new(),
    };
    let session = Session::open_node(options).await.unwrap();
    let server = session.serve(&key::rpc_any("other")).unwrap();
    let _here = session.announce(&key::live("other", 7)).unwrap();
    println!("ready");
    std::io::stdout().flush().unwrap();
    serve(server, "other").await;
}

fn start_other(dir: &Dir) -> Child {
    let mut child = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "session::other_node", "--nocapture"])
        .env("DCA_TEST_SOCKET", dir.socket("other"))
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    assert!(lines.any(|line| line.unwrap().contains("ready")));
    child
}

#[tokio::test(flavor = "multi_thread")]
async fn a_killed_node_vanishes_and_its_calls_end() {
    let dir = Dir::new("kill");
    let a = node(&dir, "a", &["other"]).await;
    let mut watch = a.watch(&key::live_any()).unwrap();
    for _ in 0..2 {
        let mut other = start_other(&dir);
        assert_eq!(watch.next().await, Some(Presence::Appeared(key::live("other", 7))));
        assert_eq!(call(&a, "other", "echo", b"x").await.unwrap(), b"x");
        let mut hanging = a.call_stream(&key::rpc("other", "hang"), Vec::new(), LONG).unwrap();
        let mut flowing = a.call_stream(&key::rpc("other", "linger"), Vec::new(), LONG).unwrap();
        assert_eq!(flowing.next().await, Some(Ok(vec![1])));
        other.kill().unwrap();
        other.wait().unwrap();
        assert_eq!(watch.next().await, Some(Presence::Vanished(key::live("other", 7))));
        assert!(matches!(hanging.next().await, Some(Err(CallError::Unreachable { .. }))));
        let end = flowing.next().await;
        assert!(matches!(end, Some(Err(CallError::Broken { count: 1, .. }))), "{end:?}");
    }
    a.close().await;
}

/// A node that is killed is restarted while the programs that it has started still run.
#[tokio::test]
async fn a_child_does_not_keep_the_socket() {
    let dir = Dir::new("lock");
    let a = node(&dir, "a", &[]).await;
    let mut child = Command::new("cat").stdin(Stdio::piped()).stdout(Stdio::null()).spawn().unwrap();
    a.close().await;
    let a = node(&dir, "a", &[]).await;
    drop(child.stdin.take());
    child.wait().unwrap();
    a.close().await;
}

#[tokio::test]
async fn opens_on_a_single_threaded_runtime_and_says_what_is_wrong() {
    let dir = Dir::new("wrong");
    let a = node(&dir, "a", &[]).await;
    assert_eq!(a.locators(), [format!("unixsock-stream/{}", dir.socket("a").display())]);
    let options = NodeOptions {
        port: 0,
        name: HostName::parse("a").unwrap(),
        socket: dir.socket("a"),
        reach: Reach::Host,
        peers: Vec::new(),
    };
    let taken = Session::open_node(options).await.unwrap_err().to_string();
    assert!(taken.starts_with("cannot open a session: ") && !taken.contains(".rs"), "{taken}");
    let nobody = Session::open_client(&dir.socket("b")).await.unwrap_err().to_string();
    assert!(nobody.starts_with("no node answers at"), "{nobody}");
    a.close().await;
}
