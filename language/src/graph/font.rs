//! Estimates the width of a text in the font of the picture. A viewer with another font must fit the letters into this width.

/// The widths of the printable ASCII characters of Helvetica, in thousandths of the font size.
/// Source: Adobe, "Font Metrics for PDF Core 14 Fonts", `Helvetica.afm`.
#[rustfmt::skip]
const WIDTHS: [i32; 95] = [
    278, 278, 355, 556, 556, 889, 667, 191, 333, 333, 389, 584, 278, 333, 278, 278, 556, 556, 556,
    556, 556, 556, 556, 556, 556, 556, 278, 278, 584, 584, 584, 556, 1015, 667, 667, 722, 722, 667,
    611, 778, 722, 278, 500, 667, 556, 833, 722, 778, 667, 778, 722, 667, 611, 722, 667, 944, 667,
    667, 611, 278, 278, 278, 469, 556, 333, 556, 556, 500, 556, 556, 278, 556, 556, 222, 222, 500,
    222, 833, 556, 556, 556, 556, 333, 500, 278, 556, 500, 722, 500, 500, 500, 334, 260, 334, 584,
];
/// The width of any other character, in the same unit.
const OTHER: i32 = 600;

/// Returns the width of a text in pixels, rounded up. `size` is the font's size in pixels.
pub(super) fn width(text: &str, size: i32, is_bold: bool) -> i32 {
    let of = |c: char| (c as usize).checked_sub(32).and_then(|at| WIDTHS.get(at)).copied().unwrap_or(OTHER);
    let sum = text.chars().take(1000).map(of).sum::<i32>() * size;
    // The bold letters are about a fifteenth wider.
    (if is_bold { sum * 16 / 15 } else { sum } + 999) / 1000
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn letters_have_their_widths() {
        assert_eq!((width("", 12, false), width("il", 1000, false), width("W~", 1000, false)), (0, 444, 1528));
        assert_eq!((width("∞", 10, false), width("mm", 12, true)), (6, 22));
    }
}
