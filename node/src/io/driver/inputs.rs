//! Gives the agent its inputs.

use super::Driver;
use crate::io::calendar;
use crate::io::event::Event;
use crate::logic::agent::Input;
use crate::logic::effect::{Effect, ProcessId};
use comms::io::clock::{self, Wakeup};

impl Driver {
    /// Gives the waiting inputs to the agent and carries out its effects, which may bring more inputs. Returns whether the node is
    /// to leave.
    pub(super) fn drain(&mut self) -> bool {
        let mut over = false;
        while let Some(input) = self.queues.pending.pop_front() {
            // Events have the calendar time of the clock, even right after the clock has been set.
            if let Some(origin) = calendar::set(self.state.agent.calendar()) {
                over |= self.give(Input::Calendar { origin });
            }
            over |= self.give(input);
            let programs = &self.state.attachments;
            let taken = |process: &ProcessId| programs.program(process).map_or(u64::MAX, |program| program.notices);
            let told = self.running.returning.complete(taken).into_iter();
            self.queues.pending.extend(told.map(|process| Input::Reached { process }));
        }
        self.files.inputs.keep_up(&self.state);
        self.set_alarm();
        over
    }

    /// Starts a thread that waits for the moment at which programs begin: the timers of the loop are late by a
    /// millisecond or two.
    fn set_alarm(&mut self) {
        let Some(at) = self.state.agent.starts_at().filter(|at| self.alarm != Some(*at)) else { return };
        self.alarm = Some(at);
        let events = self.queues.events.clone();
        self.queues.tasks.spawn_blocking(move || {
            clock::make_punctual();
            Wakeup::default().wait(Some(at));
            // If the queue of the loop is full, the loop is busy and looks at its timers in any case.
            drop(events.try_send(Event::Alarm));
        });
    }

    fn give(&mut self, input: Input) -> bool {
        let (now, mut effects, mut over) = (clock::now(), Vec::new(), false);
        self.files.inputs.append(now, &input);
        self.state.take(now, input, &mut effects);
        // Answers to people do not delay orders to programs.
        let (words, deeds): (Vec<Effect>, Vec<Effect>) = effects.into_iter().partition(is_for_caller);
        for effect in deeds.into_iter().chain(words) {
            over |= matches!(effect, Effect::Leave | Effect::Yield { .. });
            self.carry_out(effect);
        }
        over
    }
}

/// Returns whether an effect is for a caller.
fn is_for_caller(effect: &Effect) -> bool {
    matches!(effect, Effect::Answer { .. } | Effect::EndAnswers { .. } | Effect::Tail { .. } | Effect::TailAll { .. })
}
