//! The control of a program of ROS 2 beyond its start and its end: the lifecycle of its node, or the components of its container.

use crate::io::container::{ContainerNode, Request};
use crate::io::managed::Managed;
use crate::logic::container::{self, Container};
use crate::logic::lifecycle::{self, Lifecycle, Standing, State, Wanted};
use crate::setup;
use comms::logic::signals::Signal;
use comms::logic::time::Time;
use std::time::Duration;

/// How a program is controlled while it runs.
#[derive(Debug)]
pub(crate) enum Control {
    /// It is only started and ended.
    None,
    Lifecycle(Life),
    Container(Loader),
}

/// The lifecycle of a node, and its services.
#[derive(Debug)]
pub(crate) struct Life {
    pub(crate) lifecycle: Lifecycle,
    pub(crate) managed: Managed,
    pub(crate) within: Duration,
}

/// The components of a container, and its services.
#[derive(Debug)]
pub(crate) struct Loader {
    pub(crate) name: String,
    pub(crate) components: Vec<Request>,
    pub(crate) node: ContainerNode,
    pub(crate) within: Duration,
    /// None while the process does not run.
    pub(crate) container: Option<Container>,
    /// The number of the last request to an earlier container.
    pub(crate) number: u32,
}

impl Control {
    /// Begins with a start of the process. Returns whether the program has to be started now.
    pub(crate) fn begin(&mut self, now: Time) -> bool {
        match self {
            Self::None => true,
            Self::Lifecycle(life) => {
                let input = lifecycle::Input::Want { wanted: Wanted::Active, within: life.within };
                life.step(now, Some(input))
            }
            Self::Container(loader) => {
                let wanted = loader.components.iter().map(|component| container::Wanted {
                    shown: component.shown.clone(),
                    node: component.node.clone(),
                });
                let wanted = wanted.collect();
                let container = Container::new(loader.name.clone(), wanted, loader.within, now);
                loader.container = Some(container.after(loader.number));
                loader.step(now)
            }
        }
    }

    /// Takes the news, and sends the requests that follow. Returns whether the program has to be started now.
    pub(crate) fn step(&mut self, now: Time) -> bool {
        match self {
            Self::None => false,
            Self::Lifecycle(life) => life.step(now, None),
            Self::Container(loader) => loader.step(now),
        }
    }

    /// Begins with a stop of the process: a node with a lifecycle has to be deactivated within this time.
    pub(crate) fn stop(&mut self, now: Time, within: Duration) -> bool {
        match self {
            Self::None => false,
            Self::Lifecycle(life) => life.step(now, Some(lifecycle::Input::Want { wanted: Wanted::Resting, within })),
            Self::Container(loader) => {
                loader.rest();
                false
            }
        }
    }

    /// Records that the program has ended.
    pub(crate) fn ended(&mut self, now: Time) {
        match self {
            Self::None => {}
            Self::Lifecycle(life) => life.lifecycle.handle(now, lifecycle::Input::Ended, &mut Vec::new()),
            Self::Container(loader) => loader.rest(),
        }
    }

    /// Returns the relation of the present state to the wanted state; none if no state is wanted.
    pub(crate) fn standing(&self) -> Option<&Standing> {
        match self {
            Self::None => None,
            Self::Lifecycle(life) => Some(life.lifecycle.standing()),
            Self::Container(loader) => loader.container.as_ref().map(Container::standing),
        }
    }

    /// Returns the lifecycle, if the node has one.
    pub(crate) fn lifecycle(&self) -> Option<&Lifecycle> {
        match self {
            Self::Lifecycle(life) => Some(&life.lifecycle),
            Self::None | Self::Container(_) => None,
        }
    }

    /// Returns the state as a signal, if there is one.
    pub(crate) fn signal(&self) -> Option<Signal> {
        match self {
            Self::None => None,
            Self::Lifecycle(life) => {
                let state = life.lifecycle.state().map_or(0, State::number);
                Some(setup::signal("lifecycle state".to_owned(), u64::from(state)))
            }
            Self::Container(loader) => {
                let loaded = loader.container.as_ref().map_or(0, Container::loaded);
                Some(setup::signal("loaded components".to_owned(), u64::try_from(loaded).unwrap_or(u64::MAX)))
            }
        }
    }

    /// Closes the session with the router.
    pub(crate) fn close(self) {
        match self {
            Self::None => {}
            Self::Lifecycle(life) => life.managed.close(),
            Self::Container(loader) => loader.node.close(),
        }
    }
}

impl Life {
    /// Returns a node that is not started.
    pub(crate) fn new(name: String, managed: Managed, within: Duration, now: Time) -> Self {
        Self { lifecycle: Lifecycle::new(name, within, now), managed, within }
    }

    fn step(&mut self, now: Time, want: Option<lifecycle::Input>) -> bool {
        let mut effects = Vec::new();
        for input in self.managed.news().into_iter().chain(want) {
            self.lifecycle.handle(now, input, &mut effects);
        }
        effects.iter().for_each(|effect| self.managed.perform(*effect));
        effects.contains(&lifecycle::Effect::Start)
    }
}

impl Loader {
    /// Forgets the container, whose program ends or has ended.
    fn rest(&mut self) {
        self.number = self.container.take().map_or(self.number, |container| container.number());
    }

    fn step(&mut self, now: Time) -> bool {
        let news = self.node.news();
        let Some(container) = &mut self.container else { return false };
        let mut effects = Vec::new();
        for input in news {
            container.handle(now, input, &mut effects);
        }
        effects.iter().for_each(|effect| self.node.perform(*effect, &self.components));
        effects.contains(&container::Effect::Start)
    }
}
