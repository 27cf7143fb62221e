//! The ports of a struct, as the derive macros read them.

use proc_macro2::Span;
use syn::parse::{Parse, ParseStream};
use syn::spanned::Spanned;
use syn::{Attribute, Data, DeriveInput, Error, Expr, ExprLit, Field, Fields, Ident, Lit, LitStr, Meta, Token, Type};

/// The direction in which data flows through the ports of a struct.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Direction {
    /// `#[derive(Inputs)]`
    In,
    /// `#[derive(Outputs)]`
    Out,
}

/// The type that a port is bound to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Binding {
    /// A wire that a spec has to give it.
    Wire,
    /// A wire that a spec may give it.
    Optional,
    /// A device of another program.
    Client,
    /// A device of this program.
    Owner,
    /// Calls of another process, which a spec has to connect.
    Calls,
    /// Calls of another process, which a spec may connect.
    OptionalCalls,
    /// The database of the robot.
    Database,
}

/// One field.
#[derive(Debug)]
pub(crate) struct Port<'a> {
    pub(crate) field: &'a Ident,
    pub(crate) ty: &'a Type,
    pub(crate) name: LitStr,
    pub(crate) binding: Binding,
    /// Its doc comment in one line; empty without one.
    pub(crate) doc: String,
}

/// `"In"`, `"In", optional`, `"arm/cmd", owner`
struct Declared {
    name: LitStr,
    option: Option<Ident>,
}

impl Parse for Declared {
    fn parse(input: ParseStream<'_>) -> syn::Result<Self> {
        let name = input.parse()?;
        let option = if input.parse::<Option<Token![,]>>()?.is_some() { input.parse()? } else { None };
        if !input.is_empty() {
            return Err(input.error("expected nothing more: `#[port(\"In\")]` or `#[port(\"In\", optional)]`"));
        }
        Ok(Self { name, option })
    }
}

/// Reads the ports of a struct.
///
/// # Errors
/// Everything that is wrong, each at its place.
pub(crate) fn read(input: &DeriveInput, direction: Direction) -> syn::Result<Vec<Port<'_>>> {
    let Data::Struct(data) = &input.data else {
        return Err(Error::new(input.ident.span(), "ports are the fields of a struct"));
    };
    let fields = match &data.fields {
        Fields::Named(fields) => &fields.named,
        Fields::Unit => return Ok(Vec::new()),
        Fields::Unnamed(fields) => {
            return Err(Error::new(
                fields.span(),
                "ports are named fields: `struct Ports { #[port(\"In\")] value: In<f64> }`",
            ));
        }
    };
    let mut ports: Vec<Port<'_>> = Vec::new();
    let mut errors: Option<Error> = None;
    for field in fields {
        let read = port(field, direction).and_then(|port| {
            match ports.iter().find(|other| other.name.value() == port.name.value()) {
                Some(other) => {
                    let why =
                        format!("port `{}` is declared twice: the field `{}` has it", port.name.value(), other.field);
                    Err(Error::new(port.name.span(), why))
                }
                None => Ok(port),
            }
        });
        match read {
            Ok(port) => ports.push(port),
            Err(error) => match &mut errors {
                Some(errors) => errors.combine(error),
                None => errors = Some(error),
            },
        }
    }
    errors.map_or(Ok(ports), Err)
}

fn port(field: &Field, direction: Direction) -> syn::Result<Port<'_>> {
    let name = field.ident.as_ref().ok_or_else(|| Error::new(field.span(), "a port is a named field"))?;
    let is_own =
        |attribute: &&Attribute| ["port", "device", "calls", "database"].iter().any(|name| is(attribute, name));
    let mut own = field.attrs.iter().filter(is_own);
    let example = if direction == Direction::In { "In" } else { "Out" };
    let Some(attribute) = own.next() else {
        let why = format!("say which port `{name}` is: `#[port(\"{example}\")]` or `#[device(\"arm/state\")]`");
        return Err(Error::new(name.span(), why));
    };
    if let Some(second) = own.next() {
        return Err(Error::new(second.span(), format!("`{name}` is one port: one attribute says which")));
    }
    if is(attribute, "database") {
        return database(field, name, attribute, direction);
    }
    let Declared { name: port, option } = attribute.parse_args()?;
    let binding = if is(attribute, "device") {
        device(&port, option.as_ref(), direction)?
    } else if is(attribute, "port") {
        wire(&port, option.as_ref())?
    } else if direction == Direction::In {
        return Err(Error::new(
            attribute.span(),
            "calls are made by outputs: the field belongs to the struct of outputs",
        ));
    } else if wire(&port, option.as_ref())? == Binding::Wire {
        Binding::Calls
    } else {
        Binding::OptionalCalls
    };
    Ok(Port { field: name, ty: &field.ty, name: port, binding, doc: doc(&field.attrs) })
}

