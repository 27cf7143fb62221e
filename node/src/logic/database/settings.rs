//! The keys by which a robot configures its own node: parameters of controllers, and settings of the node.
//!
//! `robot/<robot>/params/<deployment>/<instance>/<parameter>` overrides the argument that the spec gives to an instance
//! on this host. `<instance>` is the path of the instance without `main`, or the end of that path:
//! `robot/c3/params/door_opening/hit/force/threshold = 12.0`. If several keys name one instance, the key with the
//! longest path is used.
//!
//! `robot/<robot>/node/<setting>` overrides the value with which the node was started, until the key is deleted. `log`
//! is the log filter, such as `"info"`. `agent_loss_grace` is how many seconds programs may run after the loss of the
//! agent. It applies to programs that are started after the change.

use dbmanager::logic::key::Key;
use dbmanager::logic::state::State;
use dbmanager::logic::view::value::Datum;
use std::collections::BTreeMap;
use std::time::Duration;

/// The position of parameters, after the name of the robot.
const PARAMETERS: &str = "/params/";
/// The position of the node's settings, after the name of the robot.
const NODE: &str = "/node/";

/// The keys below `robot/<robot>/params/` and `robot/<robot>/node/`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Settings {
    /// Parameters in the spelling of a spec.
    parameters: BTreeMap<String, String>,
    /// The filter of the node's log.
    pub log: Option<String>,
    /// How long programs have to stop after the loss of the node.
    pub agent_loss_grace: Option<Duration>,
    /// Sentences for users about settings without an effect.
    pub unfit: Vec<String>,
}

impl Settings {
    /// Reads the settings from the state of the database.
    pub fn of(state: &State, robot: &str) -> Self {
        let parameters = below(state, &prefix(robot, PARAMETERS)).map(|(name, datum)| (name, spelt(&datum))).collect();
        let mut settings = Self { parameters, ..Self::default() };
        let node = prefix(robot, NODE);
        for (name, datum) in below(state, &node) {
            if let Err(why) = settings.set(&name, &datum) {
                settings.unfit.push(format!("`{node}{name}` does nothing: {why}"));
            }
        }
        settings
    }

    fn set(&mut self, name: &str, datum: &Datum) -> Result<(), String> {
        match (name, datum) {
            ("log", Datum::Text(filter)) => self.log = Some(filter.clone()),
            ("agent_loss_grace", Datum::Integer(_) | Datum::Float(_)) => {
                let seconds = spelt(datum).parse().unwrap_or(f64::NAN);
                let grace = Duration::try_from_secs_f64(seconds).map_err(|why| why.to_string())?;
                self.agent_loss_grace = Some(grace);
            }
            ("log", _) => return Err("a filter is a text, such as \"info\"".to_owned()),
            ("agent_loss_grace", _) => return Err("a grace is a number of seconds".to_owned()),
            _ => return Err("a node has the settings `log` and `agent_loss_grace`".to_owned()),
        }
        Ok(())
    }

    /// Returns whether a key is one of the robot's parameters or settings.
    pub fn concern(robot: &str, key: &Key) -> bool {
        let own = key.as_str().strip_prefix("robot/").and_then(|rest| rest.strip_prefix(robot));
        own.is_some_and(|rest| rest.starts_with(PARAMETERS) || rest.starts_with(NODE))
    }

    /// Returns the parameters of one instance, by name.
    pub fn parameters(&self, deployment: &str, path: &str) -> Vec<(String, String)> {
        let below = format!("{deployment}/");
        let of_it = self.parameters.range(below.clone()..).take_while(|(key, _)| key.starts_with(&below));
        let named = of_it.filter_map(|(key, value)| Some((key.strip_prefix(&below)?.rsplit_once('/')?, value)));
        let mut found: BTreeMap<&str, (usize, &String)> = BTreeMap::new();
        for ((instance, name), value) in named.filter(|((instance, _), _)| stands_for(instance, path)) {
            let best = found.entry(name).or_insert((instance.len(), value));
            if best.0 < instance.len() {
                *best = (instance.len(), value);
            }
        }
        found.into_iter().map(|(name, (_, value))| (name.to_owned(), value.clone())).collect()
    }
}

/// Returns the parameters that are new or have changed. A parameter whose key was deleted has no value.
pub fn changes(before: &[(String, String)], now: &[(String, String)]) -> Vec<(String, Option<String>)> {
    let new = now.iter().filter(|one| !before.contains(one)).map(|(name, value)| (name.clone(), Some(value.clone())));
    let gone = before.iter().filter(|(name, _)| !now.iter().any(|(other, _)| other == name));
    new.chain(gone.map(|(name, _)| (name.clone(), None))).collect()
}

/// Returns whether a name in a key stands for the instance with an absolute path. The name is that path without `main`, or the end of it.
pub fn stands_for(name: &str, path: &str) -> bool {
    let path = path.split_once('/').map_or(path, |(_main, rest)| rest);
    path.strip_suffix(name).is_some_and(|before| !name.is_empty() && (before.is_empty() || before.ends_with('/')))
}

/// Splits the key of a parameter into robot, deployment, instance and name.
pub fn parameter_key(key: &str) -> Option<(&str, &str, &str, &str)> {
    let (robot, below) = key.strip_prefix("robot/")?.split_once('/')?;
    let (deployment, rest) = below.strip_prefix(PARAMETERS.trim_start_matches('/'))?.split_once('/')?;
    let (instance, name) = rest.rsplit_once('/')?;
    Some((robot, deployment, instance, name))
}

