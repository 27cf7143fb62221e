//! One deployment as clients see it: the topics of its programs, with the names and schemas that a record gives them.

use super::catalog::{Catalog, Description, ProgramName, Source, Target};
use super::order::Procedure;
use crate::logic::live_page::health_word;
use crate::logic::object::{request_schema, response_schema};
use crate::logic::record::{Entry, Rows, plain_name, plain_path};
use crate::logic::tap::{Gap, Numbers, message};
use comms::logic::layout::Message;
use comms::logic::object::{ExportKind, Exports};
use comms::logic::signals::Signals;
use comms::logic::tap::{Outputs, Tapped};
use comms::logic::time::Time;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;
use view::{LiveDeployment, MissionId, Model};

/// The beginning of the name of a service that calls a procedure; the path of its program and its name follow.
const CALLS: &str = "/calls/";
/// The most topics with signals of one program. A program whose signals change their names all the time gets no more.
const SIGNALS_MAX: usize = 16;

/// An output of a program.
#[derive(Debug)]
struct Output {
    message: Option<Arc<Message>>,
    /// Index into the topics of the rows.
    topic: usize,
    /// The topic of values that cannot be read, if there was one.
    unread: Option<usize>,
    numbers: Numbers,
}

/// A message for the clients that have subscribed to a channel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Published {
    pub(super) channel: u32,
    pub(super) payload: Vec<u8>,
    /// How many earlier values have not arrived here.
    pub(super) lost: u64,
}

/// A deployment.
#[derive(Debug)]
pub(super) struct LiveMission {
    id: MissionId,
    rows: Rows,
    /// The channel of each topic of the rows, while there is one.
    channels: BTreeMap<usize, u32>,
    outputs: BTreeMap<Source, Output>,
    /// The exports of each program, by path.
    exports: BTreeMap<String, Arc<Exports>>,
    state: Value,
    state_channel: Option<u32>,
    pub(super) is_over: bool,
}

impl LiveMission {
    pub(super) fn new(id: MissionId, catalog: &mut Catalog) -> Self {
        let described = Description {
            form: super::JSON,
            schema_name: "dca.Mission".to_owned(),
            schema: state_schema().to_string(),
        };
        let state_channel = catalog.add("/mission", described, Source::State(id.clone()));
        Self {
            id,
            rows: Rows::default(),
            channels: BTreeMap::new(),
            outputs: BTreeMap::new(),
            exports: BTreeMap::new(),
            state: Value::Null,
            state_channel,
            is_over: false,
        }
    }

    /// Stores the present state. Returns the state if it has changed. `origin` is when the clock of the model began.
    pub(super) fn look(&mut self, model: &Model, live: &LiveDeployment, origin: Duration) -> Option<Published> {
        self.is_over = live.end.is_some();
        let state = state(model, live, origin);
        if state == self.state {
            return None;
        }
        self.state = state;
        self.state()
    }

    /// Returns the present state.
    pub(super) fn state(&self) -> Option<Published> {
        let payload = self.state.to_string().into_bytes();
        Some(Published { channel: self.state_channel?, payload, lost: 0 })
    }

    /// Takes in the outputs and exports of a program.
    pub(super) fn describe(&mut self, path: &str, outputs: &Outputs, exports: Exports, catalog: &mut Catalog) {
        let program = ProgramName { mission: self.id.clone(), path: path.to_owned() };
        let mut there = BTreeMap::new();
        for output in outputs.all() {
            let source = Source::Output { program: program.clone(), output: output.name.clone() };
            let message = message(output, outputs).map(Arc::new);
            let topic = self.rows.declare(&format!("{path}/{}", output.name), message.as_deref());
            self.channel(topic, &source, catalog);
            let numbers = self.outputs.get(&source).map_or_else(Numbers::default, |known| known.numbers);
            there.insert(source, Output { message, topic, unread: None, numbers });
        }
        let gone = self.outputs.iter().filter(|(source, output)| {
            source.program() == Some(&program) && there.get(*source).is_none_or(|now| now.topic != output.topic)
        });
        let gone: Vec<usize> = gone.map(|(_, output)| output.topic).collect();
        for topic in gone {
            if let Some(channel) = self.channels.remove(&topic) {
                catalog.channels.remove(&channel);
            }
        }
        self.outputs.retain(|source, _| source.program() != Some(&program));
        self.outputs.extend(there);
        self.offer(&program, exports, catalog);
    }

