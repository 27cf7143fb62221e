//! Finds links of which zenoh and its events say different things, and makes them agree.
//!
//! Zenoh keeps its sessions in a table by peer, and deletes an entry by the peer alone. A session that is deleted twice, as when two of
//! its links end at once, so takes the entry of the next session away: that one still receives, and can send nothing, for ever. The
//! event of a loss may also come after that of the next session. Seen with zenoh 1.10.2; eclipse-zenoh/zenoh#1886 and #2806 are of the
//! same kind.

use super::super::links::lock;
use super::Change;
use super::keeper::Dialler;
use crate::io::queue::Sender;
use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

/// How often it is looked. What is told in the meantime is of the moment; what two looks in a row find stays.
const LOOK_EVERY: Duration = Duration::from_secs(1);
/// How old a tunnel is that has to carry a session: three round trips of 3 s.
const TUNNEL_MIN: Duration = Duration::from_secs(10);

/// What the last look has found.
#[derive(Default)]
struct Looks {
    strays: BTreeSet<String>,
    unheard: BTreeSet<String>,
}

/// What two looks in a row have found, by session.
#[derive(Debug, PartialEq, Eq)]
struct Found {
    /// There are links, and zenoh knows of no session.
    strays: Vec<String>,
    /// Zenoh has a session of which no event is the last.
    unheard: Vec<String>,
}

impl Looks {
    /// Compares the sessions that have links with those that zenoh knows, and those with those that stand.
    fn look(&mut self, linked: &BTreeSet<String>, known: &BTreeSet<String>, standing: &BTreeSet<String>) -> Found {
        let strays = twice(&mut self.strays, linked - known);
        Found { strays, unheard: twice(&mut self.unheard, known - standing) }
    }
}

/// Returns what was there before, too.
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
        // Before zenoh is asked: of what begins in between it knows.
        let mut linked = lock(&dialler.links).linked();
        linked.extend(dialler.tunnels.iter().flat_map(|tunnels| tunnels.older_than(TUNNEL_MIN)));
        let known = session.info().transports().await.map(|transport| transport.zid().to_string()).collect();
        let standing = lock(&dialler.links).standing.clone();
        let found = looks.look(&linked, &known, &standing);
        for stray in found.strays {
            tracing::debug!(session = stray, "its links belong to no session and are ended");
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
        let (none, r2) = (set(&[]), set(&["r2"]));
        let found = |strays: &[&str], unheard: &[&str]| Found {
            strays: strays.iter().map(|name| (*name).to_owned()).collect(),
            unheard: unheard.iter().map(|name| (*name).to_owned()).collect(),
        };
        let mut looks = Looks::default();
        assert_eq!(looks.look(&r2, &none, &r2), found(&[], &[]), "a moment");
        assert_eq!(looks.look(&r2, &r2, &r2), found(&[], &[]), "it is over");
        assert_eq!(looks.look(&r2, &none, &r2), found(&[], &[]));
        assert_eq!(looks.look(&r2, &none, &none), found(&["r2"], &[]), "whatever the events say");
        assert_eq!(looks.look(&r2, &r2, &none), found(&[], &[]));
        assert_eq!(looks.look(&r2, &r2, &none), found(&[], &["r2"]));
    }
}
