//! The units of the language and their factors to SI.

/// The dimension of a quantity: its powers of metre, kilogram, second, ampere, radian and byte.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Dimension([i8; 6]);

impl Dimension {
    pub(crate) const TIME: Self = Self([0, 0, 1, 0, 0, 0]);

    fn per(self, other: Self) -> Self {
        let mut powers = self.0;
        powers.iter_mut().zip(other.0).for_each(|(power, down)| *power -= down);
        Self(powers)
    }
}

/// Each unit has a symbol, a factor to SI, and its powers of metre, kilogram, second, ampere, radian and byte.
const UNITS: &[(&str, f64, [i8; 6])] = &[
    ("s", 1.0, [0, 0, 1, 0, 0, 0]),
    ("ms", 1e-3, [0, 0, 1, 0, 0, 0]),
    ("us", 1e-6, [0, 0, 1, 0, 0, 0]),
    ("ns", 1e-9, [0, 0, 1, 0, 0, 0]),
    ("min", 60.0, [0, 0, 1, 0, 0, 0]),
    ("h", 3600.0, [0, 0, 1, 0, 0, 0]),
    ("s2", 1.0, [0, 0, 2, 0, 0, 0]),
    ("m", 1.0, [1, 0, 0, 0, 0, 0]),
    ("cm", 1e-2, [1, 0, 0, 0, 0, 0]),
    ("mm", 1e-3, [1, 0, 0, 0, 0, 0]),
    ("um", 1e-6, [1, 0, 0, 0, 0, 0]),
    ("km", 1e3, [1, 0, 0, 0, 0, 0]),
    ("rad", 1.0, [0, 0, 0, 0, 1, 0]),
    ("deg", std::f64::consts::PI / 180.0, [0, 0, 0, 0, 1, 0]),
    ("Hz", 1.0, [0, 0, -1, 0, 0, 0]),
    ("kHz", 1e3, [0, 0, -1, 0, 0, 0]),
    ("N", 1.0, [1, 1, -2, 0, 0, 0]),
    ("kN", 1e3, [1, 1, -2, 0, 0, 0]),
    ("Nm", 1.0, [2, 1, -2, 0, 0, 0]),
    ("kg", 1.0, [0, 1, 0, 0, 0, 0]),
    ("g", 1e-3, [0, 1, 0, 0, 0, 0]),
    ("A", 1.0, [0, 0, 0, 1, 0, 0]),
    ("mA", 1e-3, [0, 0, 0, 1, 0, 0]),
    ("V", 1.0, [2, 1, -3, -1, 0, 0]),
    ("mV", 1e-3, [2, 1, -3, -1, 0, 0]),
    ("W", 1.0, [2, 1, -3, 0, 0, 0]),
    ("B", 1.0, [0, 0, 0, 0, 0, 1]),
    ("kB", 1e3, [0, 0, 0, 0, 0, 1]),
    ("MB", 1e6, [0, 0, 0, 0, 0, 1]),
];

/// Returns the factor to SI and the dimension of a unit, such as `m`, or `m` per `s`.
pub(crate) fn unit(symbol: &str, per: Option<&str>) -> Option<(f64, Dimension)> {
    let find = |symbol: &str| {
        let unit = UNITS.iter().find(|(name, _, _)| *name == symbol);
        unit.map(|&(_, factor, powers)| (factor, Dimension(powers)))
    };
    let (factor, dimension) = find(symbol)?;
    let Some(per) = per else { return Some((factor, dimension)) };
    let (divisor, below) = find(per)?;
    Some((factor / divisor, dimension.per(below)))
}

/// The types of quantities. Each has an example and its SI unit, which gives the dimension.
const TYPES: &[(&str, &str, &str, Option<&str>)] = &[
    ("Time", "5 s", "s", None),
    ("Length", "0.2 m", "m", None),
    ("Angle", "90 deg", "rad", None),
    ("Speed", "0.1 m/s", "m", Some("s")),
    ("AngularSpeed", "10 deg/s", "rad", Some("s")),
    ("Acceleration", "1 m/s2", "m", Some("s2")),
    ("Frequency", "50 Hz", "Hz", None),
    ("Mass", "2 kg", "kg", None),
    ("Force", "20 N", "N", None),
    ("Torque", "3 Nm", "Nm", None),
    ("Stiffness", "500 N/m", "N", Some("m")),
    ("Power", "10 W", "W", None),
    ("Current", "1.5 A", "A", None),
    ("Voltage", "24 V", "V", None),
    ("Size", "4 MB", "B", None),
];

/// Returns the dimension of a type of quantities, and an example.
pub(crate) fn of_type(name: &str) -> Option<(Dimension, &'static str)> {
    let &(_, example, symbol, per) = TYPES.iter().find(|(known, _, _, _)| *known == name)?;
    unit(symbol, per).map(|(_, dimension)| (dimension, example))
}

/// Returns the symbol of the SI unit of a type of quantities: `N`, `m/s`.
pub(crate) fn symbol(name: &str) -> Option<String> {
    let &(_, _, symbol, per) = TYPES.iter().find(|(known, ..)| *known == name)?;
    Some(per.map_or_else(|| symbol.to_owned(), |per| format!("{symbol}/{per}")))
}

