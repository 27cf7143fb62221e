//! Shows values to a person. In place of the bytes of a secret, its readers are shown.

use super::databases::DatabaseArgs;
use crate::io::keyring::Keyring;
use dbmanager::logic::view::value::Datum;
use node::console;
use std::cell::OnceCell;
use std::collections::BTreeMap;
use std::path::PathBuf;
use trust::bundle::Bundle;
use trust::identity::KeyId;
use trust::seal::Sealed;

/// The beginning of a sealed value in TOML. Other values cannot contain it, because quotes in a string are escaped.
const BEGIN: &str = "{\"$sealed\" = \"";
/// The end of a sealed value in TOML.
const END: &str = "\"}";

/// The names of the readers of secrets, as far as this machine knows them. They are looked up for the first secret.
#[derive(Debug)]
pub(crate) struct Readers {
    keys: Option<PathBuf>,
    names: OnceCell<BTreeMap<KeyId, String>>,
    /// Whether the note about an unknown name has been printed.
    unknown: OnceCell<()>,
}

impl Readers {
    /// Returns the readers that the teams know whose keys these arguments name.
    pub(crate) fn of(database: &DatabaseArgs) -> Self {
        Self { keys: database.key_place().folder, names: OnceCell::new(), unknown: OnceCell::new() }
    }

    /// Returns a value for people.
    pub(crate) fn text(&self, datum: &Datum) -> String {
        self.in_text(&datum.to_toml())
    }

    /// Returns JSON in which each secret is `{"secret": {"for": [READER, …], "generation": NUMBER}}`.
    pub(crate) fn json(&self, json: serde_json::Value) -> serde_json::Value {
        use serde_json::Value;
        match json {
            Value::Array(items) => items.into_iter().map(|item| self.json(item)).collect(),
            Value::Object(fields) if fields.len() == 1 && fields.contains_key("$sealed") => {
                let whole = Value::Object(fields);
                let sealed = serde_json::from_value(whole.clone()).ok().and_then(|datum: Datum| sealed(&datum));
                sealed.map_or(whole, |sealed| {
                    serde_json::json!({ "secret": { "for": self.names_of(&sealed), "generation": sealed.number() } })
                })
            }
            Value::Object(fields) => fields.into_iter().map(|(name, field)| (name, self.json(field))).collect(),
            Value::Null | Value::Bool(_) | Value::Number(_) | Value::String(_) => json,
        }
    }

    /// Adds lines of an exported file to a text. Before each secret, adds a comment with its readers. The bytes of the
    /// secret stay, so that the file can be imported.
    pub(crate) fn explain(&self, lines: &str, text: &mut String) {
        for line in lines.split_inclusive('\n') {
            if line.starts_with('#') {
                text.push_str(&self.in_text(line));
                continue;
            }
            let mut rest = line;
            while let Some((_, (said, after))) = self.next(rest) {
                text.push_str(&format!("# {said}\n"));
                rest = after;
            }
            text.push_str(line);
        }
    }

    /// Returns a TOML text in which each secret is replaced by a phrase about it.
    fn in_text(&self, toml: &str) -> String {
        let (mut text, mut rest) = (String::new(), toml);
        while let Some((before, (said, after))) = self.next(rest) {
            text.push_str(before);
            text.push_str(&said);
            rest = after;
        }
        text + rest
    }

    /// Splits a TOML text at its first secret. Returns the part before it, the phrase about it, and the part after it.
    fn next<'a>(&self, toml: &'a str) -> Option<(&'a str, (String, &'a str))> {
        let mut from = 0;
        loop {
            let begin = from + toml.get(from..)?.find(BEGIN)?;
            let digits = begin + BEGIN.len();
            let end = digits + toml.get(digits..)?.find(END)? + END.len();
            let datum = Datum::from_toml(toml.get(begin..end)?).ok();
            if let Some(sealed) = datum.as_ref().and_then(sealed) {
                let names = self.names_of(&sealed).join(", ");
                let said = format!("secret for {names}, generation {}", sealed.number());
                return Some((toml.get(..begin)?, (said, toml.get(end..)?)));
            }
            from = digits;
        }
    }

    fn names_of(&self, sealed: &Sealed) -> Vec<String> {
        let names = self.names.get_or_init(|| self.look_up());
        if sealed.readers().any(|id| !names.contains_key(&id)) {
            self.unknown.get_or_init(|| {
                console::note("note: this machine does not know the names of all readers: import their team with `dca team import`, or \
                               name the folder of your teams with `--keys`");
            });
        }
        sealed.readers().map(|id| names.get(&id).cloned().unwrap_or_else(|| format!("key {id}"))).collect()
    }

    fn look_up(&self) -> BTreeMap<KeyId, String> {
        let keyring = Keyring::at(self.keys.as_deref());
        let teams = keyring.and_then(|keyring| keyring.teams()?.iter().map(|name| keyring.team(name)).collect());
        let teams: Vec<Bundle> = teams.unwrap_or_else(|error| {
            console::note(&format!("note: the names of the readers are not known here: {error:#}"));
            Vec::new()
        });
        let mut names = BTreeMap::new();
        for bundle in &teams {
            let of_team = bundle.holders(::team::now()).into_iter().map(|holder| {
                let claims = holder.certificate.claims();
                let key = holder.certificate.subject();
                // The member may have new keys by now, which cannot open the secret.
                let state = if bundle.has_revoked(&key) { " (revoked key)" } else { "" };
                (key, format!("{}{state}", claims.name))
            });
            names.extend(of_team);
        }
        names
    }
}

