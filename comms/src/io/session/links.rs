//! The table of links of a session: the present links, by zenoh's events, and the places where a lost link is dialled again.
//!
//! A *known* place stays in the table, and is dialled first. The program was given it, a link has been there, or it has proved the key
//! of its session. Any other place was only announced on the network, where any host can announce anything. So only a few announced
//! places of each sender are kept. A place that has failed is not dialled for a while, and an untried place may replace it.

use super::patience;
use crate::logic::time::Time;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::net::IpAddr;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use zenoh::config::Locator;

/// How many places of one session are kept that were only announced on the network.
const PROPOSED_MAX: usize = 16;
/// How many of these places may come from one sender.
const PROPOSED_BY_ONE_MAX: usize = 2;
/// How many known places of one session are kept.
const KNOWN_MAX: usize = 8;
/// How long a place is not dialled after its first failure. The time doubles with each further failure.
const LEFT_ALONE: Duration = Duration::from_secs(1);
/// The longest time for which a place that has failed is not dialled.
const LEFT_ALONE_MAX: Duration = Duration::from_secs(8);
/// How many sessions that were found on the network, and are not linked yet, are dialled at a time.
const FOUND_MAX: usize = 64;
/// How many of these sessions may be on one machine.
const FOUND_NEAR_MAX: usize = 16;

/// Links by session id.
#[derive(Default)]
pub(super) struct Links {
    /// The linked sessions, according to zenoh's events. Before dialling, zenoh itself is asked as well; but right after a loss it may
    /// still answer that there is a link.
    pub(super) standing: BTreeSet<String>,
    /// The linked sessions that have lost one of several links. Zenoh takes a new link for a further link of the old session, even if
    /// the other side has discarded that session and opened another. Then neither side understands the other. So a session has to end
    /// with the loss of any of its links.
    halved: BTreeSet<String>,
    /// The links that are dialled again when they are lost.
    pub(super) kept: BTreeMap<String, Place>,
    /// The peers that the keeper dials right now.
    pub(super) dialling: BTreeSet<String>,
    /// The two ends of each TCP link of a session, and how long the link may be silent, if that is known. Two sessions that dial each
    /// other have two links.
    pub(super) ends: BTreeMap<String, Vec<(patience::Ends, Duration)>>,
    /// The names of sessions, as the sessions have announced them.
    pub(super) names: BTreeMap<String, String>,
    /// The reasons for missing links, by session or place, for people.
    pub(super) troubles: BTreeMap<String, String>,
    /// Sessions that were found on the network, each with its machine, in the order in which they were found.
    found: VecDeque<(String, IpAddr)>,
}

/// Where to dial a session again.
#[derive(Clone, Default)]
pub(super) struct Place {
    /// Places that the program was given, where a link has been, or that have proved the session's key.
    pub(super) known: Vec<Locator>,
    /// Places that were announced on the network, the latest first.
    proposed: Vec<Proposed>,
    /// For how long the session is dialled again; `None`: until this program's session closes.
    pub(super) within: Option<Duration>,
}

/// A place that was announced on the network.
#[derive(Clone)]
struct Proposed {
    locator: Locator,
    /// The machine that has announced it.
    by: IpAddr,
    /// How often dialling it has failed, and until when it is not dialled.
    failures: u32,
    until: Time,
}

/// An announcement on the network: a session, and a place where it can be dialled.
pub(super) struct PlaceFound {
    pub(super) session: String,
    /// Its name; empty if the announcement has none.
    pub(super) name: String,
    pub(super) by: IpAddr,
    pub(super) locator: Locator,
}

impl Place {
    /// Returns the known places that the program was given.
    pub(super) const fn told(known: Vec<Locator>, within: Option<Duration>) -> Self {
        Self { known, proposed: Vec::new(), within }
    }

    /// Returns all places, for people.
    pub(super) fn all(&self) -> impl Iterator<Item = &Locator> {
        self.known.iter().chain(self.proposed.iter().map(|proposed| &proposed.locator))
    }

    /// Returns the announced places that may be tried now.
    pub(super) fn due(&self, now: Time) -> Vec<Locator> {
        let due = self.proposed.iter().filter(|proposed| proposed.until <= now);
        due.map(|proposed| proposed.locator.clone()).collect()
    }

    fn propose(&mut self, locator: Locator, by: IpAddr) {
        if self.known.contains(&locator) || self.proposed.iter().any(|proposed| proposed.locator == locator) {
            return;
        }
        let by_one = self.proposed.iter().filter(|proposed| proposed.by == by).count();
        let of_sender = |proposed: &Proposed| by_one < PROPOSED_BY_ONE_MAX || proposed.by == by;
        if by_one >= PROPOSED_BY_ONE_MAX || self.proposed.len() >= PROPOSED_MAX {
            // The place that has failed most often is replaced; among several such places, the oldest.
            let places = self.proposed.iter().enumerate().filter(|(_, proposed)| of_sender(proposed));
            let gives_way = places.max_by_key(|(place, proposed)| (proposed.failures, *place)).map(|(place, _)| place);
            gives_way.map(|place| self.proposed.remove(place));
        }
        self.proposed.insert(0, Proposed { locator, by, failures: 0, until: Time::ZERO });
    }
}

