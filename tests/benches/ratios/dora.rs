//! A hop between two nodes of dora, with its Python package. The same bytes travel there and back, and the
//! measurements alternate with the others of the run. The nodes are Python programs, so the figures include the time
//! of the interpreter.

use crate::figures::Round;
use anyhow::{Context, bail};
use comms::io::clock::{Wakeup, now};
use std::io::{BufRead, BufReader, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

/// The longest time for dora to start its nodes, and for a node to answer.
const WITHIN: Duration = Duration::from_secs(120);

/// On a request over a socket, sends messages. It answers with the round-trip time of each in nanoseconds.
const PING: &str = r#"
import os, socket, time
import pyarrow
from dora import Node

node = Node()
asked = socket.socket(socket.AF_UNIX)
asked.connect(os.environ["ASKED"])
for line in asked.makefile():
    size, count, warm_up = map(int, line.split())
    data = pyarrow.Array.from_buffers(pyarrow.uint8(), size, [None, pyarrow.py_buffer(bytes(size))])
    times = []
    for _ in range(count + warm_up):
        sent = time.monotonic_ns()
        node.send_output("out", data)
        while node.next()["type"] != "INPUT":
            pass
        times.append(time.monotonic_ns() - sent)
    asked.sendall((" ".join(map(str, times[warm_up:])) + "\n").encode())
"#;

const ECHO: &str = r#"
from dora import Node

node = Node()
for event in node:
    if event["type"] == "INPUT":
        node.send_output("out", event["value"])
"#;

const FLOW: &str = r"
nodes:
  - { id: ping, path: ping.py, env: { ASKED: SOCKET }, inputs: { back: echo/out }, outputs: [out] }
  - { id: echo, path: echo.py, inputs: { there: ping/out }, outputs: [out] }
";

/// Two nodes of dora.
#[derive(Debug)]
pub(crate) struct Pair {
    child: Child,
    ping: BufReader<UnixStream>,
}

impl Pair {
    /// Starts both nodes; returns none if dora is not installed.
    pub(crate) fn start(dir: &Path) -> anyhow::Result<Option<Self>> {
        let works = |program: &str, arguments: &[&str]| {
            let mut command = Command::new(program);
            command.args(arguments).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
            command.status().is_ok_and(|status| status.success())
        };
        if !works("dora", &["--version"]) || !works("python3", &["-c", "import dora, pyarrow"]) {
            return Ok(None);
        }
        let dir = dir.join("dora");
        let socket = dir.join("asked");
        std::fs::create_dir(&dir)?;
        let flow = FLOW.replace("SOCKET", &socket.display().to_string());
        for (name, text) in [("ping.py", PING), ("echo.py", ECHO), ("flow.yml", &flow)] {
            std::fs::write(dir.join(name), text)?;
        }
        let listener = UnixListener::bind(&socket)?;
        listener.set_nonblocking(true)?;
        let mut command = Command::new("dora");
        command.args(["run", "flow.yml"]).current_dir(&dir).env("RUST_LOG", "error");
        let mut child = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn()?;
        let until = now() + WITHIN;
        let stream = loop {
            match listener.accept() {
                Ok((stream, _)) => break stream,
                Err(error) if error.kind() != std::io::ErrorKind::WouldBlock => return Err(error.into()),
                Err(_) if child.try_wait()?.is_some() => bail!("dora has ended"),
                Err(_) if now() > until => {
                    child.kill()?;
                    bail!("dora's node does not come");
                }
                Err(_) => drop(Wakeup::default().wait(Some(now() + Duration::from_millis(20)))),
            }
        };
        stream.set_nonblocking(false)?;
        stream.set_read_timeout(Some(WITHIN))?;
        Ok(Some(Self { child, ping: BufReader::new(stream) }))
    }

    /// Measures `count` round trips of `size` bytes.
    pub(crate) fn measure(&mut self, size: u32, count: u32, warm_up: u32) -> anyhow::Result<Round> {
        writeln!(self.ping.get_mut(), "{size} {count} {warm_up}")?;
        let mut line = String::new();
        self.ping.read_line(&mut line)?;
        let nanos: Result<Vec<u64>, _> = line.split_whitespace().map(str::parse).collect();
        Round::of(nanos?.into_iter().map(Duration::from_nanos).collect()).context("dora's node has ended")
    }

    /// Ends both nodes, which also ends dora.
    pub(crate) fn end(mut self) -> anyhow::Result<()> {
        drop(self.ping);
        self.child.wait()?;
        Ok(())
    }
}
