//! Finds links of which zenoh and its events say different things, and makes them agree.
//!
//! Zenoh keeps its sessions in a table by peer, and deletes an entry by the peer alone. A session that is deleted twice, as when two of
//! its links end at once, so takes the entry of the next session away: that one still receives, and can send nothing, for ever. The
//! event of a loss may also come after that of the next session. Seen with zenoh 1.10.2; eclipse-zenoh/zenoh#1886 and #2806 are of the
//! same kind.

use super::super::links::lock;
use super::super::patience;
use super::ends_of;
use super::keeper::{Change, Dialler};
use crate::io::queue::Sender;
use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

/// The time between two looks. Events and table may differ for a moment; only a difference that two looks in a row find is acted on.
const LOOK_EVERY: Duration = Duration::from_secs(1);
/// How old a tunnel is that has to carry a session: three round trips of 3 s.
const TUNNEL_MIN: Duration = Duration::from_secs(10);

/// The differences of the last look, by session.
#[derive(Default)]
struct Looks {
    strays: BTreeSet<String>,
    unheard: BTreeSet<String>,
}

/// The differences that two looks in a row have found, by session.
struct Found {
    /// Sessions with links that zenoh does not know.
    strays: Vec<String>,
    /// Sessions that zenoh has, and whose last event was a loss.
    unheard: Vec<String>,
}

impl Looks {
    /// Takes the differences of a look; returns those that the last one had as well.
    fn look(&mut self, strays: BTreeSet<String>, unheard: BTreeSet<String>) -> Found {
        Found { strays: twice(&mut self.strays, strays), unheard: twice(&mut self.unheard, unheard) }
    }
}

/// Returns the names that are in both sets, and keeps the new one.
fn twice(before: &mut BTreeSet<String>, now: BTreeSet<String>) -> Vec<String> {
    let both = now.intersection(before).cloned().collect();
    *before = now;
    both
}

/// Ends links that belong to no session, and takes note of sessions that were not heard of, until the session closes.
pub(super) async fn end_strays(session: zenoh::Session, dialler: Dialler, to_keeper: Arc<Sender<Change>>) {
    let mut looks = Looks::default();
    loop {
        tokio::time::sleep(LOOK_EVERY).await;
        let known: BTreeSet<String> =
            session.info().transports().await.map(|transport| transport.zid().to_string()).collect();
        let ends = session.info().links().await.filter_map(|link| ends_of(&link)).collect();
        let (mut strays, unheard, unknown) = {
            let links = lock(&dialler.links);
            (links.strays(&known), &known - &links.standing, links.unknown(&ends))
        };
        for (session, both) in unknown {
            if patience::is_there(both) {
                strays.insert(session);
            } else {
                lock(&dialler.links).drop_link(&session, both);
            }
        }
        let tunnels = dialler.tunnels.iter().flat_map(|tunnels| tunnels.older_than(TUNNEL_MIN));
        strays.extend(tunnels.filter(|tunnel| !known.contains(tunnel)));
        let found = looks.look(strays, unheard);
        for stray in found.strays {
            tracing::debug!(session = stray, "zenoh does not know all its links, and they are ended");
            dialler.cut(&stray);
            lock(&dialler.links).forget(&stray);
            to_keeper.push(Change::Wanted(stray));
        }
        for session in found.unheard {
            tracing::debug!(session, "it stands, and no event says so");
            lock(&dialler.links).stand(session);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_two_looks_find_is_acted_on() {
        let set = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect::<BTreeSet<_>>();
        let mut looks = Looks::default();
        let mut look = |strays: &[&str], unheard: &[&str]| {
            let found = looks.look(set(strays), set(unheard));
            (found.strays.join(" "), found.unheard.join(" "))
        };
        assert_eq!(look(&["r2"], &["r3"]), Default::default(), "a moment");
        assert_eq!(look(&[], &[]), Default::default(), "it is over");
        assert_eq!(look(&["r2"], &["r3"]), Default::default());
        assert_eq!(look(&["r2", "r4"], &["r3"]), ("r2".to_owned(), "r3".to_owned()));
    }
}
