//! The producer's end of wires. Each outlet sends to one consumer, without waiting.

use super::memory::Filler;
use super::packet::{Sent, Waits, receive, send};
use super::pool::{Pool, leases_max};
use super::server::Shared;
use super::stranger::Consumer;
use crate::io::data::Listeners;
use crate::logic::direct::{Header, INLINE_MAX, SharedValue, released, retire};
use crate::logic::object::TypeForm;
use crate::logic::switch::Boundary;
use crate::logic::{codec, direct};
use std::collections::{BTreeSet, VecDeque};
use std::io;
use std::os::fd::OwnedFd;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// The bell asks a consumer with a busy loop to read waiting packets. It is rung after this many values, or this many
/// bytes.
const BELL_EVERY: u32 = 64;
const BELL_BYTES: usize = 64 << 10;
/// How many boundaries and releases wait for a consumer that does not read; a further one replaces the oldest.
const WORDS_MAX: usize = 256;

/// The producer's end of one wire. Dropping it ends the connection.
#[derive(Debug)]
pub struct Outlet {
    end: Arc<End>,
}

/// The shared memory of one output.
#[derive(Clone, Debug, Default)]
pub struct Memory(Arc<Mutex<Pool>>);

/// A value on its way to the consumers of one output.
#[derive(Debug)]
pub struct Parcel<'a> {
    /// The encoded value; empty if the value was encoded directly into the buffer.
    bytes: &'a [u8],
    size: usize,
    /// The buffer in which the value lies, once it was copied there.
    buffer: Option<u32>,
}

#[derive(Debug)]
pub(super) struct End {
    life: u32,
    memory: Memory,
    heard: Arc<Listeners>,
    connection: Mutex<Option<Connection>>,
    shared: Arc<Shared>,
}

/// The socket of one consumer.
#[derive(Debug)]
pub(super) struct Connection {
    pub(super) stream: Arc<OwnedFd>,
    pub(super) bell: OwnedFd,
    pub(super) form: TypeForm,
    /// How many values, and how many bytes of values, were sent since the last ring of the bell.
    unread: (u32, usize),
    words: VecDeque<Vec<u8>>,
    /// The buffers that the consumer has not released (`leased`), and the buffers whose files it has (`known`).
    leased: BTreeSet<u32>,
    known: BTreeSet<u32>,
}

impl Memory {
    /// Notes the length of a value: the next value is likely to be as long.
    pub fn note(&self, size: usize) {
        self.lock().size_last = size;
    }

    fn lock(&self) -> MutexGuard<'_, Pool> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<'a> Parcel<'a> {
    /// Returns a value that has not been sent yet.
    pub fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, size: bytes.len(), buffer: None }
    }

    /// Returns a value that `fill` encodes directly into the memory of its output, sized by the previous value. None if
    /// the previous value was short, `fill` found no room, or the memory is missing.
    pub fn filled(memory: &Memory, fill: impl FnOnce(&mut Filler<'_>) -> bool) -> Option<Self> {
        let mut pool = memory.lock();
        let room = pool.size_last;
        if room + direct::HEADER_SIZE <= INLINE_MAX {
            return None;
        }
        let (buffer, size) = pool.fill(room, fill).ok().flatten()?;
        pool.size_last = size;
        Some(Self { bytes: &[], size, buffer: Some(buffer) })
    }

    /// Returns a copy of its bytes, for consumers that do not share this memory.
    pub fn to_vec(&self, memory: &Memory) -> Vec<u8> {
        match self.buffer {
            Some(buffer) if self.bytes.is_empty() => memory.lock().read(buffer, self.size).unwrap_or_default(),
            _ => self.bytes.to_vec(),
        }
    }
}

impl Outlet {
    pub(super) fn new(end: Arc<End>) -> Self {
        Self { end }
    }

    /// Sends a value to the consumer; returns whether the consumer is connected. It never waits. A
    /// value that finds no room is lost, and the consumer counts it. Values over all wires of one
    /// program arrive in the order of these calls, except simultaneous calls.
    pub fn send(&self, parcel: &mut Parcel<'_>, number: u32) -> bool {
        let header = self.end.header(number);
        self.end.with(|connection| connection.value(header, parcel, &self.end.memory))
    }

