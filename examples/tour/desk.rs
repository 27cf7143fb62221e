//! The desk of the museum, off board: visitors ask for tours, and people speak to robots.
//!
//! The people are a stand-in: a source of random numbers with a seed. A tour is given to the first robot that asks. It stays
//! open until this robot reports its end, so a robot that asks again, after a lost answer, gets the same tour again.

use super::ear::{NAME, robot_name};
use super::museum::EXHIBITS;
use super::{PERIOD, Tour};
use crate::headline;
use controllers::sdk::messaging::{Label, Router};
use controllers::sdk::serde::{Deserialize, Serialize};
use controllers::sdk::{
    About, Arguments, Calls, Controller, Exports, Kind, Message, Outcome, Outputs, Parameter, Progress, Random, Reply,
    Signal, Tick, Time,
};
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

/// How many words wait for a robot, and how many robots ask at the same time.
const WORDS_MAX: usize = 16;
const ROBOTS_MAX: usize = 16;
/// How long a robot waits for a tour before it asks again.
const ASK_WITHIN: Duration = Duration::from_secs(4);

/// A robot asks for a tour, and reports the end of its last one.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(crate = "controllers::sdk::serde")]
pub(super) struct TourRequest {
    robot: String,
    /// The number of the tour that is over. 0 without one.
    finished: f64,
}

impl Message for TourRequest {
    const TYPE: &'static str = "TourRequest";
    const FIELDS: &'static str = "robot: Text, finished: Number";
}

/// The answer of the desk.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(crate = "controllers::sdk::serde")]
pub(super) struct TourAnswer {
    /// Whether the museum has closed. Then the tour is empty.
    closed: bool,
    tour: Tour,
}

impl Message for TourAnswer {
    const TYPE: &'static str = "TourAnswer";
    const FIELDS: &'static str = "closed: Truth, tour: Tour";
}

/// A robot that waits for a tour.
struct Waiting {
    robot: String,
    reply: Reply<TourAnswer>,
}

/// The desk, with its visitors.
pub(super) struct Desk {
    /// The tours that no robot has, each with the time of its request (s after the start).
    tours: VecDeque<(f64, Tour)>,
    /// The tours that robots have, by robot.
    open: BTreeMap<String, Tour>,
    waiting: Vec<Waiting>,
    words: Router<String>,
    /// The words that will be said: when (s after the start), and to which robot.
    said: VecDeque<(f64, Word)>,
    /// The time since the start (s).
    elapsed: f64,
    done: f64,
}

/// A word for a robot.
struct Word {
    robot: String,
    text: &'static str,
    priority: u8,
}

impl Desk {
    /// Takes a request. The tour of the robot that is over is done.
    fn ask(&mut self, request: TourRequest, reply: Reply<TourAnswer>) {
        let is_over = |open: &mut Tour| (open.number - request.finished).abs() < 0.5;
        if self.open.get_mut(&request.robot).is_some_and(is_over) {
            self.open.remove(&request.robot);
            self.done += 1.0;
        }
        // An earlier question of the same robot is over.
        self.waiting.retain(|other| other.robot != request.robot);
        if self.waiting.len() >= ROBOTS_MAX {
            return reply.refuse("too many robots ask for tours");
        }
        self.waiting.push(Waiting { robot: request.robot, reply });
    }

    /// Answers the robots that can be answered now.
    fn answer(&mut self) {
        for Waiting { robot, reply } in std::mem::take(&mut self.waiting) {
            if !reply.is_wanted() {
                continue;
            }
            let open = self.open.get(&robot).cloned().or_else(|| {
                self.tours.front().filter(|(asked, _)| *asked <= self.elapsed)?;
                let (_, tour) = self.tours.pop_front()?;
                self.open.insert(robot.clone(), tour.clone());
                Some(tour)
            });
            match open {
                Some(tour) => reply.send(TourAnswer { closed: false, tour }),
                None if self.tours.is_empty() => reply.send(TourAnswer { closed: true, tour: Tour::default() }),
                None => self.waiting.push(Waiting { robot, reply }),
            }
        }
    }

    /// Says the words that are due.
    fn say(&mut self, now: Time) -> Result<(), String> {
        while self.said.front().is_some_and(|(at, _)| *at <= self.elapsed) {
            let Some((_, word)) = self.said.pop_front() else { return Ok(()) };
            let label = Label { category: &word.robot, priority: word.priority, marker: 0 };
            self.words.send(now, label, &word.text.to_owned())?;
        }
        Ok(())
    }
}

/// Returns the requests of visitors: a tour every few seconds, with two different exhibits each.
fn visitors(random: &mut Random, count: u64) -> VecDeque<(f64, Tour)> {
    let exhibits = EXHIBITS.len() as u64 - 1;
    let (mut at, mut tours) = (0.0, VecDeque::new());
    for number in 1..=count {
        let first = 1 + random.bits() % exhibits;
        let second = 1 + (first + random.bits() % (exhibits - 1)) % exhibits;
        let stops = vec![first as f64, second as f64];
        tours.push_back((at, Tour { number: number as f64, stops }));
        at += random.between(1.0, 6.0);
    }
    tours
}

