//! Sends the answers to a call. Says at the end that they are complete, or why not.
//!
//! A server must not wait for a caller that takes no answers, so only a limited number of answers can wait. If an
//! answer finds no room, the call ends, and the caller is told that its answers are incomplete. The
//! caller gets the same message if the server is gone before [`Caller::end`].
//!
//! A call may have a witness, which learns the outcome of the request even if the caller is gone.

use crate::logic::gate::{Outcome, outcome};
use crate::logic::protocol::Answer;
use std::borrow::Cow;
use std::fmt;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use tokio::sync::mpsc::error::TrySendError;
use tokio::sync::mpsc::{self, Receiver, Sender};

/// The most answers that wait for one caller.
const ANSWERS_MAX: usize = 4096;
/// The error of a caller that has not taken all answers.
const SLOW: &str = "more answers arrived than were taken";
/// The error of a caller whose answers never got an end.
const LEFT: &str = "the node stopped sending answers";

/// How the answers ended, once this is known.
type End = Arc<OnceLock<Result<(), Cow<'static, str>>>>;

/// The server's end of a call.
#[derive(Debug)]
pub struct Caller {
    answers: Sender<Answer>,
    end: End,
    witness: Mutex<Option<Witness>>,
}

/// Receives the outcome of a request once; nothing if no answer contained the outcome.
struct Witness(Box<dyn FnOnce(Option<Outcome>) + Send>);

impl fmt::Debug for Witness {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Witness(..)")
    }
}

/// The receiving end of the answers, which passes them on.
#[derive(Debug)]
pub struct Answers {
    answers: Receiver<Answer>,
    end: End,
}

/// Returns both ends of the answers to one call.
pub fn answers() -> (Caller, Answers) {
    let ((to_send, answers), end) = (mpsc::channel(ANSWERS_MAX), End::default());
    (Caller { answers: to_send, end: Arc::clone(&end), witness: Mutex::default() }, Answers { answers, end })
}

impl Caller {
    /// Adds a witness. It receives the outcome of the request once an answer contains it. If no answer contains it, it
    /// learns this at the end.
    #[must_use]
    pub(crate) fn witnessed(mut self, witness: impl FnOnce(Option<Outcome>) + Send + 'static) -> Self {
        self.witness = Mutex::new(Some(Witness(Box::new(witness))));
        self
    }

    fn witness(&self) -> MutexGuard<'_, Option<Witness>> {
        self.witness.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn tell(&self, outcome: Option<Outcome>) {
        let witness = self.witness().take();
        witness.into_iter().for_each(|witness| (witness.0)(outcome.clone()));
    }

    fn tell_of(&self, answer: &Answer) {
        outcome(answer).into_iter().for_each(|outcome| self.tell(Some(outcome)));
    }

    /// Sends an answer without waiting. Returns whether further answers can be sent: there was room and a receiver, or
    /// a witness still needs the outcome.
    pub fn offer(&self, answer: Answer) -> bool {
        self.tell_of(&answer);
        match self.answers.try_send(answer) {
            Ok(()) => true,
            Err(TrySendError::Closed(_)) => self.witness().is_some(),
            Err(TrySendError::Full(_)) => {
                self.settle(Err(SLOW.into()));
                false
            }
        }
    }

    /// Sends an answer as soon as there is room. Returns whether there is still a receiver.
    ///
    /// # Cancellation
    /// The answer is lost.
    pub async fn send(&self, answer: Answer) -> bool {
        self.tell_of(&answer);
        self.answers.send(answer).await.is_ok()
    }

    /// Returns how many answers have not been taken yet.
    pub fn waiting(&self) -> usize {
        self.answers.max_capacity() - self.answers.capacity()
    }

    /// Waits until the receiver has left.
    ///
    /// # Cancellation
    /// Safe.
    pub async fn closed(&self) {
        self.answers.closed().await;
    }

    /// Marks the answers as complete, unless one of them found no room.
    pub fn end(self) {
        self.settle(Ok(()));
    }

