//! The consumer's end of wires, and the wait of the loop that reads them. The loop wakes for a value, a call of another
//! thread or a deadline.

use super::loan::{Loan, Return, Value};
use super::memory::Mapping;
use super::packet::{Waits, receive};
use crate::io::clock::now;
use crate::logic::codec::{self, Enveloped};
use crate::logic::direct::{Frame, HEADER_SIZE, Header, INLINE_MAX, SharedValue};
use crate::logic::switch::{Arrival, Boundary, Sequence};
use crate::logic::time::Time;
use rustix::event::{EventfdFlags, PollFd, PollFlags, Timespec, eventfd, poll};
use rustix::io::Errno;
use rustix::net::{Shutdown, shutdown};
use std::collections::{BTreeMap, VecDeque};
use std::fmt;
use std::io;
use std::os::fd::OwnedFd;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

/// How many packets of one wire are read at once, so that a fast producer does not delay the other wires. A queue of
/// the usual size has no room for more packets; they stay in the socket until the loop has taken some.
const PACKETS_MAX: usize = 64;
/// How many packets are read when the bell has rung because a loop is busy: more than a socket has room for.
const PACKETS_OF_BELL: usize = 1024;
/// The longest packet.
const PACKET_SIZE: usize = HEADER_SIZE + if INLINE_MAX > Boundary::SIZE_MAX { INLINE_MAX } else { Boundary::SIZE_MAX };

/// Takes the arrivals on a wire.
type OnArrival = Box<dyn FnMut(Arrival<Value>, Sequence) + Send>;

/// The consumer's ends of all wires of a program.
#[derive(Debug)]
pub struct Inlets {
    /// Readable when another thread has called the waiting thread.
    doorbell: OwnedFd,
    is_called: AtomicBool,
    is_waiting: AtomicBool,
    set: Mutex<Set>,
}

/// The consumer's end of one wire. Dropping it ends the connection, and no value arrives afterwards.
#[derive(Debug)]
pub struct Inlet {
    number: u64,
    inlets: Arc<Inlets>,
}

#[derive(Debug)]
struct Set {
    wires: BTreeMap<u64, Wire>,
    next: u64,
    packet: Vec<u8>,
}

struct Wire {
    stream: Arc<OwnedFd>,
    process: u128,
    /// Whether its producer has no other wire to this program. The values of such a wire arrive in order by themselves.
    is_alone: bool,
    /// Packets that are read but not taken yet, because earlier values of the same producer over other wires come
    /// first.
    packets: VecDeque<Packet>,
    /// The position, in the producer's order, of the value that was read last.
    order: u64,
    mappings: BTreeMap<u32, Arc<Mapping>>,
    /// The last value in the producer's memory that the loop had not taken when the wire was last read.
    loaned: Weak<Loan>,
    on_arrival: OnArrival,
    has_ended: bool,
}

/// A packet that waits for its turn.
struct Packet {
    order: u64,
    bytes: Vec<u8>,
    file: Option<OwnedFd>,
}

impl fmt::Debug for Wire {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Wire").field("stream", &self.stream).field("has_ended", &self.has_ended).finish_non_exhaustive()
    }
}