impl Links {
    /// Notes an announcement of a session; returns whether to dial the session. Any host on a network can announce anything, so only a
    /// few sessions that were never linked are dialled at a time. A new one replaces the oldest of its machine, or the oldest of all.
    /// Real sessions repeat their announcement.
    pub(super) fn find(&mut self, PlaceFound { session, name, by, locator }: PlaceFound, within: Duration) -> bool {
        if !self.kept.contains_key(&session) {
            let (kept, standing) = (&self.kept, &self.standing);
            self.found.retain(|(other, _)| kept.contains_key(other) && !standing.contains(other));
            let is_near = |(_, other): &(String, IpAddr)| *other == by;
            let oldest = match self.found.iter().filter(|one| is_near(one)).count() {
                FOUND_NEAR_MAX.. => self.found.iter().position(is_near),
                _ => (self.found.len() >= FOUND_MAX).then_some(0),
            };
            if let Some((oldest, _)) = oldest.and_then(|oldest| self.found.remove(oldest)) {
                self.kept.remove(&oldest);
                self.names.remove(&oldest);
                self.troubles.remove(&oldest);
            }
            self.found.push_back((session.clone(), by));
        }
        if !name.is_empty() {
            self.names.insert(session.clone(), name);
        }
        let is_wanted = !self.standing.contains(&session) && !self.dialling.contains(&session);
        let place = self.kept.entry(session).or_insert_with(|| Place::told(Vec::new(), Some(within)));
        place.propose(locator, by);
        is_wanted
    }

    /// Notes that a session is at a place: a link was made there, or the place has proved its key.
    pub(super) fn prove(&mut self, session: &str, locator: &Locator) {
        let Some(place) = self.kept.get_mut(session) else { return };
        place.proposed.retain(|proposed| proposed.locator != *locator);
        if !place.known.contains(locator) {
            place.known.insert(0, locator.clone());
            place.known.truncate(KNOWN_MAX);
        }
    }

    /// Notes that dialling a place of a session has failed.
    pub(super) fn fail(&mut self, session: &str, locator: &Locator, now: Time) {
        let Some(place) = self.kept.get_mut(session) else { return };
        for proposed in place.proposed.iter_mut().filter(|proposed| proposed.locator == *locator) {
            proposed.until = now + LEFT_ALONE_MAX.min(LEFT_ALONE * 2_u32.saturating_pow(proposed.failures.min(8)));
            proposed.failures = proposed.failures.saturating_add(1);
        }
    }

    /// Notes that a session is linked.
    pub(super) fn stand(&mut self, session: String) {
        self.troubles.remove(&session);
        self.halved.remove(&session);
        self.standing.insert(session);
    }

    /// Notes that a session is not linked any more.
    pub(super) fn fall(&mut self, session: &str) {
        self.halved.remove(session);
        self.standing.remove(session);
    }

    /// Notes a TCP link of a session.
    pub(super) fn gain(&mut self, session: &str, both: patience::Ends) {
        self.ends.entry(session.to_owned()).or_default().push((both, Duration::ZERO));
    }

    /// Notes that a link of a session is lost. Returns whether the session has to end because it has other links.
    pub(super) fn lose(&mut self, session: &str, both: Option<patience::Ends>) -> bool {
        if self.standing.contains(session) {
            self.halved.insert(session.to_owned());
        }
        both.into_iter().for_each(|both| self.drop_link(session, both));
        self.ends.contains_key(session)
    }

    /// Returns the TCP links that zenoh does not know, with their sessions.
    pub(super) fn unknown(&self, known: &BTreeSet<patience::Ends>) -> Vec<(String, patience::Ends)> {
        let all = self.ends.iter().flat_map(|(session, links)| links.iter().map(move |(both, _)| (session, *both)));
        all.filter(|(_, both)| !known.contains(both)).map(|(session, both)| (session.clone(), both)).collect()
    }

    /// Returns further sessions that have to end, besides the sessions with unknown links. These have lost one of several links, or
    /// zenoh does not know them although its events said that they are linked.
    pub(super) fn strays(&self, known: &BTreeSet<String>) -> BTreeSet<String> {
        self.halved.iter().chain(self.standing.difference(known)).cloned().collect()
    }

    /// Removes a link that has ended.
    pub(super) fn drop_link(&mut self, session: &str, both: patience::Ends) {
        let Some(ends) = self.ends.get_mut(session) else { return };
        ends.retain(|(other, _)| *other != both);
        if ends.is_empty() {
            self.ends.remove(session);
        }
    }

    /// Removes all links of a session that has ended.
    pub(super) fn forget(&mut self, session: &str) {
        self.fall(session);
        self.ends.remove(session);
    }

    /// Returns the two ends of each TCP link of a session.
    pub(super) fn ends_of(&self, session: &str) -> Vec<patience::Ends> {
        self.ends.get(session).into_iter().flatten().map(|(ends, _)| *ends).collect()
    }
}

