//! A bounded queue between a callback, which must not wait, and a task, which may wait.

use crate::logic::port::{Policy, Pushed, Queue};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::Notify;

/// Returns the two ends of a queue.
pub fn channel<T>(policy: Policy) -> (Sender<T>, Receiver<T>) {
    let state = State { queue: Queue::new(policy), sender_gone: false, receiver_gone: false };
    let shared = Arc::new(Shared { state: Mutex::new(state), filled: Notify::new() });
    (Sender(Arc::clone(&shared)), Receiver(shared))
}

/// The end that a callback owns. Dropping it ends the queue.
#[derive(Debug)]
pub struct Sender<T>(Arc<Shared<T>>);

/// The end that a task owns.
#[derive(Debug)]
pub struct Receiver<T>(Arc<Shared<T>>);

#[derive(Debug)]
struct Shared<T> {
    state: Mutex<State<T>>,
    filled: Notify,
}

#[derive(Debug)]
struct State<T> {
    queue: Queue<T>,
    sender_gone: bool,
    receiver_gone: bool,
}

impl<T> Shared<T> {
    fn lock(&self) -> MutexGuard<'_, State<T>> {
        // Nothing in a critical section of this file can panic.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<T> Sender<T> {
    /// Adds a value under the policy. The value is rejected if the receiver was dropped.
    pub fn push(&self, value: T) -> Pushed<T> {
        let mut state = self.0.lock();
        if state.receiver_gone {
            return Pushed::Rejected(value);
        }
        let pushed = state.queue.push(value);
        drop(state);
        self.0.filled.notify_one();
        pushed
    }
}

impl<T> Drop for Sender<T> {
    fn drop(&mut self) {
        self.0.lock().sender_gone = true;
        self.0.filled.notify_one();
    }
}

impl<T> Receiver<T> {
    /// Returns the next value; none once the sender is gone and everything has been received.
    ///
    /// # Cancellation
    /// Safe: no value is lost.
    pub async fn recv(&mut self) -> Option<T> {
        loop {
            // A value that comes between the check and the wait leaves a permit, so it is not missed.
            {
                let mut state = self.0.lock();
                if let Some(value) = state.queue.pop() {
                    return Some(value);
                }
                if state.sender_gone {
                    return None;
                }
            }
            self.0.filled.notified().await;
        }
    }

    /// Returns the next value if there is one.
    pub fn try_recv(&mut self) -> Option<T> {
        self.0.lock().queue.pop()
    }

    /// Returns how many values were replaced or rejected because the queue was full.
    pub fn lost(&self) -> u64 {
        self.0.lock().queue.lost()
    }
}

impl<T> Drop for Receiver<T> {
    fn drop(&mut self) {
        self.0.lock().receiver_gone = true;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn ends_after_the_last_value() {
        let (tx, mut rx) = channel(Policy::reject(2));
        assert_eq!((tx.push(1), tx.push(2), tx.push(3)), (Pushed::Stored, Pushed::Stored, Pushed::Rejected(3)));
        drop(tx);
        assert_eq!((rx.recv().await, rx.recv().await, rx.recv().await), (Some(1), Some(2), None));
        assert_eq!(rx.lost(), 1);
    }

    #[tokio::test]
    async fn wakes_a_waiting_receiver() {
        let (tx, mut rx) = channel(Policy::Latest);
        let sender = std::thread::spawn(move || {
            for value in 0..1000 {
                tx.push(value);
            }
        });
        let mut last = None;
        while let Some(value) = rx.recv().await {
            last = Some(value);
        }
        sender.join().unwrap();
        assert_eq!(last, Some(999));
    }

    #[test]
    fn turns_values_away_when_nobody_listens() {
        let (tx, rx) = channel(Policy::Latest);
        drop(rx);
        assert_eq!(tx.push(1), Pushed::Rejected(1));
    }
}
