//! A node that was away for long. It checks in with the homes of its deployments before it begins anything for them.
//!
//! A node that was killed or suspended resumes with the state it had. But a home may have treated its host as
//! lost in the meantime, and have begun a replacement. So until a home has answered, no program of its
//! deployments is started again here, and nothing is activated. Messages arrive in order, so the decisions of the
//! home arrive before its answer; a decision may be to end this part.
//!
//! A home that does not answer is lost after a while. Then `on_link_loss` decides, as at any cut.
//! The home answers only hosts that it lists as present. A host that is only missing may still be
//! treated as lost, and is first told this.

use crate::logic::effect::Out;
use crate::logic::nameserver::NameServer;
use crate::logic::participant::Participant;
use crate::logic::protocol::{Body, Message};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// The questions that are not answered yet.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct CheckIns {
    /// How often this node has checked in.
    count: u64,
    /// The hosts that have checked in here, each with its boot and its number.
    come: BTreeMap<String, (u64, u64)>,
}

impl CheckIns {
    /// Checks in with every other home that may have missed this node. A deployment whose home is this host needs no
    /// answer. To be called before anything else is done.
    pub(super) fn check_in<'a>(
        &mut self,
        names: &NameServer,
        participants: impl Iterator<Item = &'a mut Participant>,
        out: &mut Out<'_>,
    ) {
        let number = self.count + 1;
        let unsure = participants.filter(|participant| names.has_slept(out.now, participant.home()));
        let waiting = unsure
            .filter_map(|participant| participant.check_in(number, out.now).then(|| participant.home().to_owned()));
        for home in waiting.collect::<BTreeSet<String>>() {
            self.count = number;
            out.send(&home, Message::about_none(Body::CheckIn { number }));
        }
    }

    /// Takes note that a host checks in, which is answered by [`CheckIns::answer`].
    pub(super) fn come(&mut self, names: &NameServer, number: u64, from: &str) {
        if let Some(boot) = names.holder(from) {
            self.come.insert(from.to_owned(), (boot, number));
        }
    }

    /// Answers the hosts that have checked in and are there, after all other messages to them. A later boot has
    /// forgotten the question.
    pub(super) fn answer(&mut self, names: &NameServer, out: &mut Out<'_>) {
        let is_over =
            |host: &String, (boot, _): &mut (u64, u64)| names.reaches(host) || names.holder(host) != Some(*boot);
        for (host, (boot, number)) in self.come.extract_if(.., is_over) {
            if names.holder(&host) == Some(boot) {
                out.send(&host, Message::about_none(Body::CheckedIn { number }));
            }
        }
    }
}