/// The one field for the database; its name is the trigger's name.
fn database<'a>(
    field: &'a Field,
    name: &'a Ident,
    attribute: &Attribute,
    direction: Direction,
) -> syn::Result<Port<'a>> {
    attribute.meta.require_path_only()?;
    if direction == Direction::In {
        let why = "the database is asked after a calculation: the field belongs to the struct of outputs";
        return Err(Error::new(attribute.span(), why));
    }
    let (port, doc) = (LitStr::new("database", attribute.span()), doc(&field.attrs));
    Ok(Port { field: name, ty: &field.ty, name: port, binding: Binding::Database, doc })
}

fn is(attribute: &Attribute, name: &str) -> bool {
    attribute.path().is_ident(name)
}

fn wire(name: &LitStr, option: Option<&Ident>) -> syn::Result<Binding> {
    if !is_word(&name.value()) {
        let why = if name.value().contains('/') {
            format!("`{0}` is a device: `#[device(\"{0}\")]`", name.value())
        } else {
            format!("`{}` cannot be the name of a port: letters, digits and `_`, a letter first", name.value())
        };
        return Err(Error::new(name.span(), why));
    }
    match option {
        None => Ok(Binding::Wire),
        Some(word) if word == "optional" => Ok(Binding::Optional),
        Some(word) => Err(Error::new(word.span(), format!("`{word}` means nothing here; `optional` does"))),
    }
}

/// A client receives the `state` of a device, and sends to its `cmd`. The owner sends the `state`, and receives the `cmd`.
fn device(name: &LitStr, option: Option<&Ident>, direction: Direction) -> syn::Result<Binding> {
    let binding = match option {
        None => Binding::Client,
        Some(word) if word == "owner" => Binding::Owner,
        Some(word) => return Err(Error::new(word.span(), format!("`{word}` means nothing here; `owner` does"))),
    };
    let channel = if (direction == Direction::In) == (binding == Binding::Client) { "state" } else { "cmd" };
    match name.value().split_once('/') {
        Some((device, found)) if is_word(device) && found == channel => Ok(binding),
        Some((device, found)) if is_word(device) && (found == "state" || found == "cmd") => {
            let who = if binding == Binding::Owner { "the owner of" } else { "a client of" };
            let does = if direction == Direction::In { "hears" } else { "sends" };
            Err(Error::new(
                name.span(),
                format!("{who} `{device}` {does} `{device}/{channel}`, not `{device}/{found}`"),
            ))
        }
        Some(_) | None => {
            let why = format!("`{}` is not a device: `NAME/{channel}` such as `arm/{channel}`", name.value());
            Err(Error::new(name.span(), why))
        }
    }
}

/// A name as specs have them.
fn is_word(text: &str) -> bool {
    text.starts_with(|first: char| first.is_ascii_alphabetic() || first == '_')
        && text.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
}

/// The doc comment of a field, its lines joined.
fn doc(attributes: &[Attribute]) -> String {
    let lines = attributes.iter().filter(|attribute| is(attribute, "doc")).filter_map(|attribute| {
        let Meta::NameValue(meta) = &attribute.meta else { return None };
        let Expr::Lit(ExprLit { lit: Lit::Str(text), .. }) = &meta.value else { return None };
        Some(text.value().trim().to_owned())
    });
    lines.filter(|line| !line.is_empty()).collect::<Vec<_>>().join(" ")
}