    /// Sends a boundary between values, with the number of the previous value; returns whether the consumer is
    /// connected. A boundary without room waits, and is sent before any later value.
    pub fn mark(&self, boundary: &Boundary, number: u32) -> bool {
        let Ok(word) = codec::encode(boundary) else { return self.is_connected() };
        let packet = self.end.header(number).word(&word);
        let is_connected = self.end.with(|connection| connection.word(packet));
        if self.end.has_words() {
            self.end.shared.wake();
        }
        is_connected
    }

    /// Returns whether the consumer is connected.
    pub fn is_connected(&self) -> bool {
        self.end.lock().is_some()
    }

    /// Returns the consumer's type, if it is connected.
    pub fn form(&self) -> Option<TypeForm> {
        self.end.lock().as_ref().map(|connection| connection.form.clone())
    }
}

impl Drop for Outlet {
    fn drop(&mut self) {
        self.end.shared.remove(&self.end);
        self.end.end(&mut self.end.lock());
    }
}

impl End {
    pub(super) fn new(life: u32, memory: Memory, heard: Arc<Listeners>, shared: Arc<Shared>) -> Self {
        Self { life, memory, heard, connection: Mutex::default(), shared }
    }

    fn header(&self, number: u32) -> Header {
        Header { life: self.life, number, order: self.shared.orders.fetch_add(1, Ordering::Relaxed) }
    }

    /// Connects a consumer that has its answer, and replaces an earlier one.
    pub(super) fn attach(&self, new: Connection) {
        self.replace(&mut self.lock(), new);
    }

    /// Answers and connects a consumer, between two values. Replaces an earlier one.
    ///
    /// # Errors
    /// The consumer is gone.
    pub(super) fn welcome(&self, consumer: Consumer) -> io::Result<()> {
        let mut connection = self.lock();
        let new = consumer.welcome()?;
        self.replace(&mut connection, new);
        Ok(())
    }

    fn replace(&self, connection: &mut Option<Connection>, new: Connection) {
        if let Some(old) = connection.replace(new) {
            old.give_back(&self.memory);
        }
        self.heard.set_direct(true);
    }

    /// Returns the socket of the consumer, and whether messages wait for it.
    pub(super) fn stream(&self) -> Option<(Arc<OwnedFd>, bool)> {
        self.lock().as_ref().map(|connection| (Arc::clone(&connection.stream), !connection.words.is_empty()))
    }

    /// Sends the waiting messages.
    pub(super) fn flush(&self) {
        self.with(|connection| if connection.flush() == Sent::Gone { Sent::Gone } else { Sent::Whole });
    }

    /// Removes the consumer with this socket, which has ended.
    pub(super) fn ended(&self, stream: &Arc<OwnedFd>) {
        let mut connection = self.lock();
        if connection.as_ref().is_some_and(|connection| Arc::ptr_eq(&connection.stream, stream)) {
            self.end(&mut connection);
        }
    }

    fn end(&self, connection: &mut Option<Connection>) {
        if let Some(connection) = connection.take() {
            connection.give_back(&self.memory);
            self.heard.set_direct(false);
        }
    }

    fn has_words(&self) -> bool {
        self.lock().as_ref().is_some_and(|connection| !connection.words.is_empty())
    }

    /// Runs an action on the connection; returns whether the connection still exists.
    fn with(&self, act: impl FnOnce(&mut Connection) -> Sent) -> bool {
        let mut connection = self.lock();
        let Some(there) = connection.as_mut() else { return false };
        if act(there) != Sent::Gone {
            return true;
        }
        self.end(&mut connection);
        false
    }

