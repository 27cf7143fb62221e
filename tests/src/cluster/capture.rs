//! Captures every packet on the interfaces of the hosts of a network, including loopback.

use super::Network;
use rustix::io::{Errno, read};
use rustix::net::sockopt::{Timeout, set_socket_recv_buffer_size, set_socket_timeout};
use rustix::net::{AddressFamily, SocketFlags, SocketType, eth, socket_with};
use std::os::fd::OwnedFd;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

/// The longest packet. It contains segments that the kernel has not yet split.
const PACKET_MAX: usize = 1 << 17;
/// How often a thread checks whether to end.
const LOOK_EVERY: Duration = Duration::from_millis(50);

/// A running capture of packets. Like a [`Network`], it needs root.
#[derive(Debug)]
pub struct Capture {
    is_over: Arc<AtomicBool>,
    hosts: Vec<JoinHandle<Vec<Vec<u8>>>>,
}

impl Capture {
    /// Begins the capture. It sees every later packet.
    ///
    /// # Panics
    /// Panics if the kernel shows no packets.
    pub fn begin(network: &Network) -> Self {
        let is_over = Arc::new(AtomicBool::new(false));
        let (opened, opening) = sync_channel(network.hosts().count());
        let on_host = |number| {
            let (is_over, opened) = (Arc::clone(&is_over), opened.clone());
            network.inside(number, move || all(&open(&opened), &is_over))
        };
        let hosts: Vec<_> = network.hosts().map(on_host).collect();
        for _ in &hosts {
            opening.recv().expect("each host sees its packets");
        }
        Self { is_over, hosts }
    }

    /// Stops capturing. Returns the packets.
    ///
    /// # Panics
    /// Panics if the kernel has stopped showing packets.
    pub fn end(self) -> Vec<Vec<u8>> {
        self.is_over.store(true, Ordering::Relaxed);
        self.hosts.into_iter().flat_map(|host| host.join().expect("it has seen its packets")).collect()
    }
}

fn open(opened: &SyncSender<()>) -> OwnedFd {
    let socket = socket_with(AddressFamily::PACKET, SocketType::RAW, SocketFlags::CLOEXEC, Some(eth::ALL));
    let socket = socket.expect("root may see packets");
    set_socket_timeout(&socket, Timeout::Recv, Some(LOOK_EVERY)).expect("a socket of ours");
    // Requests the largest buffer that the kernel gives, so that nothing is lost while this thread waits for the
    // processor.
    set_socket_recv_buffer_size(&socket, 64 << 20).unwrap_or_default();
    opened.send(()).expect("somebody waits");
    socket
}

fn all(socket: &OwnedFd, is_over: &AtomicBool) -> Vec<Vec<u8>> {
    let (mut packets, mut bytes) = (Vec::new(), vec![0; PACKET_MAX]);
    loop {
        // After the end, it still reads all packets that arrived before.
        let is_last = is_over.load(Ordering::Relaxed);
        match read(socket, &mut bytes) {
            Ok(size) => packets.push(bytes[..size].to_vec()),
            Err(Errno::AGAIN) if is_last => return packets,
            Err(Errno::AGAIN | Errno::INTR | Errno::NOBUFS) => {}
            Err(error) => panic!("no packets any more: {error}"),
        }
    }
}
