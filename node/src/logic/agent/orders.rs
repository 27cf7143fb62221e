//! Orders of other nodes that start something, at a node in a team: each waits until it is known that a user has signed it.

use crate::logic::effect::{Effect, Out};
use crate::logic::gate::outcome_of_order;
use crate::logic::protocol::{
    Body, ChangeOrder, ChangeReply, Deployment, Message, Request, Signed, ToCoordinator, ToParticipant,
};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, VecDeque};
use trust::request;

/// How many orders wait for their verdict; more are refused.
const ORDERS_MAX: usize = 64;

/// The orders that wait for their verdict.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Orders {
    next: u64,
    waiting: BTreeMap<u64, Order>,
    /// The orders that were accepted and not answered yet, each with the node that gave it; if there are many, the
    /// latest ones.
    accepted: VecDeque<(u64, Deployment, String)>,
}

/// An order of another node.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Order {
    pub(super) deployment: Deployment,
    pub(super) from: String,
    pub(super) order: ToParticipant,
}

/// How an order is handled.
#[derive(Debug, PartialEq)]
pub(super) enum Handling {
    /// It starts nothing, and is carried out at once.
    Now(Order),
    /// It waits for its verdict.
    Waits,
    /// It is refused, because too many wait.
    TooMany(Order),
}

impl Orders {
    /// Takes an order, which waits for its verdict if it starts something.
    pub(super) fn take(&mut self, order: Order, out: &mut Out<'_>) -> Handling {
        if order.order == ToParticipant::Release {
            // An order that has not begun can be dropped.
            self.waiting.retain(|_, waiting| waiting.deployment != order.deployment || waiting.from != order.from);
        }
        if !order.order.starts() {
            return Handling::Now(order);
        }
        if self.waiting.len() >= ORDERS_MAX {
            return Handling::TooMany(order);
        }
        self.next += 1;
        out.effects.push(order.judge(self.next));
        self.waiting.insert(self.next, order);
        Handling::Waits
    }

    /// Takes an order that has its verdict from those that wait.
    pub(super) fn judged(&mut self, number: u64, is_accepted: bool) -> Option<Order> {
        let order = self.waiting.remove(&number)?;
        if is_accepted {
            self.accepted.push_back((number, order.deployment.clone(), order.from.clone()));
            self.accepted.drain(..self.accepted.len().saturating_sub(ORDERS_MAX));
        }
        Some(order)
    }

    /// Notes the outcome of an accepted order, if this message is the answer to that order.
    pub(super) fn note_outcome(&mut self, to: &str, message: &Message, effects: &mut Vec<Effect>) {
        let Body::Coordinator(answer) = &message.body else { return };
        let mut accepted = self.accepted.iter();
        let place = accepted.position(|(_, deployment, from)| *deployment == message.deployment && from == to);
        let Some((place, outcome)) = place.zip(outcome_of_order(answer)) else { return };
        if let Some((number, ..)) = self.accepted.remove(place) {
            effects.push(Effect::OrderEnded { number, outcome });
        }
    }

    /// Asks again for the verdicts that a node which was killed has not given.
    pub(super) fn judge_again(&self, out: &mut Out<'_>) {
        out.effects.extend(self.waiting.iter().map(|(number, order)| order.judge(*number)));
    }

    /// Drops the orders of a node that is lost.
    pub(super) fn forget(&mut self, from: &str) {
        self.waiting.retain(|_, waiting| waiting.from != from);
    }
}

impl Order {
    fn judge(&self, number: u64) -> Effect {
        let (deployment, from) = (self.deployment.clone(), self.from.clone());
        Effect::Judge { number, deployment, from, order: Box::new(self.order.clone()) }
    }

    /// Tells the node that gave the order why this host does not carry it out.
    pub(super) fn refuse(self, host: &str, why: &str, out: &mut Out<'_>) {
        let reason = format!("host `{host}`: {why}");
        let answer = match self.order.plain() {
            Some(ToParticipant::Change(ChangeOrder::Examine { number, .. })) => {
                ToCoordinator::Change(ChangeReply::Examined { number, reasons: vec![reason] })
            }
            Some(ToParticipant::Change(order)) => ToCoordinator::Change(order.failed(reason)),
            _ => ToCoordinator::Refused { reasons: vec![reason] },
        };
        out.send(&self.from, self.deployment.to_coordinator(answer));
    }
}

/// Returns a signed request, with the signer as its author.
///
/// # Errors
/// Why it cannot be read.
pub(super) fn signed_request(signed: &Signed) -> Result<Request, String> {
    let mut request = signed.request().map_err(|error| format!("cannot read the signed request: {error}"))?;
    let Ok((_, name)) = request::Request::peek(&signed.head) else { return Ok(request) };
    if let Request::Deploy { by, .. } = &mut request {
        *by = name.to_string();
    } else if let Request::Change(change) = &mut request {
        change.by = name.to_string();
    } else if let Request::Tell(tell) = &mut request {
        tell.by = name.to_string();
    }
    Ok(request)
}
