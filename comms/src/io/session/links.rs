//! The table of links of a session: which stand, by zenoh's events, and where a lost one is dialled again.

use super::patience;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::net::IpAddr;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use zenoh::config::Locator;

/// At how many places one session is dialled.
const PLACES_MAX: usize = 4;
/// How many sessions that were found, and not linked yet, are dialled at a time.
const FOUND_MAX: usize = 64;
/// How many of those are on one machine.
const FOUND_NEAR_MAX: usize = 16;

/// Links by session id.
#[derive(Default)]
pub(super) struct Links {
    /// The links that stand, as zenoh's events say. Zenoh is also asked before dialling, but for a moment after a loss
    /// it still answers that there is a link.
    pub(super) standing: BTreeSet<String>,
    /// The links that are dialled again when they are lost.
    pub(super) kept: BTreeMap<String, Place>,
    /// The peers that the keeper dials right now.
    pub(super) dialling: BTreeSet<String>,
    /// The two ends of each TCP link of a session, and how long it may be silent, where that was said. Two that dial each other have
    /// two.
    pub(super) ends: BTreeMap<String, Vec<(patience::Ends, Duration)>>,
    /// Names of sessions that have said them.
    pub(super) names: BTreeMap<String, String>,
    /// Why there is no link, for a person.
    pub(super) troubles: BTreeMap<String, String>,
    /// Sessions that were found on the network, with their machines, from the one that was found first on.
    found: VecDeque<(String, IpAddr)>,
}

/// Where to dial a session again.
#[derive(Clone)]
pub(super) struct Place {
    pub(super) locators: Vec<Locator>,
    /// For how long; none for as long as this session lives.
    pub(super) within: Option<Duration>,
}

impl Links {
    /// Takes note of a session that says that it is there; says whether to dial it. Anybody can say anything on a network, so
    /// few that have never been linked are dialled at a time: a new one takes the place of the oldest of its machine, or of
    /// all. Who is there says so again.
    pub(super) fn find(
        &mut self,
        session: &str,
        name: String,
        (at, locator): (IpAddr, Locator),
        within: Duration,
    ) -> bool {
        if !self.kept.contains_key(session) {
            let (kept, standing) = (&self.kept, &self.standing);
            self.found.retain(|(other, _)| kept.contains_key(other) && !standing.contains(other));
            let is_near = |(_, other): &(String, IpAddr)| *other == at;
            let oldest = match self.found.iter().filter(|one| is_near(one)).count() {
                FOUND_NEAR_MAX.. => self.found.iter().position(is_near),
                _ => (self.found.len() >= FOUND_MAX).then_some(0),
            };
            if let Some((oldest, _)) = oldest.and_then(|oldest| self.found.remove(oldest)) {
                self.kept.remove(&oldest);
                self.names.remove(&oldest);
                self.troubles.remove(&oldest);
            }
            self.found.push_back((session.to_owned(), at));
        }
        if !name.is_empty() {
            self.names.insert(session.to_owned(), name);
        }
        let place = self.kept.entry(session.to_owned());
        let place = place.or_insert_with(|| Place { locators: Vec::new(), within: Some(within) });
        // What was heard last comes first.
        place.locators.retain(|other| *other != locator);
        place.locators.insert(0, locator);
        place.locators.truncate(PLACES_MAX);
        !self.standing.contains(session) && !self.dialling.contains(session)
    }

    /// Forgets a link; returns the other ones of the session.
    pub(super) fn lose(&mut self, session: &str, both: patience::Ends) -> Vec<patience::Ends> {
        let Some(ends) = self.ends.get_mut(session) else { return Vec::new() };
        ends.retain(|(other, _)| *other != both);
        let left: Vec<patience::Ends> = ends.iter().map(|(other, _)| *other).collect();
        if left.is_empty() {
            self.ends.remove(session);
        }
        left
    }
}

/// Returns the links; nobody holds them for long.
pub(super) fn lock(links: &Mutex<Links>) -> MutexGuard<'_, Links> {
    // Maps of plain values are valid whatever happened to the thread that held them.
    links.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_on_the_network_make_few_dials() {
        let mut links = Links::default();
        let hear = |links: &mut Links, session: &str, machine: u8| {
            let at = IpAddr::from([10, 0, 0, machine]);
            let locator = format!("tcp/{at}:7").parse().unwrap();
            links.find(session, "c1".into(), (at, locator), Duration::from_secs(60))
        };
        // One that is linked, and one that this program was told of, stay whatever is said.
        assert!(hear(&mut links, "linked", 1));
        links.standing.insert("linked".into());
        links.kept.insert("told".into(), Place { locators: vec![], within: None });
        for number in 0..1000 {
            assert!(hear(&mut links, &format!("forged {number}"), 2));
        }
        assert_eq!(links.kept.len(), 2 + FOUND_NEAR_MAX, "one machine has few");
        assert!(hear(&mut links, "new", 3) && links.kept.contains_key("forged 999"));
        for number in 0..1000_u16 {
            hear(&mut links, &format!("more {number}"), u8::try_from(10 + number % 200).unwrap());
        }
        assert_eq!((links.kept.len(), links.names.len()), (2 + FOUND_MAX, 1 + FOUND_MAX), "all machines have few");
        assert!(["linked", "told"].iter().all(|session| links.kept.contains_key(*session)));
        assert!(hear(&mut links, "new", 3) && links.kept.contains_key("new"), "who is there says so again");
        links.dialling.insert("new".into());
        assert!(!hear(&mut links, "new", 3) && !hear(&mut links, "linked", 1));
    }
}
