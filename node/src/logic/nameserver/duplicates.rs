//! Names that two nodes have.

use super::{Boot, NameServer, Peer};
use crate::logic::protocol::Duplicate;

impl NameServer {
    /// Returns the boots of other nodes with this one's name that are there, and whether each was there first.
    pub fn namesakes(&self) -> impl Iterator<Item = (u64, bool)> {
        let own = self.peers.get(&self.host).into_iter().flat_map(|peer| &peer.lives);
        own.filter(|(_, life)| life.is_there()).map(|(boot, life)| (*boot, life.is_elder))
    }

    /// Returns where another node with this one's name runs.
    pub fn place(&self, boot: u64) -> Option<&str> {
        self.peers.get(&self.host)?.lives.get(&boot).map(|life| life.place.as_str())
    }

    /// Returns the names that two nodes have; this one is at `place`.
    pub fn duplicates(&self, place: &str) -> Vec<Duplicate> {
        let of_name = |(host, peer): (&String, &Peer)| {
            let is_own = *host == self.host;
            let held = peer.holder.and_then(|boot| peer.lives.get(&boot)).filter(|life| life.is_there());
            let first = if is_own { Some(place) } else { held.map(|life| life.place.as_str()) };
            let others = peer
                .lives
                .iter()
                .filter(|(boot, life)| life.is_there() && (is_own || life.is_rival && Some(**boot) != peer.holder));
            let pair = |life: &Boot| {
                let (first, second) = (first?.to_owned(), life.place.clone());
                let is_second = is_own && life.is_elder;
                let (first, second) = if is_second { (second, first) } else { (first, second) };
                Some(Duplicate { host: host.clone(), first, second })
            };
            others.filter_map(|(_, life)| pair(life)).collect::<Vec<_>>()
        };
        self.peers.iter().flat_map(of_name).collect()
    }
}