/// Locks the table. The lock is never held for long.
pub(super) fn lock(links: &Mutex<Links>) -> MutexGuard<'_, Links> {
    // Maps of plain values are valid even if a thread has panicked while it held the lock.
    links.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_on_the_network_make_few_dials() {
        let mut links = Links::default();
        let hear = |links: &mut Links, session: &str, machine: u8| {
            let by = IpAddr::from([10, 0, 0, machine]);
            let locator = format!("tcp/{by}:7").parse().unwrap();
            links.find(PlaceFound { session: session.into(), name: "c1".into(), by, locator }, Duration::from_secs(60))
        };
        // A linked session, and a session that this program was given, stay in spite of all announcements.
        assert!(hear(&mut links, "linked", 1));
        links.standing.insert("linked".into());
        links.kept.insert("told".into(), Place::told(vec![], None));
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

    #[test]
    fn a_session_that_outlives_a_link_or_that_zenoh_does_not_know_is_a_stray() {
        let ends = |port: u16| ((([127, 0, 0, 1], port).into()), ([127, 0, 0, 1], 7).into());
        let known: BTreeSet<String> = ["r2".to_owned()].into();
        let standing = || {
            let mut links = Links::default();
            links.stand("r2".into());
            links.gain("r2", ends(1));
            links
        };
        let mut links = standing();
        assert!(links.strays(&known).is_empty() && links.strays(&BTreeSet::new()) == known);
        assert_eq!(
            (links.unknown(&[ends(1)].into()), links.unknown(&BTreeSet::new())),
            (vec![], vec![("r2".into(), ends(1))])
        );
        // A new link may be heard of first.
        links.gain("r2", ends(2));
        assert!(links.lose("r2", Some(ends(1))) && links.strays(&known) == known);
        let mut links = standing();
        assert!(!links.lose("r2", Some(ends(1))));
        links.gain("r2", ends(2));
        assert_eq!(links.strays(&known), known);
        // The next session of the same node has another id.
        links.fall("r2");
        links.stand("r2".into());
        assert!(links.strays(&known).is_empty());
        links.forget("r2");
        assert!(links.strays(&BTreeSet::new()).is_empty() && links.unknown(&BTreeSet::new()).is_empty());
    }

    fn locator(text: &str) -> Locator {
        format!("tcp/{text}").parse().unwrap()
    }

    /// Announces that a session is at a place, in the name of a machine.
    fn say(links: &mut Links, session: &str, by: [u8; 4], place: &str) {
        let heard = PlaceFound { session: session.into(), name: String::new(), by: by.into(), locator: locator(place) };
        links.find(heard, Duration::from_secs(60));
    }

    #[test]
    fn words_on_the_network_do_not_displace_a_place_that_has_proved_itself() {
        let (mut links, at) = (Links::default(), Time::from_nanos(1));
        say(&mut links, "r2", [10, 0, 0, 2], "10.0.0.2:7");
        assert_eq!(links.kept["r2"].due(at), [locator("10.0.0.2:7")]);
        links.prove("r2", &locator("10.0.0.2:7"));
        for number in 0..1000_u16 {
            let machine = u8::try_from(number % 250).unwrap();
            say(&mut links, "r2", [10, 0, 9, machine], &format!("10.0.9.{machine}:{number}"));
        }
        let place = &links.kept["r2"];
        assert_eq!((&place.known[..], place.due(at).len()), (&[locator("10.0.0.2:7")][..], PROPOSED_MAX));
        say(&mut links, "r2", [10, 0, 0, 2], "10.0.0.2:7");
        assert!(!links.kept["r2"].due(at).contains(&locator("10.0.0.2:7")), "it is known");
    }

    #[test]
    fn a_sender_has_few_places_and_those_that_failed_give_way() {
        let (mut links, at) = (Links::default(), Time::from_nanos(1));
        for port in 1..100 {
            say(&mut links, "r2", [10, 0, 0, 66], &format!("10.0.0.66:{port}"));
        }
        assert_eq!(links.kept["r2"].due(at), [locator("10.0.0.66:99"), locator("10.0.0.66:98")]);
        for machine in 100..114 {
            say(&mut links, "r2", [10, 0, 0, machine], &format!("10.0.0.{machine}:7"));
        }
        let all = links.kept["r2"].due(at);
        assert_eq!(all.len(), PROPOSED_MAX);
        all[1..].iter().for_each(|place| links.fail("r2", place, at));
        assert_eq!(links.kept["r2"].due(at), all[..1], "the others are left alone");
        for machine in 200..215 {
            say(&mut links, "r2", [10, 0, 0, machine], &format!("10.0.0.{machine}:7"));
        }
        let now = links.kept["r2"].due(at);
        assert!(now.len() == PROPOSED_MAX && now.contains(&all[0]), "those that were not tried stay: {now:?}");
        // Longer and longer.
        let mut now = at;
        for seconds in [1, 2, 4, 8, 8, 8] {
            links.fail("r2", &all[0], now);
            let is_due = |later: u64| links.kept["r2"].due(now + Duration::from_millis(later)).contains(&all[0]);
            assert!(!is_due(1000 * seconds - 1) && is_due(1000 * seconds), "{seconds}");
            now = now + Duration::from_secs(seconds);
        }
    }
}
