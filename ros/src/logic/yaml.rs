//! Values of YAML 1.1, as `launch` reads the value of a parameter.
//!
//! Source: the resolvers of PyYAML, and `coerce_to_type` of `launch`.

/// A value without parts.
#[derive(Clone, Debug, PartialEq)]
pub enum Scalar {
    /// An integer of 64 bits.
    Integer(i64),
    /// Another number.
    Float(f64),
    /// `true` or `false`.
    Truth(bool),
    /// A text.
    Text(String),
}

/// A scalar, or a list of scalars of one type.
#[derive(Clone, Debug, PartialEq)]
pub enum YamlValue {
    /// A scalar.
    One(Scalar),
    /// A list of scalars.
    List(Vec<Scalar>),
}

impl YamlValue {
    /// Returns the value of a text; none if `launch` refuses it: nothing, a map, a date, or a list of several types.
    pub fn of(text: &str) -> Option<Self> {
        let text = text.trim();
        let list = text.strip_prefix('[').and_then(|rest| rest.strip_suffix(']'));
        match list {
            None => Scalar::of(text).map(Self::One),
            Some(list) => {
                let items = items(list)?.into_iter().map(Scalar::of).collect::<Option<Vec<_>>>()?;
                Self::list(items)
            }
        }
    }

    /// Returns a list; none if its items have several types.
    pub fn list(items: Vec<Scalar>) -> Option<Self> {
        let is_uniform = items.windows(2).all(|two| std::mem::discriminant(&two[0]) == std::mem::discriminant(&two[1]));
        is_uniform.then_some(Self::List(items))
    }
}

/// The items of a list; none if a list or a map is inside it.
fn items(list: &str) -> Option<Vec<&str>> {
    let (mut items, mut begin, mut quote) = (Vec::new(), 0, None);
    let mut characters = list.char_indices();
    while let Some((at, found)) = characters.next() {
        match (found, quote) {
            (_, Some(open)) if found == open => quote = None,
            // The next character does not end the text.
            ('\\', Some('"')) => drop(characters.next()),
            ('\'' | '"', None) if list[begin..at].trim().is_empty() => quote = Some(found),
            (',', None) => {
                items.push(list[begin..at].trim());
                begin = at + 1;
            }
            ('[' | ']' | '{' | '}', None) => return None,
            (_, None | Some(_)) => {}
        }
    }
    let last = list[begin..].trim();
    // A comma may stand behind the last item.
    if !last.is_empty() {
        items.push(last);
    }
    (quote.is_none() && items.iter().all(|item| !item.is_empty())).then_some(items)
}

impl Scalar {
    /// Returns the scalar of a text; none if `launch` refuses it.
    pub fn of(text: &str) -> Option<Self> {
        if let Some(inner) = quoted(text) {
            return Some(Self::Text(inner));
        }
        let text = text.split_once(" #").map_or(text, |(before, _comment)| before.trim_end());
        let is_map = text.starts_with('{') && text.ends_with('}') || text.contains(": ") || text.ends_with(':');
        let is_nothing = text.starts_with('#') || matches!(text, "~" | "null" | "Null" | "NULL");
        let is_block = text == "-" || text.starts_with("- ");
        if is_map || is_nothing || is_block || is_date(text) {
            return None;
        }
        match text {
            "true" | "True" | "TRUE" | "yes" | "Yes" | "YES" | "on" | "On" | "ON" => return Some(Self::Truth(true)),
            "false" | "False" | "FALSE" | "no" | "No" | "NO" | "off" | "Off" | "OFF" => {
                return Some(Self::Truth(false));
            }
            _ => {}
        }
        if is_integer(text) {
            return integer(text).map(Self::Integer);
        }
        Some(float(text).map_or_else(|| Self::Text(text.to_owned()), Self::Float))
    }
}

/// The content of a text in quotes; none if it has other escapes than those of quotes, backslashes and characters by their number.
fn quoted(text: &str) -> Option<String> {
    let inner = |quote: char| text.strip_prefix(quote).and_then(|rest| rest.strip_suffix(quote));
    match (inner('\''), inner('"')) {
        (Some(single), _) if !single.replace("''", "").contains('\'') => Some(single.replace("''", "'")),
        (_, Some(double)) => unescaped(double),
        (Some(_) | None, None) => None,
    }
}

/// The content of a text in double quotes.
fn unescaped(text: &str) -> Option<String> {
    let (mut content, mut characters) = (String::with_capacity(text.len()), text.chars());
    while let Some(found) = characters.next() {
        match found {
            '"' => return None,
            '\\' => content.push(match characters.next()? {
                same @ ('"' | '\\') => same,
                'u' => {
                    let number = characters.as_str().get(..4)?;
                    characters = characters.as_str().get(4..)?.chars();
                    char::from_u32(u32::from_str_radix(number, 16).ok()?)?
                }
                _ => return None,
            }),
            other => content.push(other),
        }
    }
    Some(content)
}

