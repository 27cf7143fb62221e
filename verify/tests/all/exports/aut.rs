//! A reader of the Aldebaran format (`.aut`) that knows nothing about specs. It returns the number of states, and
//! whether one of them is a dead end.

/// A transition: the first state, the event, and the next state.
type Transition = (usize, String, usize);

/// Checks that an export has `states` states, and that it has a dead end exactly if `has_dead_end`. A dead end is a
/// state that does not end although nothing fails and no stop is requested.
pub(crate) fn check(text: &str, states: usize, has_dead_end: bool) -> Result<(), String> {
    let (count, all) = read(text)?;
    if count != states {
        return Err(format!("{count} states, not {states}"));
    }
    let ends = can_end(count, &all);
    let found = (1..count).any(|state| !ends[state]);
    if found == has_dead_end { Ok(()) } else { Err(format!("dead ends: {found}, not {has_dead_end}")) }
}

fn read(text: &str) -> Result<(usize, Vec<Transition>), String> {
    let mut lines = text.lines();
    let head = lines.next().and_then(|line| line.strip_prefix("des (0, ")?.strip_suffix(')'));
    let (count, states) = head.and_then(|head| head.split_once(", ")).ok_or("there is no head")?;
    let transition = |line: &str| {
        let (from, rest) = line.strip_prefix('(')?.split_once(", \"")?;
        let (word, to) = rest.strip_suffix(')')?.rsplit_once("\", ")?;
        Some((from.parse().ok()?, word.to_owned(), to.parse().ok()?))
    };
    let all: Option<Vec<Transition>> = lines.map(transition).collect();
    let all = all.ok_or("a line is not a transition")?;
    if count.parse() != Ok(all.len()) {
        return Err(format!("{} transitions, not {count}", all.len()));
    }
    Ok((states.parse().map_err(|why| format!("the number of states: {why}"))?, all))
}

/// Returns for each state whether a state without transitions can be reached from it, if nothing fails and no stop is
/// requested.
fn can_end(states: usize, all: &[Transition]) -> Vec<bool> {
    let mut ends = vec![true; states];
    all.iter().for_each(|(from, ..)| ends[*from] = false);
    let natural = |word: &str| ["start", "done(", "stopped(", "elapsed("].iter().any(|begin| word.starts_with(begin));
    loop {
        let before = ends.iter().filter(|end| **end).count();
        for (from, word, to) in all {
            ends[*from] |= natural(word) && ends[*to];
        }
        if ends.iter().filter(|end| **end).count() == before {
            return ends;
        }
    }
}
