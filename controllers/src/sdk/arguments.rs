//! Arguments that a spec gives to a controller: `GripperControl(host3, "open")`, `DoorWorld("c3", seed = 7)`.

use super::quantity::Quantity;
use comms::logic::bytes::SecretBytes;
use std::collections::BTreeMap;
use std::sync::Arc;
use thiserror::Error;

/// The longest secret, in bytes.
pub(crate) const SECRET_MAX: usize = 64 << 10;

/// A parameter that a controller type takes after its host.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameter {
    /// The name, for `name = value`. `grasp.force` is the field `force` of the record `grasp`, and `corner.0` the first
    /// value of a list.
    pub name: &'static str,
    /// The values that it takes.
    pub kind: Kind,
    /// The value if a spec gives none, spelt as in a spec; a quantity is in SI units and without its unit. None if a
    /// spec has to give the value.
    pub default: Option<&'static str>,
}

/// The values that a parameter takes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    /// A text that is one of these words; any text if the list is empty.
    Text(&'static [&'static str]),
    /// A number without a unit in this range; both ends are allowed.
    Number(f64, f64),
    /// A number without a unit and without a fraction in this range; both ends are allowed. In a spec its type is
    /// `Number`.
    Whole(f64, f64),
    /// A quantity in this range, in SI units; both ends are allowed. A spec has to give it with a unit, such as `20 N`.
    Quantity(Quantity, f64, f64),
    /// `true` or `false`.
    Truth,
    /// A secret of the database. A spec gives it as `secret("team/camera/password")`, and [`Arguments::secret`] reads
    /// it.
    Secret,
}

/// The arguments of one instance, checked against the parameters of its type: every parameter has a value of its kind.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Arguments {
    values: BTreeMap<&'static str, Value>,
    instance: String,
    deployment: String,
}

#[derive(Clone, Debug, PartialEq)]
enum Value {
    Text(String),
    Number(f64),
    Truth(bool),
    Secret(Secret),
}

/// The place of the value of a secret.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Secret {
    /// In the file with this path, which the program got at its start.
    File(String),
    /// In memory, because the value has changed since the start.
    Renewed(Arc<SecretBytes>),
}

/// The error of an argument that does not fit the parameters.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum ArgumentError {
    /// There is no parameter of this name.
    #[error("no parameter `{name}`; {}", listed(.known))]
    Unknown {
        /// The given name.
        name: String,
        /// The names of all parameters.
        known: Vec<&'static str>,
    },
    /// More arguments than parameters.
    #[error("argument `{value}` is one too many; {}", listed(.known))]
    TooMany {
        /// The first argument without a parameter.
        value: String,
        /// The names of all parameters.
        known: Vec<&'static str>,
    },
    /// A parameter is given twice.
    #[error("parameter `{name}` is given twice")]
    Twice {
        /// The parameter.
        name: &'static str,
    },
    /// A parameter is not given and has no default.
    #[error("parameter `{name}` needs {expected}")]
    Missing {
        /// The parameter.
        name: &'static str,
        /// The values that it takes.
        expected: String,
    },
    /// A value is of another kind than its parameter.
    #[error("parameter `{name}` is `{value}`, which is not {expected}")]
    Wrong {
        /// The parameter.
        name: &'static str,
        /// The given value.
        value: String,
        /// The values that it takes.
        expected: String,
    },
}