impl Inlets {
    /// Returns an empty set.
    ///
    /// # Errors
    /// The process has too many open files.
    pub(super) fn new() -> io::Result<Self> {
        let doorbell = eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK)?;
        let set = Mutex::new(Set { wires: BTreeMap::new(), next: 0, packet: vec![0; PACKET_SIZE] });
        Ok(Self { doorbell, is_called: AtomicBool::new(false), is_waiting: AtomicBool::new(false), set })
    }

    /// Ends the present wait, or the next one if there is none.
    pub fn wake(&self) {
        self.is_called.store(true, Ordering::SeqCst);
        if self.is_waiting.load(Ordering::SeqCst) {
            // The write fails only when the counter overflows, after an endless number of rings.
            rustix::io::write(&self.doorbell, &1_u64.to_ne_bytes()).unwrap_or_default();
        }
    }

    /// Waits for an arrival, a call of another thread, or the time `until`; without a time, for ever. Arrivals are
    /// read. Only one thread may wait. Returns whether everything that had arrived is read.
    pub fn wait(&self, until: Option<Time>) -> bool {
        loop {
            self.is_waiting.store(true, Ordering::SeqCst);
            if self.is_called.swap(false, Ordering::SeqCst) {
                self.is_waiting.store(false, Ordering::SeqCst);
                return false;
            }
            let streams = self.streams();
            let ready = self.poll(&streams, until);
            self.is_waiting.store(false, Ordering::SeqCst);
            if ready.is_called {
                // After an error here, the descriptor is also no longer readable.
                rustix::io::read(&self.doorbell, &mut [0; 8]).unwrap_or_default();
            }
            if ready.has_arrived {
                let has_more = self.lock().read(PACKETS_MAX);
                // A thread that calls now finds this thread awake: it is about to look at everything.
                self.is_called.store(has_more, Ordering::SeqCst);
                return true;
            }
            if until.is_some_and(|until| until <= now()) {
                return true;
            }
        }
    }

    /// Reads the packets that have arrived, without waiting.
    pub fn read(&self) {
        self.read_most(PACKETS_MAX);
    }

    /// Reads arrivals for a busy loop. They wait in the loop's queues, as long as these have room.
    pub(super) fn read_for_loop(&self) {
        self.read_most(PACKETS_OF_BELL);
    }

    fn read_most(&self, count_max: usize) {
        if self.lock().read(count_max) {
            self.wake();
        }
    }

    /// Takes a connection. If it replaces another connection, the values sent over the old one come first.
    pub(super) fn add(
        self: &Arc<Self>,
        stream: OwnedFd,
        process: u128,
        replaced: Option<Inlet>,
        on_arrival: OnArrival,
    ) -> Inlet {
        let mut set = self.lock();
        if let Some(before) = replaced.as_ref().and_then(|replaced| set.wires.get(&replaced.number)) {
            let process = before.process;
            set.read_process(process, usize::MAX);
        }
        let number = set.add(Wire::new(stream, process, on_arrival));
        drop(set);
        self.wake();
        Inlet { number, inlets: Arc::clone(self) }
    }

    fn streams(&self) -> Vec<Arc<OwnedFd>> {
        let set = self.lock();
        set.wires.values().filter(|wire| !wire.has_ended).map(|wire| Arc::clone(&wire.stream)).collect()
    }

    fn poll(&self, streams: &[Arc<OwnedFd>], until: Option<Time>) -> Ready {
        let mut ready = Vec::with_capacity(streams.len() + 1);
        ready.push(PollFd::new(&self.doorbell, PollFlags::IN));
        ready.extend(streams.iter().map(|stream| PollFd::new(stream, PollFlags::IN)));
        let left = until.map(|until| {
            let left = until.since(now());
            Timespec { tv_sec: i64::try_from(left.as_secs()).unwrap_or(i64::MAX), tv_nsec: left.subsec_nanos().into() }
        });
        if poll(&mut ready, left.as_ref()).is_err() {
            // A signal has interrupted the wait, or the system had no memory for a moment.
            return Ready { is_called: false, has_arrived: false };
        }
        let mut is_ready = ready.iter().map(|one| !one.revents().is_empty());
        Ready { is_called: is_ready.next() == Some(true), has_arrived: is_ready.any(|is_ready| is_ready) }
    }

    fn lock(&self) -> MutexGuard<'_, Set> {
        self.set.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

struct Ready {
    is_called: bool,
    has_arrived: bool,
}

impl Drop for Inlet {
    fn drop(&mut self) {
        self.inlets.lock().remove(self.number);
        self.inlets.wake();
    }
}

impl Set {
    fn add(&mut self, wire: Wire) -> u64 {
        self.next += 1;
        self.wires.insert(self.next, wire);
        self.count_processes();
        self.next
    }

    fn remove(&mut self, number: u64) {
        if let Some(wire) = self.wires.remove(&number) {
            // The waiting thread may hold the socket for a while.
            shutdown(&wire.stream, Shutdown::Both).unwrap_or_default();
        }
        self.count_processes();
    }

    fn count_processes(&mut self) {
        let mut counts = BTreeMap::<u128, usize>::new();
        self.wires.values().for_each(|wire| *counts.entry(wire.process).or_default() += 1);
        for wire in self.wires.values_mut() {
            wire.is_alone = counts.get(&wire.process) == Some(&1);
        }
    }

    /// Reads at most `count_max` packets of each wire. Returns whether packets may remain that no socket will report.
    fn read(&mut self, count_max: usize) -> bool {
        let (mut has_more, mut others) = (false, Vec::new());
        for wire in self.wires.values_mut() {
            if wire.is_alone {
                wire.read(&mut self.packet, count_max);
            } else if !others.contains(&wire.process) {
                others.push(wire.process);
            }
        }
        for process in others {
            has_more |= self.read_process(process, count_max);
        }
        has_more
    }

