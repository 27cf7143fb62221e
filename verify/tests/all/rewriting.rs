//! Compares an independent author's reading of the rules with `step` and `verify`.

mod against_faults;
mod against_flat;
mod against_formula;
mod against_hosts;
mod against_loss;
mod against_step;
mod against_times;
mod against_verify;
mod completion;
mod explore;
mod graph;
mod hosts;
mod order;
pub(crate) mod random;
mod rules;
mod stop;
mod term;
pub(crate) mod text;
mod timed;

use std::ops::Range;

// Each comparison runs on two ranges of seeds: about a tenth in the quick tests, the others in the long ones.

#[test]
fn step_does_what_the_rules_say() {
    compare_steps(0..2_000);
}

#[test]
#[ignore = "long: 18,000 groups"]
fn step_does_what_the_rules_say_in_more_groups() {
    compare_steps(2_000..20_000);
}

fn compare_steps(seeds: Range<u64>) {
    let differences: Vec<String> = seeds.filter_map(|seed| against_step::compare(seed).err()).collect();
    assert!(differences.is_empty(), "{} differences, the first: {}", differences.len(), differences.join("\n"));
}

#[test]
fn verify_says_what_brute_force_says() {
    compare_verdicts(0..1_500);
}

#[test]
#[ignore = "long: 18,500 specs"]
fn verify_says_what_brute_force_says_of_more_specs() {
    compare_verdicts(1_500..20_000);
}

/// The check refuses one spec in a few. Such a spec is left out.
fn compare_verdicts(seeds: Range<u64>) {
    let asked = seeds.end - seeds.start;
    let mut same = 0;
    let mut differences = Vec::new();
    for seed in seeds {
        match against_verify::compare(seed) {
            against_verify::Compared::Same => same += 1,
            against_verify::Compared::LeftOut => {}
            against_verify::Compared::Differs(how) => differences.push(how),
        }
    }
    assert!(differences.is_empty(), "{} differences beside {same}: {}", differences.len(), differences.join("\n"));
    assert!(same * 2 >= asked, "only {same} specs were compared");
}

/// Of three seeds, at least so many have to give a comparison.
const FORMULAS_LEAST: u64 = 2;

#[test]
fn formulas_hold_where_brute_force_says_so() {
    compare_formulas(0..300);
}

#[test]
#[ignore = "long: 14,700 formulas"]
fn more_formulas_hold_where_brute_force_says_so() {
    compare_formulas(300..15_000);
}

fn compare_formulas(seeds: Range<u64>) {
    let asked = seeds.end - seeds.start;
    let (mut holds, mut fails) = (0, 0);
    let mut differences = Vec::new();
    for seed in seeds {
        match against_formula::compare(seed) {
            against_formula::Compared::Same(true) => holds += 1,
            against_formula::Compared::Same(false) => fails += 1,
            against_formula::Compared::LeftOut => {}
            against_formula::Compared::Differs(how) => differences.push(how),
        }
    }
    assert!(differences.is_empty(), "{} differences, the first: {}", differences.len(), differences[0]);
    assert!(holds + fails >= asked * FORMULAS_LEAST / 3, "only {} formulas were compared", holds + fails);
    assert!(holds > asked / 10 && fails > asked / 10, "{holds} hold, {fails} do not");
}

/// Of ten seeds, at least so many have to give a comparison.
const HOSTS_LEAST: usize = 3;

#[test]
fn sentences_about_two_hosts_hold_where_brute_force_says_so() {
    compare_hosts(0..200);
}

#[test]
#[ignore = "long: 9,800 specs of two hosts"]
fn sentences_about_two_hosts_hold_in_more_specs() {
    compare_hosts(200..10_000);
}

fn compare_hosts(seeds: Range<u64>) {
    let asked = seeds.end - seeds.start;
    let (mut specs, mut holds, mut fails) = (0, 0, 0);
    let mut differences = Vec::new();
    for seed in seeds {
        match against_hosts::compare(seed) {
            against_hosts::Compared::Same(hold, fail) => {
                (specs, holds, fails) = (specs + 1, holds + hold, fails + fail);
            }
            against_hosts::Compared::LeftOut => {}
            against_hosts::Compared::Differs(how) => differences.push(how),
        }
    }
    assert!(differences.is_empty(), "{} differences beside {specs}: {}", differences.len(), differences[0]);
    assert!(specs >= usize::try_from(asked).unwrap_or(0) * HOSTS_LEAST / 10, "only {specs} specs were compared");
    assert!(holds > specs && fails > specs, "{holds} sentences hold, {fails} do not");
}

/// The verifier knows an order of timers only if each real clock keeps it.
#[test]
fn every_run_with_a_clock_is_one_of_the_verifier() {
    compare_clocks(0..150);
}

#[test]
#[ignore = "long: 5,850 groups with a clock"]
fn every_run_of_more_groups_with_a_clock_is_one_of_the_verifier() {
    compare_clocks(150..6_000);
}

