//! Plans that become others.

use super::*;
use crate::{Options, Source, compile};

const SPEC: &str = r#"
module Source(host, rate: Number = 1) { out Out: Number; service; }
module Sink(host) { in In: Number; in Other: Number; done; }
process Pair(here) {
host { here }
instantiated_processes { a instof Source(here); b instof Sink("c2"); }
internal_connections(a, feed) { a, Out -> b, In; }
internal_event_actions { a[feed] , b within 5 s }
}
process main() {
host { "c1" }
instantiated_processes { pair instof Pair("c1"); c instof Sink("c2"); }
internal_event_actions { pair ; c }
}
"#;

fn plan(text: &str) -> Plan {
    let compiled = compile(&Source::new("spec", text), &[], &Options::named("spec"));
    compiled.plan.unwrap_or_else(|| panic!("{:#?}", compiled.diagnostics))
}

fn changes(running: &Plan, text: &str) -> Result<Vec<String>, Vec<String>> {
    let found = difference(running, &plan(text))?;
    found.plan.validate().unwrap();
    Ok(found.changes.iter().map(ToString::to_string).collect())
}

#[test]
fn the_same_text_changes_nothing_whatever_its_lines_and_order_of_types() {
    let running = plan(SPEC);
    assert_eq!(changes(&running, SPEC), Ok(vec![]));
    assert_eq!(changes(&running, &format!("// one more line\n{SPEC}")), Ok(vec![]));
    let (modules, processes) = SPEC.split_at(SPEC.find("process Pair").unwrap());
    assert_eq!(changes(&running, &format!("{processes}{modules}")), Ok(vec![]));
}

#[test]
fn programs_and_policies_can_change_while_it_runs() {
    let running = plan(&SPEC.replace("Source(here);", "Source(here, 1);"));
    let replaced = changes(&running, &SPEC.replace("Source(here);", "Source(here, 2);"));
    assert_eq!(replaced, Ok(vec!["replace    main/pair/a: `rate` is 2, was 1".to_owned()]));
    let running = plan(SPEC);
    let permanent = SPEC.replace("Source(here);", "Source(here) { restart permanent; };");
    assert_eq!(changes(&running, &permanent), Ok(vec!["settle     main/pair/a: `restart`".to_owned()]));
    let slower = permanent.replace("permanent;", "permanent; backoff 1 s to 8 s;");
    assert_eq!(changes(&plan(&permanent), &slower), Ok(vec!["settle     main/pair/a: `backoff`".to_owned()]));
}

#[test]
fn what_a_reboot_does_can_change_while_it_runs() {
    let running = plan(SPEC);
    let resumed = SPEC.replace("process main() {", "process main() {\n    on_boot{resume}");
    assert_eq!(changes(&running, &resumed), Ok(vec!["act        main: `on_boot`".to_owned()]));
    assert_eq!(changes(&plan(&resumed), &resumed), Ok(vec![]));
}

#[test]
fn a_claim_that_changes_replaces_its_program() {
    let running = plan(&SPEC.replace("done; }", "done; claims leg; }"));
    let other = SPEC.replace("done; }", "done; claims leg(read); }");
    let lines = ["b", "c"].map(|leaf| match leaf {
        "b" => "replace    main/pair/b: its claims".to_owned(),
        _ => "replace    main/c: its claims".to_owned(),
    });
    assert_eq!(changes(&running, &other), Ok(lines.to_vec()));
}

#[test]
fn wires_that_stay_keep_their_numbers_and_new_ones_get_the_next() {
    let running = plan(SPEC);
    let text = SPEC.replace("{ a, Out -> b, In; }", "{ a, Out -> b, Other; a, Out -> b, In queue 4; }");
    let next = difference(&running, &plan(&text)).unwrap();
    let lines: Vec<String> = next.changes.iter().map(ToString::to_string).collect();
    let expected = [
        "disconnect main/pair/a, Out -> main/pair/b, In",
        "connect    main/pair/a, Out -> main/pair/b, Other",
        "connect    main/pair/a, Out -> main/pair/b, In queue 4",
    ];
    assert_eq!(lines, expected);
    assert_eq!((next.plan.wires.len(), next.plan.live_wires()), (3, BTreeSet::from([1, 2])));
    // A removed wire is not paired with a wire that is wanted again.
    let back = difference(&next.plan, &plan(SPEC)).unwrap();
    assert_eq!((back.changes.len(), back.plan.live_wires()), (3, BTreeSet::from([3])));
}

#[test]
fn what_cannot_change_is_told_and_all_of_it() {
    let running = plan(SPEC);
    let other = SPEC.replace("pair ; c", "pair , c").replace("b instof Sink(\"c2\")", "b instof Sink(\"c3\")");
    let other = other.replace("c instof", "d instof Sink(\"c4\"); c instof");
    let expected = [
        "`main/d` is on the host `c4`, which has no part in the running deployment; choose one of `c1`, `c2`",
        "`main/pair/b` moves from `c2` to `c3`",
    ];
    assert_eq!(changes(&running, &other), Err(expected.map(str::to_owned).to_vec()));
    let ordered = |text: &str| {
        text.replace(
            "internal_event_actions { pair",
            "supervision { strategy rest_for_one; }\n    internal_event_actions { pair",
        )
    };
    let swapped = SPEC.replace(
        "pair instof Pair(\"c1\"); c instof Sink(\"c2\");",
        "c instof Sink(\"c2\"); pair instof Pair(\"c1\");",
    );
    assert_eq!(changes(&running, &swapped), Ok(vec![]));
    let why = "the processes of `main` have another order, which `rest_for_one` uses; stop `spec` first";
    assert_eq!(changes(&plan(&ordered(SPEC)), &ordered(&swapped)), Err(vec![why.to_owned()]));
}

