//! Parses the commands of a person or a script to a simulation, one line each.

use super::{Ending, Simulation};
use std::time::Duration;

/// The reason why a line could not be carried out.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SimulationError {
    /// No running leaf has this name.
    #[error("no running process is called `{name}`")]
    Unknown {
        /// The name in the line.
        name: String,
    },
    /// More than one running leaf has this name.
    #[error("`{name}` could be {}", .candidates.join(" or "))]
    Ambiguous {
        /// The name in the line.
        name: String,
        /// The paths of the leaves.
        candidates: Vec<String>,
    },
    /// No running activity has such a port.
    #[error("no running activity has an input port `{name}`")]
    Port {
        /// The name in the line.
        name: String,
    },
    /// No running activity waits for this event.
    #[error("no running activity waits for `{what}`")]
    Notice {
        /// The event that no activity waits for.
        what: String,
    },
    /// The line is not understood.
    #[error(
        "expected `process`, `process done outcome`, `process abort why`, `process crash`, `message port text`, `5 s` or `stop`, found `{line}`"
    )]
    Unreadable {
        /// The line.
        line: String,
    },
}

impl Simulation<'_> {
    /// Carries out one line:
    /// - `arm` or `arm done` ends a process, and `arm done found` ends it with an outcome;
    /// - `arm abort no grip` makes it fail, and `arm crash` or `arm host_lost` makes it fail for these reasons;
    /// - `message speech stop` sends a message to activities, and `message speech 5 stop` sends one with priority 5;
    /// - `suspend`, `resume`, `answer yes`, `host c1 lost`, `link c1 lost` and `parameter arm.speed changed` are events for activities;
    /// - `5 s` lets time pass, and `stop` asks `main` to stop.
    ///
    /// Empty lines, and comments after `//`, are ignored.
    ///
    /// # Errors
    /// If the line is not a command, or names no running process.
    pub fn obey(&mut self, line: &str) -> Result<(), SimulationError> {
        let text = line.split("//").next().unwrap_or("").trim();
        let (first, rest) = text.split_once(char::is_whitespace).unwrap_or((text, ""));
        let (second, why) = rest.trim().split_once(char::is_whitespace).unwrap_or((rest.trim(), ""));
        if let Some(time) = time(text) {
            self.pass(time);
            return Ok(());
        }
        match (first, second, why.trim()) {
            ("", _, _) => Ok(()),
            ("stop", "", "") => {
                self.stop();
                Ok(())
            }
            ("suspend" | "resume", "", "") if self.notify(text) => Ok(()),
            ("host" | "link", host, "lost") => self.told_of(&format!("{first} {host} lost")),
            ("answer", option, "") if !option.is_empty() => self.told_of(&format!("answer {option}")),
            ("parameter", parameter, "changed") => self.told_of(&format!("parameter {parameter} changed")),
            ("message", port, text) if !port.is_empty() => self.send(port, text),
            (name, "" | "done", "") => self.end(name, Ending::Done),
            (name, "done", tag) if !tag.contains(char::is_whitespace) => {
                self.end(name, Ending::Outcome(tag.to_owned()))
            }
            (name, "crash", "") => self.end(name, Ending::Crashed),
            (name, "host_lost", "") => self.end(name, Ending::HostLost),
            (name, "abort", "") => self.end(name, Ending::Aborted("it failed".to_owned())),
            (name, "abort", why) => self.end(name, Ending::Aborted(why.to_owned())),
            (_, _, _) => Err(SimulationError::Unreadable { line: text.to_owned() }),
        }
    }

    fn told_of(&mut self, what: &str) -> Result<(), SimulationError> {
        if self.notify(what) { Ok(()) } else { Err(SimulationError::Notice { what: what.to_owned() }) }
    }

    pub(super) fn find(&self, name: &str) -> Result<u32, SimulationError> {
        let path = |leaf: u32| self.plan.leaves[leaf as usize].path.as_str();
        let is_called = |leaf: &u32| path(*leaf) == name || path(*leaf).ends_with(&format!("/{name}"));
        let found: Vec<u32> = self.leaves.keys().copied().filter(is_called).collect();
        match found.as_slice() {
            [] => Err(SimulationError::Unknown { name: name.to_owned() }),
            [leaf] => Ok(*leaf),
            [..] => {
                let candidates = found.iter().map(|&leaf| format!("`{}`", path(leaf))).collect();
                Err(SimulationError::Ambiguous { name: name.to_owned(), candidates })
            }
        }
    }
}

