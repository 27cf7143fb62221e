//! Sends the answers to a call, and ends them: complete, or with the reason why not.
//!
//! Whoever answers must not wait for a caller that takes nothing, so there is room for so many answers. The first one that
//! finds no room ends the call, and the caller is told that what it has is not everything. It is told the same when
//! whoever answers is gone before [`Caller::end`].
//!
//! A call may have a witness, who hears what became of the request also when its caller is gone.

use crate::logic::gate::{Outcome, outcome};
use crate::logic::protocol::Answer;
use std::borrow::Cow;
use std::fmt;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use tokio::sync::mpsc::error::TrySendError;
use tokio::sync::mpsc::{self, Receiver, Sender};

/// How many answers wait for one caller.
const ANSWERS_MAX: usize = 4096;
/// The error of a caller that has not taken all answers.
const SLOW: &str = "more came than were taken";
/// The error of a caller whose answers nobody has ended.
const LEFT: &str = "the node went away from them";

/// How the answers have ended, as soon as that is known.
type End = Arc<OnceLock<Result<(), Cow<'static, str>>>>;

/// The end of whoever answers.
#[derive(Debug)]
pub struct Caller {
    answers: Sender<Answer>,
    end: End,
    witness: Mutex<Option<Witness>>,
}

/// Hears once what became of a request; nothing if nobody has said that.
struct Witness(Box<dyn FnOnce(Option<Outcome>) + Send>);

impl fmt::Debug for Witness {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Witness(..)")
    }
}

/// The end of whoever passes the answers on.
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
    /// Has somebody hear what became of the request, once an answer says so, or that no answer has.
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

    /// Answers without waiting. Returns whether there was room, and somebody who still takes answers; if not, there will be
    /// no more. A witness takes answers, too, up to the one that says what became of the request.
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

    /// Answers, once there is room. Returns whether somebody still takes answers.
    ///
    /// # Cancellation
    /// The answer is lost.
    pub async fn send(&self, answer: Answer) -> bool {
        self.tell_of(&answer);
        self.answers.send(answer).await.is_ok()
    }

    /// Returns how many answers wait to be taken.
    pub fn waiting(&self) -> usize {
        self.answers.max_capacity() - self.answers.capacity()
    }

    /// Waits until nobody takes answers any more.
    ///
    /// # Cancellation
    /// Safe.
    pub async fn closed(&self) {
        self.answers.closed().await;
    }

    /// Says that this was everything; unless there was no room for something.
    pub fn end(self) {
        self.settle(Ok(()));
    }

    /// Says that there is more, which cannot be had, and why, for a person.
    pub fn fail(self, why: String) {
        self.tell(Some(Err(why.clone())));
        self.settle(Err(why.into()));
    }

    fn settle(&self, end: Result<(), Cow<'static, str>>) {
        // What was said first stays.
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

    /// Says, after the last answer, whether that was everything.
    ///
    /// # Errors
    /// It was not; for a person.
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

    /// Whoever asked was killed: what it has asked for goes on, and its end is known.
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
