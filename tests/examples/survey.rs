//! The door survey: it flies the door mission in many worlds on virtual time, and prints the result for each kind of
//! world.

use clap::Parser;
use comms::logic::time::Time;
use dca_tests::survey::{Mission, Outcome, Row, active_in_phases, fly_all, page, rows, table};
use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

/// Flies the door mission in many worlds, on virtual time, on all cores, and prints how each kind of world ended.
///
/// A row is a kind of world: one dimension drawn from its range with all else nominal; all dimensions at once, half as
/// wide (moderate) or as wide (wide) as alone, hinge on either side; or a trigger: the handle is lost, the grip or the
/// base slips, every hop is delayed, a controller is restarted or killed in each phase of the mission. The same seed
/// draws the same worlds, and a row draws the same worlds in any selection of rows.
///
/// success: DONE, and the door really at 60 degrees or more. strict: success, at most 30 N from the approach to the
/// grasp, and at most 60 N while the door opens. FALSE: DONE with the door below 60 degrees; done deg: the least angle
/// of all that were DONE. Forces are the largest true contact forces of all runs of a row: hit while the hand comes and
/// closes, open while the door opens, worst at any time.
///
/// Exit codes: 0 if there was no FALSE, 1 if there was one or a mission could not be flown, 2 usage.
#[derive(Debug, Parser)]
#[command(name = "survey")]
struct Options {
    /// Worlds a row; a row of restarts or kills has at least one for each controller
    #[arg(long, default_value_t = 24, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    worlds: u32,
    /// The seed that draws the worlds
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Only rows whose group or name contains one of these: `--only radius --only trigger`
    #[arg(long)]
    only: Vec<String>,
    /// Threads; as many as there are cores if not given
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// The spec; its world must be written `DoorWorld("c3"`. It is read at run time: a changed spec needs no build
    #[arg(long, default_value = "specs/door_opening.dca")]
    spec: PathBuf,
    /// How long a mission may take on its own clock (s)
    #[arg(long, default_value_t = 90, value_parser = clap::value_parser!(u16).range(1..))]
    limit: u16,
    /// Where the page with the plots goes
    #[arg(long, default_value = "survey.html")]
    page: PathBuf,
    /// Prints each mission that was not strict, with its arguments
    #[arg(long)]
    failures: bool,
    /// Lists the rows and flies nothing
    #[arg(long)]
    list: bool,
    /// Flies one world, `--one 'seed = 3, radius = 0.7'`, and prints how it ended
    #[arg(long, value_name = "ARGUMENTS")]
    one: Option<String>,
    /// Flies one mission of a row, as `--failures` names it, with the same `--worlds` and `--seed`: `--fly 'radius/3'`
    #[arg(long, value_name = "ROW/NUMBER", conflicts_with = "one")]
    fly: Option<String>,
    /// Writes all signals of the one mission that is flown, every 20 ms, as `time,leaf,signal,value`
    #[arg(long, value_name = "FILE")]
    trace: Option<PathBuf>,
}

fn main() -> ExitCode {
    match survey(&Options::parse()) {
        Ok(code) => code,
        Err(why) => {
            say(&mut std::io::stderr(), &format!("error: {why}"));
            ExitCode::FAILURE
        }
    }
}

