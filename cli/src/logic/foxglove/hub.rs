//! All clients, with the channels and services that they are offered.
//!
//! The hub is pure. Its inputs are the time, frames of clients, and changes of robots. Its outputs
//! are frames for clients, and orders for robots. Each client has separate limits, so that no
//! client can slow down another client.

use super::catalog::{Catalog, Description, Source, Target};
use super::lasting::Lasting;
use super::layout::{LayoutMission, of_missions};
use super::mission::{LiveMission, Published};
use super::order::{Answer, Given, Order, Ticket, read as read_order};
use super::outbox::Frame;
use super::protocol::{self, Call, Control, Level, ParameterValue, Request, Subscription};
use super::recording::{Played, Recording};
use super::viewer::{Arrival, NewValue, ORDERS_MAX, Viewer};
use super::{JSON, ProgramName};
use crate::logic::record::{Entry, LOG, Rows, Timeline, log_schema};
use comms::logic::object::Exports;
use comms::logic::signals::Signals;
use comms::logic::tap::{Outputs, Tapped};
use comms::logic::time::Time;
use node::logic::protocol::Event;
use node::logic::table::counted;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;
use view::{MissionId, Model};

/// The most clients at once: a few windows of a few people.
pub(super) const VIEWERS_MAX: usize = 8;
/// How many problems of one order are told.
const PROBLEMS_MAX: usize = 5;

/// All clients.
#[derive(Debug)]
pub(crate) struct Hub {
    /// The number of this view. By this number, a client notices that it connects to another view.
    session: String,
    catalog: Catalog,
    missions: BTreeMap<MissionId, LiveMission>,
    events: Lasting,
    log: Lasting,
    viewers: BTreeMap<u64, Viewer>,
    last_viewer: u64,
    parameters: BTreeMap<String, Value>,
    orders: Vec<Given>,
    /// The record that is played, if this is not the view of robots.
    recording: Option<Recording>,
}

impl Hub {
    pub(crate) fn new(session: u64) -> Self {
        let mut catalog = Catalog::default();
        let (topic, described) = super::events::channel();
        let events = Lasting::new(catalog.add(topic, described, Source::Events));
        let schema = log_schema().to_string();
        let described = Description { form: JSON, schema_name: "foxglove.Log".to_owned(), schema };
        let log = Lasting::new(catalog.add(LOG, described, Source::Log));
        for (name, request, response, target) in super::order::services() {
            catalog.add_service(name, request.to_string(), response.to_string(), target);
        }
        Self {
            session: session.to_string(),
            catalog,
            missions: BTreeMap::new(),
            events,
            log,
            viewers: BTreeMap::new(),
            last_viewer: 0,
            parameters: BTreeMap::new(),
            orders: Vec::new(),
            recording: None,
        }
    }

    /// Returns the hub of a record that is played.
    pub(crate) fn of_record(session: u64, timeline: Timeline) -> Self {
        let mut catalog = Catalog::default();
        let recording = Recording::new(timeline, &mut catalog);
        Self {
            session: session.to_string(),
            catalog,
            missions: BTreeMap::new(),
            events: Lasting::new(None),
            log: Lasting::new(None),
            viewers: BTreeMap::new(),
            last_viewer: 0,
            parameters: BTreeMap::new(),
            orders: Vec::new(),
            recording: Some(recording),
        }
    }

    /// Lets a client in, if there is room; returns its number.
    pub(crate) fn enter(&mut self) -> Option<u64> {
        if self.viewers.len() >= VIEWERS_MAX {
            return None;
        }
        let mut viewer = Viewer::default();
        let info = match &self.recording {
            Some(recording) => protocol::record_info(&self.session, recording.span()),
            None => protocol::server_info(&self.session),
        };
        let words = [
            info,
            protocol::advertise(self.catalog.channels.values()),
            protocol::advertise_services(self.catalog.services.values()),
        ];
        words.into_iter().for_each(|word| viewer.outbox.word(Frame::Text(word)));
        if let Some(recording) = &self.recording {
            recording.greeting().into_iter().for_each(|frame| viewer.outbox.latest(frame));
        }
        self.last_viewer += 1;
        self.viewers.insert(self.last_viewer, viewer);
        Some(self.last_viewer)
    }

