//! Pairs of faults that are worse together than each fault alone.

use super::{Row, Severity, Strike, Table, Target, of_strikes, rank, strikes, table};
use crate::explore::{Limits, WorkDone};
use crate::times::Times;
use std::collections::BTreeMap;

/// Explores each pair of faults of different programs, and each loss of a host together with a fault of a program, in
/// every order and at any time. A pair has one row: the worst over all phases. It has no row if one of the two faults
/// alone is as bad in the same phase. If that fault cannot happen in this phase, its other phases are compared.
pub(crate) fn pairs(times: &Times<'_, '_>, limits: &Limits<'_>) -> Table {
    let singles = table(times, limits);
    let mut pairs = Table { unfinished: singles.unfinished, states: singles.states, ..Table::default() };
    let mut alone: BTreeMap<(&str, &str), Severity> = BTreeMap::new();
    let mut in_phase: BTreeMap<(&str, &str, &str), Severity> = BTreeMap::new();
    for row in &singles.rows {
        in_phase.insert((&row.program, &row.fault, &row.phase), row.severity);
        let worst = alone.entry((&row.program, &row.fault)).or_insert(row.severity);
        *worst = row.severity.max(*worst);
    }
    let severity = |strike: &Strike, phase: &str| {
        let fault = (strike.name.as_str(), strike.kind.word());
        in_phase.get(&(fault.0, fault.1, phase)).or_else(|| alone.get(&fault)).copied()
    };
    let strikes = strikes(times.model);
    let with_others = |(index, one)| strikes[index + 1..].iter().map(move |other| (one, other));
    let is_pair = |(one, other): &(&Strike, &Strike)| {
        one.name != other.name && !matches!((one.target, other.target), (Target::Host(_), Target::Host(_)))
    };
    let all: Vec<(&Strike, &Strike)> = strikes.iter().enumerate().flat_map(with_others).filter(is_pair).collect();
    for (done, (one, other)) in all.iter().copied().enumerate() {
        limits.goes_on.hear(WorkDone::Jobs { what: "pairs of faults", done, of: all.len() });
        let mut found = Table::default();
        of_strikes(times, &[one, other], limits, &mut found);
        pairs.states += found.states;
        if !found.unfinished.is_empty() {
            pairs.unfinished.append(&mut found.unfinished);
            continue;
        }
        let is_worse = |row: &Row| [one, other].into_iter().all(|it| severity(it, &row.phase) < Some(row.severity));
        let rows = found.rows.into_iter().filter(is_worse);
        let bad = |row: &Row| rank(row.severity, row.safe_within);
        let worse = rows.reduce(|worst, row| if bad(&row) > bad(&worst) { row } else { worst });
        match worse {
            Some(row) => pairs.rows.push(row),
            None => pairs.harmless += 1,
        }
    }
    pairs
}
