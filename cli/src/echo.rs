//! `dca echo`: prints the values of an output while its program runs.

use crate::logic::tap::{Gap, Numbers, value};
use crate::tapped::{End, FollowedOutput, TapArgs, TapEvent, follow};
use comms::logic::time::Time;
use node::console::{self, Failure, block_on};
use node::logic::printable::printable;
use serde_json::json;

/// The arguments of `dca echo`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    tap: TapArgs,
    /// End after this many values
    #[arg(short = 'n', long, value_parser = clap::value_parser!(u64).range(1..))]
    count: Option<u64>,
}

/// An output that is printed, and the numbers of its values.
struct Echoed {
    output: FollowedOutput,
    numbers: Numbers,
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let (mut echoed, mut left): (Vec<Echoed>, _) = (Vec::new(), arguments.count);
    let end = block_on(follow(&arguments.tap, |event| {
        let (place, tapped) = match event {
            TapEvent::Begun(outputs) => {
                let echo = |output| Echoed { output, numbers: Numbers::default() };
                echoed = outputs.into_iter().map(echo).collect();
                return Ok(None);
            }
            TapEvent::Second => return Ok(None),
            TapEvent::Value(place, tapped) => (place, tapped),
        };
        let has_name = echoed.len() > 1;
        let Some(Echoed { output, numbers }) = echoed.get_mut(place) else { return Ok(None) };
        let gap = numbers.take(tapped.number);
        let value = value(output.message.as_ref(), &tapped.bytes);
        let line = if arguments.tap.json {
            let lost = if let Gap::Lost(lost) = gap { lost } else { 0 };
            let stamp = tapped.stamp.since(Time::ZERO).as_secs_f64();
            json!({
                "output": output.name, "type": output.type_name, "number": tapped.number, "stamp": stamp, "lost": lost,
                "restarted": gap == Gap::Restarted, "value": value,
            })
            .to_string()
        } else {
            match gap {
                Gap::None => {}
                Gap::Lost(lost) => console::note(&format!("{}: {lost} lost on the way here", output.name)),
                Gap::Restarted => console::note(&format!("{}: its program was started again", output.name)),
            }
            let name = if has_name { format!("{} ", output.name) } else { String::new() };
            format!("{name}{}: {value}", tapped.number)
        };
        if !console::pass(format!("{}\n", printable(&line)).as_bytes())? {
            return Ok(Some(End::Interrupted));
        }
        left = left.map(|left| left - 1);
        Ok((left == Some(0)).then_some(End::Enough))
    }))?;
    match (arguments.tap.json, end) {
        (true, end) => console::answer(&json!({ "end": end.word() })),
        (false, End::Finished) => console::note("the deployment is over"),
        (false, End::Enough | End::Interrupted) => {}
    }
    Ok(())
}
