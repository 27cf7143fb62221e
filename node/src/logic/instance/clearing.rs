//! What a program has left that has ended by itself: its shim ends it, and some of it may be such that nobody can.

use super::{Instance, InstanceContext, KILL_WITHIN, SHIM_KILL_WITHIN, Stage};
use crate::logic::effect::Effect;

impl Instance {
    /// The program has ended by itself, and its shim ends what it has left. That has the time that a stop has.
    pub(super) fn clear(&mut self, context: &InstanceContext<'_>) {
        if matches!(self.stage, Stage::Prepared | Stage::Idle | Stage::Running) {
            self.clearing = Some(context.now + KILL_WITHIN);
        }
    }

    /// Gives up what a program that has ended by itself has left.
    pub(super) fn tick_clearing(&mut self, context: &mut InstanceContext<'_>) {
        if self.clearing.is_none_or(|at| at > context.now) {
            return;
        }
        self.clearing = None;
        // What is being stopped or ended since then has a limit of its own.
        if !matches!(self.stage, Stage::Prepared | Stage::Idle | Stage::Running) {
            return;
        }
        if !self.shim_was_killed {
            (self.clearing, self.shim_was_killed) = (Some(context.now + SHIM_KILL_WITHIN), true);
            return context.effects.push(Effect::KillShim { process: self.order.process.clone() });
        }
        // The program itself is gone.
        self.pid = None;
        self.give_up_end(context);
    }
}
