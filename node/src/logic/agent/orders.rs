//! Orders of other nodes that start something, at a node in a team: each waits until it is known that a user has signed it.

use super::Agent;
use crate::logic::effect::{Effect, Out};
use crate::logic::gate::outcome_of_order;
use crate::logic::protocol::{
    Answer, Body, ChangeOrder, ChangeReply, Deployment, Message, Request, ToCoordinator, ToParticipant,
};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use trust::request;

/// How many orders wait for their verdict; more are refused.
const ORDERS_MAX: usize = 64;

/// The orders that wait for their verdict.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Orders {
    next: u64,
    waiting: BTreeMap<u64, Waiting>,
    /// The orders that were accepted and not answered yet, each with the node that gave it; if there are many, the
    /// latest ones.
    accepted: VecDeque<(u64, Deployment, String)>,
}

#[derive(Debug, Serialize, Deserialize)]
struct Waiting {
    deployment: Deployment,
    from: String,
    order: ToParticipant,
}

impl Agent {
    /// Takes a call. A request that a user has signed is passed on to the nodes that carry it out.
    pub(super) fn take_call(&mut self, call: u64, request: Request, out: &mut Out<'_>) {
        let Request::Signed(signed) = request else { return self.call(call, request, None, out) };
        match signed.request() {
            Ok(mut request) => {
                // The signer of the request is its author.
                if let (Request::Deploy { by, .. }, Ok((_, name))) =
                    (&mut request, request::Request::peek(&signed.head))
                {
                    *by = name.to_string();
                } else if let (Request::Change(change), Ok((_, name))) =
                    (&mut request, request::Request::peek(&signed.head))
                {
                    change.by = name.to_string();
                } else if let (Request::Tell(tell), Ok((_, name))) =
                    (&mut request, request::Request::peek(&signed.head))
                {
                    tell.by = name.to_string();
                }
                self.call(call, request, Some(Arc::new(*signed)), out);
            }
            Err(error) => {
                out.answer_last(call, Answer::Refused(format!("what was signed cannot be read: {error}")));
            }
        }
    }

    /// Takes an order of another node. In a team, an order that starts something waits for its verdict.
    pub(super) fn take_order(&mut self, deployment: Deployment, order: ToParticipant, from: &str, out: &mut Out<'_>) {
        if !self.identity.is_guarded {
            if let Some(order) = order.plain() {
                self.deliver_to_participant(&deployment, order, from, out);
            }
            return;
        }
        if order == ToParticipant::Release {
            // An order that has not begun can be dropped.
            self.orders.waiting.retain(|_, waiting| waiting.deployment != deployment || waiting.from != from);
        }
        if !order.starts() {
            return self.deliver_to_participant(&deployment, order, from, out);
        }
        let waiting = Waiting { deployment, from: from.to_owned(), order };
        if self.orders.waiting.len() >= ORDERS_MAX {
            return self.refuse_order(waiting, "too many orders wait to be judged", out);
        }
        self.orders.next += 1;
        out.effects.push(waiting.judge(self.orders.next));
        self.orders.waiting.insert(self.orders.next, waiting);
    }

    /// Carries out an order that a user has signed, or refuses it.
    pub(super) fn judged(&mut self, number: u64, verdict: Result<(), String>, out: &mut Out<'_>) {
        let Some(waiting) = self.orders.waiting.remove(&number) else { return };
        match verdict {
            Ok(()) => {
                let Waiting { deployment, from, order } = waiting;
                self.orders.accepted.push_back((number, deployment.clone(), from.clone()));
                self.orders.accepted.drain(..self.orders.accepted.len().saturating_sub(ORDERS_MAX));
                if let Some(order) = order.plain() {
                    self.deliver_to_participant(&deployment, order, &from, out);
                }
            }
            Err(why) => self.refuse_order(waiting, &why, out),
        }
    }

    /// Notes the outcome of an accepted order, if this message is the answer to that order.
    pub(super) fn note_outcome(&mut self, to: &str, message: &Message, effects: &mut Vec<Effect>) {
        let Body::Coordinator(answer) = &message.body else { return };
        let mut accepted = self.orders.accepted.iter();
        let place = accepted.position(|(_, deployment, from)| *deployment == message.deployment && from == to);
        let Some((place, outcome)) = place.zip(outcome_of_order(answer)) else { return };
        if let Some((number, ..)) = self.orders.accepted.remove(place) {
            effects.push(Effect::OrderEnded { number, outcome });
        }
    }

    /// Asks again for the verdicts that a node which was killed has not given.
    pub(super) fn judge_again(&mut self, out: &mut Out<'_>) {
        out.effects.extend(self.orders.waiting.iter().map(|(number, waiting)| waiting.judge(*number)));
    }

    /// Drops the orders of a node that is lost.
    pub(super) fn forget_orders(&mut self, from: &str) {
        self.orders.waiting.retain(|_, waiting| waiting.from != from);
    }

    fn refuse_order(&self, Waiting { deployment, from, order }: Waiting, why: &str, out: &mut Out<'_>) {
        let reason = format!("host `{}`: {why}", self.identity.host);
        let answer = match order.plain() {
            Some(ToParticipant::Change(ChangeOrder::Examine { number, .. })) => {
                ToCoordinator::Change(ChangeReply::Examined { number, reasons: vec![reason] })
            }
            Some(ToParticipant::Change(order)) => ToCoordinator::Change(order.failed(reason)),
            _ => ToCoordinator::Refused { reasons: vec![reason] },
        };
        out.send(&from, deployment.to_coordinator(answer));
    }
}

impl Waiting {
    fn judge(&self, number: u64) -> Effect {
        let (deployment, from) = (self.deployment.clone(), self.from.clone());
        Effect::Judge { number, deployment, from, order: Box::new(self.order.clone()) }
    }
}
