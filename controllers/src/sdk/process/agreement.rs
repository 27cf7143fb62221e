//! Both ends of a wire compare the type of its values before the first value. Two programs that were built from
//! different definitions are refused and cannot misread each other.
//!
//! The consumer first answers queries for its type, and then subscribes. So once its producer sees a subscriber, the
//! producer can ask. If a consumer does not answer, such as a program of an older DCA, its type is assumed to fit.

use super::keyring::{Keyring, Use};
use super::wire::answer_with;
use crate::sdk::interface::PortInterface;
use comms::io::clock::now;
use comms::io::data::{DataError, DataSession, Responder};
use comms::logic::object::TypeForm;
use comms::logic::{codec, key};
use std::time::Duration;

/// How long a consumer has to name its type: at this time it has just reported that it listens.
const ANSWER_WITHIN: Duration = Duration::from_secs(4);

/// Answers on a wire's key with the type of an input.
pub(super) fn declare(
    session: &DataSession,
    keyring: Option<&Keyring>,
    number: u32,
    wire: &str,
    input: &PortInterface,
) -> Result<Responder, DataError> {
    let form = codec::encode(&form(input)).ok();
    let sealer = keyring.map(|keyring| keyring.sealer(number, Use::Type, wire));
    answer_with(session, &key::wire_type(wire), sealer, move || form.clone())
}

/// Asks the consumer of a wire for its type.
///
/// # Errors
/// If this type differs from the output's type; both definitions are shown.
pub(super) fn check(
    session: &DataSession,
    keyring: Option<&Keyring>,
    number: u32,
    wire: &str,
    output: &PortInterface,
) -> Result<(), String> {
    let (key, until) = (key::wire_type(wire), now() + ANSWER_WITHIN);
    let asked = match keyring {
        None => session.ask(&key, ANSWER_WITHIN),
        Some(keyring) => session.ask_sealed(&key, keyring.opener(number, Use::Type, wire), ANSWER_WITHIN),
    };
    let theirs = asked
        .and_then(|asked| asked.answer(until))
        .ok()
        .flatten()
        .and_then(|bytes| codec::decode::<TypeForm>(&bytes).ok());
    theirs.map_or(Ok(()), |theirs| compare(&theirs, output))
}

/// Compares the type that the consumer of a wire takes with the type of the output. A port without a type, such as a
/// port of a replayed process, takes and sends any value.
///
/// # Errors
/// If the types differ; both definitions are shown.
pub(super) fn compare(theirs: &TypeForm, output: &PortInterface) -> Result<(), String> {
    let ours = form(output);
    if theirs.name.is_empty() || ours.name.is_empty() || theirs.fits(&ours) {
        return Ok(());
    }
    Err(format!(
        "output `{}` sends `{ours}`, but its consumer takes `{theirs}`: one of the two programs was built with another definition",
        output.name
    ))
}

/// Returns the type of a port, if it is declared.
pub(super) fn form(port: &PortInterface) -> TypeForm {
    TypeForm::new(port.type_name, port.fields)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sdk::Direction;

    #[test]
    fn other_types_are_refused_and_a_port_without_a_type_is_believed() {
        let check = |theirs: &str, ours: &'static str| {
            compare(&TypeForm::new(theirs, ""), &PortInterface::wire("Out", Direction::Out, ours))
        };
        assert_eq!(check("Range", "Range"), Ok(()));
        assert!(
            check("Range", "Force")
                .unwrap_err()
                .starts_with("output `Out` sends `Force`, but its consumer takes `Range`")
        );
        assert_eq!((check("", "Force"), check("Range", "")), (Ok(()), Ok(())));
    }
}