fn survey(options: &Options) -> Result<ExitCode, String> {
    let text = std::fs::read_to_string(&options.spec)
        .map_err(|why| format!("cannot read the spec `{}`: {why}", options.spec.display()))?;
    let limit = Duration::from_secs(options.limit.into());
    if let Some(arguments) = &options.one {
        let arguments = arguments.clone();
        let mission = Mission { arguments, ..Mission::nominal() };
        return one(&mission, options, (&text, limit));
    }
    let rows = rows(options.worlds, options.seed, &active_in_phases(&text, limit)?);
    if let Some(name) = &options.fly {
        return one(named(&rows, name)?, options, (&text, limit));
    }
    let rows: Vec<Row> = rows
        .into_iter()
        .filter(|row| {
            let is_named = |part: &String| row.name.contains(part) || row.group.name().contains(part);
            options.only.is_empty() || options.only.iter().any(is_named)
        })
        .collect();
    if rows.is_empty() {
        return Err("no row has such a name; `--list` has them all".to_owned());
    }
    if options.list {
        for row in &rows {
            say(&mut std::io::stdout(), &format!("{:<14} {}", row.group.name(), row.name));
        }
        return Ok(ExitCode::SUCCESS);
    }
    let flown = fly(rows, options, &text, limit)?;
    say(&mut std::io::stdout(), table::text(&flown).trim_end());
    if options.failures {
        say(&mut std::io::stdout(), table::failures(&flown).trim_end());
    }
    let title = format!("Door survey: {} worlds a row, seed {}", options.worlds, options.seed);
    std::fs::write(&options.page, page::html(&flown, &title))
        .map_err(|why| format!("cannot write the page `{}`: {why}", options.page.display()))?;
    say(&mut std::io::stderr(), &format!("the plots are in {}", options.page.display()));
    let is_false = flown.iter().flat_map(|(_, outcomes)| outcomes).any(Outcome::is_false);
    Ok(if is_false { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}

fn fly(rows: Vec<Row>, options: &Options, text: &str, limit: Duration) -> Result<Vec<(Row, Vec<Outcome>)>, String> {
    let threads = options.threads.map(usize::from);
    let threads = threads.or_else(|| std::thread::available_parallelism().ok().map(usize::from)).unwrap_or(1);
    let missions: Vec<Mission> = rows.iter().flat_map(|row| row.missions.clone()).collect();
    let (all, step) = (missions.len(), missions.len().div_ceil(20));
    let told = |flown: usize| {
        if flown.is_multiple_of(step) {
            say(&mut std::io::stderr(), &format!("{flown} of {all} missions"));
        }
    };
    let mut outcomes = fly_all(&missions, (text, limit), threads, &told)?.into_iter();
    Ok(rows
        .into_iter()
        .map(|row| {
            let own = outcomes.by_ref().take(row.missions.len()).collect();
            (row, own)
        })
        .collect())
}

/// Returns the mission with a name from `--failures`.
fn named<'a>(rows: &'a [Row], name: &str) -> Result<&'a Mission, String> {
    let found = name.rsplit_once('/').and_then(|(row, number)| {
        let row = rows.iter().find(|known| known.label() == row)?;
        row.missions.get(number.parse::<usize>().ok()?.checked_sub(1)?)
    });
    found
        .ok_or_else(|| format!("there is no mission `{name}`; write a row of `--list` and a number from 1, `radius/3`"))
}

fn one(mission: &Mission, options: &Options, (text, limit): (&str, Duration)) -> Result<ExitCode, String> {
    let mut trace = String::from("time,leaf,signal,value\n");
    let outcome = mission.fly_watched(text, limit, &mut |simulation| {
        if options.trace.is_some() {
            let now = simulation.now().since(Time::ZERO).as_secs_f64();
            for (leaf, signal) in simulation.signals() {
                trace.push_str(&format!("{now:.3},{leaf},{},{}\n", signal.name, signal.value));
            }
        }
    })?;
    if let Some(file) = &options.trace {
        std::fs::write(file, trace).map_err(|why| format!("cannot write the trace `{}`: {why}", file.display()))?;
    }
    let Outcome { angle, hit, pull, worst, seconds, .. } = &outcome;
    let numbers = format!("{angle:.1} deg, hit {hit:.1} N, open {pull:.1} N, worst {worst:.1} N, {seconds:.1} s");
    say(&mut std::io::stdout(), &format!("{}: {numbers}", outcome.reason()));
    Ok(if outcome.is_false() { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}

/// Writes a line. A closed output is not an error.
fn say(to: &mut dyn Write, text: &str) {
    let _closed = writeln!(to, "{text}");
}
