//! Controllers as separate programs. This process replaces their node.

use crate::streams::{Load, Tally};
use anyhow::{Context, bail, ensure};
use comms::io::clock::now;
use comms::io::control::{ControlReceiver, ControlSender, Listener};
use comms::io::data::{CallWay, DataSession};
use comms::logic::bytes::Bytes;
use comms::logic::control::{Dial, Incoming, Location, Notice, Order, Outgoing};
use comms::logic::key;
use comms::logic::messaging::header::{Header, Message as QueueMessage, MessageId};
use comms::logic::object::{CallId, ObjectCall, Signature, TypeForm};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

/// The longest time for a program to answer an order.
const WITHIN: Duration = Duration::from_secs(20);

/// Where programs report.
#[derive(Debug)]
pub(crate) struct Place {
    listener: Listener,
    dir: PathBuf,
}

/// A program that has sent its hello.
#[derive(Debug)]
pub(crate) struct Program {
    sender: ControlSender,
    receiver: ControlReceiver,
    location: Option<Location>,
    instance: String,
}

impl Place {
    pub(crate) fn new(dir: &Path) -> anyhow::Result<Self> {
        let dir = dir.to_owned();
        Ok(Self { listener: Listener::bind(&dir.join("control"))?, dir })
    }

    /// Starts a program as a shim would.
    pub(crate) fn start(&self, controller: &str, instance: &str) -> anyhow::Result<Child> {
        let mut command = Command::new(std::env::current_exe()?);
        command.arg(controller).env_clear().stdin(Stdio::null()).stdout(Stdio::null());
        command.env("DCA_CONTROL", self.dir.join("control")).env("DCA_INSTANCE", instance);
        Ok(command.env("DCA_DATA_SOCKET", self.dir.join(format!("{instance}.sock"))).spawn()?)
    }

    /// Waits for the hello of the next program.
    pub(crate) async fn hello(&self) -> anyhow::Result<Program> {
        let (sender, mut receiver) = tokio::time::timeout(WITHIN, self.listener.accept()).await??;
        let hello = tokio::time::timeout(WITHIN, receiver.recv()).await??;
        let Some(Notice::Hello { location, instance, .. }) = hello else { bail!("no hello but {hello:?}") };
        Ok(Program { sender, receiver, location, instance })
    }
}

impl Program {
    /// Gives an order and returns the notice that answers it. It skips `Running`.
    async fn order(&mut self, order: &Order) -> anyhow::Result<Notice> {
        self.sender.send(order)?;
        self.notice().await
    }

    /// Returns the next notice that is not `Running`.
    async fn notice(&mut self) -> anyhow::Result<Notice> {
        loop {
            match tokio::time::timeout(WITHIN, self.receiver.recv()).await?? {
                Some(Notice::Running { .. }) => {}
                Some(notice) => return Ok(notice),
                None => bail!("`{}` has left", self.instance),
            }
        }
    }

    /// Gives the order to start, and waits until the program runs.
    async fn run(&mut self, activation: u32) -> anyhow::Result<()> {
        self.sender.send(&Order::Activate { activation, value: Vec::new(), since: now() })?;
        let notice = tokio::time::timeout(WITHIN, self.receiver.recv()).await??;
        ensure!(matches!(notice, Some(Notice::Running { .. })), "`{}` does not run: {notice:?}", self.instance);
        Ok(())
    }

    /// Tells the program to leave, and waits until it has closed its side.
    pub(crate) async fn leave(mut self) -> anyhow::Result<()> {
        self.sender.send(&Order::Exit)?;
        while tokio::time::timeout(WITHIN, self.receiver.recv()).await??.is_some() {}
        Ok(())
    }

    fn dial(&self) -> anyhow::Result<Dial> {
        let location = self.location.clone().context("it has no data session")?;
        Ok(Dial { session: location.session, locators: location.local })
    }
}

/// A program with an exported procedure, and a session for calls to it.
pub(crate) struct Callee {
    program: Program,
    child: Child,
    session: DataSession,
    made: u64,
}

