//! Layouts for Foxglove and Lichtblick: panels for the topics of running missions, or of a record.
//!
//! Both take the same file. Panels are named by `TYPE!NAME`, and split the window in two, again and again.
//! Source: the layout API of the package `foxglove-sdk` 0.16 for Python, and exported files.

use super::catalog::Channel;
use super::recording;
use crate::logic::record::{EVENTS, LOG, SIGNALS, Timeline};
use comms::logic::signals::COUNTS;
use serde_json::{Map, Value, json};
use std::collections::BTreeSet;
use view::LiveDeployment;

/// The most lines of a panel.
const LINES_MAX: usize = 30;
/// The most curves of a plot, and the most plots: more are not legible on one screen.
const CURVES_MAX: usize = 8;
const PLOTS_MAX: usize = 6;
/// How long a stop may take, in seconds.
const STOP_WITHIN: u32 = 60;
/// The colour of a button that stops something.
const RED: &str = "#b3261e";
/// The types of messages that a 3D panel draws, by their schemas.
const DRAWN: [&str; 12] = [
    "foxglove.FrameTransform",
    "foxglove.FrameTransforms",
    "foxglove.SceneUpdate",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/TransformStamped",
    "nav_msgs/msg/OccupancyGrid",
    "nav_msgs/msg/Path",
    "sensor_msgs/msg/LaserScan",
    "sensor_msgs/msg/PointCloud2",
    "tf2_msgs/msg/TFMessage",
    "visualization_msgs/msg/Marker",
    "visualization_msgs/msg/MarkerArray",
];

/// A topic that may have a panel.
#[derive(Clone, Copy, Debug)]
struct Topic<'a> {
    name: &'a str,
    schema_name: &'a str,
    schema: &'a str,
}

/// A mission that runs, and its topic.
#[derive(Clone, Copy, Debug)]
pub(super) struct LayoutMission<'a> {
    pub(super) topic: &'a str,
    pub(super) live: &'a LiveDeployment,
}

/// A line of a panel that shows states.
struct Line {
    path: String,
    label: String,
}

/// Panels, with their settings.
#[derive(Debug, Default)]
struct Panels {
    settings: Map<String, Value>,
    left: Vec<String>,
    right: Vec<String>,
}

/// Returns the layout of missions that run.
pub(super) fn of_missions<'a>(channels: impl Iterator<Item = &'a Channel>, missions: &[LayoutMission<'_>]) -> Value {
    let topic = |channel: &'a Channel| Topic {
        name: &channel.topic,
        schema_name: &channel.schema_name,
        schema: &channel.schema,
    };
    let topics: Vec<Topic<'_>> = channels.map(topic).collect();
    let mut panels = Panels::default();
    for (number, LayoutMission { topic, live }) in missions.iter().enumerate() {
        let line = |path: &String| {
            let path = quoted(path)?;
            Some(Line { path: format!("{topic}.processes[:]{{path==\"{path}\"}}.state"), label: path.to_owned() })
        };
        panels.states(&format!("mission{number}"), &live.id.deployment.name, live.processes.keys().filter_map(line));
    }
    panels.topics(&topics);
    panels.right("Parameters!parameters", json!({ "title": "Parameters" }));
    for (number, LayoutMission { live, .. }) in missions.iter().enumerate() {
        let name = &live.id.deployment.name;
        let button = Button { service: "/dca/stop", text: &format!("Stop {name}"), colour: RED };
        panels.button(&format!("stop{number}"), &button, &json!({ "deployment": name }));
    }
    let button = Button { service: "/dca/estop", text: "Stop everything", colour: RED };
    panels.button("estop", &button, &json!({}));
    panels.layout()
}

/// Returns the layout of a record.
pub(crate) fn of_record(timeline: &Timeline) -> Value {
    let topic = |place: usize| {
        timeline.topics.get(place).map(|topic| Topic {
            name: &topic.name,
            schema_name: &topic.schema_name,
            schema: &topic.schema,
        })
    };
    let topics: Vec<Topic<'_>> = (0..timeline.topics.len()).filter_map(topic).collect();
    let events = timeline.topics.iter().position(|topic| topic.name == EVENTS);
    let events = timeline.messages.iter().filter(|message| Some(message.topic) == events);
    let processes: BTreeSet<String> = events
        .filter_map(|message| {
            let event: Value = serde_json::from_slice(&message.data).ok()?;
            event["process"].as_str().filter(|path| !path.is_empty()).map(str::to_owned)
        })
        .collect();
    let line = |path: &String| {
        let path = quoted(path)?;
        Some(Line { path: format!("{EVENTS}{{process==\"{path}\"}}.kind"), label: path.to_owned() })
    };
    let mut panels = Panels::default();
    panels.states("mission", "Processes", processes.iter().filter_map(line));
    panels.topics(&topics);
    let button = Button { service: recording::SERVICE, text: "Pause", colour: "#555c67" };
    panels.button("pause", &button, &json!({ "play": false }));
    let button = Button { service: recording::SERVICE, text: "Play from the begin", colour: "#0a6b36" };
    panels.button("play", &button, &json!({ "play": true, "seconds": 0 }));
    panels.layout()
}

