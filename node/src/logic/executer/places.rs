//! The hosts and the names of the processes of a plan.

use crate::logic::protocol::Target;
use language::plan::{Group, MemberKind, Plan};

/// Returns the name of the host of a leaf.
pub fn leaf_host(plan: &Plan, leaf: u32) -> Option<&str> {
    let host = plan.leaves.get(leaf as usize)?.host;
    plan.hosts.get(host as usize).map(String::as_str)
}

/// Returns the name of the host of a group's supervisor.
pub fn group_host(plan: &Plan, group: u32) -> Option<&str> {
    let host = plan.groups.get(group as usize)?.host;
    plan.hosts.get(host as usize).map(String::as_str)
}

pub(super) fn member_target<'a>(plan: &'a Plan, group: &Group, slot: u32) -> Option<(Target, &'a str)> {
    match group.members.get(slot as usize)?.kind {
        MemberKind::Leaf(leaf) => Some((Target::Leaf(leaf), leaf_host(plan, leaf)?)),
        MemberKind::Group(group) => Some((Target::Group(group), group_host(plan, group)?)),
    }
}

pub(super) fn member_host<'a>(plan: &'a Plan, group: &Group, slot: u32) -> Option<&'a str> {
    member_target(plan, group, slot).map(|(_, host)| host)
}

/// Returns the absolute path of a member.
pub fn member_path(plan: &Plan, group: &Group, slot: u32) -> Option<String> {
    match group.members.get(slot as usize)?.kind {
        MemberKind::Leaf(leaf) => plan.leaves.get(leaf as usize).map(|leaf| leaf.path.clone()),
        MemberKind::Group(group) => plan.groups.get(group as usize).map(|group| group.path.clone()),
    }
}
