//! The end of a program of ROS 2: it gets SIGINT, then SIGTERM, and then SIGKILL.
//!
//! SIGINT comes first: `rclcpp`, `rclpy` and launch files end cleanly on it, and a launch file then ends its nodes.

use comms::logic::time::Time;
use std::time::Duration;

/// How long a program has after SIGTERM.
pub(crate) const TERMINATE_WITHIN: Duration = Duration::from_secs(1);

/// The next step to end a program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Step {
    Interrupt,
    Terminate,
    /// Kill the program and all processes that it has started.
    Kill,
}

/// The end of a program, beginning with the first signal.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ending {
    /// The next step, and the time at which it is due.
    next: Option<(Step, Time)>,
    patience: Duration,
}

impl Ending {
    /// Returns an end that begins now. The program has this time after SIGINT.
    pub(crate) fn new(now: Time, patience: Duration) -> Self {
        Self { next: Some((Step::Interrupt, now)), patience }
    }

    /// Returns the step that is due, once.
    pub(crate) fn due(&mut self, now: Time) -> Option<Step> {
        let (step, at) = self.next.filter(|(_, at)| now >= *at)?;
        self.next = match step {
            Step::Interrupt => Some((Step::Terminate, at + self.patience)),
            Step::Terminate => Some((Step::Kill, at + TERMINATE_WITHIN)),
            Step::Kill => None,
        };
        Some(step)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_program_gets_each_signal_once_and_in_time() {
        let at = |millis: u64| Time::from_nanos(millis * 1_000_000);
        let mut ending = Ending::new(at(100), Duration::from_millis(500));
        let steps: Vec<_> = (0..4000).filter_map(|millis| Some((millis, ending.due(at(millis))?))).collect();
        assert_eq!(steps, [(100, Step::Interrupt), (600, Step::Terminate), (1600, Step::Kill)]);
        let mut late = Ending::new(at(0), Duration::ZERO);
        let steps = [5000, 5000, 5000, 5000].map(|millis| late.due(at(millis)));
        assert_eq!(steps, [Some(Step::Interrupt), Some(Step::Terminate), Some(Step::Kill), None]);
    }
}