/// Returns the sealed secret in a value; nothing if the value is not a secret.
pub(crate) fn sealed(datum: &Datum) -> Option<Sealed> {
    let Datum::Sealed(bytes) = datum else { return None };
    Sealed::from_bytes(bytes).ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use trust::identity::{Entropy, SecretKeys};
    use trust::seal::{Place, Secret};

    /// Returns a secret for two robots, and the phrase about it. Only the name of `r2` is known here.
    fn secret() -> (Readers, Datum, String) {
        let mut entropy = Entropy::new(&[7; 32]);
        let robots = [(), ()].map(|()| *SecretKeys::generate(&mut entropy).public());
        let place = Place { team: KeyId([1; 32]), path: "team/a" };
        let value = Secret::new(b"swordfish".to_vec().into()).unwrap();
        let sealed = Sealed::seal(&value, &place, &robots, &mut entropy).unwrap();
        let names = BTreeMap::from([(robots[0].id(), "r2".to_owned())]);
        let shown = sealed.readers().map(|id| names.get(&id).cloned().unwrap_or_else(|| format!("key {id}")));
        let said = format!("secret for {}, generation 1", shown.collect::<Vec<_>>().join(", "));
        (
            Readers { keys: None, names: OnceCell::from(names), unknown: OnceCell::new() },
            Datum::Sealed(sealed.to_bytes()),
            said,
        )
    }

    #[test]
    fn a_secret_is_a_phrase_wherever_it_lies() {
        let (readers, secret, said) = secret();
        assert_eq!(readers.text(&secret), said);
        let table = |name: &str, field: Datum| Datum::Table(BTreeMap::from([(name.to_owned(), field)]));
        assert_eq!(readers.text(&table("a", secret.clone())), format!("{{a = {said}}}"));
        let json = readers.json(serde_json::json!([1, { "value": secret, "by": "r1" }]));
        assert_eq!(json[1]["value"]["secret"]["generation"], 1);
        assert_eq!(json[1]["value"]["secret"]["for"].as_array().unwrap().len(), 2);
        assert_eq!((&json[0], &json[1]["by"]), (&1.into(), &"r1".into()));
        // A text that only looks like a secret is shown unchanged.
        let Datum::Sealed(bytes) = &secret else { panic!("it is sealed") };
        let cut = Datum::Sealed(bytes[1..].to_vec());
        let text = Datum::Text(secret.to_toml());
        for other in [cut, text.clone(), table("$sealed", text), Datum::List(vec!["{".into(), "$sealed".into()])] {
            assert_eq!(readers.text(&other), other.to_toml());
            assert_eq!(readers.json(serde_json::to_value(&other).unwrap()), serde_json::to_value(&other).unwrap());
        }
    }

    #[test]
    fn a_file_says_who_may_read_and_keeps_the_bytes() {
        let (readers, secret, said) = secret();
        let (value, mut file) = (secret.to_toml(), String::new());
        let lines =
            format!("[values]\n# 2 concurrent writes, also: {value}, 3\n\"team/a\" = {value}\n\"team/b\" = 1\n");
        readers.explain(&lines, &mut file);
        let expected = format!(
            "[values]\n# 2 concurrent writes, also: {said}, 3\n# {said}\n\"team/a\" = {value}\n\"team/b\" = 1\n"
        );
        assert_eq!(file, expected);
    }
}
