use super::*;
use crate::io::clock::now;
use std::time::Duration;

/// How long a test waits for a listener that is running.
const SOON: Duration = Duration::from_secs(30);

/// A separate directory for each test, removed afterwards.
struct Dir(PathBuf);

impl Dir {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("dca-control-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }
    fn socket(&self) -> PathBuf {
        self.0.join("control.sock")
    }
}

impl Drop for Dir {
    fn drop(&mut self) {
        std::fs::remove_dir_all(&self.0).unwrap();
    }
}

fn hello() -> Notice {
    let (instance, owns, needs) = ("main/x".to_owned(), vec![], vec![]);
    Notice::Hello { version: WIRE_VERSION, instance, location: None, owns, needs, signals: false }
}

/// More than the kernel keeps for one socket.
fn large() -> Vec<u8> {
    vec![5; 3_000_000]
}

#[tokio::test]
async fn orders_and_notices_pass_both_ways() {
    let dir = Dir::new("both");
    let listener = Listener::bind(&dir.socket()).unwrap();
    let mode = std::fs::metadata(dir.socket()).unwrap().permissions().mode();
    assert_eq!(mode & 0o777, 0o600);
    let path = dir.socket();
    let program = std::thread::spawn(move || {
        let (notices, mut orders) = connect(&path, SOON).unwrap();
        notices.send(&hello()).unwrap();
        let mut values = 0;
        while let Some(order) = orders.recv().unwrap() {
            let Order::Activate { activation, value, .. } = order else { return values };
            values += value.len();
            notices.send(&Notice::Done { activation, value }).unwrap();
        }
        panic!("the node has gone");
    });
    let (orders, mut notices) = listener.accept().await.unwrap();
    assert_eq!(notices.recv().await.unwrap(), Some(hello()));
    for activation in 0..20 {
        orders.send(&Order::Activate { activation, value: vec![1], since: now() }).unwrap();
    }
    orders.send(&Order::Activate { activation: 20, value: large(), since: now() }).unwrap();
    for activation in 0..20 {
        assert_eq!(notices.recv().await.unwrap(), Some(Notice::Done { activation, value: vec![1] }));
    }
    assert_eq!(notices.recv().await.unwrap(), Some(Notice::Done { activation: 20, value: large() }));
    orders.send(&Order::Exit).unwrap();
    assert_eq!(notices.recv().await.unwrap(), None);
    assert_eq!(program.join().unwrap(), 3_000_020);
}

#[tokio::test]
async fn waiting_for_a_notice_can_be_given_up_at_any_time() {
    let dir = Dir::new("cancel");
    let listener = Listener::bind(&dir.socket()).unwrap();
    let path = dir.socket();
    let program = std::thread::spawn(move || {
        let (notices, mut orders) = connect(&path, SOON).unwrap();
        for activation in 0..500 {
            notices.send(&Notice::Running { activation }).unwrap();
            assert_eq!(orders.recv().unwrap(), Some(Order::Stop { activation }));
        }
    });
    let (orders, mut notices) = listener.accept().await.unwrap();
    for activation in 0..500 {
        let notice = loop {
            tokio::select! {
                biased;
                notice = notices.recv() => break notice.unwrap(),
                () = tokio::task::yield_now() => {}
            }
        };
        assert_eq!(notice, Some(Notice::Running { activation }));
        orders.send(&Order::Stop { activation }).unwrap();
    }
    assert_eq!(notices.recv().await.unwrap(), None);
    program.join().unwrap();
}

#[tokio::test]
async fn a_program_that_does_not_read_fills_its_own_queue_only() {
    let dir = Dir::new("stuck");
    let listener = Listener::bind(&dir.socket()).unwrap();
    let (_notices, _orders) = connect(&dir.socket(), SOON).unwrap();
    let (orders, _receiver) = listener.accept().await.unwrap();
    // The kernel's buffer takes further bytes before the program reads.
    let order = Order::Activate { activation: 0, value: large(), since: now() };
    let sent = (0..2 * FRAMES_MAX).take_while(|_| orders.send(&order).is_ok()).count();
    assert!((FRAMES_MAX..FRAMES_MAX + 2).contains(&sent), "{sent}");
    assert!(matches!(orders.send(&order), Err(ControlError::Stuck)));
}

#[tokio::test]
async fn a_program_that_nobody_hears_notices() {
    let dir = Dir::new("deaf");
    let listener = Listener::bind(&dir.socket()).unwrap();
    let (_notices, mut program) = connect(&dir.socket(), SOON).unwrap();
    let (orders, receiver) = listener.accept().await.unwrap();
    drop(receiver);
    assert_eq!(program.recv().unwrap(), None);
    orders.send(&Order::Exit).unwrap();
}

#[tokio::test]
async fn garbage_and_half_frames_are_errors() {
    let dir = Dir::new("garbage");
    let listener = Listener::bind(&dir.socket()).unwrap();
    let check = async |bytes: &[u8], expect: &str| {
        UnixStream::connect(dir.socket()).unwrap().write_all(bytes).unwrap();
        let (_orders, mut notices) = listener.accept().await.unwrap();
        let error = notices.recv().await.unwrap_err().to_string();
        assert!(error.contains(expect), "{error}");
    };
    check(b"GET / HTTP/1.1", "a frame of 542393671 bytes is longer").await;
    check(&[7, 0, 0, 0, 1], "the control channel broke").await;
    check(&[2, 0, 0, 0, 1, 1], "not a DCA message").await;
    check(&frame::encode(&codec::encode(&Order::Exit).unwrap(), 100).unwrap(), "kind 1 instead of kind 2").await;
}

/// A program of a later version gets that answer, and still gives its identity.
#[tokio::test]
async fn another_version_is_told_on_both_sides() {
    let dir = Dir::new("version");
    let listener = Listener::bind(&dir.socket()).unwrap();
    let of_later = |message: Vec<u8>| {
        let mut bytes = message;
        bytes[2] = 99;
        frame::encode(&bytes, 100).unwrap()
    };
    let mut program = UnixStream::connect(dir.socket()).unwrap();
    program.write_all(&of_later(codec::encode(&hello()).unwrap())).unwrap();
    let (_orders, mut notices) = listener.accept().await.unwrap();
    let said = notices.recv().await.unwrap();
    assert!(matches!(&said, Some(Notice::Hello { version: 99, instance, .. }) if instance == "main/x"), "{said:?}");

    let node = std::os::unix::net::UnixListener::bind(dir.0.join("later.sock")).unwrap();
    let (_notices, mut orders) = connect(&dir.0.join("later.sock"), SOON).unwrap();
    node.accept().unwrap().0.write_all(&of_later(codec::encode(&Order::Exit).unwrap())).unwrap();
    let error = orders.recv().unwrap_err().to_string();
    assert!(error.starts_with("the other side speaks version 99 of the control protocol, this one "), "{error}");
}

/// A suspended node takes no notices and no connections: a program waits for neither.
#[test]
fn a_program_does_not_wait_for_a_node_that_does_not_read() {
    let dir = Dir::new("suspended");
    let node = std::os::unix::net::UnixListener::bind(dir.socket()).unwrap();
    let (notices, mut orders) = connect(&dir.socket(), SOON).unwrap();
    let large = Notice::Done { activation: 1, value: large() };
    notices.send(&large).unwrap();
    notices.send(&Notice::Running { activation: 2 }).unwrap();
    assert!(matches!(orders.recv_until(Some(now())), Ok(Received::Nothing)));
    let stuck = orders.recv().unwrap_err();
    assert!(matches!(&stuck, ControlError::Broken(cause) if cause.kind() == io::ErrorKind::TimedOut), "{stuck}");
    let sent = (0..2 * FRAMES_MAX).take_while(|_| notices.send(&Notice::Connected).is_ok()).count();
    assert!(sent < FRAMES_MAX, "{sent}");

    rustix::net::listen(&node, 0).unwrap();
    let short = Duration::from_millis(1);
    let mut waiting: Vec<_> = Vec::new();
    let error = loop {
        match connect(&dir.socket(), short) {
            Ok(channel) => waiting.push(channel),
            Err(error) => break error,
        }
        assert!(waiting.len() < 10, "a listener that accepts nobody takes everybody");
    };
    assert!(matches!(error, ControlError::Connect { .. }), "{error}");
}

/// The last notices of a program that ends reach a node that reads them late.
#[test]
fn a_program_that_leaves_has_said_everything() {
    let dir = Dir::new("flush");
    let node = std::os::unix::net::UnixListener::bind(dir.socket()).unwrap();
    let (notices, orders) = connect(&dir.socket(), SOON).unwrap();
    let large = Notice::Done { activation: 1, value: large() };
    notices.send(&large).unwrap();
    let (mut stream, _) = node.accept().unwrap();
    let reader = std::thread::spawn(move || {
        let mut bytes = Vec::new();
        stream.read_to_end(&mut bytes).unwrap();
        let mut decoder = Decoder::new(Notice::SIZE_MAX);
        decoder.push(&bytes);
        codec::decode_notice(&decoder.next_frame().unwrap().unwrap()).unwrap()
    });
    notices.flush();
    drop((notices, orders));
    assert_eq!(reader.join().unwrap(), large);
}

#[test]
fn nobody_listens() {
    let error = connect(Path::new("/no/such/socket"), SOON).unwrap_err().to_string();
    assert!(error.starts_with("no node listens on `/no/such/socket`"), "{error}");
}
