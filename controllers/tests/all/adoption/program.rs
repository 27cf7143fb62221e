//! A controller program, and the channel to it that a node has.

use super::*;

/// A source of beats, and the folder in which it looks for nodes.
pub(super) struct Program {
    pub(super) dir: PathBuf,
    pub(super) child: Child,
}

/// A node's end of a channel.
pub(super) struct Channel {
    pub(super) stream: UnixStream,
    pub(super) decoder: Decoder,
    /// How many notices the program had made when it was taken over.
    pub(super) made: u64,
}

pub(super) fn folder() -> PathBuf {
    static COUNT: AtomicU32 = AtomicU32::new(0);
    let number = COUNT.fetch_add(1, Ordering::Relaxed);
    let dir = std::env::temp_dir().join(format!("dca-adoption-{}-{number}", std::process::id()));
    std::fs::create_dir_all(&dir).unwrap();
    dir
}

impl Program {
    /// Starts a source, by way of `command`; returns it with its node's listener and its channel, on which it has said
    /// hello.
    pub(super) fn start(command: &[&str]) -> (Self, UnixListener, Channel, Notice) {
        let dir = folder();
        let listener = UnixListener::bind(dir.join("control.sock")).unwrap();
        let program = Self::begin(dir, command);
        let mut channel = Channel::accept(&listener);
        let hello = channel.next().unwrap();
        assert!(matches!(&hello, Notice::Hello { instance, .. } if instance == "main/source"), "{hello:?}");
        (program, listener, channel, hello)
    }

    pub(super) fn begin(dir: PathBuf, command: &[&str]) -> Self {
        let mut words = command.iter().copied().chain([PROGRAM, "RateSource"]);
        let child = Command::new(words.next().unwrap())
            .args(words)
            .env_clear()
            .env("DCA_CONTROL", dir.join("control.sock"))
            .env("DCA_INSTANCE", "main/source")
            .env("DCA_DATA_SOCKET", dir.join("data.sock"))
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        Self { dir, child }
    }

    /// The place where the program looks for a node, taken by another one.
    pub(super) fn listener(&self) -> UnixListener {
        UnixListener::bind(self.dir.join("control.sock")).unwrap()
    }

    /// Ends the node that listens there.
    pub(super) fn kill_node(&self, listener: UnixListener, channel: Channel) {
        drop((listener, channel));
        std::fs::remove_file(self.dir.join("control.sock")).unwrap();
    }

    pub(super) fn terminate(&self) {
        assert!(Command::new("kill").arg(self.child.id().to_string()).status().unwrap().success());
    }

    /// Waits for the end of the program. Returns its exit code and its standard error.
    pub(super) fn leave(mut self) -> (Option<i32>, String) {
        let mut said = String::new();
        self.child.stderr.take().unwrap().read_to_string(&mut said).unwrap();
        let code = self.child.wait().unwrap().code();
        std::fs::remove_dir_all(&self.dir).unwrap();
        (code, said)
    }
}

impl Channel {
    pub(super) fn accept(listener: &UnixListener) -> Self {
        listener.set_nonblocking(true).unwrap();
        let until = now() + SOON;
        let stream = loop {
            if let Ok((stream, _)) = listener.accept() {
                break stream;
            }
            assert!(now() < until, "the program does not dial");
            std::thread::yield_now();
        };
        stream.set_nonblocking(false).unwrap();
        stream.set_read_timeout(Some(SOON)).unwrap();
        Self { stream, decoder: Decoder::new(1 << 20), made: 0 }
    }

    /// Accepts a program that had lost its node, and has taken `orders` orders; it reports how many notices it has
    /// made.
    #[track_caller]
    pub(super) fn resumed(listener: &UnixListener, orders: u64) -> Self {
        let mut channel = Self::accept(listener);
        let Some(Notice::Resume { version: WIRE_VERSION, instance, orders: taken, notices }) = channel.next() else {
            panic!("the program says something else");
        };
        assert_eq!((instance.as_str(), taken), ("main/source", orders));
        channel.made = notices;
        channel
    }

    pub(super) fn order(&mut self, order: &Order) {
        self.stream.write_all(&order_frame(order)).unwrap();
    }

    pub(super) fn next(&mut self) -> Option<Notice> {
        loop {
            if let Some(body) = self.decoder.next_frame().unwrap() {
                return Some(codec::decode(&body).unwrap());
            }
            let mut bytes = [0; 4096];
            match self.stream.read(&mut bytes).unwrap() {
                0 => return None,
                size => self.decoder.push(&bytes[..size]),
            }
        }
    }

    #[track_caller]
    pub(super) fn expect(&mut self, notice: &Notice) {
        assert_eq!(self.next().as_ref(), Some(notice));
    }

    #[track_caller]
    pub(super) fn activate(&mut self, activation: u32) {
        self.order(&Order::Activate { activation, value: Vec::new(), since: now() });
        self.expect(&Notice::Running { activation });
    }

    /// Sends an order that switches no wire; the program answers it like any other.
    #[track_caller]
    pub(super) fn switch(&mut self, generation: u64) {
        self.order(&open(generation));
        self.expect(&Notice::Switched { generation });
    }
}

pub(super) fn order_frame(order: &Order) -> Vec<u8> {
    frame::encode(&codec::encode(order).unwrap(), 1 << 20).unwrap()
}

pub(super) fn open(generation: u64) -> Order {
    Order::Open { wires: vec![], generation }
}