fn listed(names: &[&'static str]) -> String {
    match names {
        [] => "this controller has no parameters".to_owned(),
        [name] => format!("the only parameter is `{name}`"),
        names => format!("the parameters are `{}`", names.join("`, `")),
    }
}

impl Parameter {
    /// Returns a parameter without a default.
    pub const fn new(name: &'static str, kind: Kind) -> Self {
        Self { name, kind, default: None }
    }

    /// Returns the parameter with a default, spelt as in a spec but without quotes, and a quantity without its unit.
    #[must_use]
    pub const fn or(self, default: &'static str) -> Self {
        Self { default: Some(default), ..self }
    }

    /// Returns the parameters as a `module` block writes them. A single parameter is `lock: Text = "unlocked"`. Fields
    /// of one record are in braces, `grasp: { force: Number = 20, width: Number }`. Values of a list are one parameter,
    /// `corner: Number[3]`.
    pub fn texts(parameters: &[Self]) -> Vec<String> {
        Self::texts_below(parameters, "")
    }

    fn texts_below(parameters: &[Self], record: &str) -> Vec<String> {
        let mut texts = Vec::new();
        let mut records = Vec::new();
        let below = parameters.iter().filter_map(|parameter| Some((parameter, parameter.name.strip_prefix(record)?)));
        for (parameter, name) in below {
            match name.split_once('.') {
                None => texts.push(parameter.text(name)),
                Some((inner, _)) if !records.contains(&inner) => {
                    records.push(inner);
                    texts.push(Self::text_of(parameters, record, inner));
                }
                Some(_) => {}
            }
        }
        texts
    }

    /// Returns the text of the record or list `inner`.
    fn text_of(parameters: &[Self], record: &str, inner: &str) -> String {
        let below = format!("{record}{inner}.");
        let parts = || parameters.iter().filter(|parameter| parameter.name.starts_with(&below));
        let is_element = |parameter: &Self| parameter.name[below.len()..].parse::<usize>().is_ok();
        match parts().next() {
            Some(first) if parts().all(is_element) => {
                let range = first.kind.range().filter(|_| parts().all(|part| part.kind == first.kind));
                format!("{inner}: {}[{}]{}", first.kind.name(), parts().count(), range.unwrap_or_default())
            }
            Some(_) | None => format!("{inner}: {{ {} }}", Self::texts_below(parameters, &below).join(", ")),
        }
    }

    fn text(&self, name: &str) -> String {
        let range = self.kind.range().unwrap_or_default();
        let default = self.default.map(|default| format!(" = {}", self.kind.literal(default))).unwrap_or_default();
        format!("{name}: {}{range}{default}", self.kind.name())
    }

    fn expected(&self) -> String {
        match self.kind {
            Kind::Text([]) => "a text".to_owned(),
            Kind::Text(words) => format!("one of `{}`", words.join("`, `")),
            Kind::Number(min, max) => format!("a number from {min} to {max}"),
            Kind::Whole(min, max) => format!("a whole number from {min} to {max}"),
            Kind::Quantity(quantity, min, max) => {
                format!("a number from {min} to {max}, the {} in {}", quantity.name(), quantity.unit())
            }
            Kind::Truth => "`true` or `false`".to_owned(),
            Kind::Secret => "`secret(\"KEY\")` in the spec".to_owned(),
        }
    }

    /// Reads a value that is spelt as in a spec: a text may have quotes.
    fn spelt(&self, text: &str) -> Result<Value, ArgumentError> {
        let bare = text.strip_prefix('"').and_then(|text| text.strip_suffix('"')).unwrap_or(text);
        self.value(bare)
    }

    /// Reads a value; a text may have any characters.
    fn value(&self, bare: &str) -> Result<Value, ArgumentError> {
        let wrong = || ArgumentError::Wrong { name: self.name, value: bare.to_owned(), expected: self.expected() };
        match self.kind {
            Kind::Text([]) => Ok(Value::Text(bare.to_owned())),
            Kind::Text(words) if words.contains(&bare) => Ok(Value::Text(bare.to_owned())),
            Kind::Number(min, max) | Kind::Quantity(_, min, max) => match bare.trim().parse() {
                Ok(number) if f64::is_finite(number) && (min..=max).contains(&number) => Ok(Value::Number(number)),
                Ok(_) | Err(_) => Err(wrong()),
            },
            Kind::Whole(min, max) => match bare.trim().parse::<f64>() {
                Ok(number) if number.fract() == 0.0 && (min..=max).contains(&number) => Ok(Value::Number(number)),
                Ok(_) | Err(_) => Err(wrong()),
            },
            Kind::Truth if ["true", "false"].contains(&bare.trim()) => Ok(Value::Truth(bare.trim() == "true")),
            Kind::Secret => Ok(Value::Secret(Secret::File(bare.to_owned()))),
            Kind::Text(_) | Kind::Truth => Err(wrong()),
        }
    }
}

impl Kind {
    /// Returns the word for this kind in specs.
    fn name(self) -> &'static str {
        match self {
            Self::Text(_) => "Text",
            Self::Number(..) | Self::Whole(..) => "Number",
            Self::Quantity(quantity, ..) => quantity.name(),
            Self::Truth => "Truth",
            Self::Secret => "Secret",
        }
    }

    /// Returns the range of a parameter as a spec writes it: ` in 1 N..200 N`, ` in "open" | "close"`; none if every
    /// value is allowed.
    fn range(self) -> Option<String> {
        let end = |number: f64| if number.is_finite() { self.literal(&number.to_string()) } else { String::new() };
        match self {
            Self::Number(min, max) | Self::Whole(min, max) | Self::Quantity(_, min, max)
                if min.is_finite() || max.is_finite() =>
            {
                Some(format!(" in {}..{}", end(min), end(max)))
            }
            Self::Text(words) if !words.is_empty() => Some(format!(" in \"{}\"", words.join("\" | \""))),
            Self::Text(_) | Self::Number(..) | Self::Whole(..) | Self::Quantity(..) | Self::Truth | Self::Secret => {
                None
            }
        }
    }

    /// Returns a value as a spec writes it: a text in quotes, a quantity with its unit.
    fn literal(self, value: &str) -> String {
        match self {
            Self::Text(_) => format!("\"{value}\""),
            Self::Quantity(quantity, ..) => format!("{value} {}", quantity.unit()),
            Self::Number(..) | Self::Whole(..) | Self::Truth | Self::Secret => value.to_owned(),
        }
    }
}