/// Whether a text is a date, or a date and a time.
fn is_date(text: &str) -> bool {
    let (day, time) = text.split_once([' ', 't', 'T']).map_or((text, None), |(day, time)| (day, Some(time.trim())));
    let parts: Vec<&str> = day.split('-').collect();
    let has_digits = parts.iter().all(|part| !part.is_empty() && part.bytes().all(|byte| byte.is_ascii_digit()));
    let lengths: Vec<usize> = parts.iter().map(|part| part.len()).collect();
    has_digits
        && match time {
            None => lengths == [4, 2, 2],
            Some(time) => {
                let is_time = time.starts_with(|found: char| found.is_ascii_digit()) && time.matches(':').count() >= 2;
                is_time && matches!(lengths.as_slice(), [4, 1 | 2, 1 | 2])
            }
        }
}

/// Removes the sign, and returns whether it was a minus.
fn unsigned(text: &str) -> (bool, &str) {
    match text.strip_prefix('-') {
        Some(rest) => (true, rest),
        None => (false, text.strip_prefix('+').unwrap_or(text)),
    }
}

fn has_only(text: &str, is_fit: impl Fn(u8) -> bool) -> bool {
    !text.is_empty() && text.bytes().all(|byte| byte == b'_' || is_fit(byte))
}

/// Whether a text is `[0-9][0-9_]*` and then parts such as `:59`.
fn is_sexagesimal(text: &str) -> bool {
    let mut parts = text.split(':');
    let is_first = parts.next().is_some_and(|first| {
        first.starts_with(|found: char| found.is_ascii_digit()) && has_only(first, |byte| byte.is_ascii_digit())
    });
    is_first
        && parts.all(|part| {
            let is_number = !part.is_empty() && part.bytes().all(|byte| byte.is_ascii_digit());
            is_number && (part.len() == 1 || part.len() == 2 && part.as_bytes()[0] <= b'5')
        })
}

fn is_integer(text: &str) -> bool {
    let (_, text) = unsigned(text);
    match (text.strip_prefix("0b"), text.strip_prefix("0x")) {
        (Some(binary), _) => has_only(binary, |byte| matches!(byte, b'0' | b'1')),
        (None, Some(hexadecimal)) => has_only(hexadecimal, |byte| byte.is_ascii_hexdigit()),
        (None, None) if text.len() > 1 && text.starts_with('0') => has_only(text, |byte| (b'0'..=b'7').contains(&byte)),
        (None, None) => is_sexagesimal(text),
    }
}

/// The value of a text that is an integer; none if it is longer than 64 bits.
fn integer(text: &str) -> Option<i64> {
    let (is_negative, text) = unsigned(text);
    let text = text.replace('_', "");
    let (digits, radix) = match (text.strip_prefix("0b"), text.strip_prefix("0x")) {
        (Some(binary), _) => (binary, 2),
        (None, Some(hexadecimal)) => (hexadecimal, 16),
        (None, None) if text.starts_with('0') => (text.as_str(), 8),
        (None, None) => (text.as_str(), 10),
    };
    let mut value = 0_i128;
    for part in digits.split(':') {
        let part = i128::from_str_radix(part, radix).ok()?;
        value = value.checked_mul(60)?.checked_add(part)?;
    }
    i64::try_from(if is_negative { -value } else { value }).ok()
}

fn float(text: &str) -> Option<f64> {
    let (is_negative, number) = unsigned(text);
    let signed = |value: f64| Some(if is_negative { -value } else { value });
    match number {
        ".inf" | ".Inf" | ".INF" => return signed(f64::INFINITY),
        ".nan" | ".NaN" | ".NAN" if number.len() == text.len() => return Some(f64::NAN),
        _ => {}
    }
    let (mantissa, exponent) = number.find(['e', 'E']).map_or((number, ""), |at| number.split_at(at));
    let (whole, fraction) = mantissa.split_once('.')?;
    let is_digit = |byte: u8| byte.is_ascii_digit();
    let is_exponent = |text: &str| {
        let digits = text.strip_prefix(['e', 'E']).and_then(|rest| rest.strip_prefix(['-', '+']));
        digits.is_some_and(|digits| !digits.is_empty() && digits.bytes().all(is_digit))
    };
    let is_whole = match whole.is_empty() {
        // `-.5` is a text.
        true => number.len() == text.len() && fraction.starts_with(|found: char| found.is_ascii_digit()),
        false => is_sexagesimal(whole),
    };
    let is_fraction = fraction.is_empty() || has_only(fraction, is_digit);
    let has_parts = whole.contains(':');
    if !is_whole || !is_fraction || !(exponent.is_empty() || is_exponent(exponent) && !has_parts) {
        return None;
    }
    let last = whole.rfind(':').map_or(0, |at| at + 1);
    let mut parts = whole[..last].split_terminator(':').map(|part| part.replace('_', "").parse::<f64>().ok());
    let minutes = parts.try_fold(0.0, |sum, part| Some(sum * 60.0 + part?))?;
    let rest: f64 = format!("0{}.{fraction}{exponent}", &whole[last..]).replace('_', "").parse().ok()?;
    signed(minutes * 60.0 + rest)
}

