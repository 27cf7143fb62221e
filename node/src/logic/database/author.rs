//! Checks whether messages of other replicas come from the sender that they claim.

use super::question::Envelope;
use dbmanager::logic::member::Members;
use dbmanager::logic::message::Message;

/// Checks that the member `author` may send a message: it speaks for replicas of its own robot only.
///
/// # Errors
/// The claimed author, and the reason for the refusal, for a user.
pub(super) fn check(members: &Members, envelope: &Envelope, author: &str) -> Result<(), (String, String)> {
    let said = match &envelope.message {
        Message::Hello(hello) => Some(hello.robot.as_str()),
        Message::Pull(pull) => pull.join.as_ref().map(|join| join.robot.as_str()),
        Message::Push(_)
        | Message::Chunk(_)
        | Message::ChunkRequest(_)
        | Message::SnapshotChunk { .. }
        | Message::Ack(_)
        | Message::DeltaPush(_)
        | Message::Coming { .. } => None,
    };
    let known = members.robot(envelope.from);
    let other = [known, said].into_iter().flatten().find(|robot| *robot != author);
    other.map_or(Ok(()), |robot| {
        Err((robot.to_owned(), format!("`{author}` uses the name of `{robot}` in messages to the database")))
    })
}