/// Returns the words of people: one robot is stopped and may go on, and is told to go faster.
fn people(random: &mut Random, robots: &[String]) -> VecDeque<(f64, Word)> {
    let mut said = Vec::new();
    for robot in robots {
        let stop = random.between(5.0, 15.0);
        let word = |text, priority| Word { robot: robot.clone(), text, priority };
        said.push((stop, word("stop", 9)));
        said.push((stop + random.between(1.0, 3.0), word("go on", 5)));
        said.push((stop + random.between(5.0, 9.0), word("faster", 1)));
    }
    said.sort_by(|one, other| one.0.total_cmp(&other.0));
    said.into()
}

impl Controller for Desk {
    type Inputs = ();
    type Outputs = ();
    const TYPE: &'static str = "Desk";

    fn about() -> About {
        const PARAMETERS: &[Parameter] = &[
            Parameter::new("tours", Kind::Whole(0.0, 1000.0)).or("4"),
            Parameter::new("robots", Kind::Text(&[])).or("ann bob"),
            Parameter::new("seed", Kind::Whole(0.0, 1e9)).or("1"),
        ];
        About::service("Gives tours to robots, and tells them the words of people.")
            .remembers()
            .every(PERIOD)
            .with(PARAMETERS)
            .signals_every(Duration::from_secs(1))
    }

    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "both are within their ranges")]
    fn new(arguments: &Arguments) -> Result<Self, String> {
        let mut random = Random::new(arguments.number("seed") as u64);
        let robots: Vec<String> = arguments.text("robots").split_whitespace().map(str::to_owned).collect();
        Ok(Self {
            tours: visitors(&mut random, arguments.number("tours") as u64),
            said: people(&mut random, &robots),
            open: BTreeMap::new(),
            waiting: Vec::new(),
            words: Router::new("desk", WORDS_MAX).map_err(|cause| cause.to_string())?,
            elapsed: 0.0,
            done: 0.0,
        })
    }

    fn exports(exports: &mut Exports<Self>) {
        exports
            .procedure_later("Tours", "Gives the robot a tour, once visitors have asked for one.", Self::ask)
            .procedure_later("Words", "Tells the words of people: a router.", |desk: &mut Self, asked, reply| {
                desk.words.ask(asked, reply);
            })
            .state("words", "The robots that hear the words of people.", |desk| desk.words.status());
    }

    fn main_calc(&mut self, tick: Tick, (): &(), (): &mut ()) -> Progress {
        self.elapsed += tick.dt();
        self.answer();
        if let Err(why) = self.say(tick.now) {
            return Progress::Aborted(why);
        }
        self.words.work(tick.now);
        Progress::Continue
    }

    fn signals(&self) -> Vec<Signal> {
        vec![headline("tours done", "", self.done)]
    }
}

#[derive(Outputs)]
pub(super) struct NextOutputs {
    /// The desk.
    #[calls("Tours")]
    tours: Calls<TourRequest, TourAnswer>,
}

/// Reports the end of the last tour, and waits for the next one. Without a link it asks again, for ever.
pub(super) struct NextTour {
    robot: String,
    given: f64,
}

impl Controller for NextTour {
    type Inputs = ();
    type Outputs = NextOutputs;
    const TYPE: &'static str = "NextTour";

    fn about() -> About {
        const OUTCOMES: &[Outcome] =
            &[Outcome { tag: "tour", type_name: Some("Tour") }, Outcome { tag: "closed", type_name: None }];
        About::task("Reports the end of a tour, and waits for the next one.")
            .every(PERIOD)
            .with(NAME)
            .ends_with(OUTCOMES)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        Ok(Self { robot: robot_name(arguments)?, given: 0.0 })
    }

    fn main_calc(&mut self, _: Tick, (): &(), outputs: &mut NextOutputs) -> Progress {
        while let Some((_, answer)) = outputs.tours.answer() {
            match answer {
                Ok(TourAnswer { closed: true, .. }) => return Progress::outcome("closed", &()),
                Ok(TourAnswer { tour, .. }) => {
                    self.given = tour.number;
                    return Progress::outcome("tour", &tour);
                }
                // No tour in time, or no link: it asks again.
                Err(_) => {}
            }
        }
        if outputs.tours.pending() == 0 {
            outputs.tours.call(TourRequest { robot: self.robot.clone(), finished: self.given }, ASK_WITHIN);
        }
        Progress::Continue
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_tour_shows_two_exhibits_that_are_there() {
        for seed in 0..100 {
            for (_, tour) in visitors(&mut Random::new(seed), 20) {
                assert!((tour.stops[0] - tour.stops[1]).abs() > 0.5, "{tour:?}");
                assert!(
                    tour.stops.iter().all(|stop| super::super::exhibit(*stop).is_some_and(|at| at > 0)),
                    "{tour:?}"
                );
            }
        }
    }
}