    fn lock(&self) -> MutexGuard<'_, Option<Connection>> {
        self.connection.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Connection {
    pub(super) fn new(stream: Arc<OwnedFd>, bell: OwnedFd, form: TypeForm) -> Self {
        let (words, leased, known) = Default::default();
        Self { stream, bell, form, unread: (0, 0), words, leased, known }
    }

    fn value(&mut self, header: Header, parcel: &mut Parcel<'_>, memory: &Memory) -> Sent {
        match self.flush() {
            Sent::Whole => {}
            other @ (Sent::NoRoom | Sent::Gone) => return self.told(other, 0),
        }
        let size = parcel.size;
        if parcel.buffer.is_none() && size + direct::HEADER_SIZE <= INLINE_MAX {
            let sent = send(&self.stream, &[&header.value(), parcel.bytes], None);
            return self.told(sent, size);
        }
        let sent = self.share(header, parcel, &mut memory.lock());
        if self.leased.len() > 1 {
            self.ring();
        }
        self.told(sent, 0)
    }

    /// Sends a value in shared memory. The value is lost for a consumer that holds too many buffers.
    fn share(&mut self, header: Header, parcel: &mut Parcel<'_>, pool: &mut Pool) -> Sent {
        self.take_releases(pool);
        let size = parcel.size;
        let Ok(length) = u32::try_from(size) else { return Sent::NoRoom };
        if self.leased.len() >= leases_max(size) {
            return Sent::NoRoom;
        }
        let buffer = match parcel.buffer {
            Some(buffer) => buffer,
            None => match pool.put(parcel.bytes) {
                Ok(buffer) => *parcel.buffer.insert(buffer),
                Err(error) => {
                    tracing::warn!(%error, size, "there is no shared memory for a value");
                    return Sent::NoRoom;
                }
            },
        };
        self.retire(pool);
        let file = if self.known.contains(&buffer) { None } else { pool.file(buffer) };
        let packet = header.shared(SharedValue { buffer, size: length });
        let sent = send(&self.stream, &[&packet], file);
        if sent == Sent::Whole {
            pool.lease(buffer);
            self.known.insert(buffer);
            self.leased.insert(buffer);
        }
        sent
    }

    /// Tells the consumer which buffers are no longer used. If the socket has no room, the message is sent later.
    fn retire(&mut self, pool: &Pool) {
        let stream = &self.stream;
        self.known.retain(|buffer| pool.has(*buffer) || send(stream, &[&retire(*buffer)], None) != Sent::Whole);
    }

    fn take_releases(&mut self, pool: &mut Pool) {
        let mut packet = [0; 16];
        while let Ok((size @ 1.., _)) = receive(&self.stream, &mut packet, Waits::Never) {
            let buffer = packet.get(..size).and_then(released);
            if let Some(buffer) = buffer.filter(|buffer| self.leased.remove(buffer)) {
                pool.release(buffer);
            }
        }
    }

    fn word(&mut self, packet: Vec<u8>) -> Sent {
        let sent = match self.flush() {
            Sent::Whole => send(&self.stream, &[&packet], None),
            other @ (Sent::NoRoom | Sent::Gone) => other,
        };
        if sent == Sent::NoRoom {
            if self.words.len() >= WORDS_MAX {
                self.words.pop_front();
            }
            self.words.push_back(packet);
        }
        self.told(sent, 0)
    }

    /// Sends the waiting messages; returns `Whole` if none is left.
    fn flush(&mut self) -> Sent {
        while let Some(packet) = self.words.front() {
            match send(&self.stream, &[packet], None) {
                Sent::Whole => drop(self.words.pop_front()),
                other @ (Sent::NoRoom | Sent::Gone) => return other,
            }
        }
        Sent::Whole
    }

    /// Rings the bell if enough was sent, so that the consumer reads its socket even while its loop is busy.
    fn told(&mut self, sent: Sent, size: usize) -> Sent {
        let (count, bytes) = &mut self.unread;
        (*count, *bytes) = (*count + 1, *bytes + size);
        if sent == Sent::NoRoom || *count >= BELL_EVERY || *bytes >= BELL_BYTES {
            self.ring();
        }
        sent
    }

    fn ring(&mut self) {
        self.unread = (0, 0);
        // The write fails only when the counter overflows, after an endless number of unread rings.
        rustix::io::write(&self.bell, &1_u64.to_ne_bytes()).unwrap_or_default();
    }

    fn give_back(mut self, memory: &Memory) {
        let mut pool = memory.lock();
        self.take_releases(&mut pool);
        self.leased.iter().for_each(|buffer| pool.abandon(*buffer));
    }
}
