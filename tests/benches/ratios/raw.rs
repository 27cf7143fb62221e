//! The machine and zenoh without DCA: pairs of processes that send bytes back and forth.

use crate::figures::Round;
use crate::programs::times_of;
use crate::raw_memory;
use anyhow::{Context, ensure};
use comms::io::clock::{Wakeup, now};
use std::io::{BufRead, BufReader, Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::time::Duration;
use zenoh::Wait;
use zenoh::bytes::ZBytes;
use zenoh::qos::{CongestionControl, Priority};

/// The transport between two processes.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Transport {
    /// A Unix socket with blocking reads and writes.
    Socket,
    /// Zenoh. At both ends, samples are passed to a thread, as in a program with its own loop.
    Zenoh,
    /// Like `Zenoh`, but each message is made from own bytes and received as bytes. Typed messages need this.
    ZenohBytes,
    /// Zenoh. Messages may share a batch, but do not wait for others. Samples of a wire travel in this way.
    ZenohShared,
    /// Zenoh. The answer is sent from the callback.
    ZenohCallback,
    /// A query of zenoh. A thread receives and answers it.
    ZenohQuery,
    /// Shared memory. Bytes are copied into it and out of it, and a Unix socket announces them.
    Memory,
}

impl Transport {
    fn word(self) -> &'static str {
        match self {
            Self::Socket => "socket",
            Self::Zenoh => "zenoh",
            Self::ZenohBytes => "zenoh-bytes",
            Self::ZenohShared => "zenoh-shared",
            Self::ZenohCallback => "zenoh-callback",
            Self::ZenohQuery => "zenoh-query",
            Self::Memory => "memory",
        }
    }

    fn parse(word: &str) -> Option<Self> {
        let all = [
            Self::Socket,
            Self::Zenoh,
            Self::ZenohBytes,
            Self::ZenohShared,
            Self::ZenohCallback,
            Self::ZenohQuery,
            Self::Memory,
        ];
        all.into_iter().find(|transport| transport.word() == word)
    }
}

/// Two processes. One measures round trips on request.
#[derive(Debug)]
pub(crate) struct Pair {
    ping: Child,
    echo: Child,
    asking: Option<ChildStdin>,
    answers: BufReader<ChildStdout>,
}

impl Pair {
    /// Starts both processes, with sockets in `dir`.
    pub(crate) fn start(transport: Transport, dir: &Path) -> anyhow::Result<Self> {
        let program = std::env::current_exe()?;
        let path = dir.join(transport.word());
        let start = |side: &str| {
            let arguments = ["raw", side, transport.word()];
            Command::new(&program).args(arguments).arg(&path).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn()
        };
        // The answering side listens, and prints a line once it does.
        let mut echo = start("echo")?;
        let mut said = String::new();
        BufReader::new(echo.stdout.take().context("no pipe")?).read_line(&mut said)?;
        let mut ping = start("ping")?;
        let (asking, answers) = (ping.stdin.take(), BufReader::new(ping.stdout.take().context("no pipe")?));
        Ok(Self { ping, echo, asking, answers })
    }

    /// Measures `count` round trips of `size` bytes, one after the other.
    pub(crate) fn measure(&mut self, size: u32, count: u32, warm_up: u32) -> anyhow::Result<Round> {
        self.measure_paced(size, count, warm_up, Duration::ZERO)
    }

    /// Measures like [`Self::measure`], with a rest before each round trip.
    pub(crate) fn measure_paced(
        &mut self,
        size: u32,
        count: u32,
        warm_up: u32,
        rest: Duration,
    ) -> anyhow::Result<Round> {
        let asking = self.asking.as_mut().context("the pair has ended")?;
        writeln!(asking, "{size} {count} {warm_up} {}", rest.as_micros())?;
        let mut times = vec![0; 8 * count as usize];
        self.answers.read_exact(&mut times).context("a raw pair ended")?;
        Round::of(times_of(&times)).context("no samples")
    }

    /// Ends both processes.
    pub(crate) fn end(mut self) -> anyhow::Result<()> {
        drop((self.asking.take(), self.echo.stdin.take()));
        ensure!(self.ping.wait()?.success() && self.echo.wait()?.success(), "a raw pair failed");
        Ok(())
    }
}

