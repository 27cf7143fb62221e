//! Measures how similar two names look.

use std::collections::BTreeSet;

/// The cost of one edit. Replacing a letter by a similar letter, or by the other case, costs less.
const EDIT: usize = 10;
const LOOK_ALIKE: usize = 1;
const CASE: usize = 2;
/// The largest number of characters of a name that are compared.
const LENGTH_MAX: usize = 64;

/// The number of names that are offered in addition to the nearest name.
const OTHERS_MAX: usize = 2;

/// The candidates that look like a name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Near<'a> {
    /// The nearest name.
    pub(crate) name: &'a str,
    /// The next nearest names.
    pub(crate) others: Vec<&'a str>,
    /// Whether the nearest name, and no other candidate, differs only in case and `_`.
    pub(crate) is_same: bool,
}

/// Returns the candidate that looks most like `name`, if it is near enough: at most a third of the letters may differ.
pub fn nearest<'a>(name: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    near(name, candidates).map(|near| near.name)
}

/// Returns the candidates that look most like `name`, if any of them is near enough.
pub(crate) fn near<'a>(name: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<Near<'a>> {
    let name_length = length(name);
    // The name itself is left out, because a word in the wrong place is not a misspelling of itself.
    let similar = candidates.into_iter().filter(|candidate| *candidate != name).filter_map(|candidate| {
        let length = length(candidate);
        let (shorter, longer) = (length.min(name_length), length.max(name_length));
        if (longer - shorter) * 3 > longer {
            return None;
        }
        let distance = distance_within(name, candidate, longer * EDIT / 3)?;
        Some((distance, candidate))
    });
    let mut found: Vec<(usize, &str)> = similar.collect();
    found.sort_by_key(|&(distance, _)| distance);
    let mut known = BTreeSet::new();
    let names: Vec<&str> = found.into_iter().map(|(_, name)| name).filter(|name| known.insert(*name)).collect();
    let is_like = |candidate: &str| folded(candidate).eq(folded(name));
    let like = names.iter().filter(|candidate| is_like(candidate)).count();
    let is_same = like == 1 && names.first().is_some_and(|first| is_like(first));
    let mut names = names.into_iter();
    Some(Near { name: names.next()?, others: names.take(OTHERS_MAX).collect(), is_same })
}

/// Returns a name without upper case and without `_`.
pub(crate) fn fold(name: &str) -> String {
    folded(name).collect()
}

fn folded(name: &str) -> impl Iterator<Item = char> {
    name.chars().filter(|&c| c != '_').flat_map(char::to_lowercase)
}

/// Returns how many pairs of letters a comparison uses, at least one.
pub(crate) fn effort(name: &str, candidate: &str) -> usize {
    1 + name.len().min(LENGTH_MAX) * candidate.len().min(LENGTH_MAX)
}

/// Returns how many letters of a name are compared.
fn length(name: &str) -> usize {
    name.chars().take(LENGTH_MAX).count()
}

/// Returns the Damerau-Levenshtein distance in tenths of an edit. A swap of adjacent letters is one edit. Characters that look alike are
/// nearly equal: `lb11` and `lbl1` differ by 1.
fn distance(one: &str, other: &str) -> usize {
    distance_within(one, other, usize::MAX).unwrap_or(usize::MAX)
}

/// Returns the same distance, or none if it is greater than `most`. A spec with a thousand mistakes is compared at each keystroke. So this
/// function allocates nothing, and stops at the first row that is too far away.
fn distance_within(one: &str, other: &str, most: usize) -> Option<usize> {
    let (one, other) = (&letters(one), &letters(other));
    let ((one, rows), (other, columns)) = ((&one.0, one.1), (&other.0, other.1));
    let mut before_last = [0; LENGTH_MAX + 1];
    let mut last: [usize; LENGTH_MAX + 1] = std::array::from_fn(|column| column * EDIT);
    for row in 1..=rows {
        let mut current = [0; LENGTH_MAX + 1];
        current[0] = row * EDIT;
        let mut least = current[0];
        for column in 1..=columns {
            let replace = last[column - 1] + cost(one[row - 1], other[column - 1]);
            let mut best = replace.min(last[column] + EDIT).min(current[column - 1] + EDIT);
            let is_swap =
                row > 1 && column > 1 && one[row - 1] == other[column - 2] && one[row - 2] == other[column - 1];
            if is_swap {
                best = best.min(before_last[column - 2] + EDIT);
            }
            current[column] = best;
            least = least.min(best);
        }
        // A swap uses the row before the previous row, so both rows must be too far away.
        if least > most && last[..=columns].iter().all(|distance| *distance > most) {
            return None;
        }
        before_last = std::mem::replace(&mut last, current);
    }
    Some(last[columns]).filter(|distance| *distance <= most)
}

/// Returns the letters of a name that are compared, and their number.
fn letters(name: &str) -> ([char; LENGTH_MAX], usize) {
    let (mut letters, mut count) = (['\0'; LENGTH_MAX], 0);
    for (place, letter) in letters.iter_mut().zip(name.chars()) {
        *place = letter;
        count += 1;
    }
    (letters, count)
}

/// Returns the common shape of letters that look like this letter, if there are any.
fn shape(letter: char) -> Option<char> {
    match letter {
        'l' | '1' | 'I' | '|' => Some('l'),
        'O' | '0' | 'o' => Some('o'),
        'S' | '5' => Some('s'),
        'B' | '8' => Some('b'),
        'Z' | '2' => Some('z'),
        '-' | '_' => Some('-'),
        _ => None,
    }
}

fn cost(one: char, other: char) -> usize {
    let is_ascii = one.is_ascii() && other.is_ascii();
    if one == other {
        0
    } else if shape(one).is_some() && shape(one) == shape(other) {
        LOOK_ALIKE
    } else if one.eq_ignore_ascii_case(&other) || !is_ascii && one.to_lowercase().eq(other.to_lowercase()) {
        CASE
    } else {
        EDIT
    }
}

/// Returns a name with hyphens between its letters: `l-b-1-1`. It is for two names that a reader cannot distinguish.
pub(crate) fn spell(name: &str) -> String {
    name.chars().map(String::from).collect::<Vec<_>>().join("-")
}

/// Returns whether two names differ only by characters that look alike.
pub(crate) fn is_look_alike(one: &str, other: &str) -> bool {
    one != other
        && one.chars().count() == other.chars().count()
        && distance(one, other) < CASE * one.chars().count().min(4)
        && one.chars().zip(other.chars()).all(|(a, b)| cost(a, b) <= LOOK_ALIKE)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(name: &str, candidates: &[&str], expect: Option<&str>) {
        assert_eq!(nearest(name, candidates.iter().copied()), expect, "{name}");
    }

    #[test]
    fn look_alikes_come_first() {
        check("lbl1", &["lbl2", "lb11"], Some("lb11"));
        check("compilant", &["forcedata", "compliant", "puma"], Some("compliant"));
        check("puma", &["hit", "force"], None);
        check("Hit", &["hit", "bit"], Some("hit"));
        check("", &["a"], None);
        assert_eq!(distance("ca", "ac"), EDIT);
        for (one, other) in [("leaf3", "leaf4x"), ("ca", "ac"), ("approach", "aproahc"), ("", "abc"), ("abcdef", "")] {
            let whole = distance(one, other);
            assert_eq!(distance_within(one, other, whole), Some(whole), "{one} {other}");
            assert_eq!(distance_within(one, other, whole.saturating_sub(1)), None, "{one} {other}");
        }
        assert!(is_look_alike("lb11", "lbl1"));
        assert!(!is_look_alike("lb11", "lb12"));
    }
}
