//! `dca fmea`: the effects of each single fault of each program, host and link, and of each pair of faults.

use crate::logic::page::text::escape;
use crate::verify::{LimitArgs, Refusal, load, story};
use crate::{Controllers, Values};
use comms::io::clock;
use node::console::{self, Failure};
use node::logic::table::counted;
use serde_json::{Value, json};
use std::path::PathBuf;
use verify::{COLUMNS, Faults, Row, Severity, Table};

/// The arguments of `dca fmea`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The spec
    file: PathBuf,
    /// Print the table as comma-separated values
    #[arg(long, conflicts_with = "html")]
    csv: bool,
    /// Print the table as a page for a browser
    #[arg(long)]
    html: bool,
    /// Explain each row
    #[arg(long, conflicts_with_all = ["csv", "html"])]
    stories: bool,
    /// Print the table as one JSON document, with the story of each row
    #[arg(long, conflicts_with_all = ["csv", "html", "stories"])]
    json: bool,
    /// Print the table in Markdown
    #[arg(long, conflicts_with_all = ["csv", "html", "stories", "json"])]
    markdown: bool,
    /// How many faults may happen in one run: 1 or 2; with 2, only pairs that are worse than each fault alone are printed
    #[arg(long, value_name = "NUMBER", default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..=2))]
    faults: u8,
    #[command(flatten)]
    limits: LimitArgs,
    #[command(flatten)]
    controllers: Controllers,
    #[command(flatten)]
    values: Values,
}

/// The most programs that are named because they were not explored completely.
const UNFINISHED_MAX: usize = 10;

/// The verdicts, from the worst to the best.
const SEVERITIES: [Severity; 8] = [
    Severity::Stuck,
    Severity::Adrift,
    Severity::Unconfirmed,
    Severity::Blind,
    Severity::FailsLater,
    Severity::Degraded,
    Severity::Handled,
    Severity::Safe,
];

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let refusal = if arguments.json { Refusal::Json } else { Refusal::Text };
    let loaded = load(&arguments.file, &arguments.controllers, &arguments.values, refusal)?;
    let faults = if arguments.faults == 2 { Faults::Two } else { Faults::One };
    let start = clock::now();
    let table = arguments.limits.with(|limits| verify::fmea(&loaded.plan, &loaded.sites, limits, faults));
    let took = clock::now().since(start);
    match arguments {
        Arguments { csv: true, .. } => console::say(&csv(&table)),
        Arguments { html: true, .. } => console::say(&html(&loaded.plan.name, &table)),
        Arguments { json: true, .. } => console::answer(&json(&loaded.plan.name, &table)),
        Arguments { markdown: true, .. } => console::say(&table.markdown()),
        _ => {
            let took = format!("looked at in {:.2} s\n", took.as_secs_f64());
            console::say(&(text(&table, arguments.stories, faults) + &took));
        }
    }
    for program in table.unfinished.iter().take(UNFINISHED_MAX) {
        console::note(&format!("not all faults of `{program}` were examined: a limit was reached"));
    }
    if let Some(more @ 1..) = table.unfinished.len().checked_sub(UNFINISHED_MAX) {
        console::note(&format!("and {more} more programs were not examined completely"));
    }
    if table.unfinished.is_empty() { Ok(()) } else { Err(Failure::Limited) }
}

fn text(table: &Table, tells_stories: bool, faults: Faults) -> String {
    let mut text = String::new();
    let mut program = "";
    for row in &table.rows {
        let [_, fault, phase, effect, running, safe, mission, word] = row.cells();
        if program != row.program {
            text += &format!("{}\n", row.program);
            program = &row.program;
        }
        let safe = if safe.is_empty() { String::new() } else { format!(" within {safe}") };
        text += &format!(
            "  {fault}, while: {phase}\n    {word}{safe}: {effect}; still runs: {running}; the mission {mission}\n"
        );
        if tells_stories {
            row.story.lines().iter().for_each(|line| text += &format!("      {line}\n"));
        }
    }
    let count = |severity| table.rows.iter().filter(|row| row.severity == severity).count();
    let of = |severity: Severity| format!("{} {}", count(severity), severity.word());
    let all = SEVERITIES.into_iter().filter(|severity| count(*severity) > 0).map(of);
    let all = all.collect::<Vec<_>>().join(", ");
    let states = counted(table.states, "state");
    let rows = counted(table.rows.len(), "row");
    match faults {
        Faults::One => text + &format!("{rows} over {states}: {all}\n"),
        Faults::Two => {
            let harmless = counted(table.harmless, "other pair");
            let all = if all.is_empty() { String::new() } else { format!(": {all}") };
            text + &format!("{rows} over {states}{all}; {harmless} no worse than one of the two faults alone\n")
        }
    }
}

fn csv(table: &Table) -> String {
    let quoted = |cell: &str| format!("\"{}\"", cell.replace('"', "\"\""));
    let line = |cells: &[String]| cells.iter().map(|cell| quoted(cell)).collect::<Vec<_>>().join(",") + "\n";
    let head = COLUMNS.map(str::to_owned);
    line(&head) + &table.rows.iter().map(|row| line(&row.cells())).collect::<String>()
}

/// `{"version", "spec", "rows": [{"program", "fault", "while", "at_once", "still_runs", "safe_within_s", "mission",
/// "verdict", "story"}], "states", "unfinished", "harmless"}`. A row without `safe_within_s` means that not everything
/// stops.
fn json(name: &str, table: &Table) -> Value {
    let row = |row: &Row| {
        json!({
            "program": row.program,
            "fault": row.fault,
            "while": row.phase,
            "at_once": row.effect.replace('`', ""),
            "still_runs": row.running,
            "safe_within_s": row.safe_within.map(|time| time.as_secs_f64()),
            "mission": row.mission.word(),
            "verdict": row.severity.word().to_lowercase(),
            "story": story(&row.story),
        })
    };
    let rows: Vec<Value> = table.rows.iter().map(row).collect();
    json!({
        "version": 1,
        "spec": name,
        "rows": rows,
        "states": table.states,
        "unfinished": table.unfinished,
        "harmless": table.harmless,
    })
}

fn html(name: &str, table: &Table) -> String {
    let row = |row: &Row| {
        let cells = row.cells().map(|cell| format!("<td>{}</td>", escape(&cell))).join("");
        format!("<tr class=\"{}\">{cells}</tr>\n", row.severity.word().to_lowercase().replace(' ', "-"))
    };
    let rows: String = table.rows.iter().map(row).collect();
    let head = COLUMNS.map(|column| format!("<th>{column}</th>")).join("");
    let name = escape(name);
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>Faults of {name}</title>\n<style>body{{font:15px sans-serif}}\
         td,th{{text-align:left;padding:3px 10px;border-bottom:1px solid #ccc;vertical-align:top}}.stuck,.out-of-reach{{background:#fdd}}\
         .unconfirmed,.goes-on-blind{{background:#fed}}.goes-on-without,.fails-later{{background:#ffd}}</style></head>\n<body><h1>Faults of {name}</h1>\n<table>\n<tr>{head}</tr>\n{rows}</table></body></html>\n"
    )
}