#[test]
fn processes_come_and_go_and_those_that_stay_keep_their_numbers() {
    let running = plan(SPEC);
    let text = SPEC
        .replace("c instof", "d instof Pair(\"c1\"); c instof")
        .replace("a instof Source(here);", "a instof Source(here); e instof Sink(here);")
        .replace("{ a, Out -> b, In; }", "{ a, Out -> e, In; }")
        .replace("a[feed] , b within 5 s", "a[feed] , e")
        .replace("b instof Sink(\"c2\");", "")
        .replace("pair ; c", "(pair , d) ; c");
    let next = difference(&running, &plan(&text)).unwrap();
    next.plan.validate().unwrap();
    let lines: Vec<String> = next.changes.iter().map(ToString::to_string).collect();
    let expected = [
        "add        main/pair/e: Sink on `c1`",
        "remove     main/pair/b",
        "add        main/d/a: Source on `c1`",
        "add        main/d/e: Sink on `c1`",
        "act        main: its event actions",
        "act        main/pair: its event actions",
        "disconnect main/pair/a, Out -> main/pair/b, In",
        "connect    main/pair/a, Out -> main/pair/e, In",
        "connect    main/d/a, Out -> main/d/e, In",
    ];
    let sorted = |mut lines: Vec<String>| {
        lines.sort();
        lines
    };
    assert_eq!(sorted(lines), sorted(expected.map(str::to_owned).to_vec()));
    let paths = |plan: &Plan| plan.leaves.iter().map(|leaf| leaf.path.clone()).collect::<Vec<_>>();
    assert_eq!(paths(&next.plan)[..3], paths(&running));
    assert_eq!(next.plan.live_leaves().len(), 5);
    // The same text again changes nothing, and a returning process has its earlier numbers.
    assert_eq!(changes(&next.plan, &text), Ok(vec![]));
    let back = difference(&next.plan, &running).unwrap();
    assert_eq!((back.plan.leaves.len(), back.plan.groups[1].members.len()), (next.plan.leaves.len(), 3));
    assert_eq!(back.plan.groups[1].expression, running.groups[1].expression);
    assert_eq!(changes(&back.plan, SPEC), Ok(vec![]));
}

/// The next program of `a` is a separate leaf, with separate wires; the person sees one line.
#[test]
fn a_program_that_overlaps_gets_a_leaf_and_wires_of_its_own() {
    let overlaps = |rate: &str| {
        SPEC.replace("Source(here);", &format!("Source(here, {rate}) {{ replace overlap; }};")).replace("};;", "}")
    };
    let running = plan(&overlaps("1"));
    let next = difference(&running, &plan(&overlaps("2"))).unwrap();
    next.plan.validate().unwrap();
    let lines: Vec<String> = next.changes.iter().map(ToString::to_string).collect();
    assert_eq!(lines, ["replace    main/pair/a: `rate` is 2, was 1; the two overlap"]);
    let (old, new) = (running.live_leaves(), next.plan.live_leaves());
    assert_eq!((old.difference(&new).count(), new.difference(&old).copied().collect::<Vec<_>>()), (1, vec![3]));
    assert_eq!((next.plan.live_wires(), next.plan.wires[1].from.leaf), (BTreeSet::from([1]), 3));
    assert_eq!(next.plan.groups[1].members[0].kind, MemberKind::Leaf(3));
    assert_eq!(difference(&next.plan, &plan(&overlaps("2"))).unwrap().changes, []);

    // Taken back, all is as before, and the numbers that were given out stay so.
    let back = next.plan.back_to(&running);
    back.validate().unwrap();
    assert_eq!((back.live_leaves(), back.live_wires()), (old.clone(), BTreeSet::from([0])));
    assert_eq!((back.leaves.len(), back.wires.len(), &back.groups), (4, 2, &running.groups));

    // Restarted, it alternates between two leaves; a process that does not overlap needs no other plan.
    let all = BTreeSet::from([0, 1, 2]);
    let anew = difference_with(&running, &running, &all).unwrap();
    let lines: Vec<String> = anew.changes.iter().map(ToString::to_string).collect();
    assert_eq!(lines, ["replace    main/pair/a: started again; the two overlap"]);
    let again = difference_with(&anew.plan, &anew.plan, &anew.plan.live_leaves()).unwrap();
    assert_eq!((again.changes.len(), again.plan.leaves.len(), again.plan.live_leaves()), (1, 4, old));

    // The wanted plan decides how; a policy alone replaces nothing.
    let settled = changes(&plan(SPEC), &SPEC.replace("Source(here);", "Source(here) { replace overlap; }"));
    assert_eq!(settled, Ok(vec!["settle     main/pair/a: `replace`".to_owned()]));
    let ended = changes(&running, &SPEC.replace("Source(here);", "Source(here, 2);"));
    assert_eq!(ended, Ok(vec!["replace    main/pair/a: `rate` is 2, was 1, `replace`".to_owned()]));
}
