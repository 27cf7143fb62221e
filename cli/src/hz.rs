//! `dca hz`: prints how often and how regularly an output sends values, and how large they are.

use crate::logic::tap::Rate;
use crate::tapped::{End, TapArgs, TapEvent, follow};
use anyhow::anyhow;
use comms::io::clock;
use node::console::{self, Failure, block_on};
use serde_json::json;
use std::time::Duration;

/// The arguments of `dca hz`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    tap: TapArgs,
    /// End after this many seconds [default: until Ctrl-C]
    #[arg(long = "for", value_name = "SECONDS", value_parser = |text: &str| crate::seconds(text, &(0.1..=86_400.0)), allow_negative_numbers = true)]
    seconds: Option<f64>,
}

/// An output, with the rate of its values since the last line, and the rate during the whole time.
struct Counted {
    name: String,
    lately: Rate,
    whole: Rate,
}

/// Runs the verb. Prints a line each second, and at the end a line for the whole time.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let (mut counted, mut ends): (Vec<Counted>, _) = (Vec::new(), None);
    let line = |name: &str, rate: &Rate, of: &str| {
        let line = if arguments.tap.json {
            json!({ "output": name, "of": of, "rate": rate.json() }).to_string()
        } else {
            format!("{name}: {}{}", if of == "all" { "in all " } else { "" }, rate.text())
        };
        console::pass(format!("{line}\n").as_bytes())
    };
    let end = block_on(follow(&arguments.tap, |event| {
        match event {
            TapEvent::Begun(outputs) => {
                let count = |name| Counted { name, lately: Rate::default(), whole: Rate::default() };
                counted = outputs.into_iter().map(|output| count(output.name)).collect();
                ends = arguments.seconds.map(|seconds| clock::now() + Duration::from_secs_f64(seconds));
            }
            TapEvent::Value(place, tapped) => {
                if let Some(one) = counted.get_mut(place) {
                    one.lately.take(&tapped);
                    one.whole.take(&tapped);
                }
            }
            TapEvent::Second => {
                for one in &mut counted {
                    if !line(&one.name, &one.lately, "second")? {
                        return Ok(Some(End::Interrupted));
                    }
                    one.lately = one.lately.next();
                }
            }
        }
        Ok(ends.is_some_and(|ends| clock::now() >= ends).then_some(End::Enough))
    }))?;
    for one in &counted {
        line(&one.name, &one.whole, "all")?;
    }
    if arguments.tap.json {
        console::answer(&json!({ "end": end.word() }));
    }
    if end == End::Enough && counted.iter().all(|one| one.whole.is_empty()) {
        let names: Vec<&str> = counted.iter().map(|one| one.name.as_str()).collect();
        return Err(anyhow!(
            "no value has left `{}` in that time; `dca status` says which processes run",
            names.join("`, `")
        )
        .into());
    }
    Ok(())
}
