//! Asks several places at once and finds the one that answers first. Zenoh would try one after the other, and wait long for
//! each.

use crate::io::clock::{now, sleep_until};
use crate::logic::human::{self, span};
use std::net::SocketAddr;
use std::time::Duration;
use tokio::net::{TcpStream, UnixStream, lookup_host};
use tokio::task::JoinSet;
use tokio::time::timeout;
use zenoh::config::Locator;

/// How long a place has to answer: a round trip of 3 s, and a machine that is busy.
const ANSWER_WITHIN: Duration = Duration::from_secs(4);
/// How often it is asked anew meanwhile: a question that was lost is repeated by the system later and later.
const ASK_EVERY: Duration = Duration::from_millis(500);

/// Returns the first place that answers, and how long it took, or why none does, for a person. A socket of this machine is asked
/// first: who is dialled from anywhere names it, too.
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
                // What is refused is refused; what is silent is asked again.
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

/// Returns the addresses of a place, or why its name has none, for a person.
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

async fn ask(locator: Locator) -> Result<(Locator, Duration), String> {
    let (began, address) = (now(), locator.address().as_str().to_owned());
    match timeout(ANSWER_WITHIN, TcpStream::connect(&address)).await {
        Ok(Ok(_)) => Ok((locator, now() - began)),
        Ok(Err(error)) => Err(format!("{address}: {}", human::cause(&error))),
        Err(_elapsed) => Err(format!("{address}: nobody answers within {}", span(ANSWER_WITHIN))),
    }
}