/// Returns the units that a person may write for a type of quantities: "`N` or `kN`".
pub(crate) fn spellings(name: &str) -> String {
    let same =
        |&&(_, _, powers): &&(&str, f64, [i8; 6])| of_type(name).is_some_and(|(own, _)| own == Dimension(powers));
    let mut symbols: Vec<String> = UNITS.iter().filter(same).map(|(symbol, ..)| format!("`{symbol}`")).collect();
    if symbols.is_empty() {
        symbols.extend(symbol(name).map(|symbol| format!("`{symbol}`")));
    }
    match symbols.split_last() {
        Some((last, rest)) if !rest.is_empty() => format!("{} or {last}", rest.join(", ")),
        Some(_) | None => symbols.concat(),
    }
}

/// Returns the type of the quantities with this dimension.
pub(crate) fn type_of(dimension: Dimension) -> Option<&'static str> {
    TYPES.iter().map(|(name, ..)| *name).find(|name| of_type(name).is_some_and(|(own, _)| own == dimension))
}

/// The reason why a text is not a quantity.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum NotRead {
    /// The text does not begin with a number.
    NoNumber,
    /// The text after the number is not a unit.
    NoUnit(String),
}

/// Reads a quantity or a number as a spec writes it: `20 N`, `0.2m/s`, `5`. Returns it in SI units.
pub(crate) fn read(text: &str) -> Result<(f64, Option<Dimension>), NotRead> {
    let text = text.trim();
    let is_exponent = |at: usize| {
        text[at..].starts_with(['e', 'E']) && text[at + 1..].starts_with(|c: char| "+-0123456789".contains(c))
    };
    let letters = text.char_indices().filter(|(_, c)| c.is_alphabetic());
    let at = letters.map(|(at, _)| at).find(|&at| !is_exponent(at)).unwrap_or(text.len());
    let number = text[..at].trim().parse::<f64>().ok().filter(|number| number.is_finite());
    let (number, spelt) = (number.ok_or(NotRead::NoNumber)?, &text[at..]);
    if spelt.is_empty() {
        return Ok((number, None));
    }
    let (symbol, per) = spelt.split_once('/').map_or((spelt, None), |(symbol, per)| (symbol, Some(per.trim())));
    let (factor, dimension) = unit(symbol.trim(), per).ok_or_else(|| NotRead::NoUnit(spelt.to_owned()))?;
    Ok((number * factor, Some(dimension)))
}

/// Returns the types of quantities, each with an example.
pub(crate) fn types() -> impl Iterator<Item = (&'static str, &'static str)> {
    TYPES.iter().map(|&(name, example, ..)| (name, example))
}

/// The types of values that are not quantities.
pub(crate) const PLAIN: [&str; 6] = ["Host", "Text", "Number", "Truth", RESOURCE, SECRET];

/// The type of a parameter that gets a resource.
pub(crate) const RESOURCE: &str = "Resource";

/// The type of a parameter that gets a secret of the database.
pub(crate) const SECRET: &str = "Secret";

/// Returns whether the language itself has a type of this name.
pub(crate) fn is_type(name: &str) -> bool {
    PLAIN.contains(&name) || of_type(name).is_some()
}

/// Returns the names of all types of values.
pub(crate) fn names() -> impl Iterator<Item = &'static str> {
    PLAIN.into_iter().chain(types().map(|(name, _)| name))
}

/// Returns the symbols of all units.
pub(crate) fn symbols() -> impl Iterator<Item = &'static str> {
    UNITS.iter().map(|(symbol, _, _)| *symbol)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_become_si() {
        assert_eq!(unit("ms", None), Some((1e-3, Dimension::TIME)));
        let (factor, speed) = unit("mm", Some("s")).unwrap();
        assert!((factor - 1e-3).abs() < 1e-18);
        assert_eq!(speed, unit("km", Some("h")).unwrap().1);
        assert_eq!(unit("parsec", None), None);
        assert!(TYPES.iter().all(|(name, _, _, _)| of_type(name).is_some()));
        assert_eq!(of_type("Time").unwrap().0, Dimension::TIME);
    }

    #[test]
    fn types_name_their_units() {
        for (name, si, all) in [
            ("Force", "N", "`N` or `kN`"),
            ("Angle", "rad", "`rad` or `deg`"),
            ("Torque", "Nm", "`Nm`"),
            ("Speed", "m/s", "`m/s`"),
            ("Length", "m", "`m`, `cm`, `mm`, `um` or `km`"),
        ] {
            assert_eq!((symbol(name).as_deref(), spellings(name).as_str()), (Some(si), all));
            assert_eq!(type_of(of_type(name).unwrap().0), Some(name));
        }
        assert_eq!((symbol("Number"), spellings("Number").as_str()), (None, ""));
    }

    #[test]
    fn texts_are_read_as_specs_spell_them() {
        let of = |name| of_type(name).map(|(dimension, _)| dimension);
        for (text, number, name) in [
            ("20 N", 20.0, Some("Force")),
            (" 0.5kN ", 500.0, Some("Force")),
            ("-2e-1 m / s", -0.2, Some("Speed")),
            ("1e3mm/s", 1.0, Some("Speed")),
            ("12.0", 12.0, None),
            ("1e3", 1000.0, None),
        ] {
            assert_eq!(read(text), Ok((number, name.and_then(of))), "{text}");
        }
        for text in ["", "N", "inf", "nan N", "1 2 N", "e3", "1e999 N", "µ"] {
            assert_eq!(read(text), Err(NotRead::NoNumber), "{text}");
        }
        for (text, unit) in [("5 parsec", "parsec"), ("5 m/", "m/"), ("5 m/s/s", "m/s/s"), ("5 e", "e"), ("5 ß", "ß")]
        {
            assert_eq!(read(text), Err(NotRead::NoUnit(unit.to_owned())), "{text}");
        }
    }
}
