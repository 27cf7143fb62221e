//! Finds links on which zenoh's table and zenoh's events disagree, and corrects them.
//!
//! Zenoh keeps its sessions in a table by peer, and deletes an entry by the peer alone. A session may be deleted twice, for example
//! because two of its links end at once. The second deletion then removes the entry of the next session, which still receives but
//! can never send. The event of a loss may also come after the event of the next session. Seen with zenoh 1.10.2;
//! eclipse-zenoh/zenoh#1886 and #2806 are of the same kind.

use super::super::links::lock;
use super::super::patience;
use super::ends_of;
use super::keeper::{Change, Dialler};
use crate::io::queue::Sender;
use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

/// The time between two comparisons. Events and table may differ for a moment. So a difference is
/// used only if two comparisons in a row find it.
const LOOK_EVERY: Duration = Duration::from_secs(1);
/// A tunnel of this age has to carry a session: three round trips of 3 s have passed.
const TUNNEL_MIN: Duration = Duration::from_secs(10);

/// Takes the differences of this comparison, by session; returns those that the previous comparison also found.
fn twice(before: &mut BTreeSet<String>, now: BTreeSet<String>) -> Vec<String> {
    let both = now.intersection(before).cloned().collect();
    *before = now;
    both
}

/// Ends links that belong to no session, and notes sessions that no event has reported, until the session closes.
pub(super) async fn end_strays(session: zenoh::Session, dialler: Dialler, to_keeper: Arc<Sender<Change>>) {
    let (mut strays_before, mut unheard_before) = (BTreeSet::new(), BTreeSet::new());
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
        for stray in twice(&mut strays_before, strays) {
            tracing::debug!(session = stray, "zenoh does not know all its links, and they are ended");
            dialler.cut(&stray);
            lock(&dialler.links).forget(&stray);
            to_keeper.push(Change::Wanted(stray));
        }
        for session in twice(&mut unheard_before, unheard) {
            tracing::debug!(session, "the link exists, but no event has reported it");
            lock(&dialler.links).stand(session);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_two_looks_find_is_acted_on() {
        let mut before = BTreeSet::new();
        let mut look = |names: &[&str]| twice(&mut before, names.iter().map(|name| (*name).to_owned()).collect());
        assert!(look(&["r2"]).is_empty(), "a moment");
        assert!(look(&[]).is_empty(), "it is over");
        assert!(look(&["r2"]).is_empty());
        assert_eq!(look(&["r2", "r4"]), ["r2"]);
    }
}
