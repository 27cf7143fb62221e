//! The whole state of a node: its agent and its attachments. The same inputs at the same times lead to the same state
//! and the same effects.

use crate::logic::agent::{Agent, Input};
use crate::logic::attachments::Attachments;
use crate::logic::effect::Effect;
use comms::logic::time::Time;
use serde::{Deserialize, Serialize};

/// An agent with its attachments.
#[derive(Debug, Serialize, Deserialize)]
pub struct NodeState {
    /// When the last input was taken.
    pub at: Time,
    /// The agent.
    pub agent: Agent,
    /// The attachments of the agent to the world.
    pub attachments: Attachments,
}

impl NodeState {
    /// Returns the state of a node whose agent has done nothing yet.
    pub fn new(agent: Agent, at: Time) -> Self {
        Self { at, agent, attachments: Attachments::default() }
    }

    /// Takes one input; appends the effects in order.
    pub fn take(&mut self, at: Time, input: Input, effects: &mut Vec<Effect>) {
        self.at = at;
        self.attachments.taken(&input);
        let first = effects.len();
        self.agent.handle(at, input, effects);
        effects.iter().skip(first).for_each(|effect| self.attachments.given(effect));
    }

    /// Returns whether anything is left that a successor would have to take over.
    pub fn is_engaged(&self) -> bool {
        let has_left = self.attachments.has_left();
        !has_left && (self.agent.is_engaged(self.at) || self.attachments.programs().next().is_some())
    }
}
