//! Rooms of a flat, shared out through the database of the team: each explorer claims the next free room, in
//! competition with the others.

use crate::headline;
use controllers::sdk::{
    About, Arguments, Controller, DatabaseRefusal, Entry, Every, Expected, Inputs, KeyAnswer, KeyNews, KeyPut,
    KeyResult, Kind, Out, Outputs, Parameter, Progress, Quantity, Registry, Signal, Tick, WatchEvent,
};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// Where claims are.
const PREFIX: &str = "team/flat/claim/";
/// How long the database has to answer.
const WITHIN: Duration = Duration::from_secs(5);

#[derive(Inputs)]
struct Hears {
    /// The claims of all explorers: first the present ones, then each change.
    #[port("Claims")]
    claims: Every<KeyNews>,
    /// The answers to its own claims.
    #[port("Answers")]
    answers: Every<KeyAnswer>,
}

#[derive(Outputs)]
struct Claims {
    #[port("Claim")]
    claim: Out<KeyPut>,
}

/// The present activity of an explorer.
#[derive(Debug, PartialEq)]
enum Now {
    /// It looks for a free room.
    Free,
    /// It has claimed a room, and waits for the answer.
    Asking(u64),
    /// It explores a room; the remaining time (s).
    Exploring(f64),
}

/// Explores the rooms that it has claimed, one after the other. It is done when all rooms are claimed.
struct Explorer {
    rooms: u64,
    /// How long a room takes (s).
    pace: f64,
    name: String,
    /// The explorer that has claimed each room, as far as this program knows.
    known: BTreeMap<String, String>,
    /// Whether all that was there at the beginning is known.
    is_complete: bool,
    /// Rooms that another explorer claimed first.
    lost: BTreeSet<u64>,
    now: Now,
    explored: f64,
}

impl Explorer {
    fn hear(&mut self, entries: &[Entry]) {
        for entry in entries {
            let Some(room) = entry.key.strip_prefix(PREFIX) else { continue };
            let by = entry.value.as_ref().and_then(|stored| String::try_from(stored.value()).ok());
            match by {
                Some(by) => drop(self.known.insert(room.to_owned(), by)),
                None => drop(self.known.remove(room)),
            }
        }
    }

    fn is_taken(&self, room: u64) -> bool {
        self.known.contains_key(&room.to_string()) || self.lost.contains(&room)
    }
}

impl Controller for Explorer {
    type Inputs = Hears;
    type Outputs = Claims;
    const TYPE: &'static str = "Explorer";

    fn about() -> About {
        const ROOMS: &[Parameter] = &[
            Parameter::new("rooms", Kind::Number(1.0, 1000.0)),
            Parameter::new("pace", Kind::Quantity(Quantity::Time, 0.0, 3600.0)).or("0.05"),
        ];
        About::task("Claims rooms, and explores those that it has.").every(Duration::from_millis(10)).with(ROOMS)
    }

    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "it is within its range")]
    fn new(arguments: &Arguments) -> Result<Self, String> {
        Ok(Self {
            rooms: arguments.number("rooms") as u64,
            pace: arguments.number("pace"),
            name: arguments.instance().to_owned(),
            known: BTreeMap::new(),
            is_complete: false,
            lost: BTreeSet::new(),
            now: Now::Free,
            explored: 0.0,
        })
    }

    fn main_calc(&mut self, tick: Tick, inputs: &Hears, outputs: &mut Claims) -> Progress {
        for news in inputs.claims.iter() {
            match &news.event {
                WatchEvent::Begin => (self.is_complete, self.known) = (false, BTreeMap::new()),
                WatchEvent::Present(entries) => self.hear(entries),
                WatchEvent::Complete => self.is_complete = true,
                WatchEvent::Changed(change) => self.hear(&change.entries),
                WatchEvent::Refused(why) => return Progress::Aborted(why.to_string()),
            }
        }
        for KeyAnswer { number, result } in inputs.answers.iter() {
            if self.now != Now::Asking(*number) {
                continue;
            }
            match result {
                // Only this is success: the claim is on the disk of this robot, and goes to all others.
                KeyResult::Committed(_) => self.now = Now::Exploring(self.pace),
                // Another explorer was quicker.
                KeyResult::Refused(DatabaseRefusal::Unmet { .. }) => {
                    self.lost.insert(*number);
                    self.now = Now::Free;
                }
                KeyResult::Refused(why) => return Progress::Aborted(why.to_string()),
                // It may still be committed: the news about the key will show it.
                KeyResult::Unknown(why) => return Progress::Aborted(why.clone()),
            }
        }
        if let Now::Exploring(left) = &mut self.now {
            *left -= tick.dt();
            if *left <= 0.0 {
                (self.now, self.explored) = (Now::Free, self.explored + 1.0);
            }
        }
        if self.now != Now::Free || !self.is_complete {
            return Progress::Continue;
        }
        match (1..=self.rooms).find(|room| !self.is_taken(*room)) {
            Some(room) => {
                let put = KeyPut::new(room, format!("{PREFIX}{room}"), self.name.as_str(), WITHIN);
                outputs.claim.send(put.expecting(Expected::Absent));
                self.now = Now::Asking(room);
                Progress::Continue
            }
            None => Progress::Done(Vec::new()),
        }
    }

    fn signals(&self) -> Vec<Signal> {
        vec![headline("explored", "", self.explored)]
    }
}

/// Adds the controllers of this example.
pub(crate) fn add(registry: &mut Registry) {
    registry.add::<Explorer>();
}
