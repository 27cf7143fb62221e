//! The page of a live view: its files, and the changes of the model as JSON for its script.

use comms::logic::time::Time;
use serde_json::{Value, json};
use view::{
    Changes, EventLine, Freshness, Gone, Health, LiveDeployment, MissionId, Model, Presence, Process, Robot,
    STALE_AFTER, Wire,
};

/// The page. The script takes the token of its session from it.
const PAGE: &str = include_str!("live_page/page.html");
pub(crate) const STYLE: &str = include_str!("live_page/page.css");
pub(crate) const SCRIPT: &str = include_str!("live_page/page.js");
pub(crate) const ICON: &str = include_str!("live_page/icon.svg");

/// Returns the page with the token of a session.
pub(crate) fn page(token: &str) -> String {
    PAGE.replace("TOKEN", &super::page::text::escape(token))
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
    json!({
        "id": live.id.key(), "title": live.id.to_string(), "home": live.id.home, "phase": live.phase(), "ended": live.end.is_some(),
        "failed": live.end.as_ref().is_some_and(|end| end.is_failed),
        "age": live.end.as_ref().map(|end| end.at).or(live.began).map(|at| age(now, at)),
    })
}

fn process(model: &Model, id: &MissionId, process: &Process, now: Time) -> Value {
    let health = model.health(id, process);
    json!({
        "mission": id.key(), "path": process.path, "kind": process.kind, "host": process.host,
        "state": process.state_text(health), "health": health_word(health), "age": age(now, process.since.at), "exact": process.since.is_exact,
        "pid": process.pid, "restarts": process.restarts,
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
        "mission": id.key(), "name": wire.name, "lost": wire.lost, "lostASecond": wire.lost_a_second,
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
mod tests {
    use super::*;
    use node::logic::protocol::{Deployment, Event, Report};
    use std::time::Duration;
    use view::{Fleet, Input, Position, RobotId};

    #[test]
    fn nothing_runs_within_the_page() {
        let page = page("a\"b");
        assert!(page.contains("content=\"a&quot;b\"") && page.contains("<script src=\"/page.js\" defer></script>"));
        assert_eq!(page.matches("<script").count(), 1);
        let within = ["style=", "onclick", "onload", "javascript:", "http:", "https:"];
        assert!(within.iter().all(|word| !page.contains(word)), "{page}");
        // Texts of robots become text nodes.
        let markup = ["innerHTML", "outerHTML", "insertAdjacentHTML", "document.write", "eval("];
        assert!(markup.iter().all(|word| !SCRIPT.contains(word)));
    }

    #[test]
    fn changes_are_data_and_what_robots_say_stays_text() {
        let mut model = Model::new(1);
        let (now, time) = (Time::from_nanos(5_000_000_000), Duration::from_secs(1_800_000_000));
        let (deployment, reasons) =
            (Deployment { name: "door".into(), epoch: 1 }, vec!["<img src=x onerror=alert(1)>".into()]);
        let report = Report::Refused { reasons };
        let event = Event { deployment, number: 0, host: "r1".into(), ago: Duration::ZERO, report, time };
        let robot = RobotId { host: "r1".into(), fleet: Fleet::Standing };
        model.apply(now, Input::Event { home: robot.clone(), event: Box::new(event) });
        model.apply(now, Input::Silent { robot, why: "it sleeps".into() });
        let json = changes(&model, &model.since(Position::default()), now);
        assert_eq!(json["whole"], true);
        assert_eq!(json["events"][0]["text"], "refused: <img src=x onerror=alert(1)>");
        assert_eq!(
            (&json["robots"][0]["presence"], &json["robots"][0]["why"]),
            (&json!("does not answer"), &json!("it sleeps"))
        );
        assert_eq!(json["ages"], json!({ "all": null, "robots": { "r1": null }, "limit": 3 }));
        let line = json.to_string();
        assert!(!line.contains('\n'), "an event of a stream is one line");
    }
}