    /// Forgets a client that has left.
    pub(crate) fn leave(&mut self, viewer: u64) {
        self.viewers.remove(&viewer);
    }

    /// Returns whether there is not a single client.
    pub(crate) fn is_empty(&self) -> bool {
        self.viewers.is_empty()
    }

    /// Returns whether clients were told of a mission, so that its programs can be described.
    pub(crate) fn has_mission(&self, id: &MissionId) -> bool {
        self.missions.contains_key(id)
    }

    /// Takes a message of a client in.
    pub(crate) fn take(&mut self, number: u64, frame: &Frame, at: Arrival) {
        let now = at.time;
        let request = match frame {
            Frame::Text(text) => protocol::read_text(text),
            Frame::Binary(bytes) => protocol::read_binary(bytes),
        };
        match request {
            Ok(Request::Subscribe(subscriptions)) => {
                self.subscribe(number, &subscriptions, at);
                if self.recording.as_ref().is_some_and(Recording::is_new) {
                    self.control(number, now, &Control { plays: Some(true), ..Control::default() });
                }
            }
            Ok(Request::Unsubscribe(ids)) => {
                self.with(number, |viewer| ids.iter().for_each(|id| viewer.unsubscribe(*id)));
            }
            Ok(Request::Parameters { .. } | Request::SetParameters { .. }) if self.recording.is_some() => {
                self.with(number, |viewer| complain(viewer, "a record has no parameters"));
            }
            Ok(Request::Control(_)) if self.recording.is_none() => {
                self.with(number, |viewer| complain(viewer, "this server shows running missions, and plays no record"));
            }
            Ok(Request::Parameters { names, id }) => {
                self.order(number, Ticket::Parameters(id), Order::Parameters { names });
            }
            Ok(Request::SetParameters { values, id }) => {
                self.order(number, Ticket::Parameters(id), Order::SetParameters { values });
            }
            Ok(Request::FollowParameters(names)) => self.with(number, |viewer| viewer.follow(names)),
            Ok(Request::UnfollowParameters(names)) => self.with(number, |viewer| viewer.unfollow(&names)),
            Ok(Request::Call(call)) if self.recording.is_some() => self.replay_call(number, &call, now),
            Ok(Request::Call(call)) => self.call(number, &call),
            Ok(Request::Control(control)) => self.control(number, now, &control),
            Err(why) => self.with(number, |viewer| complain(viewer, &why)),
        }
    }

    /// Returns the next message for a client.
    pub(crate) fn next(&mut self, number: u64, now: Time) -> Option<Frame> {
        self.viewers.get_mut(&number)?.outbox.next(now)
    }

    /// Returns whether a client has taken so little that it has to be cut off.
    pub(crate) fn is_overrun(&self, number: u64) -> bool {
        self.viewers.get(&number).is_none_or(|viewer| viewer.outbox.is_overrun())
    }

    /// Returns the sources of all channels to which some client has subscribed.
    pub(crate) fn wanted(&self) -> BTreeSet<Source> {
        let channels: BTreeSet<u32> = self.viewers.values().flat_map(Viewer::wanted).collect();
        channels.iter().filter_map(|id| Some(self.catalog.channels.get(id)?.source.clone())).collect()
    }

    /// Returns whether the signals of a program are not known: no sample has come yet.
    pub(crate) fn lacks_signals(&self, program: &ProgramName) -> bool {
        let source = Source::Signals(program.clone());
        !self.catalog.channels.values().any(|channel| channel.source == source)
    }

    /// Returns whether a client wants to get changes of parameters.
    pub(crate) fn follows_parameters(&self) -> bool {
        self.viewers.values().any(Viewer::is_follower)
    }

    /// Takes out the orders that clients have given.
    pub(crate) fn orders(&mut self) -> Vec<Given> {
        std::mem::take(&mut self.orders)
    }

