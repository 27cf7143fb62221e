//! One connection of a browser: a file of the page, the stream of changes, or an order.

use super::database::Lookup;
use super::output::{self, Output, OutputChoice};
use super::parameters;
use super::ways::WaysRequest;
use crate::logic::http::{self, Door, Entry, Head, Status};
use crate::logic::live_page::{self, Asked, ICON, MISSIONS, PARTS, Past, SCRIPT};
use comms::io::clock;
use rustix::net::{RecvFlags, recv};
use serde_json::{Value, json};
use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tokio::sync::{mpsc, oneshot, watch};
use tokio::time::timeout;
use view::{Model, Position};

/// How long a browser has for its request.
pub(super) const REQUEST_WITHIN: Duration = Duration::from_secs(10);
/// How long a browser may take for a piece of the stream before its connection is closed. The browser resumes with another connection.
const TAKEN_WITHIN: Duration = Duration::from_secs(20);
/// How often the stream has a message, even if nothing has changed.
const BEAT_EVERY: Duration = Duration::from_secs(1);
/// How long after one message the next may come.
const AGAIN_AFTER: Duration = Duration::from_millis(200);
/// How long an order may take.
pub(super) const ORDER_WITHIN: Duration = Duration::from_secs(60);

const TEXT: &str = "text/plain; charset=utf-8";
const JSON: &str = "application/json";

/// An order of the page.
pub(super) struct Order {
    pub(super) path: String,
    pub(super) body: Value,
    /// Gets a word about the result.
    pub(super) reply: oneshot::Sender<String>,
}

/// The parts that all connections share.
pub(super) struct Shared {
    pub(super) door: Door,
    pub(super) model: Arc<Mutex<Model>>,
    /// Changes with each input of the model.
    pub(super) version: watch::Receiver<u64>,
    pub(super) orders: mpsc::Sender<Order>,
    pub(super) ways: mpsc::Sender<WaysRequest>,
}

/// Tells whether a connection has shown the key.
#[derive(Debug, Default)]
pub(super) struct Guest(AtomicBool);

