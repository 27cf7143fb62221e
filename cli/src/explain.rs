//! `dca explain`: explains a diagnostic code.

use anyhow::anyhow;
use language::{Code, Severity};
use node::console::{self, Failure};

/// The arguments of `dca explain`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The code, such as E0201 [default: list all codes]
    code: Option<String>,
    /// Print it as JSON
    #[arg(long)]
    json: bool,
}

/// A diagnostic code in JSON.
#[derive(serde::Serialize)]
struct Explained {
    code: String,
    severity: &'static str,
    title: &'static str,
    explanation: &'static str,
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let one = match &arguments.code {
        None => None,
        Some(code) => Some(Code::parse(code).ok_or_else(|| anyhow!("no code `{code}`; `dca explain` lists them all"))?),
    };
    match one {
        Some(code) if arguments.json => console::answer(&explained(code)),
        Some(code) => console::say(&explanation(code)),
        None if arguments.json => {
            console::answer(&Vec::from_iter(Code::ALL.iter().copied().map(explained)));
        }
        None => console::say(&list()),
    }
    Ok(())
}

fn explained(code: Code) -> Explained {
    let severity = match code.severity() {
        Severity::Error => "error",
        Severity::Warning => "warning",
    };
    Explained { code: code.to_string(), severity, title: code.title(), explanation: code.explanation() }
}

fn explanation(code: Code) -> String {
    let severity = match code.severity() {
        Severity::Error => "an error: the spec is refused",
        Severity::Warning => "a warning: the spec runs, but may not do what you want",
    };
    format!("{code}: {}\n\n{}\n\nThis is {severity}.", code.title(), code.explanation())
}

fn list() -> String {
    Code::ALL.iter().map(|code| format!("{code}  {}\n", code.title())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_code_is_listed_and_explained() {
        assert_eq!(list().lines().count(), Code::ALL.len());
        assert!(list().contains("E0201  unknown process\n"));
        assert!(explanation(Code::E0201).starts_with("E0201: unknown process\n\nThe name is not an instance"));
    }
}