    /// Gives a client the result of an order.
    pub(crate) fn answer(&mut self, number: u64, ticket: &Ticket, answer: &Answer) {
        self.with(number, |viewer| {
            viewer.orders = viewer.orders.saturating_sub(1);
            match (ticket, answer) {
                (Ticket::Parameters(id), Answer::Values { values, problems }) => {
                    let word = protocol::parameter_values(values.iter(), id.as_deref());
                    viewer.outbox.word(Frame::Text(word));
                    if !problems.is_empty() {
                        complain(viewer, &together(problems));
                    }
                }
                (Ticket::Call { service, number }, Answer::Done(result)) => {
                    viewer.outbox.word(Frame::Binary(protocol::call_response(*service, *number, result)));
                }
                (Ticket::Call { service, number }, Answer::Failed(why)) => {
                    viewer.outbox.word(Frame::Text(protocol::call_failure(*service, *number, why)));
                }
                (Ticket::Parameters(_), Answer::Failed(why)) => complain(viewer, why),
                (Ticket::Parameters(_), Answer::Done(_)) | (Ticket::Call { .. }, Answer::Values { .. }) => {}
            }
        });
    }

    /// Stores the present values of all parameters, and sends the changed values to clients.
    pub(crate) fn parameters(&mut self, values: Vec<ParameterValue>) {
        let changed: Vec<ParameterValue> =
            values.iter().filter(|one| self.parameters.get(&one.name) != Some(&one.value)).cloned().collect();
        self.parameters = values.into_iter().map(|one| (one.name, one.value)).collect();
        for viewer in self.viewers.values_mut() {
            let mut told = changed.iter().filter(|one| viewer.follows(&one.name)).peekable();
            if told.peek().is_some() {
                let word = protocol::parameter_values(told, None);
                viewer.outbox.word(Frame::Text(word));
            }
        }
    }

    /// Takes the present model in: missions and programs that have come or gone, and states. `origin` is when the clock of the model
    /// began, since 1970.
    pub(crate) fn look(&mut self, model: &Model, now: Time, origin: Duration) {
        self.change(|hub| {
            let present: BTreeSet<&MissionId> = model.deployments().map(|live| &live.id).collect();
            let mut running = model.deployments().filter(|live| live.end.is_none());
            let has_new = running.any(|live| !hub.missions.contains_key(&live.id));
            // The topics of a mission stay after its end, until another one takes its place.
            let gone = hub.missions.iter().filter(|(id, one)| !present.contains(id) || (has_new && one.is_over));
            for id in gone.map(|(id, _)| id.clone()).collect::<Vec<_>>() {
                hub.forget(&id);
            }
            let at = origin + now.since(Time::ZERO);
            let mut published = Vec::new();
            for live in model.deployments() {
                if !hub.missions.contains_key(&live.id) && live.end.is_some() {
                    continue;
                }
                let new = || LiveMission::new(live.id.clone(), &mut hub.catalog);
                let mission = hub.missions.entry(live.id.clone()).or_insert_with(new);
                published.extend(mission.look(model, live, origin));
                let is_gone = |path: &&str| mission.is_over || !live.processes.contains_key(*path);
                for path in mission.programs().filter(is_gone).map(str::to_owned).collect::<Vec<_>>() {
                    mission.forget(&path, &mut hub.catalog);
                }
            }
            published.into_iter().for_each(|one| hub.publish(&one, at, None));
        });
    }

    /// Returns a layout with panels for the topics of the missions that run. None if nothing runs.
    pub(crate) fn layout(&self, model: &Model) -> Option<Value> {
        let topic = |id: &MissionId| {
            let source = Source::State(id.clone());
            self.catalog.channels.values().find(|channel| channel.source == source).map(|channel| &*channel.topic)
        };
        let running = model.deployments().filter(|live| live.end.is_none());
        let missions: Vec<LayoutMission<'_>> =
            running.filter_map(|live| Some(LayoutMission { topic: topic(&live.id)?, live })).collect();
        (!missions.is_empty()).then(|| of_missions(self.catalog.channels.values(), &missions))
    }

    /// Returns how many channels there are.
    pub(crate) fn channels(&self) -> usize {
        self.catalog.channels.len()
    }

    /// Takes an event in.
    pub(crate) fn event(&mut self, event: &Event) {
        if let Some(payload) = super::events::payload(event) {
            self.events.keep(event.time, &payload);
            if let Some(channel) = self.events.channel {
                self.publish(&Published { channel, payload, lost: 0 }, event.time, None);
            }
        }
    }

