//! The page of a live view: its files, and the changes of the model as JSON for its scripts.

mod asked;
mod picture;
mod timeline;

use comms::logic::time::Time;
use serde_json::{Value, json};
use view::{
    Changes, EventLine, Freshness, Gone, Health, LiveDeployment, MissionId, Model, Presence, Process, Robot,
    STALE_AFTER, Wire,
};

pub(crate) use asked::Asked;
pub(crate) use picture::picture;
pub(crate) use timeline::{Past, timeline};

/// The page. The script takes the token of its session from it.
const PAGE: &str = include_str!("live_page/page.html");
const STYLE: &str = include_str!("live_page/page.css");
pub(crate) const SCRIPT: &str = include_str!("live_page/page.js");
pub(crate) const MISSIONS: &str = include_str!("live_page/missions.js");
pub(crate) const PARTS: &str = include_str!("live_page/parts.js");
pub(crate) const ICON: &str = include_str!("live_page/icon.svg");

/// Returns the page with the token of a session.
pub(crate) fn page(token: &str) -> String {
    PAGE.replace("TOKEN", &super::page::text::escape(token))
}

/// Returns the style of the page, with the style of the lanes of a report.
pub(crate) fn style() -> String {
    format!("{STYLE}{}", super::page::LANES)
}

/// Returns changes as JSON on one line.
pub(crate) fn changes(model: &Model, changes: &Changes<'_>, now: Time) -> Value {
    json!({
        "whole": changes.is_whole,
        "robots": changes.robots.iter().map(|one| robot(one, now)).collect::<Vec<_>>(),
        "deployments": changes.deployments.iter().map(|one| deployment(one, now)).collect::<Vec<_>>(),
        "processes": changes.processes.iter().map(|(id, one)| process(model, id, one, now)).collect::<Vec<_>>(),
        "wires": changes.wires.iter().map(|(id, one)| wire(id, one)).collect::<Vec<_>>(),
        "events": changes.events.iter().map(|one| event(one)).collect::<Vec<_>>(),
        "gone": changes.gone.iter().map(|one| gone(one)).collect::<Vec<_>>(),
        "questions": model.questions().map(|one| json!({
            "mission": one.mission.key(), "deployment": one.mission.to_string(), "path": one.path, "number": one.question.number,
            "text": one.question.text, "options": one.question.options,
        })).collect::<Vec<_>>(),
        "ages": ages(model, now),
    })
}

/// Returns the ages of the data as JSON: of all, and of each robot.
pub(crate) fn ages(model: &Model, now: Time) -> Value {
    let seconds = |freshness: Freshness| match freshness {
        Freshness::Live => json!(0),
        Freshness::Stale(age) => json!(age.as_secs()),
        Freshness::Never => Value::Null,
    };
    let robots: serde_json::Map<String, Value> =
        model.robots().map(|robot| (robot.id.to_string(), seconds(robot.freshness(now)))).collect();
    json!({ "all": seconds(model.freshness(now)), "robots": robots, "limit": STALE_AFTER.as_secs() })
}

fn robot(robot: &Robot, now: Time) -> Value {
    let why = if let Presence::Silent(why) = &robot.presence { why.as_str() } else { "" };
    let database = robot.database.as_ref().map(ToString::to_string);
    json!({
        "host": robot.id.to_string(), "presence": robot.presence.word(), "why": why, "version": robot.version,
        "up": robot.up(now).map(|up| up.as_secs()), "estop": robot.estop, "waiting": robot.waiting, "database": database,
    })
}

fn deployment(live: &LiveDeployment, now: Time) -> Value {
    let ends: serde_json::Map<String, Value> = live
        .ends
        .iter()
        .map(|(path, end)| (path.clone(), json!({ "mark": end.mark.word(), "text": end.text })))
        .collect();
    json!({
        "id": live.id.key(), "title": live.id.to_string(), "home": live.id.home, "phase": live.phase(), "ended": live.end.is_some(),
        "failed": live.end.as_ref().is_some_and(|end| end.is_failed),
        "age": live.end.as_ref().map(|end| end.at).or(live.began).map(|at| age(now, at)),
        "plan": live.plan.as_ref().map(|plan| plan.number), "ends": ends,
    })
}

fn process(model: &Model, id: &MissionId, process: &Process, now: Time) -> Value {
    let health = model.health(id, process);
    json!({
        "mission": id.key(), "path": process.path, "kind": process.kind, "host": process.host,
        "state": process.state_text(health), "health": health_word(health), "age": age(now, process.since.at), "exact": process.since.is_exact,
        "pid": process.pid, "restarts": process.restarts, "mark": process.mark(health).word(), "text": process.mark_text(health),
        "states": if health == Health::Running { process.states.as_slice() } else { &[] },
    })
}

/// Returns how a process is, in one word.
pub(crate) fn health_word(health: Health) -> &'static str {
    match health {
        Health::Running => "running",
        Health::Quiet => "quiet",
        Health::Changing => "changing",
        Health::Failed => "failed",
        Health::Unknown => "unknown",
    }
}

fn wire(id: &MissionId, wire: &Wire) -> Value {
    json!({
        "mission": id.key(), "name": wire.name, "lost": wire.missing(), "lostASecond": wire.lost_a_second,
        "refused": wire.refused,
    })
}

fn event(event: &EventLine) -> Value {
    // The deployment tells the command.
    let host = event.mission.as_ref().map_or_else(|| event.robot.to_string(), |_| event.robot.host.clone());
    json!({
        "time": event.time.map(|time| time.as_secs_f64()), "host": host,
        "deployment": event.mission.as_ref().map(ToString::to_string), "path": event.path, "text": event.text,
        "failure": event.is_failure,
    })
}

fn gone(gone: &Gone) -> Value {
    match gone {
        Gone::Robot(id) => json!({ "robot": id.to_string() }),
        Gone::Deployment(id) => json!({ "mission": id.key() }),
        Gone::Process(id, path) => json!({ "mission": id.key(), "process": path }),
        Gone::Wire(id, name) => json!({ "mission": id.key(), "wire": name }),
    }
}

fn age(now: Time, at: Time) -> f64 {
    now.since(at).as_secs_f64()
}

#[cfg(test)]
mod tests;