/// Returns a text that can stand between quotes in the path of a message.
fn quoted(text: &str) -> Option<&str> {
    Some(text).filter(|text| !text.contains(['"', '\\']))
}

/// A button that calls a service.
struct Button<'a> {
    service: &'a str,
    text: &'a str,
    colour: &'a str,
}

impl Panels {
    fn left(&mut self, id: &str, settings: Value) {
        self.settings.insert(id.to_owned(), settings);
        self.left.push(id.to_owned());
    }

    fn right(&mut self, id: &str, settings: Value) {
        self.settings.insert(id.to_owned(), settings);
        self.right.push(id.to_owned());
    }

    fn states(&mut self, id: &str, title: &str, lines: impl Iterator<Item = Line>) {
        let paths: Vec<Value> = lines
            .take(LINES_MAX)
            .map(|Line { path, label }| {
                json!({ "value": path, "label": label, "enabled": true, "timestampMethod": "receiveTime" })
            })
            .collect();
        if !paths.is_empty() {
            let settings = json!({ "paths": paths, "isSynced": true, "foxglovePanelTitle": title });
            self.left(&format!("StateTransitions!{id}"), settings);
        }
    }

    /// Adds panels for the output, for signals, and for messages with a place in space.
    fn topics(&mut self, topics: &[Topic<'_>]) {
        if topics.iter().any(|topic| topic.name == LOG) {
            // The output of a program has no level, so the panel has to show messages of all levels.
            let settings =
                json!({ "topicToRender": LOG, "minLogLevel": 0, "searchTerms": [], "foxglovePanelTitle": "Output" });
            self.left("RosOut!log", settings);
        }
        let drawn = topics.iter().filter(|topic| DRAWN.contains(&topic.schema_name));
        let drawn: Map<String, Value> =
            drawn.map(|topic| (topic.name.to_owned(), json!({ "visible": true }))).collect();
        if !drawn.is_empty() {
            self.right("3D!space", json!({ "topics": drawn, "foxglovePanelTitle": "Space" }));
        }
        let signals = topics.iter().filter_map(|topic| Some((topic, curves(topic)?)));
        for (number, (topic, curves)) in signals.take(PLOTS_MAX).enumerate() {
            let settings = json!({
                "paths": curves, "showLegend": true, "legendDisplay": "floating", "isSynced": true, "xAxisVal": "timestamp",
                "showXAxisLabels": true, "showYAxisLabels": true,
                "foxglovePanelTitle": topic.name.trim_start_matches(SIGNALS),
            });
            self.right(&format!("Plot!signals{number}"), settings);
        }
    }

    fn button(&mut self, id: &str, button: &Button<'_>, request: &Value) {
        let settings = json!({
            "serviceName": button.service, "requestPayload": request.to_string(), "buttonText": button.text,
            "buttonColor": button.colour, "buttonTooltip": button.service, "layout": "vertical", "editingMode": false,
            "timeoutSeconds": STOP_WITHIN, "foxglovePanelTitle": button.text,
        });
        self.right(&format!("CallService!{id}"), settings);
    }

    fn layout(self) -> Value {
        let columns: Vec<Value> = [column(&self.left), column(&self.right)].into_iter().flatten().collect();
        let layout = match &columns[..] {
            [left, right] => json!({ "direction": "row", "first": left, "second": right, "splitPercentage": 50 }),
            other => other.first().cloned().unwrap_or_default(),
        };
        json!({
            "configById": self.settings, "globalVariables": {}, "userNodes": {}, "playbackConfig": { "speed": 1 },
            "layout": layout,
        })
    }
}

/// Returns the curves of a topic with signals: its numbers, except the time of the sample. None if the topic has only the
/// counts that every program has, since plots of these would displace others.
fn curves(topic: &Topic<'_>) -> Option<Vec<Value>> {
    if !topic.name.contains(SIGNALS) {
        return None;
    }
    let schema: Value = serde_json::from_str(topic.schema).ok()?;
    let fields = schema["properties"].as_object()?.iter();
    let numbers = fields.filter(|(name, field)| field["type"] == "number" && *name != "stamp");
    let counts = COUNTS.map(|name| name.replace(' ', "_"));
    if numbers.clone().all(|(name, _)| counts.contains(name)) {
        return None;
    }
    let curve = |(name, _): (&String, &Value)| json!({ "value": format!("{}.{name}", topic.name), "label": name, "enabled": true, "timestampMethod": "receiveTime" });
    let curves: Vec<Value> = numbers.take(CURVES_MAX).map(curve).collect();
    (!curves.is_empty()).then_some(curves)
}

/// Returns panels under each other, each with the same height.
fn column(panels: &[String]) -> Option<Value> {
    let (first, rest) = panels.split_first()?;
    let share = 100 / panels.len();
    Some(match column(rest) {
        None => json!(first),
        Some(rest) => json!({ "direction": "column", "first": first, "second": rest, "splitPercentage": share }),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::record::{RecordedMessage, RecordedTopic};
    use std::time::Duration;

    fn topic(name: &str, schema_name: &str, schema: Value) -> RecordedTopic {
        let (name, schema_name, schema) = (name.to_owned(), schema_name.to_owned(), schema.to_string());
        RecordedTopic { name, schema_name, schema, encoding: "json".into(), schema_encoding: "jsonschema".into() }
    }

    /// Returns all panels that have a place.
    fn placed(layout: &Value, found: &mut BTreeSet<String>) {
        if let Value::String(panel) = layout {
            assert!(found.insert(panel.clone()), "{panel} is placed twice");
            return;
        }
        assert!(layout["splitPercentage"].as_u64().is_some_and(|share| (1..100).contains(&share)), "{layout}");
        placed(&layout["first"], found);
        placed(&layout["second"], found);
    }

    #[test]
    fn a_record_has_panels_for_its_topics_and_each_has_a_place() {
        let signals = json!({ "properties": {
            "force": { "type": "number" }, "stamp": { "type": "number" }, "name": { "type": "string" },
        } });
        let counts = json!({ "properties": {
            "lost_values": { "type": "number" }, "overruns": { "type": "number" }, "refused_values": { "type": "number" },
            "undelivered_values": { "type": "number" },
        } });
        let event = |process: &str| RecordedMessage {
            at: Duration::from_secs(1),
            topic: 0,
            data: json!({ "process": process, "kind": "done" }).to_string().into_bytes(),
        };
        let timeline = Timeline {
            topics: vec![
                topic("/events", "dca.Event", json!({})),
                topic("/log", "foxglove.Log", json!({})),
                topic("/signals/main/0", "dca.signals.main.0", counts),
                topic("/signals/main/a", "dca.signals.main.a", signals),
                topic("/ports/main/scan/Out", "sensor_msgs/msg/LaserScan", json!({})),
                topic("/ports/main/a/Out", "dca.types.Wrench", json!({})),
            ],
            messages: vec![event("main/a"), event(""), event("main/b"), event("main/\"b"), event("main/a")],
            is_damaged: false,
        };
        let layout = of_record(&timeline);
        let mut panels = BTreeSet::new();
        placed(&layout["layout"], &mut panels);
        let settings = layout["configById"].as_object().unwrap();
        assert_eq!(settings.keys().cloned().collect::<BTreeSet<_>>(), panels);
        let expected = [
            "3D!space",
            "CallService!pause",
            "CallService!play",
            "Plot!signals0",
            "RosOut!log",
            "StateTransitions!mission",
        ];
        assert_eq!(panels, expected.map(str::to_owned).into());
        let paths = |panel: &str| -> Vec<String> {
            let paths = settings[panel]["paths"].as_array().unwrap().iter();
            paths.map(|path| path["value"].as_str().unwrap().to_owned()).collect()
        };
        assert_eq!(paths("Plot!signals0"), ["/signals/main/a.force"]);
        let states = ["main/a", "main/b"].map(|path| format!("/events{{process==\"{path}\"}}.kind"));
        assert_eq!(paths("StateTransitions!mission"), states);
        assert_eq!(settings["3D!space"]["topics"], json!({ "/ports/main/scan/Out": { "visible": true } }));
    }
}
