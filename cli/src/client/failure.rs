//! Explains to a person why a call to a node has no answer.

use anyhow::anyhow;
use comms::io::session::CallError;
use comms::logic::human::span;
use node::console::Failure;

/// Says why a call has no answer. If the node refused, these are its own words; otherwise the key of the call is left out.
pub(super) fn call_failure(host: &str, error: CallError) -> Failure {
    match error {
        CallError::Refused { reason } => Failure::Refused(anyhow!("host `{host}`: {reason}")),
        CallError::Broken { count, why, .. } => Failure::Unreachable(anyhow!(
            "the answers of the node `{host}` broke off after {count}: {why}; the received answers are not complete"
        )),
        CallError::Unreachable { .. } => Failure::Unreachable(anyhow!("the node `{host}` cannot be reached")),
        CallError::Timeout { within, .. } => {
            Failure::Unreachable(anyhow!("the node `{host}` has not answered within {}", span(within)))
        }
        CallError::Silent { silent, .. } => {
            Failure::Unreachable(anyhow!("the node `{host}` has sent nothing for {}", span(silent)))
        }
        CallError::Forged { why, .. } => Failure::Unreachable(anyhow!(
            "the node `{host}` has not answered, but {why}: its answer is ignored, and `dca team revoke` removes a member of the team"
        )),
        CallError::Session { cause, .. } => Failure::Unreachable(anyhow!("the node `{host}` cannot be asked: {cause}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::client::words;
    use std::time::Duration;

    #[test]
    fn a_call_without_an_answer_is_told_with_the_host_and_without_the_key() {
        let (key, within) = (|| "dca/n/c1/rpc/request".to_owned(), Duration::from_secs(3));
        let check = |error, unreachable, text: &str| {
            let failure = call_failure("c1", error);
            assert_eq!((matches!(failure, Failure::Unreachable(_)), words(&failure).as_str()), (unreachable, text));
        };
        check(CallError::Refused { reason: "it is full".into() }, false, "host `c1`: it is full");
        check(CallError::Unreachable { key: key() }, true, "the node `c1` cannot be reached");
        check(CallError::Timeout { key: key(), within }, true, "the node `c1` has not answered within 3 s");
        let silent = CallError::Silent { key: key(), silent: within };
        check(silent, true, "the node `c1` has sent nothing for 3 s");
        let closed = CallError::Session { key: key(), cause: "closed".into() };
        check(closed, true, "the node `c1` cannot be asked: closed");
        let broken = CallError::Broken { key: key(), count: 3, why: "it went away".into() };
        let text =
            "the answers of the node `c1` broke off after 3: it went away; the received answers are not complete";
        check(broken, true, text);
    }
}
