//! The direct path of wires between two programs of one host ([`crate::logic::direct`]): a separate Unix socket for
//! each wire, and shared memory for long values.
//!
//! A program has one [`DirectPath`]. Its [`Outlet`]s send to consumers, its [`Inlet`]s receive from producers, and its
//! loop waits for all arrivals at once ([`Inlets::wait`]), so a value wakes only one thread. Sending never waits: a
//! value for which a consumer's socket has no room is lost, and its number is missing. A consumer that is gone, killed
//! or suspended loses only its own values.

mod guard;
mod inlet;
mod loan;
pub mod memory;
mod outlet;
mod packet;
mod pool;
mod server;
mod stranger;

pub use guard::{Guard, WireSecrets};
pub use inlet::{Inlet, Inlets};
pub use loan::{Loan, Value};
pub use memory::Filler;
pub use outlet::{Memory, Outlet, Parcel};

use crate::io::data::Publisher;
use crate::io::entropy;
use crate::logic::codec;
use crate::logic::direct::{Hello, Place, Welcome};
use crate::logic::object::TypeForm;
use crate::logic::switch::{Arrival, Sequence};
use guard::hear;
use memory::Buffer;
use outlet::End;
use packet::{Waits, send_waiting};
use rustix::event::{EventfdFlags, eventfd};
use rustix::io::Errno;
use rustix::net::sockopt::{Timeout, set_socket_timeout, socket_peercred};
use rustix::net::{AddressFamily, SocketAddrUnix, SocketFlags, SocketType, bind, connect, listen, socket_with};
use server::{Server, Shared};
use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::thread::JoinHandle;
use std::time::Duration;

/// How many connections of consumers may wait to be accepted.
const BACKLOG: i32 = 256;

/// The direct paths of one program. All of them end when this is dropped.
#[derive(Debug)]
pub struct DirectPath {
    shared: Arc<Shared>,
    inlets: Arc<Inlets>,
    /// The bell that producers ring.
    bell: OwnedFd,
    thread: Option<JoinHandle<()>>,
}

impl DirectPath {
    /// Listens on the Unix socket `socket`. An existing file is replaced, and the file is removed at the end. With a
    /// guard, as in a team, both ends of a wire prove to each other that they have the secrets of the wire.
    ///
    /// # Errors
    /// If the socket cannot be used, or the system has no shared memory.
    pub fn open(socket: &Path, guard: Option<Guard>) -> io::Result<Self> {
        let path = socket.to_str().ok_or(Errno::INVAL)?.to_owned();
        // Without shared memory this program could not receive long values, so it must not offer a direct path.
        drop(Buffer::new(1)?);
        match std::fs::remove_file(socket) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        let listener = seqpacket()?;
        bind(&listener, &SocketAddrUnix::new(socket)?)?;
        listen(&listener, BACKLOG)?;
        let token = entropy::bytes::<16>()?.iter().map(|byte| format!("{byte:02x}")).collect();
        let process = u128::from_le_bytes(entropy::bytes()?);
        let event = || eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK);
        let shared = Arc::new(Shared::new(Place { path, token }, process, guard, event()?));
        let (inlets, bell) = (Arc::new(Inlets::new()?), event()?);
        let server = Server::new(listener, bell.try_clone()?, Arc::clone(&shared), Arc::clone(&inlets));
        let thread = std::thread::Builder::new().name("direct".to_owned()).spawn(move || server.run())?;
        Ok(Self { shared, inlets, bell, thread: Some(thread) })
    }

    /// Returns the locator that consumers on this host need, which contains the token that they have to present. Only
    /// the node may learn it.
    pub fn locator(&self) -> String {
        self.shared.place.locator()
    }

    /// Notes that the guard now knows other programs at the ends of wires.
    pub fn keys_changed(&self) {
        self.shared.keys_changed();
    }

    /// Returns the ends of wires that arrive here.
    pub fn inlets(&self) -> &Arc<Inlets> {
        &self.inlets
    }

    /// Returns the producer's end of the wire `key`. Values lie in `memory`, which belongs to the output. `publisher`
    /// also reports these consumers ([`Publisher::is_heard`]).
    pub fn outlet(&self, key: &str, memory: &Memory, publisher: &Publisher) -> Outlet {
        let life = self.shared.lives.fetch_add(1, Ordering::Relaxed);
        let end = Arc::new(End::new(life, memory.clone(), publisher.listeners(), Arc::clone(&self.shared)));
        self.shared.add(key, &end);
        self.shared.wake();
        Outlet::new(end)
    }

    /// Connects the consumer's end of a wire with its producer, which has `within` to accept. `on_arrival` takes the
    /// values, on a thread that must not wait. If this inlet replaces another one, the values of the old inlet come
    /// first.
    ///
    /// # Errors
    /// If no producer listens there, it does not answer in time, or another program answers.
    pub fn inlet(
        &self,
        place: &Place,
        within: Duration,
        key: &str,
        form: TypeForm,
        replaced: Option<Inlet>,
        on_arrival: impl FnMut(Arrival<Value>, Sequence) + Send + 'static,
    ) -> io::Result<Inlet> {
        let stream = seqpacket()?;
        set_socket_timeout(&stream, Timeout::Send, Some(within))?;
        set_socket_timeout(&stream, Timeout::Recv, Some(within))?;
        connect(&stream, &SocketAddrUnix::new(place.path.as_str())?)?;
        if socket_peercred(&stream)?.uid != rustix::process::getuid() {
            return Err(Errno::PERM.into());
        }
        let hello = codec::encode(&Hello { token: place.token.clone(), key: key.to_owned(), form });
        let hello = hello.map_err(io::Error::other)?;
        let bell = self.bell.as_fd();
        let process = if let Some(guard) = &self.shared.guard {
            guard.show(&stream, key, &hello, bell)?
        } else {
            send_waiting(&stream, &[&hello], Some(bell), Waits::UntilTimeout)?;
            hear::<Welcome>(&stream)?.process
        };
        Ok(self.inlets.add(stream, process, replaced, Box::new(on_arrival)))
    }
}

impl Drop for DirectPath {
    fn drop(&mut self) {
        self.shared.is_over.store(true, Ordering::Release);
        self.shared.wake();
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the thread of direct paths has panicked");
        }
        if let Err(error) = std::fs::remove_file(&self.shared.place.path) {
            tracing::debug!(%error, "a socket stays behind");
        }
    }
}

fn seqpacket() -> Result<OwnedFd, Errno> {
    socket_with(AddressFamily::UNIX, SocketType::SEQPACKET, SocketFlags::CLOEXEC, None)
}