/// Runs one side of a pair, in a child process of the benchmark.
pub(crate) fn side(arguments: &[String]) -> anyhow::Result<()> {
    let [side, transport, path] = arguments else { anyhow::bail!("a side, a transport and a path are needed") };
    let (transport, path) = (Transport::parse(transport).context("no such transport")?, PathBuf::from(path));
    match (side.as_str(), transport) {
        ("echo", Transport::Socket) => echo_socket(&path),
        ("echo", Transport::Memory) => raw_memory::echo(&path),
        (_, Transport::Memory) => raw_memory::ping(&path),
        ("echo", Transport::ZenohQuery) => echo_query(&path),
        (_, Transport::ZenohQuery) => ping_query(&path),
        ("echo", _) => echo_zenoh(&path, transport),
        (_, Transport::Socket) => ping_socket(&path),
        (_, _) => ping_zenoh(&path, transport),
    }
}

pub(crate) fn ready() -> anyhow::Result<()> {
    Ok(std::io::stdout().write_all(b"ready\n")?)
}

/// Carries out all incoming orders.
pub(crate) fn obey(mut trip: impl FnMut(usize) -> anyhow::Result<Duration>) -> anyhow::Result<()> {
    for line in std::io::stdin().lines() {
        let numbers: Vec<usize> = line?.split(' ').filter_map(|word| word.parse().ok()).collect();
        let [size, count, warm_up, rest] = numbers[..] else { anyhow::bail!("four numbers are needed") };
        let (mut times, rest) = (Vec::new(), Duration::from_micros(u64::try_from(rest)?));
        for number in 0..count + warm_up {
            if !rest.is_zero() {
                Wakeup::default().wait(Some(now() + rest));
            }
            let time = trip(size)?;
            if number >= warm_up {
                times.extend(u64::try_from(time.as_nanos())?.to_le_bytes());
            }
        }
        let mut out = std::io::stdout().lock();
        out.write_all(&times)?;
        out.flush()?;
    }
    Ok(())
}

/// Echoes messages. A message is its length, followed by this number of bytes.
fn echo_socket(path: &Path) -> anyhow::Result<()> {
    let listener = UnixListener::bind(path)?;
    ready()?;
    let (mut stream, _) = listener.accept()?;
    let (mut bytes, mut got) = (vec![0; 16 << 20], 0);
    loop {
        let read = stream.read(&mut bytes[got..])?;
        if read == 0 {
            return Ok(());
        }
        got += read;
        let Some(length) = bytes.first_chunk() else { continue };
        let whole = 4 + u32::from_le_bytes(*length) as usize;
        if got >= 4 && got == whole {
            stream.write_all(&bytes[..whole])?;
            got = 0;
        }
    }
}

fn ping_socket(path: &Path) -> anyhow::Result<()> {
    let mut stream = UnixStream::connect(path)?;
    let mut answer = Vec::new();
    obey(|size| {
        let mut message = u32::try_from(size)?.to_le_bytes().to_vec();
        message.resize(4 + size, 1);
        answer.resize(message.len(), 0);
        let sent = now();
        stream.write_all(&message)?;
        stream.read_exact(&mut answer)?;
        Ok(now().since(sent))
    })
}

/// Opens a session with the transport and settings of a controller's data session.
pub(crate) fn open(listen: Option<&Path>, connect: Option<&Path>) -> anyhow::Result<zenoh::Session> {
    let mut config = zenoh::Config::default();
    let locator = |path: Option<&Path>| path.map(|path| format!("\"unixsock-stream/{}\"", path.display()));
    let list = |path: Option<&Path>| format!("[{}]", locator(path).unwrap_or_default());
    let settings = [
        ("mode", "\"peer\"".to_owned()),
        ("scouting/multicast/enabled", "false".to_owned()),
        ("scouting/gossip/enabled", "false".to_owned()),
        ("scouting/delay", "0".to_owned()),
        ("transport/link/tx/queue/batching/time_limit", "0".to_owned()),
        ("listen/endpoints", list(listen)),
        ("connect/endpoints", list(connect)),
    ];
    for (key, value) in settings {
        config.insert_json5(key, &value).map_err(|error| anyhow::anyhow!("{key}: {error}"))?;
    }
    #[expect(clippy::disallowed_methods, reason = "this is what DCA is compared with")]
    let opening = zenoh::open(config);
    opening.wait().map_err(|error| anyhow::anyhow!("{error}"))
}