impl Callee {
    pub(crate) async fn start(dir: &Path) -> anyhow::Result<Self> {
        let place = Place::new(dir)?;
        let child = place.start("Callee", "callee")?;
        let mut program = place.hello().await?;
        let connect =
            Order::Connect { robot: "bench".into(), incoming: Vec::new(), outgoing: Vec::new(), devices: Vec::new() };
        let connected = program.order(&connect).await?;
        ensure!(connected == Notice::Connected, "not connected: {connected:?}");
        program.run(1).await?;
        let dial = program.dial()?;
        let opening = tokio::task::spawn_blocking(move || {
            let session = DataSession::open_observer(None)?;
            session.dial(&dial, WITHIN)?;
            anyhow::Ok(session)
        });
        Ok(Self { program, child, session: opening.await??, made: 0 })
    }

    /// Measures `count` calls with `size` bytes, one after the other. It blocks.
    pub(crate) fn measure(&mut self, size: u32, count: u32, warm_up: u32) -> anyhow::Result<Vec<Duration>> {
        self.calls((count, warm_up), ("Echo", "Blob", "Blob"), |_| blob(size))
    }

    /// Measures `count` messages with `size` bytes to its queue, each until its receipt. It blocks.
    pub(crate) fn measure_queue(&mut self, size: u32, count: u32, warm_up: u32) -> anyhow::Result<Vec<Duration>> {
        let (category, sender, recipient) = ("bench".to_owned(), "bench".to_owned(), String::new());
        let header =
            Header { category, id: MessageId { life: 1, number: 0 }, sender, recipient, priority: 0, marker: 0 };
        let message = QueueMessage { header, type_name: "Blob".to_owned(), fence: None, data: blob(size) };
        self.calls((count, warm_up), ("Orders", "QueueMessage", "Receipt"), |number| {
            let mut message = message.clone();
            message.header.id.number = number;
            postcard::to_allocvec(&message).unwrap_or_default()
        })
    }

    fn calls(
        &mut self,
        (count, warm_up): (u32, u32),
        (name, argument_type, result_type): (&str, &str, &str),
        argument: impl Fn(u64) -> Vec<u8>,
    ) -> anyhow::Result<Vec<Duration>> {
        let keys = key::object("bench", "callee");
        let form = |name: &str| TypeForm { name: name.to_owned(), fields: String::new() };
        let mut times = Vec::new();
        for number in 0..count + warm_up {
            self.made += 1;
            let call = ObjectCall {
                id: CallId { session: self.session.id(), number: self.made },
                caller: "bench".into(),
                name: name.to_owned(),
                signature: Signature { argument: form(argument_type), result: form(result_type) },
                within: WITHIN,
                argument: Bytes(argument(self.made)),
                warrant: None,
            };
            let sent = now();
            let answer = self.session.call_and_wait(&keys, &CallWay::Open, &call)?;
            let took = now().since(sent);
            ensure!(name != "Echo" || answer == call.argument.0, "another answer");
            if number >= warm_up {
                times.push(took);
            }
        }
        Ok(times)
    }

    pub(crate) async fn end(self) -> anyhow::Result<()> {
        let Self { program, mut child, session, .. } = self;
        tokio::task::spawn_blocking(move || session.close()).await?;
        program.leave().await?;
        child.wait()?;
        Ok(())
    }
}

/// Returns bytes as a message: their length, followed by the bytes.
fn blob(size: u32) -> Vec<u8> {
    [postcard_length(size), vec![1; size as usize]].concat()
}

fn postcard_length(size: u32) -> Vec<u8> {
    let (mut left, mut bytes) = (size, Vec::new());
    loop {
        let low = u8::try_from(left & 0x7f).unwrap_or_default();
        left >>= 7;
        if left == 0 {
            bytes.push(low);
            return bytes;
        }
        bytes.push(low | 0x80);
    }
}

/// A ping and an echo as two programs, with wires in both directions.
#[derive(Debug)]
pub(crate) struct Pair {
    ping: Program,
    echo: Program,
    children: [Child; 2],
    activation: u32,
}

