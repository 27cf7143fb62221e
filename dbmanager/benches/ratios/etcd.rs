//! A single etcd node on the loopback interface, reached through its JSON gateway on one connection.

use crate::Failure;
use comms::io::clock::{self, Wakeup};
use std::io::{BufRead, BufReader, ErrorKind, Read, Write};
use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

/// How long etcd may take to start.
const START_WITHIN: Duration = Duration::from_secs(20);
/// The pause between two attempts to connect.
const ASK_AGAIN_AFTER: Duration = Duration::from_millis(20);
/// How long one answer may take.
const ANSWER_WITHIN: Duration = Duration::from_secs(5);

/// A running etcd.
pub(crate) struct Etcd {
    child: Child,
    connection: BufReader<TcpStream>,
}

impl Etcd {
    /// Starts etcd in a folder; `None` if it is not installed.
    pub(crate) fn start(folder: &Path) -> Result<Option<Self>, Failure> {
        let url = |port: u16| format!("http://127.0.0.1:{port}");
        // Both ports are free now. If another process takes one before etcd does, etcd does not start.
        let (client, peer) = (free_port()?, free_port()?);
        let mut command = Command::new("etcd");
        command.arg("--data-dir").arg(folder).args(["--name", "bench", "--log-level", "error"]);
        command.args(["--listen-client-urls", &url(client), "--advertise-client-urls", &url(client)]);
        command.args(["--listen-peer-urls", &url(peer), "--initial-advertise-peer-urls", &url(peer)]);
        command.args(["--initial-cluster", &format!("bench={}", url(peer))]);
        let mut child = match command.stdout(Stdio::null()).stderr(Stdio::null()).spawn() {
            Ok(child) => child,
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(error.into()),
        };
        let until = clock::now() + START_WITHIN;
        loop {
            match connect(client) {
                Ok(connection) => return Ok(Some(Self { child, connection })),
                Err(_) if clock::now() < until && child.try_wait()?.is_none() => {
                    Wakeup::default().wait(Some(clock::now() + ASK_AGAIN_AFTER));
                }
                Err(error) => {
                    child.kill()?;
                    child.wait()?;
                    return Err(format!("etcd did not start: {error}").into());
                }
            }
        }
    }

    /// Puts a value, which is on the disk when this returns.
    pub(crate) fn put(&mut self, key: &str, value: &[u8]) -> Result<(), Failure> {
        put(&mut self.connection, key, value)
    }

    /// Ends etcd.
    pub(crate) fn end(mut self) -> Result<(), Failure> {
        self.child.kill()?;
        self.child.wait()?;
        Ok(())
    }
}

fn free_port() -> Result<u16, Failure> {
    Ok(TcpListener::bind((Ipv4Addr::LOCALHOST, 0))?.local_addr()?.port())
}

/// Connects, and puts a first value, which succeeds only once etcd has a leader.
fn connect(port: u16) -> Result<BufReader<TcpStream>, Failure> {
    let stream = TcpStream::connect((Ipv4Addr::LOCALHOST, port))?;
    stream.set_nodelay(true)?;
    stream.set_read_timeout(Some(ANSWER_WITHIN))?;
    let mut connection = BufReader::new(stream);
    put(&mut connection, "first", b"")?;
    Ok(connection)
}

fn put(connection: &mut BufReader<TcpStream>, key: &str, value: &[u8]) -> Result<(), Failure> {
    let body = format!(r#"{{"key":"{}","value":"{}"}}"#, base64(key.as_bytes()), base64(value));
    let head = format!("POST /v3/kv/put HTTP/1.1\r\nHost: localhost\r\nContent-Length: {}\r\n\r\n", body.len());
    connection.get_mut().write_all(format!("{head}{body}").as_bytes())?;
    let (mut line, mut length) = (String::new(), 0);
    connection.read_line(&mut line)?;
    if !line.starts_with("HTTP/1.1 200") {
        return Err(format!("etcd answered `{}`", line.trim()).into());
    }
    while line.trim() != "" {
        line.clear();
        connection.read_line(&mut line)?;
        if let Some(number) = line.to_ascii_lowercase().strip_prefix("content-length:") {
            length = number.trim().parse()?;
        }
    }
    connection.read_exact(&mut vec![0; length])?;
    Ok(())
}

/// Returns the bytes in base64. Source: RFC 4648.
fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::new();
    for chunk in bytes.chunks(3) {
        let bits = chunk.iter().fold(0_usize, |bits, byte| bits << 8 | usize::from(*byte)) << (8 * (3 - chunk.len()));
        for digit in 0..4 {
            let index = bits >> (18 - 6 * digit) & 63;
            text.push(if digit <= chunk.len() { char::from(DIGITS[index]) } else { '=' });
        }
    }
    text
}