impl Arguments {
    /// Returns the checked arguments of one instance.
    ///
    /// Each of `given` is `name=value`, and a text is everything behind the first `=`. A node starts programs in this
    /// form. By hand, a value without a name is for the next parameter: `open`, `"open"`, `0.5`, `true`.
    ///
    /// # Errors
    /// Names the first wrong argument, and the accepted values.
    pub fn parse<S: AsRef<str>>(parameters: &[Parameter], given: &[S]) -> Result<Self, ArgumentError> {
        let names = || parameters.iter().map(|parameter| parameter.name).collect();
        let mut values = BTreeMap::new();
        let mut next = parameters.iter();
        for text in given.iter().map(AsRef::as_ref) {
            let (parameter, value) = match split(text) {
                Some((name, value)) => match parameters.iter().find(|parameter| parameter.name == name) {
                    Some(parameter) => (parameter, parameter.value(value)),
                    None => return Err(ArgumentError::Unknown { name: name.to_owned(), known: names() }),
                },
                None => match next.next() {
                    Some(parameter) => (parameter, parameter.spelt(text)),
                    None => return Err(ArgumentError::TooMany { value: text.to_owned(), known: names() }),
                },
            };
            if values.insert(parameter.name, value?).is_some() {
                return Err(ArgumentError::Twice { name: parameter.name });
            }
        }
        for parameter in parameters {
            if !values.contains_key(parameter.name) {
                let default = parameter
                    .default
                    .ok_or_else(|| ArgumentError::Missing { name: parameter.name, expected: parameter.expected() })?;
                values.insert(parameter.name, parameter.value(default)?);
            }
        }
        Ok(Self { values, instance: String::new(), deployment: String::new() })
    }

    /// Returns these arguments for the process with this deployment and path.
    #[must_use]
    pub fn of(self, deployment: &str, instance: &str) -> Self {
        Self { instance: instance.to_owned(), deployment: deployment.to_owned(), ..self }
    }

    /// Returns the name of the deployment; empty if it is unknown, as in a test.
    pub fn deployment(&self) -> &str {
        &self.deployment
    }

    /// Returns the name of the process, unique among all deployments: `door:main/arm/hand`. If the deployment is
    /// unknown, returns the path alone.
    pub fn full_name(&self) -> String {
        let (deployment, instance) = (&self.deployment, &self.instance);
        if deployment.is_empty() { instance.clone() } else { format!("{deployment}:{instance}") }
    }

    /// Returns the path of the process in its deployment, `main/arm/hand`; empty if there is none, as in a test.
    pub fn instance(&self) -> &str {
        &self.instance
    }

    /// Replaces values: `over` has parameter names, and values spelt as in a spec. A value that is not of its
    /// parameter's kind changes nothing, and the reason is returned.
    pub fn overlay<S: AsRef<str>>(&mut self, parameters: &[Parameter], over: &[(S, S)]) -> Vec<ArgumentError> {
        let mut wrong = Vec::new();
        for (name, text) in over {
            match over_value(parameters, name.as_ref(), text.as_ref()) {
                Ok((name, value)) => drop(self.values.insert(name, value)),
                Err(why) => wrong.push(why),
            }
        }
        wrong
    }

    /// Returns the value of a text parameter; empty if the type has no text parameter of this name.
    pub fn text(&self, name: &str) -> &str {
        match self.values.get(name) {
            Some(Value::Text(text)) => text,
            Some(Value::Number(_) | Value::Truth(_) | Value::Secret(_)) | None => "",
        }
    }