impl Pair {
    pub(crate) async fn start(dir: &Path) -> anyhow::Result<Self> {
        let place = Place::new(dir)?;
        let ping_child = place.start("Ping", "ping")?;
        let mut ping = place.hello().await?;
        let echo_child = place.start("Echo", "echo")?;
        let mut echo = place.hello().await?;
        let outgoing = |wire: u32| Outgoing { wire, port: "Out".into(), key: format!("hop/{wire}"), pull: false };
        let connect = |out: u32, producer: Dial| Order::Connect {
            robot: "bench".into(),
            incoming: vec![Incoming {
                wire: 1 - out,
                port: "In".into(),
                key: format!("hop/{}", 1 - out),
                producer,
                pull: false,
            }],
            outgoing: vec![outgoing(out)],
            devices: Vec::new(),
        };
        let (to_ping, to_echo) = (ping.dial()?, echo.dial()?);
        // Each waits for the other, so both get their orders before either has answered.
        let (to_ping, to_echo) = (connect(1, to_ping), connect(0, to_echo));
        let connected = tokio::try_join!(ping.order(&to_echo), echo.order(&to_ping))?;
        ensure!(connected == (Notice::Connected, Notice::Connected), "not connected: {connected:?}");
        ping.order(&Order::Open { wires: vec![0], generation: 1 }).await?;
        echo.order(&Order::Open { wires: vec![1], generation: 1 }).await?;
        echo.run(1).await?;
        Ok(Self { ping, echo, children: [ping_child, echo_child], activation: 0 })
    }

    /// Measures `count` round trips of `size` bytes.
    pub(crate) async fn measure(&mut self, size: u32, count: u32, warm_up: u32) -> anyhow::Result<Vec<Duration>> {
        self.activation += 1;
        let value = crate::programs::ping_value(size, count, warm_up);
        let notice = self.ping.order(&Order::Activate { activation: self.activation, value, since: now() }).await?;
        let Notice::Done { value, .. } = notice else { bail!("the ping is not done: {notice:?}") };
        Ok(crate::programs::times_of(&value))
    }

    pub(crate) async fn end(self) -> anyhow::Result<()> {
        self.ping.leave().await?;
        self.echo.leave().await?;
        for mut child in self.children {
            child.wait()?;
        }
        Ok(())
    }
}

/// Starts one program that sends and several that listen. Returns the samples of each listener.
pub(crate) async fn stream(dir: &Path, load: Load) -> anyhow::Result<Vec<Tally>> {
    let dir = dir.join("stream");
    std::fs::create_dir(&dir)?;
    let place = Place::new(&dir)?;
    let mut children = vec![place.start(if load.pause.is_zero() { "Flood" } else { "Shout" }, "sender")?];
    let mut sender = place.hello().await?;
    let mut listeners = Vec::new();
    for number in 0..load.listeners {
        children.push(place.start("Hear", &format!("listener{number}"))?);
        listeners.push(place.hello().await?);
    }
    let wires: Vec<u32> = (0..load.listeners).collect();
    let key = |wire: &u32| format!("stream/{wire}");
    let outgoing = |wire: &u32| Outgoing { wire: *wire, port: "Out".into(), key: key(wire), pull: false };
    let connect =
        |incoming, outgoing| Order::Connect { robot: "bench".into(), incoming, outgoing, devices: Vec::new() };
    // Each waits for the other, so all get their orders before one has answered.
    sender.sender.send(&connect(Vec::new(), wires.iter().map(outgoing).collect()))?;
    for (wire, listener) in wires.iter().zip(&mut listeners) {
        let port = "In".to_owned();
        let incoming = Incoming { wire: *wire, port, key: key(wire), producer: sender.dial()?, pull: false };
        listener.sender.send(&connect(vec![incoming], Vec::new()))?;
    }
    for program in listeners.iter_mut().chain([&mut sender]) {
        let connected = program.notice().await?;
        ensure!(connected == Notice::Connected, "not connected: {connected:?}");
    }
    for listener in &mut listeners {
        listener.run(1).await?;
    }
    sender.order(&Order::Open { wires, generation: 1 }).await?;
    let value = crate::programs::ping_value(load.size, load.count, 0);
    let sent = sender.order(&Order::Activate { activation: 1, value, since: now() }).await?;
    ensure!(matches!(sent, Notice::Done { .. }), "the sender is not done: {sent:?}");
    let mut tallies = Vec::new();
    for listener in &mut listeners {
        let notice = listener.notice().await?;
        let Notice::Done { value, .. } = notice else { bail!("a listener is not done: {notice:?}") };
        tallies.push(Tally::of(&value)?);
    }
    for program in listeners.into_iter().chain([sender]) {
        program.leave().await?;
    }
    for mut child in children {
        child.wait()?;
    }
    std::fs::remove_dir_all(&dir)?;
    Ok(tallies)
}