    /// Takes in lines that a program has written.
    pub(crate) fn wrote(&mut self, program: &ProgramName, text: String, at: Duration) {
        let path = format!("{}:{}", program.mission.deployment.name, program.path);
        let payload = Rows::default().row(&Entry::Output { path, at: Duration::ZERO, text }, at).data;
        self.log.keep(at, &payload);
        if let Some(channel) = self.log.channel {
            self.publish(&Published { channel, payload, lost: 0 }, at, None);
        }
    }

    /// Forgets the lines so far: they are told again.
    pub(crate) fn log_begins(&mut self) {
        self.log.clear();
    }

    /// Takes in the outputs and exports of a program.
    pub(crate) fn described(&mut self, program: &ProgramName, outputs: &Outputs, exports: Exports) {
        self.change(|hub| {
            if let Some(mission) = hub.missions.get_mut(&program.mission).filter(|mission| !mission.is_over) {
                mission.describe(&program.path, outputs, exports, &mut hub.catalog);
            }
        });
    }

    /// Takes note that the values of an output are received from now on. Earlier values are not lost, because nothing had requested them.
    pub(crate) fn hears(&mut self, source: &Source) {
        let mission = source.program().and_then(|program| self.missions.get_mut(&program.mission));
        if let Some(mission) = mission {
            mission.hears(source);
        }
    }

    /// Takes a value of an output in. It is encoded only if a client wants it.
    pub(crate) fn value(&mut self, source: &Source, tapped: Tapped, at: Arrival) {
        let Some(program) = source.program() else { return };
        let wants = |channel| self.viewers.values().any(|viewer| viewer.wants(channel, at.time));
        let mission = self.missions.get(&program.mission);
        if mission.is_some_and(|mission| mission.channels_of(source).any(wants)) {
            self.publish_of(&program.mission, at, |mission, catalog| {
                mission.value(source, tapped, at.since_1970, catalog)
            });
        }
    }

    /// Takes samples of the signals of a program in. So many messages before them were left out.
    pub(crate) fn signals(&mut self, program: &ProgramName, samples: Vec<Signals>, lost: u64, at: Arrival) {
        for (sample, lost) in samples.into_iter().zip(std::iter::once(lost).chain(std::iter::repeat(0))) {
            self.publish_of(&program.mission, at, |mission, catalog| {
                let published = mission.signals(&program.path, sample, at.since_1970, catalog)?;
                Some(Published { lost, ..published })
            });
        }
    }

    fn publish_of(
        &mut self,
        mission: &MissionId,
        at: Arrival,
        take: impl FnOnce(&mut LiveMission, &mut Catalog) -> Option<Published>,
    ) {
        // A channel is compared only if there may be a new one: values come often.
        let before = self.catalog.channels.len();
        let Some(mission) = self.missions.get_mut(mission) else { return };
        let published = take(mission, &mut self.catalog);
        if self.catalog.channels.len() > before {
            let new = self.catalog.channels.values().skip(before);
            let word = protocol::advertise(new);
            self.viewers.values_mut().for_each(|viewer| viewer.outbox.word(Frame::Text(word.clone())));
        }
        if let Some(published) = published {
            self.publish(&published, at.since_1970, Some(at.time));
        }
    }

    /// Sends a message to all clients that have subscribed to its channel, before it arrived if that is given.
    fn publish(&mut self, Published { channel, payload, lost }: &Published, at: Duration, arrived: Option<Time>) {
        let Some(topic) = self.catalog.channels.get(channel).map(|channel| Arc::clone(&channel.topic)) else { return };
        let value = NewValue { channel: *channel, topic: &topic, arrived, lost: *lost };
        for viewer in self.viewers.values_mut() {
            viewer.put(value, |subscription| protocol::data(subscription, at, payload));
        }
    }

