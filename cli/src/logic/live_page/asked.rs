//! A request of the page for a part of a mission.

use language::plan::Plan;
use std::str::FromStr;
use std::sync::Arc;
use view::{LiveDeployment, Model};

/// A picture or a timeline that a page asks for. `17` is the graph or the whole timeline of the mission with plan 17. `17-60` is the
/// picture of its activity of group 60, or the last 60 s of its timeline.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Asked {
    plan: u64,
    pub(super) more: Option<u32>,
}

impl FromStr for Asked {
    type Err = ();

    fn from_str(text: &str) -> Result<Self, ()> {
        let (plan, more) = text.split_once('-').map_or((text, None), |(plan, more)| (plan, Some(more)));
        let more = more.map(|text| text.parse().map_err(|_not_a_number| ())).transpose()?;
        Ok(Self { plan: plan.parse().map_err(|_not_a_number| ())?, more })
    }
}

impl Asked {
    /// Returns the mission and its plan. None if the model has no such plan any more, or if the plan was too large to be kept.
    pub(crate) fn find(self, model: &Model) -> Option<(&LiveDeployment, Arc<Plan>)> {
        let live = model.planned(self.plan)?;
        Some((live, live.plan.as_ref()?.plan.clone()?))
    }
}
