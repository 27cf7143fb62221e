//! One call at its server: the request, its author, and the answers to it.

use super::super::proof::{self, Author};
use super::super::stream::End;
use super::{Asked, Caller, Request, refuse, send};
use crate::logic::key;
use zenoh::query::Query;

impl Request {
    pub(super) fn new(query: &Query, asked: Asked, caller: Caller) -> Self {
        let payload = query.payload().map(|payload| payload.to_bytes().into_owned()).unwrap_or_default();
        Self { key: key::without_session(query.key_expr().as_str()).to_owned(), payload, asked, caller }
    }

    /// Returns the author. A command line is not an author: a user signs its requests, if required.
    pub fn author(&self) -> Author {
        let Asked { authenticator, question, proof } = &self.asked;
        let Some(authenticator) = authenticator else { return Author::Anybody };
        match proof {
            Some(proof) => authenticator.check(proof, question),
            None => Author::Nobody("it is not signed".to_owned()),
        }
    }

    /// Returns the key that was called.
    pub fn key(&self) -> &str {
        &self.key
    }

    /// Returns the payload of the call.
    pub fn payload(&self) -> &[u8] {
        &self.payload
    }

    /// Sends an answer, one of possibly many. Waits for a caller that takes answers more slowly than they come.
    /// Returns whether there is still a reader.
    ///
    /// # Cancellation
    /// The answer is lost.
    pub async fn reply(&mut self, bytes: Vec<u8>) -> bool {
        let stream = match &mut self.caller {
            Caller::One(query) => {
                let Some(query) = query.take() else { return false };
                let digest = || proof::answer(&self.asked.question, &bytes);
                let proof = proof::beside(self.asked.authenticator.as_ref(), digest, true);
                send(query, bytes, proof).await;
                return true;
            }
            Caller::Stream(stream) => stream,
        };
        loop {
            if let Some(is_taken) = stream.give(&bytes) {
                return is_taken;
            }
            stream.taken.notified().await;
        }
    }

    /// Waits until the answers have lost their reader: the caller has cancelled, or has not asked for ten minutes.
    ///
    /// # Cancellation
    /// Safe.
    pub async fn left(&self) {
        let Caller::Stream(stream) = &self.caller else { return std::future::pending().await };
        while !stream.lock().is_left {
            stream.taken.notified().await;
        }
    }

    /// Tells the caller that more answers may come.
    pub fn still_here(&self) {
        if let Caller::Stream(stream) = &self.caller {
            stream.change(|state| state.is_here = true);
        }
    }

    /// Marks the answers as complete.
    pub fn finish(self) {
        if let Caller::Stream(stream) = &self.caller {
            stream.change(|state| state.outgoing.finish());
        }
    }

    /// Marks the stream as incomplete and ends it, with the reason for people.
    pub fn break_off(self, why: &str) {
        match &self.caller {
            Caller::One(query) => query.iter().for_each(|query| refuse(query, why)),
            Caller::Stream(stream) => stream.change(|state| state.outgoing.end(End::Broken(why.to_owned()))),
        }
    }

    /// Refuses the request, with a reason for people.
    pub fn refuse(self, reason: &str) {
        match &self.caller {
            Caller::One(query) => query.iter().for_each(|query| refuse(query, reason)),
            Caller::Stream(stream) => stream.change(|state| state.outgoing.end(End::Refused(reason.to_owned()))),
        }
    }
}

impl Drop for Request {
    fn drop(&mut self) {
        if let Caller::Stream(stream) = &self.caller {
            stream.change(|state| {
                state.is_dropped = true;
                state.outgoing.abandon();
            });
        }
    }
}