fn compare_clocks(seeds: Range<u64>) {
    let asked = seeds.end - seeds.start;
    let (mut timers, mut wrong) = (0, Vec::new());
    for seed in seeds {
        match timed::compare(seed) {
            Ok(elapsed) => timers += elapsed,
            Err(how) => wrong.push(how),
        }
    }
    assert!(wrong.is_empty(), "{}: {}", wrong.len(), wrong[..wrong.len().min(3)].join("\n"));
    assert!(timers > asked, "only {timers} timers elapsed");
}

#[test]
fn no_run_takes_longer_than_what_is_proved() {
    compare_times(0..500);
}

#[test]
#[ignore = "long: 19,500 groups with a clock"]
fn no_run_of_more_groups_takes_longer_than_what_is_proved() {
    compare_times(500..20_000);
}

fn compare_times(seeds: Range<u64>) {
    let asked = seeds.end - seeds.start;
    let (mut proved, mut wrong) = (0, Vec::new());
    for seed in seeds {
        match against_times::compare(seed) {
            Ok(count) => proved += u64::from(count),
            Err(how) => wrong.push(how),
        }
    }
    assert!(wrong.is_empty(), "{}: {}", wrong.len(), wrong[..wrong.len().min(6)].join("\n"));
    assert!(proved > asked / 4, "only {proved} limits hold");
}

/// Of ten seeds, at least so many have to give a comparison.
const FLAT_LEAST: usize = 3;

#[test]
fn what_is_looked_at_alone_or_in_pieces_is_what_the_whole_does() {
    compare_wholes(0..300);
}

#[test]
#[ignore = "long: 9,700 specs with groups in groups"]
fn what_is_looked_at_in_pieces_is_what_the_whole_does_in_more_specs() {
    compare_wholes(300..10_000);
}

fn compare_wholes(seeds: Range<u64>) {
    let asked = seeds.end - seeds.start;
    let (mut specs, mut holds, mut fails, mut differences) = (0, 0, 0, Vec::new());
    for seed in seeds {
        match against_flat::compare(seed) {
            against_flat::Compared::Same(hold, fail) => {
                (specs, holds, fails) = (specs + 1, holds + hold, fails + fail);
            }
            against_flat::Compared::LeftOut => {}
            against_flat::Compared::Differs(how) => differences.push(how),
        }
    }
    let shown = differences.iter().take(3).cloned().collect::<Vec<_>>().join("\n");
    assert!(differences.is_empty(), "{} differences beside {specs}: {shown}", differences.len());
    assert!(specs >= usize::try_from(asked).unwrap_or(0) * FLAT_LEAST / 10, "only {specs} specs were compared");
    assert!(holds > specs && fails > specs, "{holds} sentences hold, {fails} do not");
}

/// Of ten seeds, at least so many have to give a comparison.
const FAULTS_LEAST: u64 = 4;

#[test]
fn a_fault_does_what_brute_force_says() {
    compare_faults(0..200);
}

#[test]
#[ignore = "long: 9,800 specs with each fault"]
fn a_fault_does_what_brute_force_says_in_more_specs() {
    compare_faults(200..10_000);
}

fn compare_faults(seeds: Range<u64>) {
    let asked = seeds.end - seeds.start;
    let (mut specs, mut all, mut of_limits, mut differences) = (0, 0, 0, Vec::new());
    for seed in seeds {
        match against_faults::compare(seed) {
            against_faults::Compared::Same { rows, caught } => {
                (specs, all, of_limits) = (specs + 1, all + rows, of_limits + caught);
            }
            against_faults::Compared::LeftOut => {}
            against_faults::Compared::Differs(how) => differences.push(how),
        }
    }
    let shown = differences.iter().take(3).cloned().collect::<Vec<_>>().join("\n");
    assert!(differences.is_empty(), "{} differences beside {specs}: {shown}", differences.len());
    assert!(specs >= asked * FAULTS_LEAST / 10, "only {specs} specs were compared");
    assert!(of_limits > all / 20, "a limit leads to success in {of_limits} of {all} rows");
}

#[test]
fn no_row_of_a_loss_contradicts_a_sentence() {
    compare_losses(0..150);
}

#[test]
#[ignore = "long: 9,850 specs on two hosts"]
fn no_row_of_a_loss_contradicts_a_sentence_in_more_specs() {
    compare_losses(150..10_000);
}

fn compare_losses(seeds: Range<u64>) {
    let asked = seeds.end - seeds.start;
    let (mut rows, mut differences) = (0, Vec::new());
    for seed in seeds {
        match against_faults::compare_loss(seed) {
            Ok(count) => rows += count.unwrap_or(0),
            Err(how) => differences.push(how),
        }
    }
    let shown = differences.iter().take(3).cloned().collect::<Vec<_>>().join("\n");
    assert!(differences.is_empty(), "{} differences in {rows} rows: {shown}", differences.len());
    assert!(rows as u64 > asked, "only {rows} rows were compared");
}
