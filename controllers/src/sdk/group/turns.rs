//! A running group: its members calculate in turns, and exchange values in memory.

use super::checks::{Layout, Outlet, Target};
use super::inner::InnerTaps;
use crate::sdk::arguments::Arguments;
use crate::sdk::calls::CallOrder;
use crate::sdk::controller::{Configured, Progress, Schedule, Stopping};
use crate::sdk::database::{DatabaseOrder, Unknown};
use crate::sdk::export::{Activity, RawReply};
use crate::sdk::interface::Interface;
use crate::sdk::module::{Delivery, DeliveryError, Module, Outlets, guarded};
use comms::logic::control::KeyPort;
use comms::logic::database::DatabaseAnswer;
use comms::logic::object::ObjectError;
use comms::logic::signals::Signal;
use comms::logic::time::Time;
use std::sync::Arc;

/// The position of the member's number in the number of a request to the database. Members count from 1, and the
/// highest bit is used for another purpose.
const MEMBER_SHIFT: u32 = 48;
const MEMBER_MASK: u64 = 0xff << MEMBER_SHIFT;

/// An instance of a group.
pub(super) struct GroupModule {
    layout: Arc<Layout>,
    members: Vec<Running>,
    /// The values that leave the group next.
    sent: Vec<(&'static str, Vec<u8>)>,
    /// The values of the member that is calculating.
    passing: Vec<(&'static str, Vec<u8>)>,
    /// The watched values between the members.
    taps: InnerTaps,
    /// Arguments that wait for the next activation.
    next: Option<Arguments>,
    /// The calls that the spec connects.
    connected: Vec<&'static str>,
    /// The failed stops of members. The other members are stopped first.
    failed_stops: Vec<String>,
}

struct Running {
    module: Box<dyn Module>,
    /// Whether it is between its `init` and the end of its `stop`.
    is_active: bool,
    due: Time,
    is_triggered: bool,
}

impl Running {
    fn new(module: Box<dyn Module>) -> Self {
        Self { module, is_active: false, due: Time::ZERO, is_triggered: false }
    }

    /// Hands over a value, if the member is active.
    fn deliver(&mut self, port: &str, bytes: &[u8], arrived: Time) -> Result<Delivery, DeliveryError> {
        if !self.is_active {
            return Ok(Delivery::Stored);
        }
        let delivery = self.module.deliver(port, bytes, arrived)?;
        Ok(self.noted(delivery))
    }

    fn noted(&mut self, delivery: Delivery) -> Delivery {
        self.is_triggered |= delivery == Delivery::Triggers;
        delivery
    }

    /// Calculates if it is time: on the grid of its period, or after a trigger. With a trigger, the next deadline is
    /// one period after the last calculation.
    fn calculate(&mut self, schedule: &Schedule, now: Time) -> Option<Progress> {
        let (is_due, period) = (now >= self.due, schedule.period);
        if !self.is_active || !(is_due || self.is_triggered) {
            return None;
        }
        self.is_triggered = false;
        if schedule.trigger.is_some() {
            self.due = now + period;
        } else if is_due {
            // A deadline that has passed is skipped, not caught up. The grid remains the grid of the group.
            let periods = (now - self.due).as_nanos() / period.as_nanos().max(1) + 1;
            self.due = self.due + period * u32::try_from(periods).unwrap_or(u32::MAX);
        }
        Some(self.module.calculate(now))
    }
}

impl GroupModule {
    pub(super) fn new(layout: Arc<Layout>, arguments: &Arguments) -> Result<Self, String> {
        let members = layout.make(arguments)?.into_iter().map(Running::new).collect();
        let taps = InnerTaps::new(layout.interface.inner.len());
        let (sent, passing, connected, failed_stops) = Default::default();
        Ok(Self { layout, members, sent, passing, taps, next: None, connected, failed_stops })
    }

    /// Passes on the values that a member has sent.
    fn pass(&mut self, at: usize, now: Time) {
        let mut passing = std::mem::take(&mut self.passing);
        if let Some(member) = self.members.get_mut(at) {
            member.module.drain(&mut |port, bytes| passing.push((port, bytes)));
        }
        let layout = Arc::clone(&self.layout);
        for (port, bytes) in passing.drain(..) {
            let outlet = layout.members.get(at).and_then(|place| place.outputs.get(port));
            let Some(Outlet { targets, inner }) = outlet else { continue };
            let Some((last, others)) = targets.split_last() else { continue };
            inner.iter().for_each(|inner| self.taps.pass(*inner, &bytes));
            for target in others {
                self.send(*target, bytes.clone(), now);
            }
            self.send(*last, bytes, now);
        }
        self.passing = passing;
    }

    fn send(&mut self, target: Target, bytes: Vec<u8>, now: Time) {
        match target {
            Target::Outside(port) => self.sent.push((port, bytes)),
            Target::Member(to, port) => {
                let Some(member) = self.members.get_mut(to) else { return };
                if let Err(error) = member.deliver(port, &bytes, now) {
                    tracing::warn!(%error, "cannot take a value");
                }
            }
        }
    }

    /// Returns the effect of a member's end on the group.
    fn ending(&self, at: usize, progress: Progress) -> Progress {
        let Some(place) = self.layout.members.get(at) else { return progress };
        match progress {
            Progress::Done(_) if place.is_service => {
                Progress::Aborted(format!("`{}` is a service, and has ended", place.name))
            }
            Progress::Aborted(reason) => Progress::Aborted(format!("`{}`: {reason}", place.name)),
            Progress::Done(_) | Progress::Continue => progress,
        }
    }
}

impl Module for GroupModule {
    fn interface(&self) -> &Interface {
        &self.layout.interface
    }

    fn deliver(&mut self, port: &str, bytes: &[u8], arrived: Time) -> Result<Delivery, DeliveryError> {
        let type_name = self.layout.interface.type_name;
        let Some(inputs) = self.layout.inputs.get(port) else {
            return Err(DeliveryError::NoInput { type_name, port: port.to_owned() });
        };
        let mut all = Delivery::Stored;
        for (at, port) in inputs {
            if let Some(member) = self.members.get_mut(*at)
                && member.deliver(port, bytes, arrived)? == Delivery::Triggers
            {
                all = Delivery::Triggers;
            }
        }
        Ok(all)
    }

    fn lose(&mut self, port: &str, count: u64) {
        for (at, port) in self.layout.inputs.get(port).into_iter().flatten() {
            self.members.get_mut(*at).into_iter().for_each(|member| member.module.lose(port, count));
        }
    }

    fn init(&mut self, value: &[u8], now: Time) -> Result<(), String> {
        match self.next.take().map(|arguments| self.layout.make(&arguments)) {
            Some(Ok(members)) => self.members = members.into_iter().map(Running::new).collect(),
            Some(Err(why)) => tracing::warn!(why, "parameters of the database are ignored"),
            None => {}
        }
        self.sent.clear();
        self.failed_stops.clear();
        self.taps.clear();
        for (at, (member, place)) in self.members.iter_mut().zip(&self.layout.members).enumerate() {
            (member.due, member.is_triggered, member.is_active) = (now, false, true);
            let value = if at == 0 { value } else { &[] };
            member.module.connect_calls(&self.connected);
            member.module.init(value, now).map_err(|why| format!("`{}`: {why}", place.name))?;
        }
        Ok(())
    }

    fn configure(&mut self, arguments: Arguments, running: bool) -> Result<Configured, String> {
        let members = self.layout.make(&arguments)?;
        if running {
            // Either all members take the new arguments or none, because one member may refuse arguments that another
            // member takes.
            self.next = Some(arguments);
            return Ok(Configured::Later);
        }
        self.members = members.into_iter().map(Running::new).collect();
        self.next = None;
        Ok(Configured::Now)
    }

    fn calculate(&mut self, now: Time) -> Progress {
        let (layout, mut all) = (Arc::clone(&self.layout), Progress::Continue);
        for (at, place) in layout.members.iter().enumerate() {
            let progress = self.members.get_mut(at).and_then(|member| member.calculate(&place.schedule, now));
            let Some(progress) = progress else { continue };
            self.pass(at, now);
            // The first member that ends also ends the group, once the turn is over.
            if all == Progress::Continue {
                all = self.ending(at, progress);
            }
        }
        all
    }

    fn stop(&mut self, now: Time) -> Stopping {
        let (layout, mut is_over) = (Arc::clone(&self.layout), true);
        for (at, place) in layout.members.iter().enumerate() {
            let Some(member) = self.members.get_mut(at).filter(|member| member.is_active) else { continue };
            match guarded(|| member.module.stop(now)) {
                Ok(Stopping::Finished) => member.is_active = false,
                Ok(Stopping::Again) => is_over = false,
                Ok(Stopping::Failed(why)) | Err(why) => {
                    member.is_active = false;
                    self.failed_stops.push(format!("`{}`: {why}", place.name));
                }
            }
            self.pass(at, now);
        }
        match std::mem::take(&mut self.failed_stops) {
            failed if !is_over => {
                self.failed_stops = failed;
                Stopping::Again
            }
            failed if failed.is_empty() => Stopping::Finished,
            failed => Stopping::Failed(failed.join("; ")),
        }
    }

    fn unconfirmed(&mut self) -> Option<String> {
        let members = self.members.iter_mut().zip(&self.layout.members);
        let all = members.filter_map(|(member, place)| Some((&place.name, member.module.unconfirmed()?)));
        all.map(|(name, why)| format!("`{name}`: {why}")).reduce(|one, other| format!("{one}; {other}"))
    }

    fn drain(&mut self, send: &mut dyn FnMut(&'static str, Vec<u8>)) {
        self.sent.drain(..).for_each(|(port, bytes)| send(port, bytes));
    }

    fn drain_to(&mut self, outlets: &mut dyn Outlets) {
        self.drain(&mut |port, bytes| outlets.send(port, bytes));
        self.taps.show(outlets);
    }

    fn signals(&self) -> Vec<Signal> {
        let all = self.members.iter().zip(&self.layout.members);
        let named = |(member, name): (&Running, &str)| {
            let signals = member.module.signals().into_iter();
            signals.map(|signal| Signal { name: format!("{name} {}", signal.name), ..signal }).collect::<Vec<_>>()
        };
        all.flat_map(|(member, place)| named((member, &place.name))).collect()
    }

    fn serve(&mut self, name: &str, argument: &[u8], activity: Activity, reply: RawReply) {
        match self.layout.exports.get(name).and_then(|at| self.members.get_mut(*at)) {
            Some(member) => member.module.serve(name, argument, activity, reply),
            None => {
                let known = self.layout.exports.keys().map(|&name| name.to_owned()).collect();
                reply.answer(Err(ObjectError::NoSuchProcedure { name: name.to_owned(), known }));
            }
        }
    }

    fn connect_calls(&mut self, calls: &[&'static str]) {
        self.connected = calls.to_vec();
    }

    fn drain_calls(&mut self, order: &mut dyn FnMut(&'static str, CallOrder)) {
        self.members.iter_mut().for_each(|member| member.module.drain_calls(order));
    }

    fn answered(&mut self, call: &str, number: u64, result: Result<Vec<u8>, ObjectError>) -> Delivery {
        let Some(member) = self.layout.calls.get(call).and_then(|at| self.members.get_mut(*at)) else {
            return Delivery::Stored;
        };
        let delivery = member.module.answered(call, number, result);
        member.noted(delivery)
    }

    fn connect_keys(&mut self, ports: Vec<KeyPort>) {
        for (at, (member, place)) in self.members.iter_mut().zip(&self.layout.members).enumerate() {
            let own = ports.iter().flat_map(|port| {
                let inputs = self.layout.inputs.get(&*port.port).into_iter().flatten();
                let inputs = inputs.filter(|(of, _)| *of == at && !port.is_write).map(|(_, name)| *name);
                let leads = |targets: &[Target]| {
                    targets.iter().any(|to| matches!(to, Target::Outside(name) if *name == port.port))
                };
                let outputs = place.outputs.iter().filter(|(_, outlet)| port.is_write && leads(&outlet.targets));
                let names = inputs.chain(outputs.map(|(name, _)| *name));
                names.map(|name| KeyPort { port: name.to_owned(), ..port.clone() }).collect::<Vec<_>>()
            });
            member.module.connect_keys(own.collect());
        }
    }

    fn drain_database(&mut self, order: &mut dyn FnMut(DatabaseOrder)) {
        for (at, member) in (0_u64..).zip(&mut self.members) {
            let of_member = |number: u64| number | at << MEMBER_SHIFT;
            member.module.drain_database(&mut |one| {
                order(match one {
                    DatabaseOrder::Ask { number, request } => DatabaseOrder::Ask { number: of_member(number), request },
                    DatabaseOrder::Taken { number } => DatabaseOrder::Taken { number: of_member(number) },
                    DatabaseOrder::Cancel { number } => DatabaseOrder::Cancel { number: of_member(number) },
                });
            });
        }
    }

    fn database_answered(&mut self, number: u64, answer: Result<DatabaseAnswer, Unknown>) -> Delivery {
        let at = usize::try_from((number & MEMBER_MASK) >> MEMBER_SHIFT).unwrap_or(usize::MAX);
        let Some(member) = self.members.get_mut(at) else { return Delivery::Stored };
        let delivery = member.module.database_answered(number & !MEMBER_MASK, answer);
        member.noted(delivery)
    }
}