impl Guest {
    /// Takes note that it has been let in.
    pub(super) fn let_in(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    pub(super) fn is_known(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

impl Shared {
    pub(super) fn model(&self) -> MutexGuard<'_, Model> {
        self.model.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Answers one request. A browser that leaves or sends nonsense ends only its own connection.
pub(super) async fn connection(mut stream: TcpStream, shared: Arc<Shared>, guest: Arc<Guest>) {
    let request = timeout(REQUEST_WITHIN, request(&mut stream)).await;
    let answered = match request {
        Ok(Ok(Ok((head, body)))) => {
            let entry = shared.door.check(&head);
            guest.0.store(entry.is_ok(), Ordering::Relaxed);
            answer(&mut stream, &shared, entry, &head, &body).await
        }
        Ok(Ok(Err(status))) => refuse(&mut stream, status).await,
        Ok(Err(_)) | Err(_) => return,
    };
    if answered.is_ok() {
        stream.shutdown().await.unwrap_or_default();
    }
}

/// Reads a request: its head and its body.
pub(super) async fn request(stream: &mut TcpStream) -> io::Result<Result<(Head, Vec<u8>), Status>> {
    let mut bytes = Vec::new();
    let (head, begin) = loop {
        let mut chunk = [0; 2048];
        let count = stream.read(&mut chunk).await?;
        if count == 0 {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        bytes.extend_from_slice(&chunk[..count]);
        match http::head(&bytes) {
            Ok(Some(whole)) => break whole,
            // A head that is too long is an error.
            Ok(None) => {}
            Err(status) => return Ok(Err(status)),
        }
    };
    let mut body = bytes.split_off(begin);
    body.truncate(head.length);
    let begun = body.len();
    body.resize(head.length, 0);
    stream.read_exact(&mut body[begun..]).await?;
    Ok(Ok((head, body)))
}

async fn refuse(stream: &mut TcpStream, status: Status) -> io::Result<()> {
    let is_without_link = status == Status::Forbidden;
    let link = "this page opens with the link that `dca view --page` has printed";
    let text = format!("{}\n", if is_without_link { link } else { status.line() });
    stream.write_all(&http::answer(status, TEXT, "", text.as_bytes())).await
}

async fn answer(
    stream: &mut TcpStream,
    shared: &Shared,
    entry: Result<Entry, Status>,
    head: &Head,
    body: &[u8],
) -> io::Result<()> {
    match entry {
        Err(status) => return refuse(stream, status).await,
        Ok(Entry::Link) => return stream.write_all(&shared.door.welcome()).await,
        Ok(Entry::Granted) => {}
    }
    let (kind, file) = match (head.is_post, head.path.as_str()) {
        (false, "/") => ("text/html; charset=utf-8", live_page::page(&shared.door.token)),
        (false, "/page.css") => ("text/css; charset=utf-8", live_page::style()),
        (false, "/page.js") => ("text/javascript; charset=utf-8", SCRIPT.to_owned()),
        (false, "/missions.js") => ("text/javascript; charset=utf-8", MISSIONS.to_owned()),
        (false, "/parts.js") => ("text/javascript; charset=utf-8", PARTS.to_owned()),
        (false, "/picture" | "/timeline") => match drawn(shared, head).await {
            Some(drawn) => (JSON, drawn),
            None => return refuse(stream, Status::BadRequest).await,
        },
        (false, "/icon.svg") => ("image/svg+xml", ICON.to_owned()),
        (false, "/events") => return events(stream, shared, head).await,
        // A person who was not answered has given up, and does not expect it any more.
        (true, _) if is_left(stream) => return Ok(()),
        (true, "/estop" | "/release" | "/answer" | "/parameter") => (TEXT, order(shared, head, body).await),
        (true, "/database") => match lookup(shared, body).await {
            Some(found) => (JSON, found),
            None => return refuse(stream, Status::BadRequest).await,
        },
        (true, "/parameters") => match parameters(shared).await {
            Some(found) => (JSON, found),
            None => return refuse(stream, Status::Busy).await,
        },
        (_, _) => return stream.write_all(&http::answer(Status::NotFound, TEXT, "", b"there is no such page\n")).await,
    };
    stream.write_all(&http::answer(Status::Ok, kind, "", file.as_bytes())).await
}

/// Asks all robots for their parameters. Returns nothing if the view ends.
async fn parameters(shared: &Shared) -> Option<String> {
    let ways = WaysRequest::send(&shared.ways, None).await?;
    let homes = parameters::homes(&shared.model());
    Some(parameters::list(ways, homes).await.to_string())
}

/// Asks the database of a robot. Returns nothing if the question cannot be read, or if the view ends.
async fn lookup(shared: &Shared, body: &[u8]) -> Option<String> {
    let body = serde_json::from_slice(body).ok()?;
    let lookup = match Lookup::read(&body, &shared.model()) {
        Ok(lookup) => lookup,
        Err(why) => return Some(json!({ "why": why }).to_string()),
    };
    let ways = WaysRequest::send(&shared.ways, Some(lookup.robot.clone())).await?;
    Some(lookup.ask(ways).await.to_string())
}

/// Returns a picture or a timeline. None if the query cannot be read.
async fn drawn(shared: &Shared, head: &Head) -> Option<String> {
    let asked: Asked = head.query.parse().ok()?;
    // Drawing takes a while, so it is done without the model, and beside the connections.
    let drawing = if head.path == "/picture" {
        let plan = asked.find(&shared.model()).map(|(_, plan)| plan);
        tokio::task::spawn_blocking(move || live_page::picture(asked, plan.as_deref()).to_string())
    } else {
        let past = Past::new(asked, &shared.model(), clock::now());
        tokio::task::spawn_blocking(move || live_page::timeline(past.as_ref()).to_string())
    };
    drawing.await.ok()
}

/// Returns whether the browser has closed its connection. The kernel is asked, because the runtime may not have noticed the end yet.
fn is_left(stream: &TcpStream) -> bool {
    matches!(recv(stream, &mut [0], RecvFlags::PEEK | RecvFlags::DONTWAIT), Ok((_, 0)))
}

async fn order(shared: &Shared, head: &Head, body: &[u8]) -> String {
    let Ok(body) = serde_json::from_slice::<Value>(body) else { return "this order cannot be read".to_owned() };
    let (reply, word) = oneshot::channel();
    let order = Order { path: head.path.clone(), body, reply };
    let given = async {
        shared.orders.send(order).await.ok()?;
        word.await.ok()
    };
    match timeout(ORDER_WITHIN, given).await {
        Ok(Some(word)) => word,
        Ok(None) => "the order was not carried out, because the view ends".to_owned(),
        Err(_) => {
            format!("no result within {} s; the robots below show whether they are stopped", ORDER_WITHIN.as_secs())
        }
    }
}

/// Sends the changes since a position, and then each further one, and the output of a process if the window shows one.
async fn events(stream: &mut TcpStream, shared: &Shared, head: &Head) -> io::Result<()> {
    let field = |name: &str| head.query.split('&').find_map(|one| one.strip_prefix(name)?.strip_prefix('='));
    // A browser that reconnects by itself tells the position in its field, and a script that opens a new stream in the query.
    let in_query = field("after").unwrap_or_default();
    let last = if head.last_event_id.is_empty() { in_query } else { &head.last_event_id };
    let (mut version, mut position) = (shared.version.clone(), last.parse().unwrap_or(Position::default()));
    let choice = field("output").and_then(OutputChoice::read);
    let mut output = choice.clone().and_then(|choice| Output::begin(choice, &shared.model(), &shared.ways));
    let mut gone = choice.filter(|_| output.is_none()).map(|_| output::gone());
    stream.write_all(&http::stream()).await?;
    loop {
        version.mark_unchanged();
        let news = output.as_mut().and_then(Output::news).or_else(|| gone.take());
        let (next, message) = message(&shared.model(), position, news);
        position = next;
        let sent = timeout(TAKEN_WITHIN, stream.write_all(&message)).await;
        sent.unwrap_or_else(|_| Err(io::ErrorKind::TimedOut.into()))?;
        let sent_at = clock::now();
        tokio::select! {
            () = clock::sleep_until(sent_at + BEAT_EVERY) => {}
            () = changed(output.as_mut()) => clock::sleep_until(sent_at + AGAIN_AFTER).await,
            changed = version.changed() => match changed {
                Ok(()) => clock::sleep_until(sent_at + AGAIN_AFTER).await,
                // The view ends.
                Err(_) => return Ok(()),
            },
        }
    }
}

/// Waits until there is something new of an output. Without an output, waits for ever.
async fn changed(output: Option<&mut Output>) {
    match output {
        Some(output) => output.changed().await,
        None => std::future::pending().await,
    }
}

fn message(model: &Model, position: Position, output: Option<Value>) -> (Position, Vec<u8>) {
    let (changes, now) = (model.since(position), clock::now());
    let mut data = match changes.is_empty() {
        true => json!({ "ages": live_page::ages(model, now) }),
        false => live_page::changes(model, &changes, now),
    };
    if let Some(output) = output {
        data["output"] = output;
    }
    (changes.position, http::event(&changes.position.to_string(), &data.to_string()))
}
