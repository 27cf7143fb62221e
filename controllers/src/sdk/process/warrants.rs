//! Calls of users in a team, from their arrival until the node has judged whether the user may make them.
//!
//! The node judges, because it knows the members of the team and the requests that it has accepted, and because it
//! writes the audit log. If the node is lost before it has answered, the call is refused and was not executed.

use super::inbox::Inbox;
use super::node_line::NoticeLog;
use comms::io::data::{DataSession, IncomingCall, call_digest};
use comms::logic::control::{Notice, UserCall};
use comms::logic::object::{Access, ObjectError, PER_CALLER_MAX};
use comms::logic::seal::{NO_WIRE, Refusal};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError, Weak};

/// The calls that wait for a judgement.
#[derive(Debug)]
pub(super) struct Warrants {
    inbox: Arc<Inbox>,
    /// The connection to the node, once there is one.
    notices: OnceLock<NoticeLog>,
    open: Mutex<Open>,
}

#[derive(Debug, Default)]
struct Open {
    asked: u64,
    calls: BTreeMap<u64, Waiting>,
}

#[derive(Debug)]
struct Waiting {
    incoming: IncomingCall,
    session: Weak<DataSession>,
    /// The channel over which the node was asked.
    channel: u64,
}

impl Warrants {
    pub(super) fn new(inbox: &Arc<Inbox>) -> Self {
        Self { inbox: Arc::clone(inbox), notices: OnceLock::new(), open: Mutex::default() }
    }

    /// Uses this connection to ask the node from now on.
    pub(super) fn ask_by(&self, notices: &NoticeLog) {
        self.notices.get_or_init(|| notices.clone());
    }

    /// Accepts a call for which a user does not need a right, and asks the node about any other call. Never waits.
    pub(super) fn admit(&self, key: &str, access: Access, mut incoming: IncomingCall, session: &Weak<DataSession>) {
        let warrant = incoming.call.warrant.take();
        if !incoming.is_visit || access == Access::Look {
            return self.inbox.called(incoming, session);
        }
        let Some(warrant) = warrant else {
            self.inbox.refuse(NO_WIRE, Refusal::Unsigned, Some(incoming.call.id.session.clone()));
            let name = &incoming.call.name;
            let why =
                format!("in a team, a call of `{name}` needs the key of a user who may {access} (`dca team key`)");
            return refuse(incoming, why);
        };
        let digest = match call_digest(key, &incoming.call) {
            Ok(digest) => digest,
            Err(error) => return refuse(incoming, format!("the call cannot be read: {error}")),
        };
        let call = UserCall { name: incoming.call.name.clone(), access, digest, warrant };
        let mut open = self.open();
        if open.calls.len() >= PER_CALLER_MAX {
            let waiting = u32::try_from(open.calls.len()).unwrap_or(u32::MAX);
            drop(open);
            return incoming.way.answer(Err(ObjectError::Busy { waiting }));
        }
        open.asked += 1;
        let number = open.asked;
        let sent = self.notices.get().map(|notices| notices.send_now(&Notice::Judge { number, call }));
        match sent {
            Some(Ok(Some(channel))) => {
                open.calls.insert(number, Waiting { incoming, session: Weak::clone(session), channel });
            }
            Some(Err(error)) => refuse(incoming, format!("its node cannot be asked: {error}")),
            Some(Ok(None)) | None => refuse(incoming, NO_NODE.to_owned()),
        }
    }

    /// Takes the decision of the node.
    pub(super) fn judged(&self, number: u64, refusal: Option<String>) {
        let Some(Waiting { incoming, session, .. }) = self.open().calls.remove(&number) else { return };
        match refusal {
            None => self.inbox.called(incoming, &session),
            Some(why) => refuse(incoming, why),
        }
    }

    /// Takes note of a new channel: questions over earlier channels get no answer.
    pub(super) fn renew(&self) {
        let Some(channel) = self.notices.get().map(NoticeLog::channel) else { return };
        let lost: Vec<Waiting> =
            self.open().calls.extract_if(.., |_, waiting| waiting.channel < channel).map(|(_, call)| call).collect();
        lost.into_iter().for_each(|waiting| refuse(waiting.incoming, NO_NODE.to_owned()));
    }

    fn open(&self) -> MutexGuard<'_, Open> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Why a call is refused while the node is away.
const NO_NODE: &str =
    "the node of this program is not connected, so it cannot check whether you may make this call; try again";

fn refuse(incoming: IncomingCall, reason: String) {
    incoming.way.answer(Err(ObjectError::Refused { reason }));
}
