//! The thread of a program that accepts the consumers of its wires. It also sends messages that found no room before,
//! and reads what arrives for this program while the program's own loop is busy.

use super::guard::Guard;
use super::inlet::Inlets;
use super::outlet::{Connection, End};
use super::stranger::{Consumer, Fate, News, Stranger};
use crate::io::clock::{Wakeup, now};
use crate::logic::direct::Place;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::net::{SocketFlags, accept_with};
use std::collections::{BTreeMap, VecDeque};
use std::io;
use std::os::fd::OwnedFd;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::Duration;

/// How long a consumer has to introduce itself. At most `STRANGERS_MAX` may do so at a time; a further one replaces
/// the oldest.
const HELLO_WITHIN: Duration = Duration::from_secs(2);
const STRANGERS_MAX: usize = 64;
/// The pause before the next accept after the system has refused one.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);
/// How many consumers may wait for wires that this program has not made yet; a plan has fewer wires.
const WAITING_MAX: usize = 10_000;

/// The state that the thread and the ends of wires share.
#[derive(Debug)]
pub(super) struct Shared {
    pub(super) place: Place,
    pub(super) process: u128,
    /// The guard, in a team.
    pub(super) guard: Option<Guard>,
    /// Whether the programs at the other ends of wires have changed since the thread last checked.
    has_keys: AtomicBool,
    /// Readable once the thread has work.
    control: OwnedFd,
    pub(super) is_over: AtomicBool,
    pub(super) lives: AtomicU32,
    /// How many frames were sent over all wires: the next frame gets this number.
    pub(super) orders: AtomicU64,
    table: Mutex<Table>,
}

#[derive(Debug, Default)]
struct Table {
    ends: BTreeMap<String, Weak<End>>,
    /// Consumers that wait, by the key of a wire that this program has not made yet.
    waiting: BTreeMap<String, Connection>,
}

/// The state that only the thread uses.
pub(super) struct Server {
    pub(super) listener: OwnedFd,
    /// Rung by producers.
    pub(super) bell: OwnedFd,
    pub(super) shared: Arc<Shared>,
    pub(super) inlets: Arc<Inlets>,
    strangers: VecDeque<Stranger>,
}

impl Shared {
    pub(super) fn new(place: Place, process: u128, guard: Option<Guard>, control: OwnedFd) -> Self {
        let (has_keys, is_over, lives, orders, table) = Default::default();
        Self { place, process, guard, has_keys, control, is_over, lives, orders, table }
    }

    /// Makes the thread check again the programs whose proof did not fit.
    pub(super) fn keys_changed(&self) {
        self.has_keys.store(true, Ordering::Release);
        self.wake();
    }

    /// Makes the thread look for changes.
    pub(super) fn wake(&self) {
        // The write fails only when the counter overflows, after an endless number of writes.
        rustix::io::write(&self.control, &1_u64.to_ne_bytes()).unwrap_or_default();
    }

    /// Adds the producer's end of a wire, and connects it with a consumer that came earlier.
    pub(super) fn add(&self, key: &str, end: &Arc<End>) {
        let mut table = self.lock();
        if let Some(connection) = table.waiting.remove(key) {
            end.attach(connection);
        }
        table.ends.insert(key.to_owned(), Arc::downgrade(end));
    }

    /// Removes the producer's end of a wire: it gets no other consumer.
    pub(super) fn remove(&self, end: &Arc<End>) {
        self.lock().ends.retain(|_, other| !std::ptr::eq(other.as_ptr(), Arc::as_ptr(end)));
    }

    /// Connects a consumer with its wire, or keeps it until this program makes the wire. The consumer gets the answer in
    /// between, so each value that is sent after the answer reaches the consumer.
    pub(super) fn take(&self, consumer: Consumer) -> io::Result<()> {
        let mut table = self.lock();
        if let Some(end) = table.ends.get(&consumer.key).and_then(Weak::upgrade) {
            return end.welcome(consumer);
        }
        let key = consumer.key.clone();
        let connection = consumer.welcome()?;
        if table.waiting.len() >= WAITING_MAX {
            table.waiting.pop_first();
        }
        table.waiting.insert(key, connection);
        Ok(())
    }