/// Reads `5 s`, `20 ms` or `1.5 min`.
fn time(text: &str) -> Option<Duration> {
    let end = text.find(|c: char| !c.is_ascii_digit() && c != '.')?;
    let number: f64 = text[..end].parse().ok()?;
    let factor = match text[end..].trim() {
        "ms" => 1e-3,
        "s" => 1.0,
        "min" => 60.0,
        "h" => 3600.0,
        _ => return None,
    };
    Duration::try_from_secs_f64(number * factor).ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::Plan;
    use crate::{Options, Source, Transition, compile};
    use expect_test::{Expect, expect};

    const SPEC: &str = "
        module Sensor(host) { service; }
        process Detector(h) {
            host{h}
            instantiated_processes { sensor instof Sensor(h); threshold instof Threshold(h); }
            internal_event_actions { sensor, threshold }
        }
        process main() {
            host{c1}
            instantiated_processes { hit instof Detector(c1); arm instof Arm(c1); home instof Home(c1); log instof Sensor(c1); other instof Detector(c1); }
            internal_event_actions { log, (((hit # (arm within 10 s)) else skip) ; wait(2 s) ; home ; other) }
        }";

    fn plan() -> Plan {
        compile(&Source::new("a.dca", SPEC), &[], &Options::named("a")).plan.unwrap()
    }

    fn check(lines: &[&str], expect: &Expect) {
        let plan = plan();
        let mut simulation = Simulation::start(&plan);
        let mut text = String::new();
        for line in std::iter::once(&"").chain(lines) {
            if let Err(error) = simulation.obey(line) {
                text += &format!("{error}\n");
            }
            for found in simulation.take_happenings() {
                text += &format!("{:?} {} {:?}\n", found.at, found.path, found.transition);
            }
            text += &format!("    runs: {}\n", simulation.running().join(" "));
        }
        expect.assert_eq(&text);
    }

    #[test]
    fn the_expression_runs_as_it_would() {
        check(
            &["hit/threshold // the hand touches", "1 s", "5 s", "home done", "threshold"],
            &expect![[r#"
                0ns main Started
                0ns main/log Started
                0ns main/hit Started
                0ns main/arm Started
                0ns main Limited(10s)
                0ns main/hit/sensor Started
                0ns main/hit/threshold Started
                    runs: main/hit/sensor main/hit/threshold main/arm main/log
                0ns main/hit/threshold Done
                0ns main/hit/sensor Stopped
                0ns main/hit Done
                0ns main/arm Stopped
                0ns main Waits(2s)
                    runs: main/log
                    runs: main/log
                2s main/home Started
                    runs: main/home main/log
                6s main/home Done
                6s main/other Started
                6s main/other/sensor Started
                6s main/other/threshold Started
                    runs: main/log main/other/sensor main/other/threshold
                6s main/other/threshold Done
                6s main/other/sensor Stopped
                6s main/other Done
                6s main/log Stopped
                6s main Done
                    runs: 
            "#]],
        );
    }

    #[test]
    #[expect(clippy::too_many_lines, reason = "most of it is the text that is expected")]
    fn failures_are_explained_and_mistakes_are_said() {
        check(
            &["", "20 s", "arm", "threshold", "what is this", "home abort no way"],
            &expect![[r#"
                0ns main Started
                0ns main/log Started
                0ns main/hit Started
                0ns main/arm Started
                0ns main Limited(10s)
                0ns main/hit/sensor Started
                0ns main/hit/threshold Started
                    runs: main/hit/sensor main/hit/threshold main/arm main/log
                    runs: main/hit/sensor main/hit/threshold main/arm main/log
                10s main/arm Stopped
                10s main/hit/sensor Stopped
                10s main/hit/threshold Stopped
                10s main/hit Stopped
                10s main Waits(2s)
                12s main/home Started
                    runs: main/home main/log
                no running process is called `arm`
                    runs: main/home main/log
                no running process is called `threshold`
                    runs: main/home main/log
                expected `process`, `process done outcome`, `process abort why`, `process crash`, `message port text`, `5 s` or `stop`, found `what is this`
                    runs: main/home main/log
                20s main/home Aborted("no way")
                20s main/log Stopped
                20s main Aborted("`home`: no way")
                    runs: 
            "#]],
        );
        check(
            &["sensor abort broken cable", "log abort disk full"],
            &expect![[r#"
                0ns main Started
                0ns main/log Started
                0ns main/hit Started
                0ns main/arm Started
                0ns main Limited(10s)
                0ns main/hit/sensor Started
                0ns main/hit/threshold Started
                    runs: main/hit/sensor main/hit/threshold main/arm main/log
                0ns main/hit/sensor Aborted("broken cable")
                0ns main/hit/threshold Stopped
                0ns main/hit Aborted("`sensor`: broken cable")
                0ns main/arm Stopped
                0ns main Waits(2s)
                    runs: main/log
                0ns main/log Aborted("disk full")
                0ns main Aborted("`log`: disk full")
                    runs: 
            "#]],
        );
        check(
            &["stop"],
            &expect![[r#"
                0ns main Started
                0ns main/log Started
                0ns main/hit Started
                0ns main/arm Started
                0ns main Limited(10s)
                0ns main/hit/sensor Started
                0ns main/hit/threshold Started
                    runs: main/hit/sensor main/hit/threshold main/arm main/log
                0ns main/log Stopped
                0ns main/arm Stopped
                0ns main/hit/sensor Stopped
                0ns main/hit/threshold Stopped
                0ns main/hit Stopped
                0ns main Stopped
                    runs: 
            "#]],
        );
    }

    #[test]
    fn a_name_has_to_mean_one_process() {
        let plan = plan();
        let mut simulation = Simulation::start(&plan);
        assert!(matches!(simulation.obey("main"), Err(SimulationError::Unknown { .. })));
        simulation.obey("main/hit/threshold").unwrap();
        simulation.obey("2 s").unwrap();
        simulation.obey("home").unwrap();
        assert_eq!(simulation.outcome(), None);
        simulation.obey("threshold").unwrap();
        assert_eq!(simulation.outcome(), Some(&Transition::Done));
    }
}
