//! The channels and services that clients are offered. A number is never given twice: clients keep schemas by it.

use crate::logic::record::{Form, RecordedTopic, free_name, plain_name};
use node::logic::protocol::Deployment;
use std::collections::BTreeMap;
use std::sync::Arc;
use view::MissionId;

/// The most channels. A person finds no topic among more, and a client keeps the schema of each.
pub(super) const CHANNELS_MAX: usize = 4096;
/// The most services.
const SERVICES_MAX: usize = 1024;

/// A running program.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct ProgramName {
    /// Its deployment.
    pub(crate) mission: MissionId,
    /// The absolute path of its process.
    pub(crate) path: String,
}

/// The source of the values of a channel.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Source {
    /// The events of all deployments.
    Events,
    /// The output of all programs, as text.
    Log,
    /// The states of the processes of a deployment.
    State(MissionId),
    Output {
        program: ProgramName,
        output: String,
    },
    Signals(ProgramName),
    /// A topic of a record, by its place there.
    Recorded(usize),
}

impl Source {
    /// Returns the program that it belongs to, if it belongs to one.
    pub(crate) fn program(&self) -> Option<&ProgramName> {
        match self {
            Self::Output { program, .. } | Self::Signals(program) => Some(program),
            Self::Events | Self::Log | Self::State(_) | Self::Recorded(_) => None,
        }
    }
}

/// The encoding of the messages of a channel, and the encoding of their schema, with the names of the MCAP registry.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Encodings {
    pub(super) messages: String,
    pub(super) schema: String,
}

impl From<Form> for Encodings {
    fn from(form: Form) -> Self {
        let (messages, schema) = form.encodings();
        Self { messages: messages.to_owned(), schema: schema.to_owned() }
    }
}

/// The description of a channel.
#[derive(Clone, Debug)]
pub(super) struct Description {
    pub(super) form: Form,
    pub(super) schema_name: String,
    pub(super) schema: String,
}

/// A channel.
#[derive(Clone, Debug)]
pub(super) struct Channel {
    pub(super) id: u32,
    pub(super) topic: Arc<str>,
    pub(super) encodings: Encodings,
    pub(super) schema_name: String,
    pub(super) schema: String,
    pub(super) source: Source,
}

/// The effect of a service.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Target {
    Stop,
    Estop,
    /// Play a record, or pause it.
    Replay,
    Procedure {
        program: ProgramName,
        procedure: String,
    },
}

/// A service.
#[derive(Clone, Debug)]
pub(super) struct Service {
    pub(super) id: u32,
    pub(super) name: String,
    /// Its type.
    pub(super) kind: String,
    /// The schemas of its argument and of its result.
    pub(super) request: String,
    pub(super) response: String,
    pub(super) target: Target,
}

/// All channels and services.
#[derive(Debug, Default)]
pub(super) struct Catalog {
    pub(super) channels: BTreeMap<u32, Channel>,
    pub(super) services: BTreeMap<u32, Service>,
    last: u32,
}

impl Catalog {
    /// Adds a channel, if there is room; returns its number. A topic of another deployment that is called so has the name first.
    pub(super) fn add(&mut self, topic: &str, described: Description, source: Source) -> Option<u32> {
        let deployment = match &source {
            Source::State(mission) => Some(&mission.deployment),
            Source::Output { program, .. } | Source::Signals(program) => Some(&program.mission.deployment),
            Source::Events | Source::Log | Source::Recorded(_) => None,
        };
        if self.channels.len() >= CHANNELS_MAX {
            return None;
        }
        let topic = name(topic, deployment, |name| self.channels.values().any(|channel| *channel.topic == *name));
        let Description { form, schema_name, schema } = described;
        let id = self.number();
        self.channels
            .insert(id, Channel { id, topic: topic.into(), encodings: form.into(), schema_name, schema, source });
        Some(id)
    }

    /// Adds a service, if there is room.
    pub(super) fn add_service(&mut self, service: &str, request: String, response: String, target: Target) {
        let deployment = match &target {
            Target::Procedure { program, .. } => Some(&program.mission.deployment),
            Target::Stop | Target::Estop | Target::Replay => None,
        };
        if self.services.len() >= SERVICES_MAX {
            return;
        }
        let name = name(service, deployment, |name| self.services.values().any(|service| service.name == name));
        let kind = format!("dca{}", name.strip_prefix("/dca").unwrap_or(&name).replace('/', "."));
        let id = self.number();
        self.services.insert(id, Service { id, name, kind, request, response, target });
    }

    /// Adds a topic of a record, if there is room; returns its number.
    pub(super) fn add_recorded(&mut self, place: usize, recorded: &RecordedTopic) -> Option<u32> {
        if self.channels.len() >= CHANNELS_MAX {
            return None;
        }
        // A record may have two topics of one name, with two schemas. A client takes one.
        let topic = name(&recorded.name, None, |name| self.channels.values().any(|channel| *channel.topic == *name));
        let RecordedTopic { encoding, schema_name, schema_encoding, schema, .. } = recorded.clone();
        let (id, encodings) = (self.number(), Encodings { messages: encoding, schema: schema_encoding });
        let source = Source::Recorded(place);
        self.channels.insert(id, Channel { id, topic: topic.into(), encodings, schema_name, schema, source });
        Some(id)
    }

    fn number(&mut self) -> u32 {
        self.last += 1;
        self.last
    }
}

/// Returns the name as in a record. If another deployment has the same name, the deployment comes before it.
fn name(wanted: &str, deployment: Option<&Deployment>, is_taken: impl Fn(&str) -> bool) -> String {
    if !is_taken(wanted) {
        return wanted.to_owned();
    }
    let whole = deployment.map_or_else(|| wanted.to_owned(), |one| format!("/{}{wanted}", plain_name(&one.name)));
    free_name(whole, is_taken)
}

#[cfg(test)]
mod tests {
    use super::*;
    use view::Fleet;

    #[test]
    fn two_deployments_have_two_names_and_no_number_is_given_twice() {
        let mut catalog = Catalog::default();
        let described = || Description { form: Form::Json, schema_name: "S".to_owned(), schema: "{}".to_owned() };
        let state = |name: &str| {
            let deployment = Deployment { name: name.to_owned(), epoch: 1 };
            Source::State(MissionId { deployment, home: "r1".to_owned(), fleet: Fleet::Standing })
        };
        let ids: Vec<u32> = ["door", "gate two", "gate two"]
            .into_iter()
            .filter_map(|name| catalog.add("/mission", described(), state(name)))
            .collect();
        let topics: Vec<&str> = catalog.channels.values().map(|channel| &*channel.topic).collect();
        assert_eq!(topics, ["/mission", "/gate_two/mission", "/gate_two/mission_2"]);
        catalog.channels.clear();
        let again = catalog.add("/mission", described(), state("door"));
        assert!(again.is_some_and(|id| !ids.contains(&id)), "{ids:?}");
        for number in 1..CHANNELS_MAX {
            assert!(catalog.add(&format!("/{number}"), described(), Source::Log).is_some());
        }
        assert_eq!(catalog.add("/y", described(), Source::Log), None);
    }
}
