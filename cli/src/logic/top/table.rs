//! A table that fits into a terminal: one column takes the room that is left, and columns that can be spared go first.

use unicode_width::UnicodeWidthStr as _;

/// The room between two columns.
const GAP: usize = 2;
/// The least width of the column that takes the room that is left.
const FLEXIBLE_MIN: usize = 16;

/// A column of a table.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Column {
    pub(crate) title: &'static str,
    pub(crate) width: Width,
    /// Whether numbers are aligned at their last digit.
    pub(crate) is_right: bool,
}

/// The width of a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Width {
    /// As wide as the widest cell, but at most this width.
    UpTo(usize),
    /// The same; the column is left out where there is little room.
    Spare(usize),
    /// The room that is left.
    Rest,
}

/// A column that is shown: its place in the table, and its width.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Placed {
    pub(crate) place: usize,
    pub(crate) width: usize,
}

/// Returns the columns that fit into `room`, with their widths. `widest` has the widest cell of each column.
pub(crate) fn fit(columns: &[Column], widest: &[usize], room: usize) -> Vec<Placed> {
    let natural = |place: usize| widest.get(place).copied().unwrap_or_default().max(columns[place].title.len());
    let width = |place: usize| match columns[place].width {
        Width::UpTo(limit) | Width::Spare(limit) => natural(place).min(limit),
        Width::Rest => FLEXIBLE_MIN,
    };
    let mut shown: Vec<usize> = (0..columns.len()).collect();
    let needed = |shown: &[usize]| shown.iter().map(|place| width(*place) + GAP).sum::<usize>().saturating_sub(GAP);
    while needed(&shown) > room {
        let spare = shown.iter().rposition(|place| matches!(columns[*place].width, Width::Spare(_)));
        let Some(spare) = spare else { break };
        shown.remove(spare);
    }
    let left = room.saturating_sub(needed(&shown));
    let placed = shown.iter().map(|place| {
        let is_rest = columns[*place].width == Width::Rest;
        let width = if is_rest { (FLEXIBLE_MIN + left).min(natural(*place).max(FLEXIBLE_MIN)) } else { width(*place) };
        Placed { place: *place, width }
    });
    placed.collect()
}

/// Returns a text in this width: cut or filled up.
pub(crate) fn cell(text: &str, width: usize, is_right: bool) -> String {
    let mut shown = String::new();
    let mut used = 0;
    for character in text.chars() {
        let more = character.to_string().width();
        if used + more > width {
            break;
        }
        shown.push(character);
        used += more;
    }
    let blank = " ".repeat(width - used);
    if is_right { blank + &shown } else { shown + &blank }
}

/// Returns a text in lines of this width, at most `limit` of them. It breaks between words where it can. Of a text that is longer,
/// the last line ends with `...`.
pub(crate) fn wrap(text: &str, width: usize, limit: usize) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in text.split_whitespace() {
        let mut rest = word.to_owned();
        while !rest.is_empty() {
            let line = lines.last_mut().expect("there is one");
            let gap = usize::from(!line.is_empty());
            if line.width() + gap + rest.width() <= width {
                line.push_str(&" "[..gap]);
                line.push_str(&rest);
                break;
            }
            if !line.is_empty() {
                lines.push(String::new());
                continue;
            }
            let piece = cell(&rest, width, false).trim_end().to_owned();
            if piece.is_empty() {
                break;
            }
            rest = rest.split_off(piece.len());
            *line = piece;
            lines.push(String::new());
        }
    }
    if lines.last().is_some_and(String::is_empty) {
        lines.pop();
    }
    if lines.len() > limit {
        lines.truncate(limit);
        if let Some(last) = lines.last_mut() {
            *last = cell(last, width.saturating_sub(4), false).trim_end().to_owned() + " ...";
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    const COLUMNS: [Column; 3] = [
        Column { title: "NAME", width: Width::Rest, is_right: false },
        Column { title: "STATE", width: Width::UpTo(10), is_right: false },
        Column { title: "PID", width: Width::Spare(8), is_right: true },
    ];

    #[test]
    fn the_columns_fit() {
        let check = |widest: [usize; 3], room: usize, expected: &[(usize, usize)]| {
            let placed: Vec<_> = fit(&COLUMNS, &widest, room).iter().map(|one| (one.place, one.width)).collect();
            assert_eq!(placed, expected, "{widest:?} in {room}");
        };
        check([20, 7, 4], 80, &[(0, 20), (1, 7), (2, 4)]);
        check([60, 70, 4], 50, &[(0, 32), (1, 10), (2, 4)]);
        check([60, 70, 4], 30, &[(0, 18), (1, 10)]);
        check([60, 70, 4], 10, &[(0, 16), (1, 10)]);
    }

    #[test]
    fn a_text_is_wrapped_between_words() {
        assert_eq!(wrap("may the arm move?", 8, 9), ["may the", "arm", "move?"]);
        assert_eq!(wrap("abcdefgh ij", 3, 9), ["abc", "def", "gh", "ij"]);
        assert_eq!(wrap("one two three four", 8, 2), ["one two", "thre ..."]);
        assert_eq!(wrap("日本語", 4, 9), ["日本", "語"]);
        assert_eq!(wrap("日", 1, 9), [""; 0]);
        assert_eq!(wrap("", 5, 9), [""; 0]);
    }

    #[test]
    fn a_cell_has_its_width() {
        assert_eq!(cell("abc", 5, false), "abc  ");
        assert_eq!(cell("abc", 5, true), "  abc");
        assert_eq!(cell("abcdef", 3, false), "abc");
        // A wide character takes two places.
        assert_eq!(cell("日本語", 5, false), "日本 ");
    }
}
