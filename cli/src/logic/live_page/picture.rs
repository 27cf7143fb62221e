//! The pictures of a mission for its page: its graph, and the states of its activities. The page colours them.

use super::asked::Asked;
use language::plan::Plan;
use language::{activities_of_plan, graph_of_activity, graph_of_plan};
use serde_json::{Value, json};

/// Returns a picture as JSON, or the reason why there is none. It may take a while: the caller holds no lock.
pub(crate) fn picture(asked: Asked, plan: Option<&Plan>) -> Value {
    let Some(plan) = plan else {
        return json!({ "why": "the mission is too large for a picture, or it is no longer shown" });
    };
    if let Some(group) = asked.more {
        return match graph_of_activity(plan, group as usize) {
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