    /// Does something that may change the channels and services, and tells all clients about it.
    fn change(&mut self, change: impl FnOnce(&mut Self)) {
        let channels: BTreeSet<u32> = self.catalog.channels.keys().copied().collect();
        let services: BTreeSet<u32> = self.catalog.services.keys().copied().collect();
        change(self);
        let mut words = Vec::new();
        let gone: Vec<u32> = channels.iter().filter(|id| !self.catalog.channels.contains_key(id)).copied().collect();
        if !gone.is_empty() {
            words.push(protocol::unadvertise(&gone));
        }
        let mut new = self.catalog.channels.values().filter(|one| !channels.contains(&one.id)).peekable();
        if new.peek().is_some() {
            words.push(protocol::advertise(new));
        }
        let ended: Vec<u32> = services.iter().filter(|id| !self.catalog.services.contains_key(id)).copied().collect();
        if !ended.is_empty() {
            words.push(protocol::unadvertise_services(&ended));
        }
        let mut new = self.catalog.services.values().filter(|one| !services.contains(&one.id)).peekable();
        if new.peek().is_some() {
            words.push(protocol::advertise_services(new));
        }
        for viewer in self.viewers.values_mut() {
            gone.iter().for_each(|channel| viewer.forget(*channel));
            words.iter().for_each(|word| viewer.outbox.word(Frame::Text(word.clone())));
        }
    }

    fn forget(&mut self, id: &MissionId) {
        let Some(mut mission) = self.missions.remove(id) else { return };
        for path in mission.programs().map(str::to_owned).collect::<Vec<_>>() {
            mission.forget(&path, &mut self.catalog);
        }
        self.catalog.channels.retain(|_, channel| channel.source != Source::State(id.clone()));
    }

    fn subscribe(&mut self, number: u64, subscriptions: &[Subscription], at: Arrival) {
        let Some(viewer) = self.viewers.get_mut(&number) else { return };
        let (mut refused, mut first) = (0_usize, None);
        for subscription in subscriptions {
            let Some(channel) = self.catalog.channels.get(&subscription.channel) else {
                refused += 1;
                first.get_or_insert_with(|| format!("the channel {} does not exist", subscription.channel));
                continue;
            };
            if let Err(why) = viewer.subscribe(*subscription, at.time) {
                refused += 1;
                first.get_or_insert(why);
                continue;
            }
            let mut send = |at, payload: &[u8]| {
                let frame = protocol::data(subscription.id, at, payload);
                viewer.outbox.value(&channel.topic, subscription.id, frame);
            };
            match &channel.source {
                Source::Events => self.events.kept.iter().for_each(|kept| send(kept.at, &kept.payload)),
                Source::Log => self.log.kept.iter().for_each(|kept| send(kept.at, &kept.payload)),
                Source::State(mission) => {
                    let state = self.missions.get(mission).and_then(LiveMission::state);
                    state.iter().for_each(|state| send(at.since_1970, &state.payload));
                }
                Source::Output { .. } | Source::Signals(_) => {}
                Source::Recorded(_) => {
                    let last = self.recording.as_ref().and_then(|recording| recording.last(channel.id));
                    last.iter().for_each(|message| send(message.at, message.data));
                }
            }
        }
        if let Some(first) = first {
            complain(viewer, &format!("{refused} of {} subscriptions refused: {first}", subscriptions.len()));
        }
    }

    fn call(&mut self, number: u64, call: &Call) {
        let ticket = Ticket::Call { service: call.service, number: call.number };
        let read = match self.catalog.services.get(&call.service).map(|service| &service.target) {
            None => Err(format!("the service {} does not exist", call.service)),
            Some(_) if call.encoding != protocol::ENCODING => {
                Err(format!("`{}` is not an encoding of this server; it takes `{}`", call.encoding, protocol::ENCODING))
            }
            Some(Target::Procedure { program, procedure }) => {
                let mission = self.missions.get(&program.mission);
                let found = mission.and_then(|mission| mission.procedure(&program.path, procedure));
                let gone = || format!("`{}` has ended", program.path);
                found.ok_or_else(gone).and_then(|found| super::order::procedure(program, found, &call.payload))
            }
            Some(target @ (Target::Stop | Target::Estop | Target::Replay)) => read_order(target, &call.payload),
        };
        match read {
            Ok(order) => self.order(number, ticket, order),
            Err(why) => self.with(number, |viewer| {
                viewer.outbox.word(Frame::Text(protocol::call_failure(call.service, call.number, &why)));
            }),
        }
    }

