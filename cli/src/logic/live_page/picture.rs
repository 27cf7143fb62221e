//! The pictures of a mission for its page: its graph, and the states of its activities. The page colours them.

use language::plan::Plan;
use language::{activities_of_plan, graph_of_activity, graph_of_plan};
use serde_json::{Value, json};
use std::str::FromStr;
use std::sync::Arc;
use view::Model;

/// A picture that a page asks for: `17` is the graph of plan 17, and `17-3` its activity of group 3.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct AskedPicture {
    plan: u64,
    activity: Option<usize>,
}

impl FromStr for AskedPicture {
    type Err = ();

    fn from_str(text: &str) -> Result<Self, ()> {
        let (plan, activity) = text.split_once('-').map_or((text, None), |(plan, activity)| (plan, Some(activity)));
        let activity = activity.map(|text| text.parse().map_err(|_not_a_number| ())).transpose()?;
        Ok(Self { plan: plan.parse().map_err(|_not_a_number| ())?, activity })
    }
}

impl AskedPicture {
    /// Returns the plan that the picture shows. None if the model has no such plan any more, or if the plan was too large to be kept.
    pub(crate) fn plan(self, model: &Model) -> Option<Arc<Plan>> {
        model.planned(self.plan)?.plan.as_ref()?.plan.clone()
    }
}

/// Returns a picture as JSON, or the reason why there is none. It may take a while: the caller holds no lock.
pub(crate) fn picture(asked: AskedPicture, plan: Option<&Plan>) -> Value {
    let Some(plan) = plan else {
        return json!({ "why": "the mission is too large for a picture, or it is no longer shown" });
    };
    if let Some(group) = asked.activity {
        return match graph_of_activity(plan, group) {
            Ok(Some(graph)) => json!({ "svg": graph.svg() }),
            Ok(None) => json!({ "why": "there is no such activity" }),
            Err(why) => json!({ "why": format!("no picture: {why}") }),
        };
    }
    let activities: Vec<Value> =
        activities_of_plan(plan).map(|(group, path)| json!({ "group": group, "path": path })).collect();
    match graph_of_plan(plan) {
        Ok(graph) => {
            let wires: Vec<String> = plan.wires.iter().map(|wire| plan.ends(wire)).collect();
            json!({ "svg": graph.svg(), "wires": wires, "activities": activities })
        }
        Err(why) => json!({ "why": format!("no picture: {why}"), "activities": activities }),
    }
}
