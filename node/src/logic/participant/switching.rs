//! Switches of connection sets, as far as programs and supervisors of this host take part in them.

use super::Participant;
use crate::logic::effect::Out;
use crate::logic::protocol::ToParticipant;
use comms::logic::control::Order;
use comms::logic::switch::{Expect, Flip};
use serde::{Deserialize, Serialize};

/// A switch that a program of this host is to expect.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Expecting {
    group: u32,
    leaf: u32,
    host: String,
    generation: u64,
}

impl Participant {
    /// Has a program expect a switch. For one that is not there nobody waits: what is sent to it is lost anyway.
    pub(super) fn expect(
        &mut self,
        (group, leaf, from): (u32, u32, &str),
        (expect, then): (Expect, Option<Flip>),
        out: &mut Out<'_>,
    ) {
        self.ticket += 1;
        let (ticket, generation) = (self.ticket, expect.generation);
        self.expecting.insert(ticket, Expecting { group, leaf, host: from.to_owned(), generation });
        if let Some(then) = &then {
            self.open.retain(|wire| !then.close.contains(wire));
            self.open.extend(then.open.iter().map(|opening| opening.wire));
        }
        let order = Order::Expect { ticket, expect, then };
        let mut is_there = false;
        self.with_instance(leaf, out, |instance, context| is_there = instance.switch(order, context));
        if !is_there {
            self.confirm_taken(ticket, (0, 0, Vec::new()), out);
        }
    }

    pub(super) fn confirm_expecting(&mut self, ticket: u64, out: &mut Out<'_>) {
        if let Some(Expecting { group, leaf, host, generation }) = self.expecting.get(&ticket) {
            let (group, leaf, generation) = (*group, *leaf, *generation);
            let word = ToParticipant::Expecting { group, leaf, generation };
            out.send(host, self.deployment.to_participant(word));
        }
    }

    pub(super) fn confirm_taken(
        &mut self,
        ticket: u64,
        (lost, late, missing): (u64, u64, Vec<u32>),
        out: &mut Out<'_>,
    ) {
        if let Some(Expecting { group, leaf, host, generation }) = self.expecting.remove(&ticket) {
            let word = ToParticipant::Taken { group, leaf, generation, lost, late, missing };
            out.send(&host, self.deployment.to_participant(word));
        }
    }

    /// A program that is gone takes nothing any more.
    pub(super) fn forget_expecting(&mut self, leaf: u32, out: &mut Out<'_>) {
        let theirs = self.expecting.iter().filter(|(_, expecting)| expecting.leaf == leaf).map(|(ticket, _)| *ticket);
        for ticket in theirs.collect::<Vec<_>>() {
            self.confirm_taken(ticket, (0, 0, Vec::new()), out);
        }
    }

    /// Gives a supervisor of this host what it needs for a switch.
    pub(super) fn follow_switch(&mut self, message: ToParticipant, out: &mut Out<'_>) {
        if let ToParticipant::Expecting { group, leaf, generation } = message {
            self.with_executer(group, out, |executer, at, out| {
                executer.expecting((generation, leaf), at, out);
                None
            });
        } else if let ToParticipant::Taken { group, leaf, generation, lost, late, missing } = message {
            self.with_executer(group, out, |executer, at, out| {
                executer.taken((generation, leaf), (lost, late, missing), at, out);
                None
            });
        } else if let ToParticipant::Succeeding { group, leaf, is_handed_over } = message {
            self.with_executer(group, out, |executer, at, out| {
                executer.succeeding(leaf, is_handed_over, at, out);
                None
            });
        } else if let ToParticipant::SwitchSets { group, slot, sets, call } = message {
            self.with_executer(group, out, |executer, at, out| {
                executer.switch_sets((slot, &sets), call, at, out);
                None
            });
        }
    }
}
