//! The messages of an action: the id of the goal is in front of each goal and its feedback. Source: `rosidl_parser`, `Action`.
//!
//! An id has sixteen bytes, so the message after it has the same padding as alone.

use super::goal::CancelAnswer;
use super::value;
use ros::logic::cdr::{self, CdrError, Value};
use ros::logic::schema::Schema;

/// The header of CDR.
const HEADER: [u8; 4] = [0, 1, 0, 0];
/// The bytes of a time of zero.
const TIME: [u8; 8] = [0; 8];

/// Returns the request to accept a goal, made of the message of the goal.
pub(crate) fn with_id(id: [u8; 16], goal: &[u8]) -> Vec<u8> {
    [&HEADER, &id[..], goal.get(HEADER.len()..).unwrap_or_default()].concat()
}

/// Returns the message of feedback; none if it belongs to another goal.
pub(crate) fn without_id(id: [u8; 16], message: &[u8]) -> Option<Vec<u8>> {
    let feedback = message.strip_prefix(&HEADER)?.strip_prefix(&id)?;
    Some([&HEADER, feedback].concat())
}

/// Returns the request for the result of a goal.
pub(crate) fn result_request(id: [u8; 16]) -> Vec<u8> {
    [&HEADER, &id[..]].concat()
}

/// Returns the request to cancel a goal.
pub(crate) fn cancel_request(id: [u8; 16]) -> Vec<u8> {
    [&HEADER, &id[..], &TIME].concat()
}

/// Returns whether the value of an answer says that a goal is accepted.
pub(crate) fn is_accepted(answer: &[u8]) -> bool {
    first(answer) == Some(1)
}

/// Returns the answer to a request to cancel a goal, from its value.
pub(crate) fn cancel_answer(answer: &[u8]) -> CancelAnswer {
    match first(answer) {
        Some(0) => CancelAnswer::Accepted,
        Some(1) => CancelAnswer::Refused,
        Some(2) => CancelAnswer::Unknown,
        Some(3) => CancelAnswer::Ended,
        _ => CancelAnswer::Missing,
    }
}

/// Returns whether a server does not know the goal to cancel. Another server of the action may know it.
pub(crate) fn cancels_unknown(answer: &[u8]) -> bool {
    cancel_answer(answer) == CancelAnswer::Unknown
}

/// Returns whether a server does not know the goal whose result was requested. Another server of the action may know it.
pub(crate) fn is_unknown(answer: &[u8]) -> bool {
    first(answer) == Some(0)
}

/// Returns the first byte of the first field.
fn first(answer: &[u8]) -> Option<u8> {
    value::message_in(answer)?.get(HEADER.len()).copied()
}

/// Returns the status and the message of the result in the value of an answer.
///
/// # Errors
/// If the value is not such an answer.
pub(crate) fn result(answer: &Schema, result: &Schema, bytes: &[u8]) -> Result<(i64, Vec<u8>), CdrError> {
    let message = value::message_in(bytes).ok_or(CdrError::End)?;
    let Value::Record(fields) = cdr::read(answer, message)? else { return Err(CdrError::Type) };
    let [Value::Signed(status), found] = fields.as_slice() else { return Err(CdrError::Type) };
    Ok((*status, cdr::write(result, found)?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use controllers::ros::example_interfaces::{FibonacciFeedback, FibonacciGoal, FibonacciResult};
    use controllers::ros::nav2_msgs::{NavigateToPoseGoal, NavigateToPoseResult};
    use ros::logic::library;
    use ros::logic::name::TypeName;
    use ros::typed::Message;

    const ID: [u8; 16] = [7; 16];

    fn schema(name: &str) -> Schema {
        library::schema(&TypeName::parse(name).unwrap()).unwrap()
    }

    /// Wraps a message, and checks that the wrapped message has the expected type.
    fn check_goal<M: Message>(goal: &M, whole: &str) {
        let wrapped = with_id(ID, &goal.to_cdr().unwrap());
        let Value::Record(fields) = cdr::read(&schema(whole), &wrapped).unwrap() else { panic!("{whole}") };
        assert_eq!(fields[0], Value::Record(vec![Value::Bytes(ID.to_vec())]));
        assert_eq!(cdr::write(&schema(M::NAME), &fields[1]), Ok(goal.to_cdr().unwrap()));
        assert_eq!(without_id(ID, &wrapped), Some(goal.to_cdr().unwrap()));
        assert_eq!((without_id([8; 16], &wrapped), without_id(ID, &wrapped[..10])), (None, None));
    }

    #[test]
    fn a_goal_and_feedback_are_behind_an_id() {
        check_goal(&FibonacciGoal { order: 5 }, "example_interfaces/action/Fibonacci_SendGoal_Request");
        let feedback = FibonacciFeedback { sequence: vec![1, 2] };
        check_goal(&feedback, "example_interfaces/action/Fibonacci_FeedbackMessage");
        let mut goal = NavigateToPoseGoal::default();
        goal.pose.header.frame_id = "map".to_owned();
        goal.pose.pose.position.x = 1.5;
        check_goal(&goal, "nav2_msgs/action/NavigateToPose_SendGoal_Request");
    }

    #[test]
    fn a_result_is_behind_its_status() {
        let result_of = NavigateToPoseResult { error_code: 9003, error_msg: "late".to_owned() };
        let of = "nav2_msgs/action/NavigateToPose";
        let (answer, inner) = (schema(&format!("{of}_GetResult_Response")), schema(&format!("{of}_Result")));
        let value = cdr::read(&inner, &result_of.to_cdr().unwrap()).unwrap();
        let bytes = cdr::write(&answer, &Value::Record(vec![Value::Signed(6), value])).unwrap();
        let wire = value::of_message(&bytes);
        assert_eq!(result(&answer, &inner, &wire), Ok((6, result_of.to_cdr().unwrap())));
        for nonsense in [&wire[..wire.len() - 1], &[], &[5, 0, 1, 0, 0, 4]] {
            assert!(result(&answer, &inner, nonsense).is_err(), "{nonsense:?}");
        }
        let empty = FibonacciResult::default();
        assert_eq!(FibonacciResult::from_cdr(&empty.to_cdr().unwrap()), Ok(empty));
    }

    #[test]
    fn questions_have_their_types() {
        cdr::check(&schema("example_interfaces/action/Fibonacci_GetResult_Request"), &result_request(ID)).unwrap();
        cdr::check(&schema("action_msgs/srv/CancelGoal_Request"), &cancel_request(ID)).unwrap();
        let answer = |first: u8| value::of_message(&[0, 1, 0, 0, first, 0, 0, 0]);
        assert!(is_accepted(&answer(1)) && !is_accepted(&answer(0)) && !is_accepted(&[]));
        let answers =
            [answer(0), answer(1), answer(2), answer(3), answer(4), Vec::new()].map(|one| cancel_answer(&one));
        use CancelAnswer::{Accepted, Ended, Missing, Refused, Unknown};
        assert_eq!(answers, [Accepted, Refused, Unknown, Ended, Missing, Missing]);
        assert!(cancels_unknown(&answer(2)) && !cancels_unknown(&answer(0)));
        assert!(is_unknown(&answer(0)) && !is_unknown(&answer(4)) && !is_unknown(&[]));
    }
}