/// Returns the key for a parameter of the instance with an absolute path.
pub fn key_of_parameter(robot: &str, deployment: &str, path: &str, name: &str) -> String {
    let instance = path.split_once('/').map_or(path, |(_main, rest)| rest);
    format!("{}{deployment}/{instance}/{name}", prefix(robot, PARAMETERS))
}

fn prefix(robot: &str, below: &str) -> String {
    format!("robot/{robot}{below}")
}

/// Returns the readable values of the keys below a prefix. Each has the rest of its key.
fn below<'a>(state: &'a State, prefix: &'a str) -> impl Iterator<Item = (String, Datum)> {
    state.scan(prefix).filter_map(move |(key, versions)| {
        let value = versions.last()?.value.as_ref()?;
        Some((key.as_str().strip_prefix(prefix)?.to_owned(), Datum::of(value)))
    })
}

/// Returns a value in the spelling of a spec.
pub fn spelt(datum: &Datum) -> String {
    if let Datum::Text(text) = datum { text.clone() } else { datum.to_toml() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dbmanager::logic::clock::Timestamp;
    use dbmanager::logic::state::CausalContext;
    use dbmanager::logic::txn::Write;
    use dbmanager::logic::version_vector::{Dot, ReplicaId, VersionVector};

    #[test]
    fn what_has_changed_is_found() {
        let of = |all: &[(&str, &str)]| {
            all.iter().map(|(name, value)| ((*name).into(), (*value).into())).collect::<Vec<_>>()
        };
        let found = changes(&of(&[("a", "1"), ("b", "2"), ("c", "3")]), &of(&[("a", "1"), ("b", "5"), ("d", "6")]));
        let expected = [("b", Some("5")), ("d", Some("6")), ("c", None)];
        assert_eq!(found, expected.map(|(name, value)| (name.to_owned(), value.map(str::to_owned))));
    }

    fn state(entries: &[(&str, Datum)]) -> State {
        let mut state = State::default();
        let write = |(key, datum): &(&str, Datum)| Write { key: Key::new(*key).unwrap(), value: datum.encode().ok() };
        let writes: Vec<Write> = entries.iter().map(write).collect();
        let (dot, context) = (Dot { origin: ReplicaId::new(1), seq: 1 }, VersionVector::default());
        state.apply(dot, Timestamp::default(), CausalContext { context: &context, only: None }, &writes);
        state
    }

    #[test]
    fn a_node_is_told_what_it_understands_and_says_what_not() {
        let told = |name: &str, datum| Settings::of(&state(&[(&format!("robot/c1/node/{name}"), datum)]), "c1");
        assert_eq!(told("log", Datum::from("info")).log, Some("info".to_owned()));
        assert_eq!(told("agent_loss_grace", Datum::from(2)).agent_loss_grace, Some(Duration::from_secs(2)));
        assert_eq!(told("agent_loss_grace", Datum::float(0.5)).agent_loss_grace, Some(Duration::from_millis(500)));
        let unfit = [
            told("agent_loss_grace", Datum::float(-1.0)),
            told("agent_loss_grace", Datum::from("long")),
            told("log", Datum::from(1)),
            told("grace", Datum::from(1)),
        ];
        assert!(unfit.iter().all(|one| one.unfit.len() == 1 && one.log.is_none() && one.agent_loss_grace.is_none()));
        let other = Settings::of(&state(&[("robot/c2/node/log", Datum::from("info"))]), "c1");
        assert_eq!(other, Settings::default());
    }

    #[test]
    fn each_instance_gets_its_own() {
        let entries = [
            ("robot/c1/params/door/hit/force/level", Datum::float(2.5)),
            ("robot/c1/params/door/hit/force/mode", Datum::from("soft")),
            ("robot/c1/params/door/hit/level", Datum::from(3)),
            ("robot/c1/params/door/hitter/level", Datum::from(4)),
            ("robot/c2/params/door/hit/level", Datum::from(5)),
        ];
        let settings = Settings::of(&state(&entries), "c1");
        let check = |path, expected: &[(&str, &str)]| {
            let found = settings.parameters("door", path);
            let found: Vec<(&str, &str)> = found.iter().map(|(name, value)| (name.as_str(), value.as_str())).collect();
            assert_eq!(found, expected, "{path}");
        };
        check("main/hit/force", &[("level", "2.5"), ("mode", "soft")]);
        check("main/hit", &[("level", "3")]);
        // The end of the path is enough, and a longer end takes precedence.
        check("main/arm/hit", &[("level", "3")]);
        check("main/arm/hit/force", &[("level", "2.5"), ("mode", "soft")]);
        check("main/door/hitter", &[("level", "4")]);
        let both = Settings::of(
            &state(&[
                ("robot/c1/params/door/force/level", Datum::from(7)),
                ("robot/c1/params/door/hit/force/level", Datum::from(8)),
            ]),
            "c1",
        );
        assert_eq!(both.parameters("door", "main/arm/hit/force"), [("level".to_owned(), "8".to_owned())]);
        assert_eq!(both.parameters("door", "main/arm/force"), [("level".to_owned(), "7".to_owned())]);
        let key = key_of_parameter("c1", "door", "main/arm/hit", "level");
        assert_eq!(key, "robot/c1/params/door/arm/hit/level");
        assert_eq!(parameter_key(&key), Some(("c1", "door", "arm/hit", "level")));
        check("main/other", &[]);
        let concern = |key: &str| Settings::concern("c1", &Key::new(key).unwrap());
        assert!(concern(entries[0].0) && concern("robot/c1/node/log") && !concern(entries[4].0));
    }
}
