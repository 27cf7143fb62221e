//! A container of components, seen from outside: one component after the other is loaded, and then all have to stay loaded.
//!
//! Only the container knows which components it has loaded. A request without an answer may have been carried out, and a second request
//! would load the component twice. So the container is asked for its components before a request is repeated. A silent container only
//! fails at the end of the time that its spec allows. Source: `composition_interfaces/srv/{LoadNode,ListNodes}`.

use super::lifecycle::Standing;
use comms::logic::human::span;
use comms::logic::time::Time;
use std::time::Duration;

/// How often the components of a container are requested when all are loaded.
const ASK_EVERY: Duration = Duration::from_secs(1);
/// The pause before the next request if the container has not answered.
const LOOK_AGAIN: Duration = Duration::from_millis(200);

/// A component to load.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Wanted {
    /// The component, for a person.
    pub(crate) shown: String,
    /// The full name of its node.
    pub(crate) node: String,
}

/// News of a container.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Input {
    /// Whether its services exist; checked from time to time.
    Services { are_there: bool },
    /// The answer to the request to load a component, by its number.
    Loaded { number: u32, answer: Answer },
    /// The answer to a request for the components; none if it was lost, or is not an answer of a container.
    Listed { number: u32, components: Option<Vec<Loaded>> },
}

/// The answer to the request to load a component.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Answer {
    /// The container has loaded it, and this is its number.
    Done { id: u64 },
    /// The container has not loaded it, for this reason.
    Failed { why: String },
    /// The answer is missing or cannot be read: the component may be loaded.
    Missing,
}

/// A component in a container.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Loaded {
    pub(crate) id: u64,
    pub(crate) node: String,
}

/// An effect on a container.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Effect {
    /// Start the program of the container.
    Start,
    /// Load the component with this index.
    Load { number: u32, component: usize },
    /// Ask for the components.
    List { number: u32 },
}

/// A request without an answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Request {
    Load,
    List,
}

/// The requests for the components.
#[derive(Debug)]
struct Questions {
    due: Time,
    /// When the container last answered.
    heard: Time,
    /// Whether the next component may be loaded already.
    has_doubt: bool,
    /// Whether the container has listed its components since its start.
    has_listed: bool,
}

/// A container, from its start to its end.
#[derive(Debug)]
pub(crate) struct Container {
    name: String,
    components: Vec<Wanted>,
    /// The numbers of the loaded components, in their order.
    loaded: Vec<u64>,
    /// How long the start may take, and how long the container may be silent.
    within: Duration,
    until: Time,
    standing: Standing,
    is_started: bool,
    are_there: bool,
    /// The number of the last request.
    number: u32,
    request: Option<Request>,
    questions: Questions,
}

impl Container {
    /// Returns a container that is not started. All components have to be loaded within this time.
    pub(crate) fn new(name: String, components: Vec<Wanted>, within: Duration, now: Time) -> Self {
        Self {
            name,
            components,
            loaded: Vec::new(),
            within,
            until: now + within,
            standing: Standing::Underway,
            is_started: false,
            are_there: false,
            number: 0,
            request: None,
            questions: Questions { due: now, heard: now, has_doubt: false, has_listed: false },
        }
    }

    /// Numbers the requests from this number on. So a late answer to an earlier container of this name is not taken.
    pub(crate) fn after(self, number: u32) -> Self {
        Self { number, ..self }
    }

    /// Returns the number of the last request.
    pub(crate) fn number(&self) -> u32 {
        self.number
    }

    /// Takes an input.
    pub(crate) fn handle(&mut self, now: Time, input: Input, effects: &mut Vec<Effect>) {
        match input {
            Input::Services { are_there } => self.are_there = are_there,
            Input::Loaded { number, answer } => {
                if self.answered(number) == Some(Request::Load) {
                    self.take_answer(now, answer);
                }
            }
            Input::Listed { number, components } => {
                if self.answered(number) == Some(Request::List) {
                    self.take_list(now, components, effects);
                }
            }
        }
        self.look(now, effects);
    }

    /// Returns whether all components are loaded.
    pub(crate) fn standing(&self) -> &Standing {
        &self.standing
    }

    /// Returns how many components are loaded.
    pub(crate) fn loaded(&self) -> usize {
        self.loaded.len()
    }

    /// Takes an answer; returns its request. An answer to an earlier request is ignored.
    fn answered(&mut self, number: u32) -> Option<Request> {
        self.request.take_if(|_| number == self.number)
    }

