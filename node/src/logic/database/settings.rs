//! What a robot's own keys say to its node: parameters of controllers, and settings of the node itself.
//!
//! `robot/<robot>/params/<deployment>/<instance>/<parameter>`: goes over the argument that the spec gives to an instance of
//! this host. The instance is its path without `main`: `robot/c3/params/door_opening/hit/force/threshold = 12.0`.
//!
//! `robot/<robot>/node/<setting>`: goes over what the node was started with, until the key is deleted. `log` is what it logs, a
//! filter such as `"info"`; `agent_loss_grace` is how long programs that start from then on have to stop when it is gone, in
//! seconds.

use dbmanager::logic::key::Key;
use dbmanager::logic::state::State;
use dbmanager::logic::view::value::Datum;
use std::collections::BTreeMap;
use std::time::Duration;

/// Where parameters are, behind the name of the robot.
const PARAMETERS: &str = "/params/";
/// Where the settings of the node are.
const NODE: &str = "/node/";

/// What is below `robot/<robot>/params/` and `robot/<robot>/node/`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Settings {
    /// Parameters, as a spec would spell them.
    parameters: BTreeMap<String, String>,
    /// What the node logs.
    pub log: Option<String>,
    /// How long programs have to stop when the node is gone.
    pub agent_loss_grace: Option<Duration>,
    /// Sentences about settings that mean nothing.
    pub unfit: Vec<String>,
}

impl Settings {
    /// Reads them.
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

    /// Returns whether a key is among them.
    pub fn concern(robot: &str, key: &Key) -> bool {
        let own = key.as_str().strip_prefix("robot/").and_then(|rest| rest.strip_prefix(robot));
        own.is_some_and(|rest| rest.starts_with(PARAMETERS) || rest.starts_with(NODE))
    }

    /// Returns the parameters of one instance, by name.
    pub fn parameters(&self, deployment: &str, path: &str) -> Vec<(String, String)> {
        let instance = path.split_once('/').map_or(path, |(_main, rest)| rest);
        let below = format!("{deployment}/{instance}/");
        let of_it = self.parameters.range(below.clone()..).take_while(|(key, _)| key.starts_with(&below));
        let named = of_it.filter_map(|(key, value)| Some((key.strip_prefix(&below)?, value)));
        // What lies deeper belongs to an instance below this one.
        named.filter(|(name, _)| !name.contains('/')).map(|(name, value)| (name.to_owned(), value.clone())).collect()
    }
}

fn prefix(robot: &str, below: &str) -> String {
    format!("robot/{robot}{below}")
}

/// Returns what a read shows of the keys below a prefix, by what follows it.
fn below<'a>(state: &'a State, prefix: &'a str) -> impl Iterator<Item = (String, Datum)> {
    state.scan(prefix).filter_map(move |(key, versions)| {
        let value = versions.last()?.value.as_ref()?;
        Some((key.as_str().strip_prefix(prefix)?.to_owned(), Datum::of(value)))
    })
}

/// Returns a value as a spec spells it.
fn spelt(datum: &Datum) -> String {
    if let Datum::Text(text) = datum { text.clone() } else { datum.to_toml() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dbmanager::logic::clock::Stamp;
    use dbmanager::logic::cut::{Cut, Dot, Origin};
    use dbmanager::logic::state::Seen;
    use dbmanager::logic::txn::Write;

    fn state(entries: &[(&str, Datum)]) -> State {
        let mut state = State::default();
        let write = |(key, datum): &(&str, Datum)| Write { key: Key::new(*key).unwrap(), value: datum.encode().ok() };
        let writes: Vec<Write> = entries.iter().map(write).collect();
        let (dot, context) = (Dot { origin: Origin::new(1), seq: 1 }, Cut::default());
        state.apply(dot, Stamp::default(), Seen { context: &context, only: None }, &writes);
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
        check("main/other", &[]);
        let concern = |key: &str| Settings::concern("c1", &Key::new(key).unwrap());
        assert!(concern(entries[0].0) && concern("robot/c1/node/log") && !concern(entries[4].0));
    }
}
