//! The owners of prefixes. Only the owner of a prefix writes below it, so a condition that holds at the owner holds for the
//! team.
//!
//! *State.* `sys/own/<prefix>` holds a *term* and the name of a robot, or no name if the prefix was released. Without such
//! a record, `robot/<name>/…` belongs to that robot with term 0. The longest matching prefix is used.
//!
//! *Rule.* Other robots refuse to write below the prefix, and name the owner, so that the request
//! can be sent to it. The owner may give the prefix to any robot. If the prefix has no owner, any
//! robot may give it to a robot. An operator may *take it over* by force. The term of each grant is
//! one above the term that its writer knows. Among grants that did not see each other, the larger
//! term wins, then the later timestamp.
//!
//! *Why no write passes unseen.* A robot that is cut off keeps writing after a takeover, or before the first owner.
//! Consider a write and a grant to another robot, neither of which has seen the other. Such a write is kept, and listed as
//! a race, for any clocks ([`races`](crate::logic::view::past::Past::races)). A write carries its *fence*, the condition
//! that its grant is still valid. So its writer's grant is known even if that robot returned and lost its context.
//!
//! *Why conditions at the owner are linearizable.* One robot commits one transaction at a time, and checks its conditions
//! on a state with all earlier transactions under the same term: its own. A later term begins at a replica that has seen
//! the release of the earlier one, and so all transactions under it. If an operator took the prefix over by force instead,
//! the races list the old owner's writes in the meantime.

use crate::logic::key::{Key, KeyError, Namespace};
use crate::logic::state::{State, Version};
use crate::logic::txn::{Encoding, Value};
use crate::logic::version_vector::Dot;
use std::collections::BTreeMap;

const OWN: &str = "sys/own/";

/// The grants of a prefix.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Owner {
    /// Goes up with each grant.
    pub term: u64,
    /// The robot that owns the prefix, if any.
    pub robot: Option<String>,
    /// The transaction that granted the prefix; none if it belongs to a robot by its name.
    pub grant: Option<Dot>,
}

/// The owners of all prefixes with a record.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Owners(BTreeMap<String, Owner>);

/// Returns the key with the record of a prefix, such as `team/arm`.
///
/// # Errors
/// If the result is not a key.
pub fn record(prefix: &Key) -> Result<Key, KeyError> {
    Key::new(format!("{OWN}{prefix}"))
}

/// Returns a record: a term, and the new owner of the prefix; none to release it.
pub fn grant(term: u64, robot: Option<&str>) -> Value {
    let text = format!("{term} {}", robot.unwrap_or_default());
    Value { encoding: Encoding::TEXT, bytes: text.trim_end().as_bytes().into() }
}

/// Returns the prefix whose record has this key; none if the key is not such a record.
pub fn prefix(record: &Key) -> Option<&str> {
    record.as_str().strip_prefix(OWN)
}

/// Returns the term of a record, and the owner of the prefix, if there is one.
pub fn read(record: &Value) -> Option<(u64, Option<String>)> {
    let text = std::str::from_utf8(&record.bytes).ok()?;
    let (term, robot) = text.split_once(' ').unwrap_or((text, ""));
    Some((term.parse().ok()?, Some(robot.to_owned()).filter(|robot| !robot.is_empty())))
}

/// Returns the prefixes of a key that may have a record, the shortest first, and the key itself.
pub fn prefixes(key: &Key) -> impl Iterator<Item = &str> {
    let text = key.as_str();
    text.match_indices('/').map(|(end, _)| end).chain([text.len()]).map(|end| &text[..end])
}

impl FromIterator<(String, Owner)> for Owners {
    fn from_iter<T: IntoIterator<Item = (String, Owner)>>(owners: T) -> Self {
        Self(owners.into_iter().collect())
    }
}

impl Owners {
    /// Reads the owners from a state.
    pub fn of(state: &State) -> Self {
        let standing = |versions: &[Version]| {
            let known = versions.iter().filter_map(|version| Some((version, read(version.value.as_ref()?)?)));
            let (version, (term, robot)) = known.max_by_key(|(version, (term, _))| (*term, version.stamp))?;
            Some(Owner { term, robot, grant: Some(version.dot) })
        };
        state.scan(OWN).filter_map(|(key, versions)| Some((prefix(key)?.to_owned(), standing(versions)?))).collect()
    }

    /// Returns the longest prefix of `key` that has an owner or a record, and the owner.
    pub fn find<'a>(&self, key: &'a Key) -> Option<(&'a str, Owner)> {
        let known = prefixes(key).filter_map(|prefix| Some((prefix, self.0.get(prefix)?.clone()))).last();
        known.or_else(|| {
            let Namespace::Robot(name) = key.namespace() else { return None };
            let prefix = prefixes(key).nth(1).unwrap_or(key.as_str());
            Some((prefix, Owner { term: 0, robot: Some(name.to_owned()), grant: None }))
        })
    }

    /// Returns every prefix with a record.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &Owner)> {
        self.0.iter().map(|(prefix, owner)| (prefix.as_str(), owner))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::clock::Timestamp;
    use crate::logic::version_vector::ReplicaId;

    fn state(records: &[(&str, &str, u64)]) -> State {
        let mut state = State::default();
        for (prefix, text, hlc) in records {
            let key = record(&Key::new(*prefix).unwrap()).unwrap();
            let origin = ReplicaId::new(*hlc);
            let value = Some(Value { encoding: Encoding::TEXT, bytes: text.as_bytes().into() });
            let version =
                Version { dot: Dot { origin, seq: 1 }, stamp: Timestamp { epoch: 0, hlc: *hlc, origin }, value };
            let mut versions = state.versions(&key).to_vec();
            versions.push(version);
            state.restore(key, versions);
        }
        state
    }

    #[test]
    fn the_longest_prefix_and_the_largest_term_count() {
        let owners = Owners::of(&state(&[
            ("team/arm", "2 r2", 1),
            ("team/arm", "1 r1", 9),
            ("team/arm/left", "1 r3", 2),
            ("team/free", "4", 3),
            ("robot/r5/leg", "1 r6", 4),
            ("team/bad", "x", 5),
        ]));
        let check = |key: &str, expected: Option<(&str, u64, Option<&str>)>| {
            let key = Key::new(key).unwrap();
            let found = owners.find(&key);
            let found = found.as_ref().map(|(prefix, owner)| (*prefix, owner.term, owner.robot.as_deref()));
            assert_eq!(found, expected, "{key}");
        };
        check("team/arm", Some(("team/arm", 2, Some("r2"))));
        check("team/arm/x", Some(("team/arm", 2, Some("r2"))));
        check("team/arm/left/x", Some(("team/arm/left", 1, Some("r3"))));
        check("team/army", None);
        check("team/free/x", Some(("team/free", 4, None)));
        check("robot/r5/x", Some(("robot/r5", 0, Some("r5"))));
        check("robot/r5/leg/x", Some(("robot/r5/leg", 1, Some("r6"))));
        check("team/bad/x", None);
        assert_eq!(
            Owners::of(&state(&[("a", "7 r", 1)])).find(&Key::new("a").unwrap()).unwrap().1.grant.unwrap().seq,
            1
        );
    }
}
