//! Compares brute force with the answers of `verify` about the loss of a host.

use super::graph::{Kind, Seat};
use super::hosts::{Fate, Links, Loss, Tags, explore_loss};
use language::plan::{MemberKind, Plan};
use verify::{Finding, Story, Verdict};

/// Compares whether a member may start once `c2` has died or is cut off. The test does not compare failures after `c2`
/// has lost only its programs.
pub(crate) fn never_after_loss((plan, tags): (&Plan, &Tags), who: Seat, finding: &Finding) -> Option<String> {
    let host = (0_u32..).zip(&plan.hosts).find(|(_, name)| *name == "c2").map(|(host, _)| host)?;
    if has_using(plan) {
        return None;
    }
    let fails = finding.verdict == Verdict::Fails;
    let may_start = as_verified(fails, |links| {
        let mut may_start = false;
        for fate in [Fate::Dead, Fate::Cut] {
            let graph = explore_loss(plan, tags, Loss { host, fate }, links)?;
            may_start |=
                graph.objects(|_, happened, seen| match seen.is_lost && happened.contains(&(who, Kind::Started)) {
                    true => Err(()),
                    false => Ok(false),
                });
        }
        Some(may_start)
    })?;
    let story = finding.story.as_ref().map(|story| Story::lines(story).join("\n")).unwrap_or_default();
    let is_other = fails && story.contains("LOSES ALL ITS PROGRAMS");
    let differs = may_start != fails && !is_other;
    differs.then(|| format!("`{}`: it may start: {may_start} by brute force\n{story}", finding.sentence))
}

/// Asks a question about each order of messages. The verifier does not follow every message, so messages about one member may
/// overtake messages about another member, if this is the answer of the verifier.
fn as_verified(is_verified: bool, ask: impl Fn(Links) -> Option<bool>) -> Option<bool> {
    match ask(Links::InOrder)? {
        false if is_verified => ask(Links::EachMember),
        is_so => Some(is_so),
    }
}

fn has_using(plan: &Plan) -> bool {
    plan.groups.iter().any(|group| format!("{:?}", group.expression).contains("Using"))
}

/// Compares the assumption below a proof that two members never run at the same time: whether they may once a host has
/// died or is cut off. The test leaves out specs that take resources with `using`, since those resources stay taken.
pub(crate) fn loss_difference((plan, tags): (&Plan, &Tags), (a, b): (Seat, Seat), finding: &Finding) -> Option<String> {
    let is_group =
        |(group, slot): Seat| matches!(plan.groups[group as usize].members[slot as usize].kind, MemberKind::Group(_));
    if is_group(a) || is_group(b) || has_using(plan) {
        return None;
    }
    let may_run = as_verified(finding.assumes.is_some(), |links| {
        let mut may_run = false;
        for host in 0..u32::try_from(plan.hosts.len()).expect("few hosts") {
            for fate in [Fate::Dead, Fate::Cut] {
                let graph = explore_loss(plan, tags, Loss { host, fate }, links)?;
                may_run |= graph.seen.iter().any(|seen| seen.active.contains(&a) && seen.active.contains(&b));
            }
        }
        Some(may_run)
    })?;
    let story = finding.assumes.as_ref().and_then(|it| it.story.as_ref()).map(|story| Story::lines(story).join("\n"));
    (may_run != finding.assumes.is_some()).then(|| {
        format!(
            "`{}`: after a loss both may run: {may_run} by brute force, {:?}\n{}",
            finding.sentence,
            finding.assumes.as_ref().map(|it| &it.text),
            story.unwrap_or_default()
        )
    })
}
