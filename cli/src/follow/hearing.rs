//! Receives the signals of a mission's programs, and the values of the recorded wires. If a program was restarted
//! elsewhere, it is received from its new place.

use crate::io::observer::{Observer, Sinks};
use crate::logic::record::{Port, WireName};
use comms::logic::control::Dial;
use node::logic::protocol::Deployment;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// The signals and values of a mission that are received.
pub(super) struct Hearing {
    /// The name of the deployment.
    name: String,
    /// The credentials that this command shows to programs on other hosts of a team.
    team: Option<PathBuf>,
    /// The wires that are recorded.
    ports: Vec<Port>,
    /// The receivers of signals and of values.
    sinks: Sinks,
    /// The observers of signals and of wires. Each is opened when it has something to observe.
    observers: [Option<Observer>; 2],
    /// The last reported session of each program, by path. `is_located` says whether all programs were reported.
    sessions: BTreeMap<String, String>,
    is_located: bool,
}

impl Hearing {
    pub(super) fn new(name: &str, team: Option<PathBuf>, ports: Vec<Port>, sinks: Sinks) -> Self {
        let (observers, sessions) = ([None, None], BTreeMap::new());
        Self { name: name.to_owned(), team, ports, sinks, observers, sessions, is_located: false }
    }

    /// Returns the wire of this name that is recorded.
    pub(super) fn port(&self, name: &WireName) -> Option<&Port> {
        self.ports.iter().find(|port| port.name == *name)
    }

    /// Receives the signals of programs.
    pub(super) fn signals(&mut self, signals: &[(String, Dial)]) {
        self.sessions.extend(signals.iter().map(|(path, dial)| (path.clone(), dial.session.clone())));
        if !signals.is_empty() {
            let open = || Observer::open(self.team.clone(), self.sinks.clone());
            self.observers[0].get_or_insert_with(open).signals(&self.name, signals);
        }
    }

    /// Receives programs at their present places. The first call names all programs; those with signals were reported before by GO.
    pub(super) fn programs(&mut self, deployment: Option<&Deployment>, at: &[(String, Dial)]) {
        let is_first = !std::mem::replace(&mut self.is_located, true);
        let moved = |(path, dial): &&(String, Dial)| match self.sessions.get(path) {
            Some(session) => *session != dial.session,
            None => !is_first,
        };
        let moved: Vec<(String, Dial)> = at.iter().filter(moved).cloned().collect();
        self.sessions.extend(at.iter().map(|(path, dial)| (path.clone(), dial.session.clone())));
        self.signals(&moved);
        if let Some(deployment) = deployment {
            self.wires(deployment, at);
        }
    }

    fn wires(&mut self, deployment: &Deployment, at: &[(String, Dial)]) {
        let dial = |port: &Port| at.iter().find(|(path, _)| *path == port.producer).map(|(_, dial)| dial.clone());
        let ports: Vec<(Port, Dial)> = self.ports.iter().filter_map(|port| Some((port.clone(), dial(port)?))).collect();
        if !ports.is_empty() {
            let open = || Observer::open(self.team.clone(), self.sinks.clone());
            self.observers[1].get_or_insert_with(open).ports(deployment, &ports, self.team.is_some());
        }
    }

    /// Receives nothing more.
    pub(super) async fn close(&mut self) {
        for observer in std::mem::take(&mut self.observers).into_iter().flatten() {
            observer.close().await;
        }
    }
}
