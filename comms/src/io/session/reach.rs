//! Asks several places at once, and finds the place that answers first. Zenoh would try one place after the other, and wait
//! long for each.

use super::interfaces;
use crate::io::clock::{now, sleep_until};
use crate::logic::human::{self, span};
use rustix::system::uname;
use std::net::{IpAddr, SocketAddr, UdpSocket};
use std::time::Duration;
use tokio::net::{TcpStream, UnixStream, lookup_host};
use tokio::task::JoinSet;
use tokio::time::timeout;
use zenoh::config::Locator;

/// How long a place has to answer: enough for a round trip of 3 s and a busy machine.
const ANSWER_WITHIN: Duration = Duration::from_secs(4);
/// How often the question is repeated. The system itself would repeat a lost question at growing intervals.
const ASK_EVERY: Duration = Duration::from_millis(500);

/// Returns the first address that answers, and how long that took. The error is the reason why none answers, for people. A
/// socket of this machine is tried first: a peer that others can dial also has such a socket.
///
/// # Cancellation
/// Safe.
pub(super) async fn first(locators: &[Locator]) -> Result<(Locator, Duration), String> {
    let (over_tcp, here): (Vec<&Locator>, Vec<&Locator>) =
        locators.iter().partition(|locator| locator.protocol().as_str() == "tcp");
    let (began, mut asking, mut why) = (now(), JoinSet::new(), String::new());
    for locator in here {
        match UnixStream::connect(locator.address().as_str()).await {
            Ok(_) => return Ok((locator.clone(), Duration::ZERO)),
            Err(error) => why = format!("{}: {}", locator.address(), human::cause(&error)),
        }
    }
    if over_tcp.is_empty() {
        return Err(why);
    }
    let mut again = began;
    loop {
        tokio::select! {
            biased;
            Some(answer) = asking.join_next() => match answer {
                Ok(Ok(found)) => return Ok(found),
                // A refusal is final; a silent address is tried again.
                Ok(Err(cause)) if asking.is_empty() => return Err(cause),
                Ok(Err(cause)) => why = cause,
                Err(error) => why = error.to_string(),
            },
            () = sleep_until(again), if again < began + ANSWER_WITHIN => {
                again = again + ASK_EVERY;
                for locator in &over_tcp {
                    asking.spawn(ask((*locator).clone()));
                }
            }
            else => return Err(why),
        }
    }
}

/// Returns the addresses of a locator. The error is the reason why its name has none, for people.
///
/// # Cancellation
/// Safe.
pub(super) async fn resolve(locator: &Locator) -> Result<Vec<SocketAddr>, String> {
    let address = locator.address().as_str();
    match timeout(ANSWER_WITHIN, lookup_host(address)).await {
        Ok(Ok(addresses)) => Ok(addresses.collect()),
        Ok(Err(error)) => Err(format!("the name in `{address}` cannot be resolved: {}", human::cause(&error))),
        Err(_elapsed) => Err(format!("the name in `{address}` cannot be resolved within {}", span(ANSWER_WITHIN))),
    }
}

/// Returns whether a locator leads to this machine itself on `port`: by one of its own addresses, or by its name.
pub(super) fn is_own(locator: &str, port: u16) -> bool {
    let Ok(locator) = locator.parse::<Locator>() else { return false };
    let Some((host, dialled)) = locator.address().as_str().rsplit_once(':') else { return false };
    if locator.protocol().as_str() != "tcp" || dialled.parse() != Ok(port) {
        return false;
    }
    let host = host.trim_start_matches('[').trim_end_matches(']');
    let address = host.split_once('%').map_or(host, |(address, _interface)| address);
    match address.parse::<IpAddr>() {
        // The system lets no program listen at an address of another machine. A link-local address needs its interface.
        Ok(IpAddr::V6(address)) if address.is_unicast_link_local() => {
            interfaces::now().iter().any(|own| own.ip == IpAddr::V6(address))
        }
        Ok(address) => UdpSocket::bind((address, 0)).is_ok(),
        Err(_name) => {
            let system = uname();
            let own = system.nodename().to_string_lossy();
            host == own || host.strip_suffix(".local") == Some(&*own)
        }
    }
}

async fn ask(locator: Locator) -> Result<(Locator, Duration), String> {
    let (began, address) = (now(), locator.address().as_str().to_owned());
    match timeout(ANSWER_WITHIN, TcpStream::connect(&address)).await {
        Ok(Ok(_)) => Ok((locator, now() - began)),
        Ok(Err(error)) => Err(format!("{address}: {}", human::cause(&error))),
        Err(_elapsed) => Err(format!("{address}: nothing answers within {}", span(ANSWER_WITHIN))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_list_of_places_serves_all_robots() {
        let name = uname().nodename().to_string_lossy().into_owned();
        for own in
            ["tcp/127.0.0.1:7447", "tcp/[::1]:7447", &format!("tcp/{name}:7447"), &format!("tcp/{name}.local:7447")]
        {
            // A machine without IPv6 has no such address.
            let is_there = !own.contains("::1") || UdpSocket::bind(("::1", 0)).is_ok();
            assert_eq!(is_own(own, 7447), is_there, "{own}");
            assert!(!is_own(own, 7448), "{own}: another node of this machine");
        }
        for other in
            ["tcp/192.0.2.7:7447", "tcp/another-robot:7447", "tcp/[fe80::7%eth0]:7447", "unixsock-stream//run/x", ""]
        {
            assert!(!is_own(other, 7447), "{other}");
        }
    }
}