    /// Returns the value of a number parameter; NaN if the type has no number parameter of this name.
    pub fn number(&self, name: &str) -> f64 {
        match self.values.get(name) {
            Some(Value::Number(number)) => *number,
            Some(Value::Text(_) | Value::Truth(_) | Value::Secret(_)) | None => f64::NAN,
        }
    }

    /// Returns the value of a truth parameter; false if the type has no truth parameter of this name.
    pub fn truth(&self, name: &str) -> bool {
        matches!(self.values.get(name), Some(Value::Truth(true)))
    }

    /// Returns the place of the value of a secret parameter; none if the type has no secret parameter of this name.
    pub(crate) fn place_of_secret(&self, name: &str) -> Option<&Secret> {
        let Some(Value::Secret(place)) = self.values.get(name) else { return None };
        Some(place)
    }

    /// Takes a new value of a secret parameter.
    pub(crate) fn renew_secret(&mut self, name: &str, value: SecretBytes) {
        if let Some(Value::Secret(place)) = self.values.get_mut(name) {
            *place = Secret::Renewed(Arc::new(value));
        }
    }
}

/// Returns the replacing values that apply from now on, and the errors of the wrong ones. A wrong value is replaced by
/// the value in `present`, if there is one.
pub(crate) fn accepted(
    parameters: &[Parameter],
    over: Vec<(String, String)>,
    present: &[(String, String)],
) -> (Vec<(String, String)>, Vec<ArgumentError>) {
    let mut wrong = Vec::new();
    let accepted = over.into_iter().filter_map(|(name, text)| match over_value(parameters, &name, &text) {
        Ok(_) => Some((name, text)),
        Err(why) => {
            wrong.push(why);
            present.iter().find(|(other, _)| *other == name).cloned()
        }
    });
    (accepted.collect(), wrong)
}

/// Reads a replacing value.
fn over_value(parameters: &[Parameter], name: &str, text: &str) -> Result<(&'static str, Value), ArgumentError> {
    let parameter = parameters.iter().find(|parameter| parameter.name == name).ok_or_else(|| {
        ArgumentError::Unknown { name: name.to_owned(), known: parameters.iter().map(|one| one.name).collect() }
    })?;
    if parameter.kind == Kind::Secret {
        // Only the node decides in which file a secret is.
        let (value, expected) = (text.to_owned(), parameter.expected());
        return Err(ArgumentError::Wrong { name: parameter.name, value, expected });
    }
    Ok((parameter.name, parameter.spelt(text)?))
}