/// An integer by the rules of `int` in Python, for a parameter whose type the file says.
pub fn python_integer(text: &str) -> Option<i64> {
    let text = python_digits(text)?;
    text.parse().ok()
}

/// A number by the rules of `float` in Python.
pub fn python_float(text: &str) -> Option<f64> {
    python_digits(text)?.parse().ok()
}

/// A number without the `_` between its digits.
fn python_digits(text: &str) -> Option<String> {
    let text = text.trim();
    let is_bare = text.starts_with('_') || text.ends_with('_') || text.contains("__");
    let between = |at: usize| {
        let digit = |byte: Option<&u8>| byte.is_some_and(u8::is_ascii_digit);
        digit(text.as_bytes().get(at.wrapping_sub(1))) && digit(text.as_bytes().get(at + 1))
    };
    (!is_bare && text.match_indices('_').all(|(at, _)| between(at))).then(|| text.replace('_', ""))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn one(text: &str) -> Option<Scalar> {
        match YamlValue::of(text)? {
            YamlValue::One(scalar) => Some(scalar),
            YamlValue::List(_) => None,
        }
    }

    /// The expected values are those of `yaml.safe_load` of PyYAML 6.
    #[test]
    fn numbers_are_those_of_yaml_1_1() {
        for (text, value) in [
            ("0x46d", 1133),
            ("-0x_F", -15),
            ("1_000", 1000),
            ("012", 10),
            ("007", 7),
            ("0", 0),
            ("-0", 0),
            ("0_", 0),
            ("0b11", 3),
            ("+5", 5),
            ("1:30", 90),
            ("-1:30:01", -5401),
            ("9223372036854775807", i64::MAX),
            (" 5 ", 5),
            ("5 # five", 5),
        ] {
            assert_eq!(one(text), Some(Scalar::Integer(value)), "{text}");
        }
        for (text, value) in [
            ("5.", 5.0),
            (".5", 0.5),
            ("1.5e+3", 1500.0),
            ("-1_0.2_5", -10.25),
            ("1:30.5", 90.5),
            ("+.inf", f64::INFINITY),
            ("-.INF", f64::NEG_INFINITY),
        ] {
            assert_eq!(one(text), Some(Scalar::Float(value)), "{text}");
        }
        assert!(matches!(one(".NaN"), Some(Scalar::Float(value)) if value.is_nan()));
        for text in
            ["08", "0o17", "1e5", "1.5e3", "-.5", "1:60", "0x", "-.nan", "inf", "x", "", "a:b", "[1", "1__x", "+"]
        {
            assert_eq!(one(text), Some(Scalar::Text(text.to_owned())), "{text}");
        }
        for (text, inner) in [
            ("'5'", "5"),
            ("\"true\"", "true"),
            ("'it''s'", "it's"),
            ("a # b", "a"),
            ("\"a \\\"b\\\" \\\\ \\u2028\"", "a \"b\" \\ \u{2028}"),
        ] {
            assert_eq!(one(text), Some(Scalar::Text(inner.to_owned())), "{text}");
        }
        for text in [
            "~",
            "null",
            "-",
            "2020-01-02",
            "2020-01-02T10:00:00Z",
            "{a: 1}",
            "a: b",
            "# x",
            "99999999999999999999",
            "[1, x]",
            "[[1]]",
        ] {
            assert_eq!(YamlValue::of(text), None, "{text}");
        }
    }

    #[test]
    fn lists_have_one_type() {
        let list = |text: &str| match YamlValue::of(text) {
            Some(YamlValue::List(items)) => items,
            Some(YamlValue::One(_)) | None => panic!("{text}"),
        };
        assert_eq!(list("[0x10, 1_0,]"), [Scalar::Integer(16), Scalar::Integer(10)]);
        assert_eq!(list("[1.0, 2.5]"), [Scalar::Float(1.0), Scalar::Float(2.5)]);
        assert_eq!(list("['a, b', \"1\"]"), [Scalar::Text("a, b".into()), Scalar::Text("1".into())]);
        assert_eq!(list("[\"a\\\", b\", \"c\"]"), [Scalar::Text("a\", b".into()), Scalar::Text("c".into())]);
        assert_eq!(list("[]"), []);
        assert_eq!(YamlValue::of("[1, 2.0]"), None);
    }

    #[test]
    fn a_type_of_the_file_reads_as_python() {
        assert_eq!(python_integer("1_000"), Some(1000));
        assert_eq!(python_integer("012"), Some(12));
        assert_eq!((python_integer("0x46d"), python_integer("1__0"), python_integer("_1")), (None, None, None));
        assert_eq!(python_float("1e5"), Some(1e5));
        assert_eq!(python_float("1_0.5"), Some(10.5));
        assert_eq!(python_float("x"), None);
    }
}
