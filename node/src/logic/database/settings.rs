//! What a robot's own keys say to its node: parameters of controllers.
//!
//! `robot/<robot>/params/<deployment>/<instance>/<parameter>`: goes over the argument that the spec gives to an instance of
//! this host. The instance is its path without `main`: `robot/c3/params/door_opening/hit/force/threshold = 12.0`.

use dbmanager::logic::key::Key;
use dbmanager::logic::state::State;
use dbmanager::logic::view::value::Datum;
use std::collections::BTreeMap;

/// What is below `robot/<robot>/params/`, as a spec would spell it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Settings(BTreeMap<String, String>);

impl Settings {
    /// Reads them.
    pub fn of(state: &State, robot: &str) -> Self {
        let below = prefix(robot);
        let entries = state.scan(&below).filter_map(|(key, versions)| {
            let value = versions.last()?.value.as_ref()?;
            Some((key.as_str().strip_prefix(&below)?.to_owned(), spelt(&Datum::of(value))))
        });
        Self(entries.collect())
    }

    /// Returns whether a key is among them.
    pub fn concern(robot: &str, key: &Key) -> bool {
        key.as_str().starts_with(&prefix(robot))
    }

    /// Returns the parameters of one instance, by name.
    pub fn parameters(&self, deployment: &str, path: &str) -> Vec<(String, String)> {
        let instance = path.split_once('/').map_or(path, |(_main, rest)| rest);
        let below = format!("{deployment}/{instance}/");
        let of_it = self.0.range(below.clone()..).take_while(|(key, _)| key.starts_with(&below));
        let named = of_it.filter_map(|(key, value)| Some((key.strip_prefix(&below)?, value)));
        // What lies deeper belongs to an instance below this one.
        named.filter(|(name, _)| !name.contains('/')).map(|(name, value)| (name.to_owned(), value.clone())).collect()
    }
}

fn prefix(robot: &str) -> String {
    format!("robot/{robot}/params/")
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

    #[test]
    fn each_instance_gets_its_own() {
        let mut state = State::default();
        let write = |key: &str, datum: &Datum| Write { key: Key::new(key).unwrap(), value: datum.encode().ok() };
        let writes = [
            write("robot/c1/params/door/hit/force/level", &Datum::float(2.5)),
            write("robot/c1/params/door/hit/force/mode", &Datum::from("soft")),
            write("robot/c1/params/door/hit/level", &Datum::from(3)),
            write("robot/c1/params/door/hitter/level", &Datum::from(4)),
            write("robot/c2/params/door/hit/level", &Datum::from(5)),
        ];
        let (dot, context) = (Dot { origin: Origin::new(1), seq: 1 }, Cut::default());
        state.apply(dot, Stamp::default(), Seen { context: &context, only: None }, &writes);
        let settings = Settings::of(&state, "c1");
        let check = |path, expected: &[(&str, &str)]| {
            let found = settings.parameters("door", path);
            let found: Vec<(&str, &str)> = found.iter().map(|(name, value)| (name.as_str(), value.as_str())).collect();
            assert_eq!(found, expected, "{path}");
        };
        check("main/hit/force", &[("level", "2.5"), ("mode", "soft")]);
        check("main/hit", &[("level", "3")]);
        check("main/other", &[]);
        assert!(Settings::concern("c1", &writes[0].key) && !Settings::concern("c1", &writes[4].key));
    }
}