    /// Offers the procedures of a program as services.
    fn offer(&mut self, program: &ProgramName, exports: Exports, catalog: &mut Catalog) {
        let path = &program.path;
        if self.exports.get(path).is_some_and(|known| **known == exports) {
            return;
        }
        catalog.services.retain(|_, service| !is_of(&service.target, program));
        for exported in exports.exports.iter().filter(|exported| exported.kind == ExportKind::Procedure) {
            let name = format!("{CALLS}{}/{}", plain_path(path), plain_name(&exported.name));
            let procedure = exported.name.clone();
            let request = request_schema(&exports, &exported.signature, &exported.doc).to_string();
            let response = response_schema(&exports, &exported.signature).to_string();
            let target = Target::Procedure { program: program.clone(), procedure };
            catalog.add_service(&name, request, response, target);
        }
        self.exports.insert(path.clone(), Arc::new(exports));
    }

    /// Returns a procedure of a program.
    pub(super) fn procedure(&self, path: &str, name: &str) -> Option<Procedure> {
        let exports = self.exports.get(path)?;
        let exported = exports.exports.iter().find(|exported| exported.name == name)?.clone();
        Some(Procedure { exported, exports: Arc::clone(exports) })
    }

    /// Forgets a program that has gone.
    pub(super) fn forget(&mut self, path: &str, catalog: &mut Catalog) {
        let program = ProgramName { mission: self.id.clone(), path: path.to_owned() };
        let of_program = catalog.channels.values().filter(|channel| channel.source.program() == Some(&program));
        let gone: Vec<u32> = of_program.map(|channel| channel.id).collect();
        for channel in gone {
            catalog.channels.remove(&channel);
            self.channels.retain(|_, known| *known != channel);
        }
        catalog.services.retain(|_, service| !is_of(&service.target, &program));
        self.outputs.retain(|source, _| source.program() != Some(&program));
        self.exports.remove(path);
    }

    /// Returns the programs that have topics or services.
    pub(super) fn programs(&self) -> impl Iterator<Item = &str> {
        self.exports.keys().map(String::as_str)
    }

    /// Takes note that the values of an output are received from now on.
    pub(super) fn hears(&mut self, source: &Source) {
        if let Some(output) = self.outputs.get_mut(source) {
            output.numbers = Numbers::default();
        }
    }

    /// Returns the channels that values of an output go to.
    pub(super) fn channels_of(&self, source: &Source) -> impl Iterator<Item = u32> {
        let topics = self.outputs.get(source).map(|output| [Some(output.topic), output.unread]);
        topics.into_iter().flatten().flatten().filter_map(|topic| self.channels.get(&topic).copied())
    }

    /// Takes a value of an output in.
    pub(super) fn value(
        &mut self,
        source: &Source,
        tapped: Tapped,
        at: Duration,
        catalog: &mut Catalog,
    ) -> Option<Published> {
        let Source::Output { program, output } = source else { return None };
        let known = self.outputs.get_mut(source)?;
        let lost = if let Gap::Lost(lost) = known.numbers.take(tapped.number) { lost } else { 0 };
        let entry = Entry::Port {
            from: format!("{}/{output}", program.path),
            to: String::new(),
            at: Duration::ZERO,
            bytes: tapped.bytes,
            message: known.message.clone(),
        };
        let row = self.rows.row(&entry, at);
        known.unread = Some(row.topic).filter(|topic| *topic != known.topic).or(known.unread);
        let channel = self.channel(row.topic, source, catalog)?;
        Some(Published { channel, payload: row.data, lost })
    }

