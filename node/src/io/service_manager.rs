//! The notices of a node to the service manager that has started it: it is ready, it is ending, it is alive.
//!
//! The manager names a socket and an interval in the environment. If it does not, the node sends no notices. Source: sd_notify(3),
//! sd_watchdog_enabled(3).

use comms::logic::time::Time;
use std::ffi::OsStr;
use std::io;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::sync::Arc;
use std::time::Duration;

/// How many times the node reports that it is alive in the manager's interval.
const SIGNS_PER_INTERVAL: u32 = 3;

/// The service manager of this process, if it has one.
#[derive(Clone, Debug, Default)]
pub struct ServiceManager {
    socket: Option<Arc<UnixDatagram>>,
    /// How often a pass of the loop is reported.
    every: Option<Duration>,
    /// When the next report is due.
    due: Option<Time>,
}

impl ServiceManager {
    /// Returns the manager that the environment of this process names.
    ///
    /// # Errors
    /// The environment names a socket that cannot be reached.
    pub fn of_environment() -> io::Result<Self> {
        let Some(socket) = std::env::var_os("NOTIFY_SOCKET") else { return Ok(Self::default()) };
        let variable = |name| std::env::var(name).ok();
        let every = watchdog(variable("WATCHDOG_USEC"), variable("WATCHDOG_PID"), std::process::id());
        Self::at(&socket, every)
    }

    /// Returns the manager behind a socket. The socket is a path, or `@` and a name that is in no file system.
    fn at(socket: &OsStr, every: Option<Duration>) -> io::Result<Self> {
        let address = match socket.as_bytes().strip_prefix(b"@") {
            Some(name) => SocketAddr::from_abstract_name(name)?,
            None => SocketAddr::from_pathname(socket)?,
        };
        let socket = UnixDatagram::unbound()?;
        socket.connect_addr(&address)?;
        // A manager that does not read must not delay the node.
        socket.set_nonblocking(true)?;
        Ok(Self { socket: Some(Arc::new(socket)), every, due: every.map(|_| Time::ZERO) })
    }

    /// Reports that the node can be called.
    pub fn ready(&self, name: &str) {
        self.tell(&format!("READY=1\nSTATUS=the node `{name}` is ready"));
    }

    /// Reports that the node is ending: first its programs, then itself.
    pub fn leaving(&self) {
        self.tell("STOPPING=1");
    }

    /// Returns when [`ServiceManager::turn`] has to be called; never if no manager watches the node.
    pub fn due(&self) -> Option<Time> {
        self.due
    }

    /// Reports that the loop of the node is alive.
    pub fn turn(&mut self, now: Time) {
        self.tell("WATCHDOG=1");
        self.due = self.every.map(|every| now + every);
    }

    fn tell(&self, text: &str) {
        if let Some(socket) = &self.socket
            && let Err(error) = socket.send(text.as_bytes())
        {
            tracing::warn!(%error, "cannot report the state of this node to the service manager");
        }
    }
}

/// Returns how often the loop has to report that it is alive, according to the manager's variables. `pid` is this process.
fn watchdog(interval_us: Option<String>, meant: Option<String>, pid: u32) -> Option<Duration> {
    let is_meant = meant.is_none_or(|meant| meant.parse() == Ok(pid));
    let interval = interval_us?.parse().ok().filter(|us| *us > 0)?;
    is_meant.then(|| Duration::from_micros(interval) / SIGNS_PER_INTERVAL)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn heard(socket: &UnixDatagram) -> String {
        let mut bytes = [0; 128];
        let size = socket.recv(&mut bytes).unwrap();
        String::from_utf8_lossy(&bytes[..size]).into_owned()
    }

    #[test]
    fn a_manager_hears_of_it_by_a_path_and_by_a_name() {
        let name = format!("dca-notify-{}", std::process::id());
        let path = std::env::temp_dir().join(&name);
        let at_path = UnixDatagram::bind(&path).unwrap();
        let at_name = UnixDatagram::bind_addr(&SocketAddr::from_abstract_name(&name).unwrap()).unwrap();
        for (socket, manager) in [(path.as_os_str(), &at_path), (format!("@{name}").as_ref(), &at_name)] {
            let mut node = ServiceManager::at(socket, Some(Duration::from_secs(2))).unwrap();
            node.ready("c1");
            assert_eq!(heard(manager), "READY=1\nSTATUS=the node `c1` is ready");
            let now = Time::ZERO + Duration::from_secs(10);
            assert!(node.due().is_some_and(|due| due <= now), "the first sign of life is due at once");
            node.turn(now);
            assert_eq!((heard(manager).as_str(), node.due()), ("WATCHDOG=1", Some(now + Duration::from_secs(2))));
            node.leaving();
            assert_eq!(heard(manager), "STOPPING=1");
        }
        std::fs::remove_file(path).unwrap();
    }

    #[test]
    fn without_a_manager_nothing_is_said_or_due() {
        let mut nobody = ServiceManager::default();
        nobody.ready("c1");
        nobody.turn(Time::ZERO);
        assert_eq!(nobody.due(), None);
        assert!(ServiceManager::at("/nowhere/at/all".as_ref(), None).is_err());
    }

    #[test]
    fn signs_of_life_are_given_to_who_has_asked_this_process() {
        let text = |text: &str| Some(text.to_owned());
        let second = Some(Duration::from_secs(1));
        assert_eq!(watchdog(text("3000000"), None, 7), second);
        assert_eq!(watchdog(text("3000000"), text("7"), 7), second);
        for (interval, meant) in [(text("3000000"), text("8")), (None, text("7")), (text("0"), None), (text("x"), None)]
        {
            assert_eq!(watchdog(interval, meant, 7), None);
        }
    }
}