impl Port<'_> {
    /// Whether it makes calls.
    pub(crate) fn is_call(&self) -> bool {
        matches!(self.binding, Binding::Calls | Binding::OptionalCalls)
    }

    /// Where an error about its type belongs.
    pub(crate) fn type_span(&self) -> Span {
        self.ty.span()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Field, port, binding and documentation.
    type Row<'a> = (&'a str, &'a str, Binding, &'a str);

    /// Checks the ports that are read of a struct with these fields, or every error.
    fn check(fields: &str, direction: Direction, expect: Result<&[Row<'_>], &[&str]>) {
        let input: DeriveInput = syn::parse_str(&format!("struct Ports {{ {fields} }}")).unwrap();
        let found = match read(&input, direction) {
            Ok(ports) => {
                let shown = |port: Port<'_>| (port.field.to_string(), port.name.value(), port.binding, port.doc);
                Ok(ports.into_iter().map(shown).collect::<Vec<_>>())
            }
            Err(errors) => Err(errors.into_iter().map(|error| error.to_string()).collect::<Vec<_>>()),
        };
        let found = found.as_ref().map(|ports| {
            ports.iter().map(|(field, name, binding, doc)| (&**field, &**name, *binding, &**doc)).collect::<Vec<_>>()
        });
        let found = found.map_err(|errors| errors.iter().map(String::as_str).collect::<Vec<_>>());
        assert_eq!(found, expect.map(<[_]>::to_vec).map_err(<[_]>::to_vec), "{fields}");
    }

    #[test]
    fn a_field_says_which_port_it_is_and_a_doc_comment_is_optional() {
        let fields = "/// What is measured,\n /// in metres.\n #[port(\"In\")] pub length: In<Length>, \
                      #[port(\"In2\", optional)] gain: In<f64>, #[device(\"arm/state\")] arm: In<ArmState>, \
                      #[device(\"base/cmd\", owner)] base: In<BaseCommand>,";
        let expect = [
            ("length", "In", Binding::Wire, "What is measured, in metres."),
            ("gain", "In2", Binding::Optional, ""),
            ("arm", "arm/state", Binding::Client, ""),
            ("base", "base/cmd", Binding::Owner, ""),
        ];
        check(fields, Direction::In, Ok(&expect));
        check("", Direction::Out, Ok(&[]));
    }

    #[test]
    fn every_mistake_is_told_and_what_would_be_right() {
        let fields = "a: In<f64>, #[port(\"In\")] b: In<f64>, #[port(\"In\")] c: In<f64>, #[port(\"two words\")] d: In<f64>, \
                      #[port(\"In3\", needed)] e: In<f64>, #[device(\"arm/cmd\")] f: In<f64>, #[port(\"arm/state\")] g: In<f64>, \
                      #[port(\"In4\")] #[device(\"arm/state\")] h: In<f64>, #[device(\"arm\", owner)] i: In<f64>, \
                      #[port(\"In5\", optional, optional)] j: In<f64>";
        let errors = [
            "say which port `a` is: `#[port(\"In\")]` or `#[device(\"arm/state\")]`",
            "port `In` is declared twice: the field `b` has it",
            "`two words` cannot be the name of a port: letters, digits and `_`, a letter first",
            "`needed` means nothing here; `optional` does",
            "a client of `arm` hears `arm/state`, not `arm/cmd`",
            "`arm/state` is a device: `#[device(\"arm/state\")]`",
            "`h` is one port: one attribute says which",
            "`arm` is not a device: `NAME/cmd` such as `arm/cmd`",
            "expected nothing more: `#[port(\"In\")]` or `#[port(\"In\", optional)]`",
        ];
        check(fields, Direction::In, Err(&errors));
    }

    #[test]
    fn ports_are_named_fields_of_a_struct() {
        for text in ["enum Ports { A }", "struct Ports(In<f64>);", "union Ports { a: u8 }"] {
            let input: DeriveInput = syn::parse_str(text).unwrap();
            assert!(read(&input, Direction::In).is_err(), "{text}");
        }
        let unit: DeriveInput = syn::parse_str("struct Ports;").unwrap();
        assert!(read(&unit, Direction::In).is_ok_and(|ports| ports.is_empty()));
    }
}