    /// Reads several wires of one producer, in the order in which the producer has sent. Returns whether packets were
    /// read that still wait for their turn.
    ///
    /// Two passes over all sockets are needed. While the first pass reads one socket, a value may reach another socket
    /// that the pass has already read, and the pass may then read a later value elsewhere. The second pass reads the
    /// missed value. So everything sent up to the last packet of the first pass is here, unless a socket has more
    /// packets than are read at once.
    fn read_process(&mut self, process: u128, count_max: usize) -> bool {
        let mut wires: Vec<&mut Wire> = self.wires.values_mut().filter(|wire| wire.process == process).collect();
        let mut capped: Vec<bool> = wires.iter_mut().map(|wire| wire.fetch(&mut self.packet, count_max)).collect();
        let last = wires.iter().map(|wire| wire.order).max().unwrap_or(0);
        for (wire, capped) in wires.iter_mut().zip(&mut capped).filter(|(_, capped)| !**capped) {
            *capped = wire.fetch(&mut self.packet, count_max);
        }
        let behind = wires.iter().zip(&capped).filter(|(_, capped)| **capped).map(|(wire, _)| wire.order);
        let complete = behind.chain([last]).min().unwrap_or(last);
        loop {
            let next = wires.iter_mut().filter_map(|wire| Some((wire.packets.front()?.order, wire)));
            match next.min_by_key(|(order, _)| *order) {
                Some((order, wire)) if order <= complete => wire.take_first(),
                Some(_) => return true,
                None => return false,
            }
        }
    }
}

impl Wire {
    fn new(stream: OwnedFd, process: u128, on_arrival: OnArrival) -> Self {
        let (stream, packets, mappings) = (Arc::new(stream), VecDeque::new(), BTreeMap::new());
        let loaned = Weak::new();
        Self { stream, process, is_alone: true, packets, order: 0, mappings, loaned, on_arrival, has_ended: false }
    }

    /// Reads and takes packets.
    fn read(&mut self, buffer: &mut [u8], count_max: usize) {
        while !self.packets.is_empty() {
            self.take_first();
        }
        for _ in 0..count_max {
            let Some((size, file)) = self.receive(buffer) else { return };
            self.take(buffer.get(..size).unwrap_or_default(), file);
        }
    }

    /// Reads and keeps packets, up to `count_max`; returns whether the socket may have more.
    fn fetch(&mut self, buffer: &mut [u8], count_max: usize) -> bool {
        while self.packets.len() < count_max {
            let Some((size, file)) = self.receive(buffer) else { return false };
            let bytes = buffer.get(..size).unwrap_or_default().to_vec();
            self.order = Frame::parse(&bytes).and_then(|frame| frame.order()).unwrap_or(self.order);
            self.packets.push_back(Packet { order: self.order, bytes, file });
        }
        true
    }

    /// Returns the next packet, if there is one now.
    fn receive(&mut self, buffer: &mut [u8]) -> Option<(usize, Option<OwnedFd>)> {
        if self.has_ended {
            return None;
        }
        match receive(&self.stream, buffer, Waits::Never) {
            Err(Errno::AGAIN) => None,
            Ok((0, _)) | Err(_) => {
                self.has_ended = true;
                None
            }
            Ok(received) => Some(received),
        }
    }

    fn take_first(&mut self) {
        if let Some(Packet { bytes, file, .. }) = self.packets.pop_front() {
            self.take(&bytes, file);
        }
    }

    fn take(&mut self, packet: &[u8], file: Option<OwnedFd>) {
        match Frame::parse(packet) {
            Some(Frame::Value(header, bytes)) => self.arrived(header, Arrival::Value(bytes.to_vec().into())),
            Some(Frame::Word(header, word)) => match codec::decode::<Boundary>(word) {
                Ok(boundary) => self.arrived(header, Arrival::Boundary(boundary)),
                Err(error) => tracing::warn!(%error, "a word between values is ignored"),
            },
            Some(Frame::Shared(header, value)) => self.shared(header, value, file),
            Some(Frame::Retired(buffer)) => drop(self.mappings.remove(&buffer)),
            None => tracing::warn!(size = packet.len(), "a packet of a wire is ignored"),
        }
    }

    fn arrived(&mut self, Header { life, number, .. }: Header, arrival: Arrival<Value>) {
        (self.on_arrival)(arrival, Sequence { publisher: (self.process, life), number });
    }

    /// Takes a value in shared memory. It stays there until it is read, or until the next value comes. A value that
    /// cannot be mapped is lost: it counts as missing when the next value comes.
    fn shared(&mut self, header: Header, SharedValue { buffer, size }: SharedValue, file: Option<OwnedFd>) {
        if let Some(file) = file {
            match Mapping::of(&file) {
                Ok(mapping) => drop(self.mappings.insert(buffer, Arc::new(mapping))),
                Err(error) => tracing::warn!(%error, "shared memory of a wire cannot be read"),
            }
        }
        if let Some(before) = self.loaned.upgrade() {
            before.copy();
        }
        let back = Return { stream: Arc::clone(&self.stream), buffer };
        let mapping = usize::try_from(size).ok().zip(self.mappings.get(&buffer));
        match mapping.and_then(|(size, mapping)| Loan::new(mapping, size, back)).map(Arc::new) {
            Some(loan) => {
                self.loaned = Arc::downgrade(&loan);
                self.arrived(header, Arrival::Value(Value::Loaned(loan)));
            }
            None => tracing::warn!(buffer, size, "a value in shared memory cannot be read"),
        }
    }
}
