//! A controller's calls of another process's exports: sent after a calculation, answered in a later one.

use super::export::{encode, fit, refused};
use super::port::Message;
use comms::logic::object::ObjectError;
use std::collections::{BTreeSet, VecDeque};
use std::fmt::Debug;
use std::marker::PhantomData;
use std::time::Duration;

/// How many calls of one kind may be in transit at the same time.
const PENDING_MAX: usize = 64;

/// Calls of one procedure of another process, which the spec connects. It is a field of a struct of outputs, with
/// `#[calls("Grip")]`.
///
/// No method waits: [`Calls::call`] sends after this calculation, and [`Calls::answer`] returns the answers that have
/// arrived since.
#[derive(Debug)]
pub struct Calls<A, R> {
    raw: RawCalls,
    of: PhantomData<fn(A) -> R>,
}

/// Calls of one procedure whose arguments and results are bytes. [`Calls`] wraps them, and controllers in other languages use them.
#[derive(Debug, Default)]
pub struct RawCalls {
    is_connected: bool,
    made: u64,
    pending: BTreeSet<u64>,
    orders: Vec<CallOrder>,
    answers: VecDeque<Answered<Vec<u8>>>,
}

/// The number of a call, and its result.
pub type Answered<R> = (u64, Result<R, ObjectError>);

/// An order about a call.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CallOrder {
    /// Make the call.
    Make {
        /// The number of the call.
        number: u64,
        /// The path of the process to call, if the spec connects several processes. None means the first process.
        to: Option<String>,
        /// The encoded argument.
        argument: Vec<u8>,
        /// How long it may take.
        within: Duration,
    },
    /// Cancel the call: the controller no longer waits for it.
    Cancel {
        /// The number of the call.
        number: u64,
    },
}

impl<A, R> Default for Calls<A, R> {
    fn default() -> Self {
        Self { raw: RawCalls::default(), of: PhantomData }
    }
}

impl RawCalls {
    /// Calls after this calculation, like [`Calls::call`] and [`Calls::call_to`]. If the argument cannot be sent, the
    /// answer is the reason.
    pub fn call(&mut self, to: Option<String>, argument: Result<Vec<u8>, ObjectError>, within: Duration) -> u64 {
        self.made += 1;
        let number = self.made;
        let waiting = u32::try_from(self.pending.len()).unwrap_or(u32::MAX);
        let busy = if self.pending.len() >= PENDING_MAX { Err(ObjectError::Busy { waiting }) } else { Ok(()) };
        let argument = busy.and(argument);
        match argument.and_then(|bytes| ObjectError::check_size(bytes.len()).map(|()| bytes)) {
            Ok(argument) => {
                self.pending.insert(number);
                self.orders.push(CallOrder::Make { number, to, argument, within });
            }
            Err(error) => self.answers.push_back((number, Err(error))),
        }
        number
    }

    /// Returns whether the spec connects this call with something, see [`Calls::is_connected`].
    pub const fn is_connected(&self) -> bool {
        self.is_connected
    }

    /// Returns the next answer, with the number of its call.
    pub fn answer(&mut self) -> Option<Answered<Vec<u8>>> {
        self.answers.pop_front()
    }

    /// Stops waiting for a call; its answer is dropped. If the call has not begun at the other end, it never begins.
    pub fn cancel(&mut self, number: u64) {
        if self.pending.remove(&number) {
            self.orders.push(CallOrder::Cancel { number });
        }
    }

    /// Returns how many calls have no answer yet.
    pub fn pending(&self) -> usize {
        self.pending.len()
    }

    /// Records that the spec connects this call.
    pub fn connect(&mut self) {
        self.is_connected = true;
    }

    /// Takes the waiting orders, in order.
    pub fn take(&mut self) -> Vec<CallOrder> {
        std::mem::take(&mut self.orders)
    }

    /// Takes the answer to a call; an answer to a cancelled call is dropped.
    pub fn deliver(&mut self, number: u64, result: Result<Vec<u8>, ObjectError>) {
        if self.pending.remove(&number) {
            self.answers.push_back((number, result));
        }
    }
}

impl<A: Message, R: Message> Calls<A, R> {
    /// Calls after this calculation; returns the number of the call. Every call gets exactly one answer, unless it is
    /// cancelled or the activation ends before.
    pub fn call(&mut self, argument: A, within: Duration) -> u64 {
        self.make(None, argument, within)
    }

    /// Calls the process with this path, if it is one of the processes that the spec connects with this call. Otherwise
    /// the answer is [`ObjectError::NotConnected`].
    pub fn call_to(&mut self, process: &str, argument: A, within: Duration) -> u64 {
        self.make(Some(process.to_owned()), argument, within)
    }

    fn make(&mut self, to: Option<String>, argument: A, within: Duration) -> u64 {
        let argument = fit(&argument, "argument").and_then(|()| encode(&argument));
        self.raw.call(to, argument, within)
    }

