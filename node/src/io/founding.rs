//! The first node of a team founds the team's database. When it joined, it learned that it is the first.

use crate::io::caller;
use crate::io::database::Handle;
use crate::logic::database::question::{Question, Reply};
use crate::logic::protocol::Answer;
use comms::io::clock;
use std::sync::Arc;
use std::time::Duration;
use team::member::Member;

/// The number of its calls. No command line and no program uses this number.
const CALL: u64 = (1 << 63) - 1;
/// The pause before the next try, if the disk refuses or a member of another database is present.
const AGAIN_AFTER: Duration = Duration::from_secs(10);

/// If this node is marked to found the database, founds it. Removes the mark when the database exists.
///
/// # Cancellation
/// Safe: the next start of the node begins the founding again.
pub(crate) async fn begin(member: Option<Arc<Member>>, database: Handle) {
    let Some(member) = member.filter(|member| member.founds()) else { return };
    let mut told = None;
    while let Err(why) = found(&database).await {
        if told.as_ref() != Some(&why) {
            tracing::warn!(why, "the database of the team is not begun");
            told = Some(why);
        }
        clock::sleep_until(clock::now() + AGAIN_AFTER).await;
    }
    if let Err(error) = member.has_founded() {
        tracing::warn!(%error, "the mark of the first node of a team cannot be removed; it has no effect any more");
    }
}

/// Founds the database, unless this node already has one.
async fn found(database: &Handle) -> Result<(), String> {
    if let Reply::Status(status) = ask(database, Question::Status).await?
        && status.member
    {
        return Ok(());
    }
    let Reply::Done(said) = ask(database, Question::Found).await? else {
        return Err("unexpected answer from the database".to_owned());
    };
    tracing::info!(said, "the database of the team has begun");
    Ok(())
}

async fn ask(database: &Handle, question: Question) -> Result<Reply, String> {
    let (caller, mut answers) = caller::answers();
    database.call(CALL, question, Some(caller));
    while let Some(answer) = answers.next().await {
        let Answer::Database(reply) = answer else { continue };
        if let Reply::Refused(why) = reply {
            return Err(why);
        }
        if !matches!(reply, Reply::Note(_)) {
            return Ok(reply);
        }
    }
    Err("the database does not answer".to_owned())
}
