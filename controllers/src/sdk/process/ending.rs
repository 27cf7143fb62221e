//! The end of an activation, and the notice of it.

use comms::logic::control::{self, Notice};

/// The largest size of a reason to abort, in bytes. A longer reason is cut.
const REASON_MAX: usize = 4096;

/// How the present activation ends once `stop` has finished.
#[derive(Debug)]
pub(super) enum Ending {
    Done(Vec<u8>),
    Aborted(String),
    Stopped,
}

impl Ending {
    /// Makes this end an abort, because the stop has gone wrong: `why`. An abort keeps its first reason.
    pub(super) fn fail(&mut self, why: String) {
        *self = Self::Aborted(match std::mem::replace(self, Self::Stopped) {
            Self::Aborted(first) => format!("{first}; {why}"),
            Self::Done(_) | Self::Stopped => why,
        });
    }

    /// Returns the notice of this end. A notice above the limit of a frame would be lost, and the activation would
    /// never end. So a value that is too large becomes an abort, and a reason that is too long is cut. `unconfirmed`
    /// names the work outside of the program that may continue.
    pub(super) fn notice(self, activation: u32, unconfirmed: Option<String>) -> Notice {
        match (self, unconfirmed) {
            (Self::Stopped, Some(reason)) => Notice::StopUnconfirmed { activation, reason: cut(reason) },
            (Self::Aborted(reason), Some(why)) => {
                Notice::Aborted { activation, reason: cut(format!("{reason}; {why}")) }
            }
            (Self::Done(_), Some(why)) => Notice::Aborted { activation, reason: cut(why) },
            (ending, None) => ending.plain(activation),
        }
    }

    fn plain(self, activation: u32) -> Notice {
        match self {
            Self::Done(value) => match control::too_large(value.len()) {
                None => Notice::Done { activation, value },
                Some(reason) => Notice::Aborted { activation, reason },
            },
            Self::Aborted(reason) => Notice::Aborted { activation, reason: cut(reason) },
            Self::Stopped => Notice::Stopped { activation },
        }
    }
}

fn cut(mut reason: String) -> String {
    if reason.len() > REASON_MAX {
        reason.truncate(reason.floor_char_boundary(REASON_MAX));
        reason.push('…');
    }
    reason
}

#[cfg(test)]
mod tests {
    use super::*;
    use comms::io::control::notice_frame;
    use comms::logic::control::VALUE_MAX;

    fn check(ending: Ending, expected: &str) {
        let notice = ending.notice(1, None);
        notice_frame(&notice).unwrap();
        let Notice::Aborted { reason, .. } = notice else { panic!("{notice:?}") };
        assert_eq!(reason, expected);
    }

    #[test]
    fn an_end_of_any_size_reaches_the_node() {
        check(Ending::Done(vec![0; 17 << 20]), "it leaves a value of 17825792 bytes; 1048576 are allowed");
        check(Ending::Aborted("ä".repeat(9 << 20)), &format!("{}…", "ä".repeat(REASON_MAX / 2)));
        check(Ending::Aborted("no door".to_owned()), "no door");
        assert_eq!(
            Ending::Done(vec![0; VALUE_MAX]).notice(1, None),
            Notice::Done { activation: 1, value: vec![0; VALUE_MAX] }
        );
    }
    #[test]
    fn what_may_go_on_is_a_part_of_the_end() {
        let goes_on = || Some("the goal may go on".to_owned());
        let activation = 1;
        let reason = "the goal may go on".to_owned();
        assert_eq!(Ending::Stopped.notice(1, goes_on()), Notice::StopUnconfirmed { activation, reason });
        let reason = "no door; the goal may go on".to_owned();
        assert_eq!(Ending::Aborted("no door".to_owned()).notice(1, goes_on()), Notice::Aborted { activation, reason });
        assert_eq!(Ending::Stopped.notice(1, None), Notice::Stopped { activation });
        let reason = "the goal may go on".to_owned();
        assert_eq!(Ending::Done(vec![1]).notice(1, goes_on()), Notice::Aborted { activation, reason });
    }

    #[test]
    fn a_stop_that_goes_wrong_is_an_abort() {
        for (mut ending, expected) in [
            (Ending::Done(vec![1]), "it presses"),
            (Ending::Stopped, "it presses"),
            (Ending::Aborted("no door".to_owned()), "no door; it presses"),
        ] {
            ending.fail("it presses".to_owned());
            let reason = expected.to_owned();
            assert_eq!(ending.notice(1, None), Notice::Aborted { activation: 1, reason });
        }
    }
}
