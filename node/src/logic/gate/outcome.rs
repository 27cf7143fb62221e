//! The outcome of an accepted request, derived from the answers to it.

use crate::logic::database::question::Reply;
use crate::logic::protocol::{Answer, ChangeReply, Delivery, Report, StopReply, ToCoordinator};

/// The outcome of a request: done, or the reason why not, for a user.
pub type Outcome = Result<(), String>;

/// Returns the outcome of a request from an answer to it; nothing if the answer does not show the outcome yet.
pub fn outcome(answer: &Answer) -> Option<Outcome> {
    match answer {
        Answer::Report(report) => of_report(report),
        Answer::Refused(why)
        | Answer::Switched(Err(why))
        | Answer::Delivered(Delivery::Refused(why) | Delivery::Unconfirmed(why)) => Some(Err(why.clone())),
        Answer::Stop(StopReply::Unknown) => Some(Err("no such deployment has its home here".to_owned())),
        Answer::Database(reply) => of_reply(reply),
        Answer::Stop(StopReply::Stopped)
        | Answer::Switched(Ok(_))
        | Answer::Delivered(Delivery::Taken { .. })
        | Answer::Estopped(_)
        | Answer::Released { .. } => Some(Ok(())),
        // These are answers to questions, which change nothing.
        Answer::Status(_)
        | Answer::Output(_)
        | Answer::Parameters(_)
        | Answer::Wrote { .. }
        | Answer::Unlinked(_)
        | Answer::Absent(_)
        | Answer::Plan(_)
        | Answer::Revision(_)
        | Answer::Events(_)
        | Answer::Behind(_)
        | Answer::Names(_)
        | Answer::Locations(_)
        | Answer::Revoked { .. }
        | Answer::Revocations(_)
        | Answer::Clock(_)
        | Answer::Team(_)
        | Answer::Credentials(_)
        | Answer::Duplicates(_) => None,
    }
}

/// Returns the outcome of an order from this host's answer to the home; nothing if the answer is about something else.
pub fn outcome_of_order(answer: &ToCoordinator) -> Option<Outcome> {
    match answer {
        ToCoordinator::Prepared { .. } => Some(Ok(())),
        ToCoordinator::Refused { reasons } => Some(Err(reasons.join("; "))),
        ToCoordinator::Change(reply) => match reply {
            ChangeReply::Examined { reasons, .. } if reasons.is_empty() => Some(Ok(())),
            ChangeReply::Examined { reasons, .. } => Some(Err(reasons.join("; "))),
            ChangeReply::Applied { .. } | ChangeReply::Joined { .. } => Some(Ok(())),
            ChangeReply::Failed { reason, .. } => Some(Err(reason.clone())),
            ChangeReply::Linked { .. } | ChangeReply::Healthy { .. } => None,
        },
        // The order was taken back before anything had begun.
        ToCoordinator::Released | ToCoordinator::Unconfirmed => Some(Err("it was taken back".to_owned())),
        ToCoordinator::Connected
        | ToCoordinator::MainEnded { .. }
        | ToCoordinator::Happened { .. }
        | ToCoordinator::SetsSwitched { .. }
        | ToCoordinator::Answered { .. }
        | ToCoordinator::ClockRead { .. }
        | ToCoordinator::BeganLate { .. }
        | ToCoordinator::Stepped { .. } => None,
    }
}

fn of_report(report: &Report) -> Option<Outcome> {
    match report {
        Report::Go { .. } | Report::Changed { .. } => Some(Ok(())),
        Report::Refused { reasons } | Report::Unchanged { reasons, .. } => Some(Err(reasons.join("; "))),
        // The deployment has ended before the request was carried out.
        Report::Finished { .. } => Some(Err("the deployment has ended before".to_owned())),
        Report::Accepted { .. }
        | Report::Prepared { .. }
        | Report::Connected { .. }
        | Report::Process { .. }
        | Report::Programs { .. }
        | Report::Replanned { .. }
        | Report::Aligned { .. }
        | Report::BeganLate { .. }
        | Report::Omitted { .. }
        | Report::Stepped { .. } => None,
    }
}

fn of_reply(reply: &Reply) -> Option<Outcome> {
    match reply {
        Reply::Committed(_) | Reply::Reached(_) | Reply::Pending(_) | Reply::Done(_) => Some(Ok(())),
        Reply::Refused(why) | Reply::Unmet { why, .. } | Reply::Unknown(why) => Some(Err(why.clone())),
        Reply::NotOwner { owner } => Some(Err(format!("only `{owner}` writes there"))),
        Reply::Entries(_)
        | Reply::Status(_)
        | Reply::Note(_)
        | Reply::History(_)
        | Reply::Conflicts(..)
        | Reply::Differences(_)
        | Reply::Version(_)
        | Reply::Notification(_)
        | Reply::Text(_)
        | Reply::Owners(_) => None,
    }
}
