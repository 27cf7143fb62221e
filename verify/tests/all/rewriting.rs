//! An independent author's reading of the rules, and what it says of `step` and of `verify`.

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
pub(crate) mod random;
mod rules;
mod stop;
mod term;
pub(crate) mod text;

/// As many random groups are run in the suite.
const GROUPS: u64 = 20_000;

#[test]
fn step_does_what_the_rules_say() {
    let differences: Vec<String> = (0..GROUPS).filter_map(|seed| against_step::compare(seed).err()).collect();
    assert!(differences.is_empty(), "{} differences, the first: {}", differences.len(), differences.join("\n"));
}

/// As many random specs are looked at by brute force; one in a few is refused by the check, and left out.
const SPECS: u64 = 20_000;
/// At least so many have to be left.
const SPECS_LEAST: usize = 10_000;

#[test]
fn verify_says_what_brute_force_says() {
    let mut same = 0;
    let mut differences = Vec::new();
    for seed in 0..SPECS {
        match against_verify::compare(seed) {
            against_verify::Compared::Same => same += 1,
            against_verify::Compared::LeftOut => {}
            against_verify::Compared::Differs(how) => differences.push(how),
        }
    }
    assert!(differences.is_empty(), "{} differences beside {same}: {}", differences.len(), differences.join("\n"));
    assert!(same >= SPECS_LEAST, "only {same} specs were compared");
}

/// As many random specs are asked a random formula; `FORMULAS=15000` in the environment asks more.
const FORMULAS: u64 = 2_000;
/// At least so many of three have to be left.
const FORMULAS_LEAST: u64 = 2;

#[test]
fn formulas_hold_where_brute_force_says_so() {
    let asked = std::env::var("FORMULAS").ok().and_then(|asked| asked.parse().ok()).unwrap_or(FORMULAS);
    let (mut holds, mut fails) = (0, 0);
    let mut differences = Vec::new();
    for seed in 0..asked {
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

/// As many random specs of two hosts are compared; `HOSTS=40000` in the environment compares more.
const HOSTS: u64 = 1_500;
/// At least so many of ten have to be left.
const HOSTS_LEAST: usize = 3;

#[test]
fn sentences_about_two_hosts_hold_where_brute_force_says_so() {
    let asked = std::env::var("HOSTS").ok().and_then(|asked| asked.parse().ok()).unwrap_or(HOSTS);
    let (mut specs, mut holds, mut fails) = (0, 0, 0);
    let mut differences = Vec::new();
    for seed in 0..asked {
        match against_hosts::compare(seed) {
            against_hosts::Compared::Same(hold, fail) => {
                (specs, holds, fails) = (specs + 1, holds + hold, fails + fail);
            }
            against_hosts::Compared::LeftOut => {}
            against_hosts::Compared::Differs(how) => differences.push(how),
        }
    }
    println!("{specs} specs, {holds} sentences hold, {fails} do not, {} differences", differences.len());
    assert!(differences.is_empty(), "{} differences beside {specs}: {}", differences.len(), differences[0]);
    assert!(specs >= usize::try_from(asked).unwrap_or(0) * HOSTS_LEAST / 10, "only {specs} specs were compared");
    assert!(holds > specs && fails > specs, "{holds} sentences hold, {fails} do not");
}

/// As many random groups are run with a clock; `TIMES=20000` in the environment runs more.
const TIMES: u64 = 4_000;

#[test]
fn no_run_takes_longer_than_what_is_proved() {
    let asked = std::env::var("TIMES").ok().and_then(|asked| asked.parse().ok()).unwrap_or(TIMES);
    let (mut proved, mut wrong) = (0, Vec::new());
    for seed in 0..asked {
        match against_times::compare(seed) {
            Ok(count) => proved += u64::from(count),
            Err(how) => wrong.push(how),
        }
    }
    println!("{proved} limits hold, {} do not", wrong.len());
    assert!(wrong.is_empty(), "{}: {}", wrong.len(), wrong[..wrong.len().min(6)].join("\n"));
    assert!(proved > asked / 4, "only {proved} limits hold");
}

/// As many random specs with groups in groups are compared; `FLAT=40000` in the environment compares more.
const FLAT: u64 = 1_500;
/// At least so many of ten have to be left.
const FLAT_LEAST: usize = 3;

#[test]
fn what_is_looked_at_alone_or_in_pieces_is_what_the_whole_does() {
    let asked = std::env::var("FLAT").ok().and_then(|asked| asked.parse().ok()).unwrap_or(FLAT);
    let first = std::env::var("FLAT_FIRST").ok().and_then(|first| first.parse().ok()).unwrap_or(0);
    let (mut specs, mut holds, mut fails, mut differences) = (0, 0, 0, Vec::new());
    for seed in first..first + asked {
        match against_flat::compare(seed) {
            against_flat::Compared::Same(hold, fail) => {
                (specs, holds, fails) = (specs + 1, holds + hold, fails + fail);
            }
            against_flat::Compared::LeftOut => {}
            against_flat::Compared::Differs(how) => differences.push(how),
        }
    }
    println!("{specs} specs, {holds} sentences hold, {fails} do not, {} differences", differences.len());
    let shown = differences.iter().take(3).cloned().collect::<Vec<_>>().join("\n");
    assert!(differences.is_empty(), "{} differences beside {specs}: {shown}", differences.len());
    assert!(specs >= usize::try_from(asked).unwrap_or(0) * FLAT_LEAST / 10, "only {specs} specs were compared");
    assert!(holds > specs && fails > specs, "{holds} sentences hold, {fails} do not");
}
