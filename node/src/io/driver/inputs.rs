//! Gives the agent its inputs.

use super::Driver;
use crate::io::calendar;
use crate::logic::agent::Input;
use crate::logic::effect::Effect;
use comms::io::clock;

impl Driver {
    /// Gives what waits to the agent and carries its effects out, which may bring more. Says whether the node is to leave.
    pub(super) fn drain(&mut self) -> bool {
        let mut over = false;
        while let Some(input) = self.pending.pop_front() {
            // Events have the time that the clock shows, also in the moment after somebody has set it.
            if let Some(origin) = calendar::set(self.state.agent.calendar()) {
                over |= self.give(Input::Calendar { origin });
            }
            over |= self.give(input);
        }
        self.inputs.keep_up(&self.state);
        over
    }

    fn give(&mut self, input: Input) -> bool {
        let (now, mut effects, mut over) = (clock::now(), Vec::new(), false);
        self.inputs.append(now, &input);
        self.state.take(now, input, &mut effects);
        for effect in effects {
            over |= matches!(effect, Effect::Leave | Effect::Yield { .. });
            self.carry_out(effect);
        }
        over
    }
}
