//! Two hosts with a slow or long link between them. Two threads for each direction carry packets from one host's interface to the
//! other's, and delay each packet. `tc netem` does the same, but many kernels are built without it.

use super::network::{Network, skip};
use super::pass;
use comms::io::clock::now;
use comms::logic::time::Time;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::ioctl::{Opcode, Setter, ioctl};
use rustix::process::getpid;
use std::fs::{File, OpenOptions};
use std::io::{Read, Write};
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

/// The greatest number of waiting packets in each direction. Further packets are dropped. Source: the default of tc-netem(8).
const WAITING_MAX: usize = 1000;
/// The longest packet. Source: the MTU of a TUN device is 1500 bytes.
const PACKET_MAX: usize = 2048;
/// How often a thread checks whether to end.
const LOOK_EVERY: Timespec = Timespec { tv_sec: 0, tv_nsec: 100_000_000 };
/// Source: `TUNSETIFF` of linux/if_tun.h, with the kernel's number on machines where an `int` has four bytes.
const TUNSETIFF: Opcode = 0x4004_54ca;
/// Source: `IFF_TUN | IFF_NO_PI` of linux/if_tun.h. The packets are IP packets, with nothing before them.
const TUN_NO_PI: u16 = 0x1001;

/// The properties of a link, for both directions.
#[derive(Clone, Copy, Debug)]
pub struct Line {
    /// How long a byte travels.
    pub delay: Duration,
    /// Bytes a second.
    pub rate: f64,
    /// Whether nothing comes through.
    pub is_cut: bool,
}

impl Line {
    /// A cable.
    pub const FAST: Self = Self { delay: Duration::ZERO, rate: 1e8, is_cut: false };
    /// A pulled cable.
    pub const CUT: Self = Self { is_cut: true, ..Self::FAST };
}

/// Hosts 1 and 2, as 10.77.0.1 and 10.77.0.2. Dropping the link removes them.
#[derive(Debug)]
pub struct SlowLink {
    network: Network,
    line: Arc<Mutex<Line>>,
    sent: [Arc<AtomicU64>; 2],
    is_over: Arc<AtomicBool>,
    carriers: Vec<JoinHandle<()>>,
}

/// One direction of a link.
struct Direction {
    from: File,
    to: File,
    line: Arc<Mutex<Line>>,
    sent: Arc<AtomicU64>,
    is_over: Arc<AtomicBool>,
}

impl SlowLink {
    /// Makes a link, which is fast at first. If a test cannot have one, it prints the reason on the terminal and returns none.
    ///
    /// # Panics
    /// Panics if the kernel refuses a step.
    pub fn new() -> Option<Self> {
        let network = Network::begin(2)?;
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let name = format!("ds{}x{}", getpid().as_raw_nonzero(), COUNT.fetch_add(1, Ordering::Relaxed));
        let mut devices = Vec::new();
        for number in network.hosts() {
            let interface = format!("{name}{number}");
            match interface_of_own(&interface) {
                Ok(device) => devices.push(device),
                Err(error) => return skip(&format!("needs interfaces of its own, by /dev/net/tun: {error}")),
            }
            network.take(number, &interface);
        }
        let clone = |index: usize| devices[index].try_clone().expect("a descriptor can be copied");
        let (line, is_over) = (Arc::new(Mutex::new(Line::FAST)), Arc::new(AtomicBool::new(false)));
        let sent = [Arc::default(), Arc::default()];
        let mut carriers = Vec::new();
        for (from, to) in [(0, 1), (1, 0)] {
            let (line, is_over, sent) = (Arc::clone(&line), Arc::clone(&is_over), Arc::clone(&sent[from]));
            carriers.extend(Direction { from: clone(from), to: clone(to), line, sent, is_over }.carry());
        }
        Some(Self { network, line, sent, is_over, carriers })
    }

    /// Returns the hosts of the link, for [`Cluster::host`](super::Cluster::host).
    pub fn network(&self) -> &Network {
        &self.network
    }

    /// Changes the link for all later packets.
    pub fn set(&self, line: Line) {
        *self.line.lock().unwrap_or_else(PoisonError::into_inner) = line;
    }

    /// Returns the number of bytes that each of host 1 and host 2 has sent so far.
    pub fn sent(&self) -> [u64; 2] {
        [&self.sent[0], &self.sent[1]].map(|sent| sent.load(Ordering::Relaxed))
    }
}

impl Drop for SlowLink {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
        self.carriers.drain(..).for_each(|carrier| carrier.join().unwrap_or_default());
    }
}

impl Direction {
    /// Begins to carry packets. One thread takes the packets, and the other passes each on at its time.
    fn carry(mut self) -> [JoinHandle<()>; 2] {
        let (packets, due) = sync_channel::<(Time, Vec<u8>)>(WAITING_MAX);
        let mut to = self.to.try_clone().expect("a descriptor can be copied");
        let giver = std::thread::spawn(move || {
            for (at, packet) in due {
                pass(at.since(now()));
                // A host takes no packets while its interface is down.
                to.write(&packet).map(drop).unwrap_or_default();
            }
        });
        [std::thread::spawn(move || self.take(&packets)), giver]
    }

    fn take(&mut self, packets: &SyncSender<(Time, Vec<u8>)>) {
        let (mut free, mut packet) = (now(), [0; PACKET_MAX]);
        while !self.is_over.load(Ordering::Relaxed) {
            let mut readable = [PollFd::new(&self.from, PollFlags::IN)];
            if !poll(&mut readable, Some(&LOOK_EVERY)).is_ok_and(|count| count > 0) {
                continue;
            }
            let Ok(size) = self.from.read(&mut packet) else { continue };
            let line = *self.line.lock().unwrap_or_else(PoisonError::into_inner);
            if line.is_cut {
                continue;
            }
            self.sent.fetch_add(size as u64, Ordering::Relaxed);
            free = free.max(now()) + Duration::from_secs_f64(size as f64 / line.rate);
            // A packet is dropped if the queue is full, as on a radio link.
            packets.try_send((free + line.delay, packet[..size].to_vec())).unwrap_or_default();
        }
    }
}

/// Makes an interface whose packets this program reads and writes.
#[expect(unsafe_code, reason = "no crate in use makes an interface")]
fn interface_of_own(name: &str) -> std::io::Result<File> {
    /// Source: `struct ifreq` of linux/if.h.
    #[repr(C)]
    struct Wanted {
        name: [u8; 16],
        flags: u16,
        rest: [u8; 22],
    }
    let device = OpenOptions::new().read(true).write(true).open("/dev/net/tun")?;
    let mut wanted = Wanted { name: [0; 16], flags: TUN_NO_PI, rest: [0; 22] };
    wanted.name[..name.len()].copy_from_slice(name.as_bytes());
    // SAFETY: for this operation, the kernel reads and writes a structure of this size, and keeps no pointer to it.
    unsafe { ioctl(&device, Setter::<TUNSETIFF, Wanted>::new(wanted)) }?;
    Ok(device)
}
