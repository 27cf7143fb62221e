//! Orders of people to an activity. The home finds the activity that a person means, and passes on the answer of its supervisor.

use super::mission::Mission;
use crate::logic::effect::Out;
use crate::logic::meant::{MeantActivity, meant};
use crate::logic::protocol::{Answer, Delivery, Taken, TellRequest, ToParticipant};
use comms::logic::time::Time;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::time::Duration;

/// How long a supervisor has to confirm an order. The user waits longer than this.
const CONFIRM_WITHIN: Duration = Duration::from_secs(3);
/// How many calls may wait at one time.
const CALLS_MAX: usize = 256;

/// The calls that wait for the answer of an activity.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Orders(BTreeMap<u64, Handed>);

/// An order that was sent to the host of an activity.
#[derive(Debug, Serialize, Deserialize)]
struct Handed {
    path: String,
    host: String,
    until: Time,
}

impl Orders {
    /// Sends an order to the supervisor of an activity; `call` is answered when the supervisor has confirmed the order.
    ///
    /// # Errors
    /// The answer, if the order was sent to no supervisor.
    pub(super) fn give(
        &mut self,
        mission: &Mission,
        call: u64,
        request: &TellRequest,
        out: &mut Out<'_>,
    ) -> Result<(), Delivery> {
        if self.0.len() >= CALLS_MAX {
            return Err(Delivery::Refused(format!("{CALLS_MAX} orders already wait for an answer; try again later")));
        }
        let MeantActivity { group, path, host } = meant(&mission.plan, request).map_err(Delivery::Refused)?;
        if mission.is_lost(&host) {
            return Err(Delivery::Unconfirmed(format!("host `{host}`, which runs `{path}`, is lost")));
        }
        let (told, by) = (request.order.clone(), Some(request.by.clone()));
        mission.tell(&host, ToParticipant::Tell { group, told, by, call: Some(call) }, out);
        self.0.insert(call, Handed { path, host, until: out.now + CONFIRM_WITHIN });
        Ok(())
    }

    /// Passes on the answer of a supervisor.
    pub(super) fn told(&mut self, call: u64, taken: Result<Taken, String>, out: &mut Out<'_>) {
        if let Some(Handed { path, .. }) = self.0.remove(&call) {
            let taken = taken.map(|taken| Delivery::Taken { path, taken });
            out.answer_last(call, Answer::Delivered(taken.unwrap_or_else(Delivery::Refused)));
        }
    }

    /// Returns when [`Orders::tick`] wants to be called.
    pub(super) fn deadline(&self) -> Option<Time> {
        self.0.values().map(|handed| handed.until).min()
    }

    /// Gives up calls whose supervisors do not answer.
    pub(super) fn tick(&mut self, mission: &Mission, out: &mut Out<'_>) {
        let now = out.now;
        self.0.retain(|call, Handed { path, host, until }| {
            let why = if mission.is_lost(host) {
                format!("the order was sent to host `{host}`, which is lost; `{path}` has not confirmed the order")
            } else if *until <= now {
                let within = CONFIRM_WITHIN.as_secs();
                format!(
                    "the order was sent to host `{host}`, and `{path}` has not confirmed it within {within} s; the order may still arrive"
                )
            } else {
                return true;
            };
            out.answer_last(*call, Answer::Delivered(Delivery::Unconfirmed(why)));
            false
        });
    }

    /// Answers all calls because the deployment ends.
    pub(super) fn abandon(&mut self, name: &str, out: &mut Out<'_>) {
        for (call, _) in std::mem::take(&mut self.0) {
            out.answer_last(call, Answer::Delivered(Delivery::Refused(format!("`{name}` ends"))));
        }
    }
}