    fn take_answer(&mut self, now: Time, answer: Answer) {
        let why = match answer {
            Answer::Done { id } if id != 0 && !self.loaded.contains(&id) => {
                self.loaded.push(id);
                self.questions.heard = now;
                self.questions.due = now + ASK_EVERY;
                return;
            }
            Answer::Done { id } => format!("the container gives the number {id}, which no new component can have"),
            Answer::Failed { why } if why.is_empty() => {
                "the container gives no reason; its output may say why".to_owned()
            }
            Answer::Failed { why } => why,
            Answer::Missing => {
                self.questions.has_doubt = true;
                self.questions.due = now + LOOK_AGAIN;
                return;
            }
        };
        self.fail(&format!("{} was not loaded: {why}", self.next()));
    }

    fn take_list(&mut self, now: Time, components: Option<Vec<Loaded>>, effects: &mut Vec<Effect>) {
        self.questions.due = now + if self.standing == Standing::Reached { ASK_EVERY } else { LOOK_AGAIN };
        let Some(components) = components else {
            self.questions.due = now + LOOK_AGAIN;
            if !self.is_started && !self.are_there {
                self.is_started = true;
                effects.push(Effect::Start);
            }
            return;
        };
        self.questions.heard = now;
        if !self.is_started {
            // A container with this name exists, and would get the requests as well.
            return;
        }
        self.questions.has_listed = true;
        if std::mem::take(&mut self.questions.has_doubt) {
            let wanted = self.components.get(self.loaded.len()).map(|wanted| &wanted.node);
            let is_new = |found: &&Loaded| Some(&found.node) == wanted && !self.loaded.contains(&found.id);
            self.loaded.extend(components.iter().find(is_new).map(|found| found.id));
        }
        let is_gone = |id: &u64| components.iter().all(|found| found.id != *id);
        if let Some(gone) = self.loaded.iter().position(is_gone) {
            let shown = &self.components[gone].shown;
            self.fail(&format!(
                "{shown} is not loaded any more: another client, or the container itself, has unloaded it"
            ));
        }
    }

    /// Updates the relation to the wanted state, and sends the next request.
    fn look(&mut self, now: Time, effects: &mut Vec<Effect>) {
        match self.standing {
            Standing::Failed(_) => return,
            Standing::Underway if self.is_started && self.loaded.len() == self.components.len() => {
                self.standing = Standing::Reached;
            }
            Standing::Underway if now >= self.until => return self.fail(&self.late()),
            Standing::Reached if now >= self.questions.heard + ASK_EVERY + self.within => {
                let why = format!("it has not listed its components for {}", span(self.within));
                return self.fail(&why);
            }
            Standing::Underway | Standing::Reached => {}
        }
        // Before the start, the only request is whether a container with this name already exists.
        if self.request.is_some() || self.are_there != self.is_started {
            return;
        }
        let is_question = !self.is_started || self.questions.has_doubt || self.standing == Standing::Reached;
        if is_question && now < self.questions.due {
            return;
        }
        self.number += 1;
        let (number, component) = (self.number, self.loaded.len());
        self.request = Some(if is_question { Request::List } else { Request::Load });
        effects.push(if is_question { Effect::List { number } } else { Effect::Load { number, component } });
    }

    fn fail(&mut self, why: &str) {
        self.standing = Standing::Failed(format!("container `{}`: {why}", self.name));
    }

    /// Returns the component that is loaded next, for a person.
    fn next(&self) -> &str {
        self.components.get(self.loaded.len()).map_or("no component", |wanted| &wanted.shown)
    }

    /// Returns the reason why not all components are loaded in time.
    fn late(&self) -> String {
        let within = span(self.within);
        match self.request {
            _ if !self.is_started => format!("another container of this name still runs after {within}"),
            _ if !self.are_there => format!(
                "its service `{}/_container/load_node` is not there after {within}; is the program a container of components, does it \
                 have this name, and does it use `rmw_zenoh_cpp`?",
                self.name
            ),
            Some(Request::Load) => {
                format!("{} was not loaded within {within}: the container has not answered the request", self.next())
            }
            Some(Request::List) | None if self.questions.has_listed => format!(
                "{} was not loaded within {within}: the container lists its components, but gives no answer to this request that can be read",
                self.next()
            ),
            Some(Request::List) | None => {
                format!("{} was not loaded within {within}: the container does not list its components", self.next())
            }
        }
    }
}

#[cfg(test)]
mod tests;