    /// Takes a sample of the signals of a program in.
    pub(super) fn signals(
        &mut self,
        path: &str,
        sample: Signals,
        at: Duration,
        catalog: &mut Catalog,
    ) -> Option<Published> {
        let program = ProgramName { mission: self.id.clone(), path: path.to_owned() };
        let source = Source::Signals(program);
        let count = catalog.channels.values().filter(|channel| channel.source == source).count();
        let is_full = count >= SIGNALS_MAX && !self.rows.knows(path, &sample);
        // A sample may be late: its program has gone.
        if sample.values.is_empty() || is_full || !self.exports.contains_key(path) {
            return None;
        }
        let row = self.rows.row(&Entry::Signals { path: path.to_owned(), at: Duration::ZERO, sample }, at);
        let channel = self.channel(row.topic, &source, catalog)?;
        Some(Published { channel, payload: row.data, lost: 0 })
    }

    /// Returns the channel of a topic of the rows; a new one, if it has none.
    fn channel(&mut self, index: usize, source: &Source, catalog: &mut Catalog) -> Option<u32> {
        if let Some(channel) = self.channels.get(&index) {
            return Some(*channel);
        }
        let topic = self.rows.topics().get(index)?;
        let schema = String::from_utf8_lossy(&topic.schema).into_owned();
        let described = Description { form: topic.form, schema_name: topic.schema_name.clone(), schema };
        let channel = catalog.add(&topic.name, described, source.clone())?;
        self.channels.insert(index, channel);
        Some(channel)
    }
}

fn is_of(target: &Target, of: &ProgramName) -> bool {
    matches!(target, Target::Procedure { program, .. } if program == of)
}

fn state(model: &Model, live: &LiveDeployment, origin: Duration) -> Value {
    let since_1970 = |at: Time| (origin + at.since(Time::ZERO)).as_secs_f64();
    let processes = live.processes.values().map(|process| {
        json!({
            "path": process.path, "kind": process.kind, "state": process.state,
            "health": health_word(model.health(&live.id, process)), "since": since_1970(process.since.at),
            "is_exact": process.since.is_exact, "host": process.host, "pid": process.pid.unwrap_or_default(),
            "restarts": process.restarts,
        })
    });
    json!({
        "deployment": live.id.deployment.to_string(), "home": live.id.home,
        "command": live.id.fleet.command().unwrap_or_default(), "phase": live.phase(), "ended": live.end.is_some(),
        "failed": live.end.as_ref().is_some_and(|end| end.is_failed),
        "since": live.end.as_ref().map(|end| end.at).or(live.began).map_or(0.0, since_1970),
        "processes": processes.collect::<Vec<_>>(),
    })
}

fn state_schema() -> Value {
    let text = |what: &str| json!({ "type": "string", "description": what });
    let number = |what: &str| json!({ "type": "number", "description": what });
    let truth = |what: &str| json!({ "type": "boolean", "description": what });
    let process = json!({
        "type": "object",
        "properties": {
            "path": text("the absolute path"), "kind": text("the type"),
            "state": text("the state, as `dca status` prints it"),
            "health": text("`running`, `quiet`, `changing`, `failed` or `unknown`"),
            "since": number("when this state began, in seconds since 1970"),
            "is_exact": truth("whether `since` is exact: otherwise, the state began at this time or earlier"),
            "host": text("the host"), "pid": number("the process id; 0 if there is none"),
            "restarts": number("how often the program was started again"),
        },
    });
    json!({
        "title": "dca.Mission",
        "type": "object",
        "properties": {
            "deployment": text("name and number"), "home": text("the host of `main`"),
            "command": number("the process id of the command that contains the nodes; 0 if the nodes are separate programs"),
            "phase": text("the phase, or how the deployment has ended"), "ended": truth("whether the deployment has ended"),
            "failed": truth("whether the deployment has failed"),
            "since": number("when the deployment began or ended, in seconds since 1970; 0 if this is not known"),
            "processes": { "type": "array", "items": process },
        },
    })
}