    /// Marks the answers as incomplete, with the reason for a person.
    pub fn fail(self, why: String) {
        self.tell(Some(Err(why.clone())));
        self.settle(Err(why.into()));
    }

    fn settle(&self, end: Result<(), Cow<'static, str>>) {
        // Only the first end is used.
        self.end.set(end).unwrap_or_default();
    }
}

impl Drop for Caller {
    fn drop(&mut self) {
        self.tell(None);
    }
}

impl Answers {
    /// Returns the next answer; nothing after the last one.
    ///
    /// # Cancellation
    /// Safe.
    pub async fn next(&mut self) -> Option<Answer> {
        self.answers.recv().await
    }

    /// Returns, after the last answer, whether the answers are complete.
    ///
    /// # Errors
    /// The answers are incomplete. The text is the reason, for a person.
    pub fn end(self) -> Result<(), Cow<'static, str>> {
        self.end.get().cloned().unwrap_or(Err(LEFT.into()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::protocol::Report;
    use std::time::Duration;

    fn answer() -> Answer {
        Answer::Refused(String::new())
    }

    async fn drain(mut answers: Answers) -> (usize, Result<(), Cow<'static, str>>) {
        let mut count = 0;
        while answers.next().await.is_some() {
            count += 1;
        }
        (count, answers.end())
    }

    #[tokio::test]
    async fn what_is_ended_is_complete() {
        let (caller, rest) = answers();
        assert!(caller.offer(answer()));
        caller.end();
        assert_eq!(drain(rest).await, (1, Ok(())));
    }

    #[tokio::test]
    async fn a_witness_hears_once_what_became_of_the_request() {
        let heard = |answers_given: Vec<Answer>| {
            let (told, hears) = std::sync::mpsc::sync_channel(8);
            let (caller, _rest) = answers();
            let caller = caller.witnessed(move |outcome| told.send(outcome).unwrap());
            for answer in answers_given {
                caller.offer(answer);
            }
            caller.end();
            hears.iter().collect::<Vec<_>>()
        };
        let told = |report| Answer::Report(report);
        let go = || told(Report::Go { took: Duration::ZERO, signals: Vec::new() });
        let connected = || told(Report::Connected { host: "c1".into() });
        assert_eq!(heard(vec![connected()]), [None]);
        assert_eq!(heard(vec![connected(), go(), go()]), [Some(Ok(()))]);
        let refused = Report::Refused { reasons: vec!["one".into(), "two".into()] };
        assert_eq!(heard(vec![told(refused), answer()]), [Some(Err("one; two".to_owned()))]);
        assert_eq!(heard(vec![answer()]), [Some(Err(String::new()))]);
    }

    /// The caller was killed. Its request continues, and the witness learns the outcome.
    #[tokio::test]
    async fn a_witness_takes_answers_when_the_caller_is_gone() {
        let (told, hears) = std::sync::mpsc::sync_channel(8);
        let (caller, rest) = answers();
        let caller = caller.witnessed(move |outcome| told.send(outcome).unwrap());
        drop(rest);
        let report = |report| caller.offer(Answer::Report(report));
        assert!(report(Report::Connected { host: "c1".into() }), "there is somebody who hears");
        assert!(!report(Report::Go { took: Duration::ZERO, signals: Vec::new() }), "there is nobody any more");
        drop(caller);
        assert_eq!(hears.iter().collect::<Vec<_>>(), [Some(Ok(()))]);
    }

    #[tokio::test]
    async fn a_caller_that_takes_too_little_is_told_so() {
        let (caller, rest) = answers();
        let taken = (0..=ANSWERS_MAX).take_while(|_| caller.offer(answer())).count();
        caller.end();
        assert_eq!((taken, drain(rest).await), (ANSWERS_MAX, (ANSWERS_MAX, Err(SLOW.into()))));
    }

    #[tokio::test]
    async fn what_nobody_ends_is_broken() {
        let (caller, rest) = answers();
        assert!(caller.send(answer()).await);
        drop(caller);
        assert_eq!(drain(rest).await, (1, Err(LEFT.into())));
    }
}
