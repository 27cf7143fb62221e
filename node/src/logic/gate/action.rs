//! The requests that a user has to sign, the action that each of them needs, and its addressees.

use crate::logic::database::question::{Commit, Question};
use crate::logic::protocol::{ActivityInput, Request, TellRequest};
use comms::logic::object::Access;
use language::plan::Plan;
use trust::name::{Name, NoName};
use trust::request::Audience;
use trust::role::Action;

/// How many keys of a transaction the audit log names at most.
const KEYS_MAX: usize = 4;

/// Returns the permission that the signer of a request needs. Nothing is needed for a request that changes nothing, or
/// is proved in another way.
pub fn action(request: &Request) -> Option<Action> {
    match request {
        Request::Deploy { .. } | Request::Change(_) | Request::Switch(_) => Some(Action::Deploy),
        Request::Stop { .. } | Request::Forget { .. } | Request::StopAway(_) => Some(Action::Stop),
        Request::ReleaseEstop => Some(Action::Start),
        Request::Database(question) | Request::Here { question, .. } => of_question(question),
        Request::Call(call) => of_access(call.access),
        Request::Tell(_) => Some(Action::Operate),
        // Every user may stop everything. The set of revoked keys and the renewal request of a user contain their own signatures.
        Request::Estop(_)
        | Request::Revoke { .. }
        | Request::Revocations(_)
        | Request::RenewUser { .. }
        | Request::Status
        | Request::Logs { .. }
        | Request::Watch { .. }
        | Request::Parameters
        | Request::Output { .. }
        | Request::Unlinked
        | Request::Absent
        | Request::Plan { .. }
        | Request::Revision { .. }
        | Request::Events { .. }
        | Request::Names
        | Request::Locations { .. }
        | Request::Clock
        | Request::Team
        | Request::Credentials
        | Request::Duplicates
        // A signature around a signature is not a valid request.
        | Request::Signed(_) => None,
    }
}

const fn of_access(access: Access) -> Option<Action> {
    match access {
        Access::Look => None,
        Access::Operate => Some(Action::Operate),
        Access::Deploy => Some(Action::Deploy),
    }
}

fn of_question(question: &Question) -> Option<Action> {
    match question {
        Question::Commit(_) | Question::Resolve(_) | Question::Own(_) => Some(Action::Write),
        Question::Found
        | Question::Join { .. }
        | Question::Retire { .. }
        | Question::RetireOlder { .. }
        | Question::HealClock => Some(Action::Found),
        Question::Get { .. }
        | Question::List { .. }
        | Question::Status
        | Question::History(_)
        | Question::Conflicts { .. }
        | Question::Diff { .. }
        | Question::Version(_)
        | Question::Watch { .. }
        | Question::Follow { .. }
        | Question::Export { .. }
        | Question::Owners => None,
    }
}

/// Returns the plan that a request asks for, if it asks for one.
pub(super) fn plan_of(request: &Request) -> Option<&Plan> {
    if let Request::Deploy { plan, .. } = request {
        return Some(plan);
    }
    if let Request::Change(change) = request { Some(&change.plan) } else { None }
}

/// Returns the subject of a request, for the audit log.
#[expect(clippy::wildcard_enum_match_arm, reason = "`action` says of each request whether it is ever asked for")]
pub fn subject(request: &Request) -> String {
    match request {
        Request::Deploy { plan, .. } => format!("deploy `{}`", plan.name),
        Request::Change(change) => format!("change `{}@{}`", change.name, change.epoch),
        Request::Stop { name } => format!("stop `{name}`"),
        Request::Switch(switch) => format!("switch `{}` of `{}`", switch.process, switch.name),
        Request::Forget { deployment } => format!("forget `{deployment}`"),
        Request::StopAway(tombstone) => {
            format!("stop `{}` of `{}`, which is away", tombstone.deployment, tombstone.home)
        }
        Request::Estop(_) => "stop everything".to_owned(),
        Request::ReleaseEstop => "let programs begin again".to_owned(),
        Request::Database(question) | Request::Here { question, .. } => subject_of(question),
        Request::Tell(tell) => subject_of_order(tell),
        Request::Call(call) => format!("call `{}` of `{}` of `{}`", call.procedure, call.path, call.deployment),
        _ => "look".to_owned(),
    }
}

fn subject_of_order(request: &TellRequest) -> String {
    let TellRequest { name, process, order, .. } = request;
    match order {
        ActivityInput::Message { port, .. } => format!("tell `{process}` of `{name}` at `{port}`"),
        ActivityInput::Notice(notice) => format!("{notice} `{process}` of `{name}`"),
        ActivityInput::Answer { question, option } => {
            format!("answer `{option}` to question {question} of `{process}` of `{name}`")
        }
    }
}

#[expect(clippy::wildcard_enum_match_arm, reason = "`of_question` says of each question whether it is ever asked for")]
fn subject_of(question: &Question) -> String {
    match question {
        Question::Commit(Commit { writes, .. }) => {
            let keys: Vec<String> = writes.iter().take(KEYS_MAX).map(|write| write.key.to_string()).collect();
            let more = writes.len().saturating_sub(KEYS_MAX);
            let more = if more == 0 { String::new() } else { format!(" and {more} more") };
            format!("write {}{more}", keys.join(", "))
        }
        Question::Resolve(resolve) => format!("settle {}", resolve.key),
        Question::Own(own) => format!("give {}", own.prefix),
        Question::Found => "begin the database".to_owned(),
        Question::Join { robot } => format!("join the database of `{robot}`"),
        Question::Retire { member } => format!("retire `{member}`"),
        Question::RetireOlder { robot } => format!("retire older names of `{robot}`"),
        Question::HealClock => "begin a new epoch of dates".to_owned(),
        _ => "read the database".to_owned(),
    }
}

/// Returns the addressees of a request that is sent to a host. A request that starts something on several hosts is
/// addressed to the hosts of the deployment.
///
/// # Errors
/// The host has a name that no certificate can have.
pub fn audience(request: &Request, host: &str) -> Result<Audience, NoName> {
    match plan_of(request).map(|plan| &plan.name) {
        None => host.parse().map(Audience::Host),
        // The names of the hosts are in the plan, which is signed.
        Some(name) => Ok(name.parse::<Name>().map_or(Audience::Team, Audience::Deployment)),
    }
}