/// Splits `name=value`. A quoted text, or a text whose part before the `=` is not an identifier, is a plain value.
fn split(text: &str) -> Option<(&str, &str)> {
    let (name, value) = text.split_once('=')?;
    let name = name.trim();
    let is_part = |part: &str| part.chars().all(|c| c.is_alphanumeric() || c == '_') && !part.is_empty();
    name.split('.').all(is_part).then_some((name, value))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io;

    const PARAMETERS: &[Parameter] = &[
        Parameter::new("lock", Kind::Text(&["unlocked", "locked"])).or("unlocked"),
        Parameter::new("seed", Kind::Number(0.0, 1e6)).or("1"),
        Parameter::new("loud", Kind::Truth),
    ];

    fn check(given: &[&str], expect: &str) {
        let got = match Arguments::parse(PARAMETERS, given) {
            Ok(a) => format!("{} {} {}", a.text("lock"), a.number("seed"), a.truth("loud")),
            Err(error) => error.to_string(),
        };
        assert_eq!(got, expect);
    }

    #[test]
    fn a_secret_is_read_where_the_node_says_and_is_no_parameter_of_the_database() {
        const SECRET: &[Parameter] = &[Parameter::new("password", Kind::Secret)];
        let path = std::env::temp_dir().join(format!("dca-argument-{}", std::process::id()));
        std::fs::write(&path, b"hunter2\xff").unwrap();
        let mut arguments = Arguments::parse(SECRET, &[format!("password={}", path.display())]).unwrap();
        let wrong = arguments.overlay(SECRET, &[("password", "/etc/hostname")]);
        assert_eq!(wrong.len(), 1);
        assert_eq!(**arguments.secret("password").unwrap(), *b"hunter2\xff");
        assert!(!format!("{arguments:?}").contains("hunter2") && arguments.text("password").is_empty());
        let mut renewed = arguments.clone();
        renewed.renew_secret("password", SecretBytes::new(b"correct".to_vec()));
        renewed.renew_secret("other", SecretBytes::new(b"nothing".to_vec()));
        assert_eq!(**renewed.secret("password").unwrap(), *b"correct");
        assert!(!format!("{renewed:?}").contains("correct") && renewed.secret("other").is_err());
        std::fs::write(&path, vec![0; SECRET_MAX + 1]).unwrap();
        assert_eq!(arguments.secret("password").unwrap_err().kind(), io::ErrorKind::FileTooLarge);
        std::fs::remove_file(&path).unwrap();
        assert!(arguments.secret("password").is_err() && arguments.secret("other").is_err());
        assert_eq!(Parameter::texts(SECRET), ["password: Secret"]);
        let missing = Arguments::parse::<&str>(SECRET, &[]).unwrap_err().to_string();
        assert_eq!(missing, "parameter `password` needs `secret(\"KEY\")` in the spec");
    }

    #[test]
    fn what_is_put_over_is_checked_too() {
        let mut arguments = Arguments::parse(PARAMETERS, &["locked", "7", "false"]).unwrap();
        let wrong = arguments.overlay(PARAMETERS, &[("seed", "-1"), ("loud", "true"), ("gain", "2")]);
        assert_eq!((arguments.text("lock"), arguments.number("seed"), arguments.truth("loud")), ("locked", 7.0, true));
        let wrong: Vec<String> = wrong.iter().map(ToString::to_string).collect();
        assert_eq!(
            wrong,
            [
                "parameter `seed` is `-1`, which is not a number from 0 to 1000000",
                "no parameter `gain`; the parameters are `lock`, `seed`, `loud`"
            ]
        );
    }

    #[test]
    fn a_wrong_value_leaves_the_present_one_and_takes_the_others() {
        const WHOLE: &[Parameter] = &[
            Parameter::new("whole", Kind::Whole(0.0, 10.0)).or("3"),
            Parameter::new("gain", Kind::Number(0.0, 9.0)).or("1"),
            Parameter::new("on", Kind::Truth).or("false"),
            Parameter::new("mode", Kind::Text(&["eco", "boost"])).or("eco"),
            Parameter::new("reach", Kind::Quantity(Quantity::Length, 0.0, 2.0)).or("1"),
        ];
        let pairs = |all: &[(&str, &str)]| -> Vec<(String, String)> {
            all.iter().map(|(name, text)| ((*name).to_owned(), (*text).to_owned())).collect()
        };
        let present = pairs(&[("whole", "7"), ("on", "true"), ("mode", "\"boost\"")]);
        let all = [("whole", "4.5"), ("on", "1"), ("mode", "fast"), ("reach", "3"), ("gain", "5"), ("other", "1")];
        let (taken, wrong) = accepted(WHOLE, pairs(&all), &present);
        assert_eq!(taken, pairs(&[("whole", "7"), ("on", "true"), ("mode", "\"boost\""), ("gain", "5")]));
        assert_eq!(wrong.len(), 5);
        let why = "parameter `whole` is `4.5`, which is not a whole number from 0 to 10";
        assert_eq!(wrong[0].to_string(), why);
        // A value that is no longer set does not stay.
        assert_eq!(accepted(WHOLE, Vec::new(), &present), (Vec::new(), Vec::new()));
        for (given, is_whole) in [("whole=10", true), ("whole=-0", true), ("whole=1e1", true), ("whole=0.5", false)] {
            assert_eq!(Arguments::parse(WHOLE, &[given]).is_ok(), is_whole, "{given}");
        }
        let endless = [Parameter::new("n", Kind::Whole(f64::NEG_INFINITY, f64::INFINITY))];
        for (given, is_whole) in [("n=1e300", true), ("n=inf", false), ("n=-inf", false), ("n=NaN", false)] {
            assert_eq!(Arguments::parse(&endless, &[given]).is_ok(), is_whole, "{given}");
        }
        assert_eq!(Parameter::texts(&WHOLE[..1]), ["whole: Number in 0..10 = 3"]);
    }

    #[test]
    fn a_quantity_has_its_unit_in_the_text_and_comes_without() {
        let force = Kind::Quantity(Quantity::Force, 1.0, 200.0);
        let parameters = [
            Parameter::new("threshold", force).or("8"),
            Parameter::new("way.0", Kind::Quantity(Quantity::Length, f64::NEG_INFINITY, 2.5)),
            Parameter::new("way.1", Kind::Quantity(Quantity::Length, f64::NEG_INFINITY, 2.5)),
            Parameter::new("grip.speed", Kind::Quantity(Quantity::Speed, -0.5, f64::INFINITY)).or("-0.1"),
        ];
        let expect = [
            "threshold: Force in 1 N..200 N = 8 N",
            "way: Length[2] in ..2.5 m",
            "grip: { speed: Speed in -0.5 m/s.. = -0.1 m/s }",
        ];
        assert_eq!(Parameter::texts(&parameters), expect);
        let arguments = Arguments::parse(&parameters, &["20", "way.0=1", "way.1=2"]).unwrap();
        let numbers = ["threshold", "grip.speed"].map(|name| arguments.number(name).to_string());
        assert_eq!(numbers, ["20", "-0.1"]);
        for not_finite in ["grip.speed=inf", "way.0=-inf", "way.0=NaN", "grip.speed=1e999"] {
            let refused = Arguments::parse(&parameters, &["20", "way.1=2", not_finite]).unwrap_err();
            assert!(matches!(refused, ArgumentError::Wrong { .. }), "{not_finite}: {refused}");
        }
        let refused = Arguments::parse(&parameters, &["20 m"]).unwrap_err().to_string();
        assert_eq!(refused, "parameter `threshold` is `20 m`, which is not a number from 1 to 200, the Force in N");
    }

    #[test]
    fn names_with_dots_are_fields_of_records() {
        let number = |name| Parameter::new(name, Kind::Number(0.0, 100.0));
        let parameters = [
            number("job.at.x"),
            Parameter::new("name", Kind::Text(&[])),
            number("job.force").or("20"),
            number("job.at.y"),
            number("corner.0"),
            number("corner.1"),
        ];
        let expect = [
            "job: { at: { x: Number in 0..100, y: Number in 0..100 }, force: Number in 0..100 = 20 }",
            "name: Text",
            "corner: Number[2] in 0..100",
        ];
        assert_eq!(Parameter::texts(&parameters), expect);
        let arguments =
            Arguments::parse(&parameters, &["name=cup", "job.at.x=1", "job.at.y = 2", "corner.0=3", "corner.1=4"])
                .unwrap();
        let numbers = ["job.at.x", "job.at.y", "job.force", "corner.1"].map(|name| arguments.number(name));
        assert_eq!((numbers, arguments.text("name")), ([1.0, 2.0, 20.0, 4.0], "cup"));
    }

    #[test]
    fn a_text_behind_its_name_is_taken_as_it_is() {
        const TEXT: &[Parameter] = &[Parameter::new("name", Kind::Text(&[])), Parameter::new("count", Kind::Truth)];
        for text in [
            "name=bob",
            "count=true",
            "aGVsbG8=",
            "=",
            "",
            " ",
            "  both ends  ",
            "\"quoted\"",
            "\"",
            "a b",
            "--help",
            "-x",
            "$HOME",
            "two\nlines",
            "é\u{202e}\u{0}",
            "true",
            "1e3",
            "secret(\"k\")",
            "name",
            "x.y=1",
            "#",
        ] {
            let arguments = Arguments::parse(TEXT, &[&format!("name={text}"), "count=true"]).unwrap();
            assert_eq!((arguments.text("name"), arguments.truth("count")), (text, true));
        }
    }

    #[test]
    fn values_and_errors() {
        check(&["loud=true"], "unlocked 1 true");
        check(&["\"locked\"", "7", "false"], "locked 7 false");
        check(&["seed = 9", "locked", "loud=true"], "locked 9 true");
        check(&[], "parameter `loud` needs `true` or `false`");
        check(&["ajar"], "parameter `lock` is `ajar`, which is not one of `unlocked`, `locked`");
        check(&["locked", "inf"], "parameter `seed` is `inf`, which is not a number from 0 to 1000000");
        check(&["locked", "-3"], "parameter `seed` is `-3`, which is not a number from 0 to 1000000");
        check(&["lock=locked", "locked"], "parameter `lock` is given twice");
        check(&["sead=1"], "no parameter `sead`; the parameters are `lock`, `seed`, `loud`");
        check(&["locked", "1", "true", "4"], "argument `4` is one too many; the parameters are `lock`, `seed`, `loud`");
    }
}
