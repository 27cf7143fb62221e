//! The durations of a node that have to fit together. Each is defined where it is used; this file gives their order,
//! and the reasons. The compiler refuses a change that breaks the order.
//!
//! ```text
//! a node that answers no more    asked again every 1 s ─▶ silent for 2.5 s ─▶ missing, 1 s after its last answer ─▶ lost 5 s later
//! one that nothing depends on    asked again every 60 s ─▶ from then on as above
//! a stream of answers            8 s without a sign of life end it: its node was lost before
//! a program that hangs at start  ready within 15 s ─▶ killed, gone within 20 s ─▶ the home has waited for 40 s
//! a program that cannot link     its own 38 s ─▶ the home's 48 s
//! a program that does not leave  SIGTERM ─▶ 1 s ─▶ SIGKILL ─▶ 15 s ─▶ its shim is killed, too ─▶ gone within 5 s
//!                                ─▶ the home has waited for 25 s
//! ```

use super::coordinator::{self, PREPARE_WITHIN, REASONS_WITHIN, RELEASE_WITHIN};
use super::executer::{PACE, SWITCH_WITHIN};
use super::instance::watchdog::READY_WITHIN;
use super::instance::{self, GRACE, KILL_WITHIN, SHIM_KILL_WITHIN};
use super::link::{RESEND_AFTER, RESEND_AFTER_MAX};
use super::nameserver::{self, ASK_EVERY, ASK_GAP, DOUBT, LOST_AFTER, NEW_FOR, QUIET_EVERY, SILENCE_MISSING};
use super::{absence, protocol};
use std::time::Duration;

/// Returns whether each duration is shorter than the next one.
const fn rise(durations: &[Duration]) -> bool {
    let mut index = 1;
    while index < durations.len() {
        if durations[index - 1].as_nanos() >= durations[index].as_nanos() {
            return false;
        }
        index += 1;
    }
    true
}

const _: () =
    assert!(rise(&[ASK_GAP, ASK_EVERY, nameserver::SILENCE_MAX]), "a node misses two rounds before it is silent");
const _: () = assert!(rise(&[DOUBT, SILENCE_MISSING, nameserver::SILENCE_MAX]), "a silent node is missing at once");
const _: () = assert!(
    rise(&[nameserver::SILENCE_MAX, nameserver::KNOWN_WITHIN, NEW_FOR, QUIET_EVERY]),
    "a node that comes is known before it is asked seldom"
);
const _: () = assert!(
    QUIET_EVERY.as_nanos() + LOST_AFTER.as_nanos() < nameserver::REMEMBERED.as_nanos(),
    "a host that is lost is remembered until all were asked once more"
);
const _: () = assert!(
    rise(&[nameserver::SILENCE_MAX, LOST_AFTER, protocol::SILENCE_MAX]),
    "silent, then lost; a stream ends after both"
);
const _: () = assert!(rise(&[RESEND_AFTER, RESEND_AFTER_MAX]), "a message is repeated more and more rarely");
const _: () =
    assert!(RESEND_AFTER_MAX.as_nanos() <= LOST_AFTER.as_nanos(), "a message is repeated before its host is lost");
const _: () = assert!(rise(&[PACE, SWITCH_WITHIN, LOST_AFTER]), "no consumer waits for the wires of a lost host");
const _: () = assert!(
    rise(&[READY_WITHIN.saturating_add(KILL_WITHIN).saturating_add(SHIM_KILL_WITHIN), PREPARE_WITHIN]),
    "a host says which of its programs was not ready before its home gives up"
);
const _: () = assert!(rise(&[REASONS_WITHIN, PREPARE_WITHIN]), "one refusal does not wait for all hosts");
const _: () = assert!(
    rise(&[instance::CONNECT_WITHIN, coordinator::CONNECT_WITHIN]),
    "a host says which of its programs has no links before its home gives up"
);
const _: () = assert!(
    rise(&[GRACE.saturating_add(KILL_WITHIN).saturating_add(SHIM_KILL_WITHIN), RELEASE_WITHIN]),
    "a program that is killed is gone in time"
);
const _: () =
    assert!(rise(&[LOST_AFTER, absence::ASK_EVERY, absence::HOSTS_KEPT]), "a lost host is asked, then forgotten");