    /// Returns when the record that is played continues.
    pub(crate) fn deadline(&self) -> Option<Time> {
        self.recording.as_ref()?.deadline()
    }

    /// Plays the record up to now.
    pub(crate) fn play(&mut self, now: Time) {
        if let Some(played) = self.recording.as_mut().map(|recording| recording.advance(now)) {
            self.tell(played, None);
        }
    }

    /// Carries out a request of a client about the record.
    fn control(&mut self, number: u64, now: Time, control: &Control) {
        if let Some(played) = self.recording.as_mut().map(|recording| recording.control(now, control)) {
            self.tell(played, Some(number));
        }
    }

    /// Sends the state of the record, which clients get first, and messages. The client that has asked gets its answer.
    fn tell(&mut self, Played { messages, frames, answer, has_jumped }: Played, asker: Option<u64>) {
        if has_jumped {
            self.viewers.values_mut().for_each(|viewer| viewer.outbox.drop_values());
        }
        for place in messages {
            let Some((channel, message)) = self.recording.as_ref().and_then(|recording| recording.message(place))
            else {
                continue;
            };
            let Some(topic) = self.catalog.channels.get(&channel).map(|channel| &channel.topic) else { continue };
            for viewer in self.viewers.values_mut() {
                let value = NewValue { channel, topic, arrived: None, lost: 0 };
                viewer.put(value, |subscription| protocol::data(subscription, message.at, message.data));
            }
        }
        for (number, viewer) in &mut self.viewers {
            frames.iter().for_each(|frame| viewer.outbox.latest(frame.clone()));
            match &answer {
                Some(answer) if asker == Some(*number) => viewer.outbox.answer(answer.asker.clone()),
                Some(answer) => viewer.outbox.latest(answer.others.clone()),
                None => {}
            }
        }
    }

    /// Plays the record, or pauses it, for a client without controls of its own.
    fn replay_call(&mut self, number: u64, call: &Call, now: Time) {
        let (service, call_number) = (call.service, call.number);
        let is_known = self.catalog.services.contains_key(&service);
        let control = match &self.recording {
            Some(recording) if is_known => recording.read(&call.payload),
            Some(_) | None => Err(format!("the service {service} does not exist")),
        };
        let frame = match control {
            Ok(control) => {
                self.control(number, now, &control);
                let state = self.recording.as_ref().map(Recording::in_json).unwrap_or_default();
                Frame::Binary(protocol::call_response(service, call_number, &state))
            }
            Err(why) => Frame::Text(protocol::call_failure(service, call_number, &why)),
        };
        self.with(number, |viewer| viewer.outbox.word(frame));
    }

    /// Takes note of an order of a client, unless it waits for too many.
    fn order(&mut self, number: u64, ticket: Ticket, order: Order) {
        let Some(viewer) = self.viewers.get_mut(&number) else { return };
        // A stop is never refused for other orders.
        if viewer.orders >= ORDERS_MAX && !order.is_stop() {
            let why = format!("not done: {ORDERS_MAX} orders of this client are still being carried out");
            return match ticket {
                Ticket::Call { service, number } => {
                    viewer.outbox.word(Frame::Text(protocol::call_failure(service, number, &why)));
                }
                Ticket::Parameters(_) => complain(viewer, &why),
            };
        }
        viewer.orders += 1;
        self.orders.push(Given { viewer: number, ticket, order });
    }

    fn with(&mut self, number: u64, change: impl FnOnce(&mut Viewer)) {
        if let Some(viewer) = self.viewers.get_mut(&number) {
            change(viewer);
        }
    }
}

/// Returns several problems in one message.
fn together(problems: &[String]) -> String {
    let named = problems.iter().take(PROBLEMS_MAX).map(String::as_str).collect::<Vec<_>>().join("; ");
    match problems.len().saturating_sub(PROBLEMS_MAX) {
        0 => named,
        more => format!("{named}; and {}", counted(more, "other problem")),
    }
}

fn complain(viewer: &mut Viewer, why: &str) {
    viewer.outbox.word(Frame::Text(protocol::status(Level::Error, why)));
}

#[cfg(test)]
mod tests;