    /// Returns whether the spec connects this call, in any connection set. If the call is not connected, or its set is
    /// not open, the answer is [`ObjectError::NotConnected`].
    pub const fn is_connected(&self) -> bool {
        self.raw.is_connected()
    }

    /// Returns the next answer, with the number of its call.
    pub fn answer(&mut self) -> Option<Answered<R>> {
        let (number, result) = self.raw.answer()?;
        let decode = |bytes: Vec<u8>| {
            let read = postcard::from_bytes(&bytes);
            let read =
                read.map_err(|cause| refused(format!("the answer is not a value of type `{}`: {cause}", R::TYPE)))?;
            fit(&read, "answer").map(|()| read)
        };
        Some((number, result.and_then(decode)))
    }

    /// Stops waiting for a call; its answer is dropped. If the call has not begun at the other end, it never begins.
    pub fn cancel(&mut self, number: u64) {
        self.raw.cancel(number);
    }

    /// Returns how many calls have no answer yet.
    pub fn pending(&self) -> usize {
        self.raw.pending()
    }
}

/// Calls with any types. Implemented by [`Calls`]; used by [`super::Module`].
pub trait AnyCalls {
    /// Records that the spec connects this call.
    fn connect(&mut self);
    /// Takes the waiting orders, in order.
    fn take(&mut self) -> Vec<CallOrder>;
    /// Takes the answer to a call; an answer that is no longer expected is dropped.
    fn deliver(&mut self, number: u64, result: Result<Vec<u8>, ObjectError>);
}

impl<A: Message, R: Message> AnyCalls for Calls<A, R> {
    fn connect(&mut self) {
        self.raw.connect();
    }

    fn take(&mut self) -> Vec<CallOrder> {
        self.raw.take()
    }

    fn deliver(&mut self, number: u64, result: Result<Vec<u8>, ObjectError>) {
        self.raw.deliver(number, result);
    }
}

/// A field with `#[calls("Grip")]`. Only [`Calls`] implements this trait.
#[diagnostic::on_unimplemented(
    message = "`{Self}` makes no calls",
    label = "expected `Calls<A, R>`, where `A` and `R` are messages",
    note = "a field with `#[calls(\"Name\")]` is a `Calls<Argument, Result>`"
)]
pub trait CallPort: AnyCalls + Default {
    /// The argument.
    type Argument: Message;
    /// The result.
    type Result: Message;
}

impl<A: Message, R: Message> CallPort for Calls<A, R> {
    type Argument = A;
    type Result = R;
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[derive(Debug, serde::Serialize, serde::Deserialize)]
    struct Pair(f64, f64);
    impl Message for Pair {
        const TYPE: &'static str = "Pair";
    }

    fn made(calls: &mut Calls<(), ()>) -> Vec<u64> {
        let number = |order| if let CallOrder::Make { number, .. } = order { Some(number) } else { None };
        calls.take().into_iter().filter_map(number).collect()
    }

    proptest! {
        /// The answers arrive in any order and repeatedly: each call that was not cancelled gets one answer.
        #[test]
        fn each_call_has_one_answer_or_is_cancelled(steps in prop::collection::vec((0_u8..4, 1_u64..80), 0..400)) {
            let (mut calls, mut open, mut told) = (Calls::<(), ()>::default(), BTreeSet::new(), 0_u64);
            let (mut all, mut cancelled) = (0, 0);
            for (step, number) in steps {
                match step {
                    0 | 1 => {
                        let waiting = open.len();
                        let made_now = calls.call((), Duration::from_secs(1));
                        all += 1;
                        prop_assert_eq!(made_now, all);
                        let sent = made(&mut calls);
                        prop_assert_eq!(sent.is_empty(), waiting >= PENDING_MAX);
                        open.extend(sent);
                    }
                    2 => {
                        calls.deliver(number, Ok(Vec::new()));
                        open.remove(&number);
                    }
                    _ => {
                        let was_open = open.remove(&number);
                        calls.cancel(number);
                        cancelled += u64::from(was_open);
                        let expected = if was_open { vec![CallOrder::Cancel { number }] } else { Vec::new() };
                        prop_assert_eq!(calls.take(), expected);
                    }
                }
                while let Some((number, _)) = calls.answer() {
                    prop_assert!(!open.contains(&number));
                    told += 1;
                }
                prop_assert_eq!(calls.pending(), open.len());
            }
            prop_assert_eq!(told + cancelled + open.len() as u64, all);
        }
    }

    #[test]
    fn what_is_no_answer_is_told() {
        let mut calls = Calls::<(), Pair>::default();
        let number = calls.call((), Duration::from_secs(1));
        calls.deliver(number, Ok(vec![1]));
        let (_, result) = calls.answer().unwrap();
        assert!(matches!(result, Err(ObjectError::Refused { .. })), "{result:?}");
    }
}
