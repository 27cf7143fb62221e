//! Suggests a known name in place of an unknown one.

use crate::logic::process_name::{DeploymentName, ProcessName};
use node::logic::protocol::Deployment;
use std::collections::BTreeSet;

/// Returns the deployment that the user may have meant: another run of the same name, or the most similar name.
pub(crate) fn deployment<'a>(
    name: &DeploymentName,
    known: impl Iterator<Item = &'a Deployment> + Clone,
) -> Option<String> {
    let latest = known.clone().filter(|one| name.is_called(&one.name)).max();
    let similar = || language::nearest(name.plain(), known.map(|one| one.name.as_str())).map(str::to_owned);
    latest.map(ToString::to_string).or_else(similar)
}

/// Returns the process that the user may have meant, in a form that the user can write.
pub(crate) fn process<'a>(
    name: &ProcessName,
    known: impl Iterator<Item = (&'a Deployment, &'a str)> + Clone,
) -> Option<String> {
    let wanted = name.process().unwrap_or_default();
    let named = name.deployment();
    if let Some(named) = named.filter(|named| !known.clone().any(|(deployment, _)| named.is(deployment))) {
        return deployment(named, known.map(|(deployment, _)| deployment)).map(|near| format!("{near}:{wanted}"));
    }
    let here = known.filter(|(deployment, _)| named.is_none_or(|named| named.is(deployment)));
    let ends: BTreeSet<&str> = here.flat_map(|(_, path)| ends(path)).collect();
    let near = language::nearest(wanted, ends)?;
    Some(named.map_or_else(|| near.to_owned(), |named| format!("{named}:{near}")))
}

/// Returns a path and all of its ends.
fn ends(path: &str) -> impl Iterator<Item = &str> {
    std::iter::once(path).chain(path.match_indices('/').map(|(at, _)| &path[at + 1..]))
}

/// Returns the second half of a sentence that says that a name is unknown.
pub(crate) fn question(near: Option<String>, otherwise: &str) -> String {
    near.map_or_else(|| otherwise.to_owned(), |near| format!("did you mean `{near}`?"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slip_in_a_name_is_found() {
        let deployments = [("door", 1), ("door", 2), ("patrol", 7)];
        let deployments = deployments.map(|(name, epoch)| Deployment { name: name.into(), epoch });
        let near = |text: &str| deployment(&DeploymentName::parse(text).unwrap(), deployments.iter());
        assert_eq!(near("patrl").as_deref(), Some("patrol"));
        assert_eq!(near("patrl@7").as_deref(), Some("patrol"));
        assert_eq!(near("door@9").as_deref(), Some("door@2"), "another run of it");
        assert_eq!(near("window"), None);

        let [_, door, patrol] = &deployments;
        let paths = [(door, "main/hit/force"), (door, "main/arm"), (patrol, "main/base")];
        let near = |text: &str| process(&ProcessName::new(text), paths.iter().copied());
        assert_eq!(near("forse").as_deref(), Some("force"));
        assert_eq!(near("hit/forse").as_deref(), Some("hit/force"));
        assert_eq!(near("door:bas"), None, "it is none of this deployment");
        assert_eq!(near("patrol:bsae").as_deref(), Some("patrol:base"));
        assert_eq!(near("patrl:base").as_deref(), Some("patrol:base"));
        assert_eq!(question(near("x"), "`dca status` lists all"), "`dca status` lists all");
    }
}
