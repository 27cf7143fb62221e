//! The display of a mission: lines while it runs, one screen at its end.

use crate::logic::mission::{Files, Mission, Progress, summary};
use crate::output::Output;
use anyhow::Context;
use std::time::Duration;

/// How often [`Display::update`] has to be called while no report arrives.
pub const UPDATE_EVERY: Duration = Duration::from_millis(100);

/// Shows one mission.
#[derive(Debug, Default)]
pub struct Display {
    progress: Progress,
}

impl Display {
    /// Shows the changes. Has to be called after each report and every [`UPDATE_EVERY`], but not after each sample.
    pub fn update(&mut self, mission: &Mission, output: &mut Output) {
        for line in self.progress.lines(mission, output.style()) {
            output.line(&line);
        }
    }

    /// Shows the remaining changes and then the summary, which is the command's result.
    ///
    /// # Errors
    /// Standard output cannot be written.
    pub fn finish(&mut self, mission: &Mission, files: &Files, output: &mut Output) -> anyhow::Result<()> {
        self.update(mission, output);
        output.note("");
        let summary = summary(mission, files, output.columns());
        output.result(&summary).context("the summary could not be written to standard output")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::mission::tests::{OPENING, door, feed, seconds};
    use crate::output::tests::output;
    use node::logic::protocol::{Ending, Report};

    #[test]
    fn the_lines_go_to_one_stream_and_the_summary_to_the_other() {
        let (mut output, results, notes) = output(false);
        let (mut mission, mut display) = (Mission::new(&door()), Display::default());
        for line in OPENING.lines() {
            feed(&mut mission, line);
            display.update(&mission, &mut output);
        }
        mission.report(&Report::Finished { ending: Ending::Stopped, at: seconds(22.6), unconfirmed: Vec::new() });
        let files = Files::default();
        display.finish(&mission, &files, &mut output).unwrap();
        assert_eq!(results.text(), summary(&mission, &files, None));
        assert!(notes.text().ends_with("✓ pull                      9.5 s  done\n\n"), "{}", notes.text());
    }
}