pub(crate) fn publisher(
    session: &zenoh::Session,
    key: &'static str,
    transport: Transport,
) -> anyhow::Result<zenoh::pubsub::Publisher<'static>> {
    let publisher = session
        .declare_publisher(key)
        .congestion_control(CongestionControl::Drop)
        .priority(Priority::InteractiveHigh)
        .express(!matches!(transport, Transport::ZenohShared));
    publisher.wait().map_err(|error| anyhow::anyhow!("{error}"))
}

fn echo_zenoh(path: &Path, transport: Transport) -> anyhow::Result<()> {
    let session = open(Some(path), None)?;
    let failed = |error: zenoh::Error| anyhow::anyhow!("{error}");
    let answers = publisher(&session, "raw/answer", transport)?;
    let answer = move |payload: ZBytes| answers.put(payload).wait().unwrap_or_default();
    let asked = session.declare_subscriber("raw/ask");
    if matches!(transport, Transport::ZenohCallback) {
        let asked = asked.callback(move |sample| answer(sample.payload().clone())).background();
        asked.wait().map_err(failed)?;
    } else {
        let asked = asked.wait().map_err(failed)?;
        // Ends with the process.
        std::thread::spawn(move || {
            while let Ok(sample) = asked.recv() {
                answer(if matches!(transport, Transport::ZenohBytes) {
                    ZBytes::from(sample.payload().to_bytes().into_owned())
                } else {
                    sample.payload().clone()
                });
            }
        });
    }
    ready()?;
    std::io::stdin().read_to_end(&mut Vec::new())?;
    session.close().wait().map_err(failed)
}

fn ping_zenoh(path: &Path, transport: Transport) -> anyhow::Result<()> {
    let session = open(None, Some(path))?;
    let failed = |error: zenoh::Error| anyhow::anyhow!("{error}");
    let answers = session.declare_subscriber("raw/answer").wait().map_err(failed)?;
    let asks = publisher(&session, "raw/ask", transport)?;
    let (mut payload, mut bytes) = (ZBytes::new(), Vec::new());
    obey(|size| {
        if bytes.len() != size {
            bytes = vec![1; size];
            payload = ZBytes::from(bytes.clone());
        }
        let sent = now();
        loop {
            let copied = || ZBytes::from(bytes.clone());
            asks.put(if matches!(transport, Transport::ZenohBytes) { copied() } else { payload.clone() })
                .wait()
                .map_err(failed)?;
            // Nothing arrives before each side knows the other.
            if let Some(answer) = answers.recv_timeout(Duration::from_millis(200)).map_err(failed)? {
                if matches!(transport, Transport::ZenohBytes) {
                    bytes = answer.payload().to_bytes().into_owned();
                }
                return Ok(now().since(sent));
            }
        }
    })?;
    session.close().wait().map_err(failed)
}

fn echo_query(path: &Path) -> anyhow::Result<()> {
    let session = open(Some(path), None)?;
    let failed = |error: zenoh::Error| anyhow::anyhow!("{error}");
    let asked = session.declare_queryable("raw/query").complete(true).wait().map_err(failed)?;
    // Ends with the process.
    std::thread::spawn(move || {
        while let Ok(query) = asked.recv() {
            let bytes = query.payload().cloned().unwrap_or_default();
            query.reply(query.key_expr().clone(), bytes).express(true).wait().unwrap_or_default();
        }
    });
    ready()?;
    std::io::stdin().read_to_end(&mut Vec::new())?;
    session.close().wait().map_err(failed)
}

fn ping_query(path: &Path) -> anyhow::Result<()> {
    let session = open(None, Some(path))?;
    let failed = |error: zenoh::Error| anyhow::anyhow!("{error}");
    obey(|size| {
        let bytes = vec![1; size];
        loop {
            let sent = now();
            let asking = session.get("raw/query").payload(bytes.clone()).congestion_control(CongestionControl::Block);
            let answers = asking.priority(Priority::InteractiveLow).express(true).wait().map_err(failed)?;
            // Queries have no answer before the link is up.
            if let Ok(answer) = answers.recv()
                && answer.result().is_ok_and(|answer| answer.payload().len() == size)
            {
                return Ok(now().since(sent));
            }
        }
    })?;
    session.close().wait().map_err(failed)
}