    fn ends(&self) -> Vec<Arc<End>> {
        self.lock().ends.values().filter_map(Weak::upgrade).collect()
    }

    fn lock(&self) -> MutexGuard<'_, Table> {
        self.table.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Server {
    pub(super) fn new(listener: OwnedFd, bell: OwnedFd, shared: Arc<Shared>, inlets: Arc<Inlets>) -> Self {
        Self { listener, bell, shared, inlets, strangers: VecDeque::new() }
    }

    /// Serves until the direct path is dropped.
    pub(super) fn run(mut self) {
        while !self.shared.is_over.load(Ordering::Acquire) {
            self.turn();
        }
    }

    fn turn(&mut self) {
        let ends: Vec<_> = self.shared.ends().into_iter().filter_map(|end| Some((end.stream()?, end))).collect();
        let mut ready = vec![
            PollFd::new(&self.shared.control, PollFlags::IN),
            PollFd::new(&self.listener, PollFlags::IN),
            PollFd::new(&self.bell, PollFlags::IN),
        ];
        ready.extend(self.strangers.iter().map(|stranger| PollFd::new(&stranger.stream, PollFlags::IN)));
        // Even without a requested flag, `poll` reports the end of a connection.
        let flags = |has_words| if has_words { PollFlags::OUT } else { PollFlags::empty() };
        ready.extend(ends.iter().map(|((stream, has_words), _)| PollFd::new(stream, flags(*has_words))));
        let until = self.strangers.iter().map(|stranger| stranger.until).min();
        let left = until.map(|until| until.since(now())).map(|left| Timespec {
            tv_sec: i64::try_from(left.as_secs()).unwrap_or(i64::MAX),
            tv_nsec: left.subsec_nanos().into(),
        });
        if poll(&mut ready, left.as_ref()).is_err() {
            // A signal has interrupted the wait, or the system had no memory for a moment.
            return;
        }
        let ready: Vec<PollFlags> = ready.iter().map(PollFd::revents).collect();
        let [control, listener, bell, ready @ ..] = &ready[..] else { return };
        let (of_strangers, of_ends) = ready.split_at(self.strangers.len());
        let of_strangers = of_strangers.to_vec();
        for (((stream, _), end), ready) in ends.iter().zip(of_ends) {
            if ready.intersects(PollFlags::HUP | PollFlags::ERR) {
                end.ended(stream);
            } else if ready.contains(PollFlags::OUT) {
                end.flush();
            }
        }
        for (ready, file) in [(control, &self.shared.control), (bell, &self.bell)] {
            if !ready.is_empty() {
                rustix::io::read(file, &mut [0; 8]).unwrap_or_default();
            }
        }
        if !bell.is_empty() {
            self.inlets.read_for_loop();
        }
        let is_listened = !listener.is_empty();
        self.hear(&of_strangers);
        if is_listened {
            self.accept();
        }
    }

    fn accept(&mut self) {
        let Ok(stream) = accept_with(&self.listener, SocketFlags::CLOEXEC | SocketFlags::NONBLOCK) else {
            // The process has too many open files. Without this pause, a waiting connection would wake the thread
            // again and again.
            Wakeup::default().wait(Some(now() + ACCEPT_PAUSE));
            return;
        };
        if self.strangers.len() >= STRANGERS_MAX {
            self.strangers.pop_front();
        }
        self.strangers.push_back(Stranger::new(stream, now() + HELLO_WITHIN));
    }

    /// Accepts the consumers that have introduced themselves. Drops connections that cannot do this, or did not do it in time.
    fn hear(&mut self, ready: &[PollFlags]) {
        let (now, has_keys) = (now(), self.shared.has_keys.swap(false, Ordering::AcqRel));
        for (stranger, ready) in std::mem::take(&mut self.strangers).into_iter().zip(ready) {
            let news = News { is_ready: !ready.is_empty(), has_keys, now };
            match stranger.turn(news, &self.shared) {
                Some(Fate::Waits(stranger)) => self.strangers.push_back(stranger),
                Some(Fate::Accepted(consumer)) => {
                    let taken = self.shared.take(consumer);
                    taken.unwrap_or_else(|error| tracing::debug!(%error, "a consumer of this host did not wait"));
                }
                None => {}
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::outlet::Memory;
    use super::super::packet::{Waits, receive, send_waiting};
    use super::*;
    use crate::io::data::Listeners;
    use crate::logic::codec::{self, Enveloped};
    use crate::logic::direct::{Hello, Welcome};
    use crate::logic::object::TypeForm;
    use rustix::event::{EventfdFlags, eventfd};
    use rustix::io::Errno;
    use rustix::net::{AddressFamily, SocketType, socketpair};
    use std::os::fd::AsFd;

    fn event() -> OwnedFd {
        eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK).unwrap()
    }

    /// Returns the socket of a program that asks for the wire `k`, and the accepted consumer.
    fn ask(shared: &Shared) -> (OwnedFd, Consumer) {
        let (own, theirs) = socketpair(AddressFamily::UNIX, SocketType::SEQPACKET, SocketFlags::CLOEXEC, None).unwrap();
        let form = TypeForm { name: "W".into(), fields: String::new() };
        let hello = codec::encode(&Hello { token: "t".into(), key: "k".into(), form }).unwrap();
        send_waiting(&theirs, &[&hello], Some(event().as_fd()), Waits::Never).unwrap();
        let news = News { is_ready: true, has_keys: false, now: now() };
        let fate = Stranger::new(own, now() + HELLO_WITHIN).turn(news, shared);
        let Some(Fate::Accepted(consumer)) = fate else { panic!("the consumer is refused") };
        (theirs, consumer)
    }

    fn is_welcomed(socket: &OwnedFd) -> bool {
        let mut packet = [0; Welcome::SIZE_MAX];
        match receive(socket, &mut packet, Waits::Never) {
            Ok((size, _)) => codec::decode::<Welcome>(&packet[..size]).is_ok(),
            Err(error) => {
                assert_eq!(error, Errno::AGAIN);
                false
            }
        }
    }

    /// A consumer that was answered before it was connected missed the values in between.
    #[test]
    fn a_consumer_is_answered_when_it_is_connected() {
        let place = Place { path: String::new(), token: "t".into() };
        let shared = Arc::new(Shared::new(place, 7, None, event()));
        let wire = || {
            let heard = Arc::new(Listeners::default());
            let end = Arc::new(End::new(0, Memory::default(), Arc::clone(&heard), Arc::clone(&shared)));
            (end, heard)
        };
        // The first consumer comes before the wire is made.
        let (early, consumer) = ask(&shared);
        assert!(!is_welcomed(&early));
        shared.take(consumer).unwrap();
        assert!(is_welcomed(&early));
        let (end, heard) = wire();
        shared.add("k", &end);
        assert!(heard.is_any());
        let first = end.stream().unwrap().0;
        let (late, consumer) = ask(&shared);
        assert!(!is_welcomed(&late) && Arc::ptr_eq(&end.stream().unwrap().0, &first));
        shared.take(consumer).unwrap();
        let second = end.stream().unwrap().0;
        assert!(is_welcomed(&late) && !Arc::ptr_eq(&second, &first));
        // A consumer that has not waited takes nothing away.
        let (gone, consumer) = ask(&shared);
        drop(gone);
        assert!(shared.take(consumer).is_err());
        assert!(Arc::ptr_eq(&end.stream().unwrap().0, &second) && heard.is_any());
        // A wire that has ended gets no consumer: the next wire with this key gets it.
        shared.remove(&end);
        let (_later, consumer) = ask(&shared);
        shared.take(consumer).unwrap();
        assert!(Arc::ptr_eq(&end.stream().unwrap().0, &second));
        let (next, heard) = wire();
        shared.add("k", &next);
        shared.remove(&end);
        assert!(heard.is_any() && shared.ends().len() == 1);
    }
}
