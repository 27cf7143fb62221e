//! `dca replay`: runs a spec on this machine, where a record replaces some of its processes. Or it shows the record in Foxglove.

use crate::follow::{self, Spec};
use crate::io::{named_file, recorder};
use crate::logic::foxglove::{layout_of_record, origin};
use crate::logic::record::{MISSING, Run, messages, output_message};
use crate::logic::replay::{self, Playing, StandIn, TAIL};
use crate::reader::Reader;
use crate::run::{self, Here};
use crate::viewer::foxglove::{put_layout, serve_record};
use crate::{Controllers, Values, check, viewer};
use anyhow::{Context as _, anyhow};
use language::plan::LeafPort;
use node::console::{self, Failure, block_on};
use node::io::programs;
use node::logic::table::counted;
use std::collections::BTreeMap;
use std::fs::DirBuilder;
use std::net::SocketAddr;
use std::os::unix::fs::DirBuilderExt as _;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// The program that plays steps.
const PLAYER: &str = "dca-controller";
/// The folder for the steps, in the folder of this command's nodes.
const STEPS: &str = "replay";

/// The arguments of `dca replay`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The record, or the folder it is in
    record: PathBuf,
    /// The spec: the spec of the record, or a changed spec
    #[arg(required_unless_present_any = ["foxglove", "layout"])]
    file: Option<PathBuf>,
    /// Play the record in Foxglove or Lichtblick on this machine, and run nothing [default: 127.0.0.1:8765]
    #[arg(
        long, value_name = "ADDR", num_args = 0..=1, default_missing_value = viewer::FOXGLOVE, value_parser = viewer::address,
        conflicts_with = "file"
    )]
    foxglove: Option<SocketAddr>,
    /// Let a web page of this origin connect to `--foxglove`, such as `https://viewer.example`; may be given more than once
    /// [default: Foxglove, Lichtblick and pages of this machine]
    #[arg(long = "origin", value_name = "ORIGIN", value_parser = origin, requires = "foxglove")]
    origins: Vec<String>,
    /// Write a layout for Foxglove or Lichtblick with panels for the record, and run nothing
    #[arg(long, value_name = "FILE", conflicts_with_all = ["file", "foxglove"])]
    layout: Option<PathBuf>,
    /// The outputs of the processes that the record replaces, such as `Scan` or `laser.Scan`
    /// [default: the outputs of each process that only sends]
    #[arg(long = "ports", value_name = "PORT", value_delimiter = ',')]
    played: Vec<String>,
    /// How much faster than recorded
    #[arg(long, value_name = "NUMBER", default_value = "1", value_parser = rate)]
    rate: f64,
    #[command(flatten)]
    following: follow::FollowArgs,
    #[command(flatten)]
    controllers: Controllers,
    #[command(flatten)]
    values: Values,
    /// Folder with the sockets of this machine's nodes, where other verbs find this command's, too
    #[arg(long, value_name = "DIR")]
    run_dir: Option<PathBuf>,
}

fn rate(text: &str) -> Result<f64, String> {
    let rate: f64 = text.parse().map_err(|_no_number| format!("`{text}` is not a number"))?;
    if (0.01..=100.0).contains(&rate) { Ok(rate) } else { Err("it is from 0.01 to 100".to_owned()) }
}

/// Runs the verb.
pub(crate) fn run(arguments: Arguments) -> Result<(), Failure> {
    let record = recorder::file(&arguments.record);
    let Some(file) = &arguments.file else { return show(&arguments, &record) };
    let recorded = recorder::read_with_values(&record).map_err(anyhow::Error::from)?;
    if let Some(damage) = recorded.lacks() {
        console::note(&format!("warning: the record `{}` is not whole: {damage}", record.display()));
    }
    let missing = recorded.missing();
    for sentence in &missing {
        console::note(&format!("warning: {sentence}"));
    }
    let mut spec = check::load(file, &arguments.controllers, &arguments.values, false)?;
    let counts = counts(&recorded);
    let why = |why: String| {
        if missing.is_empty() { anyhow!(why) } else { anyhow!("{why}; the warnings name missing values") }
    };
    let stand_ins = replay::choose(&spec.plan, &counts, &arguments.played).map_err(why)?;
    programs::check_shim()?;
    let base = run::base(arguments.run_dir.as_deref())?;
    let prepared = prepare(&mut spec, &recorded, &stand_ins, &base.join(STEPS), arguments.rate);
    if let Err(error) = prepared {
        run::remove(&base);
        return Err(error.into());
    }
    tell_unused(&spec, &counts, &stand_ins);
    let length = end(&recorded).div_f64(arguments.rate) + TAIL;
    if !replay::end_after(&mut spec.plan, length) {
        console::note("warning: `main` is an activity, so it does not end with the record; end it with Ctrl-C");
    }
    let Arguments { following, controllers, .. } = &arguments;
    run::carry_out(spec, &base, Here { following, controllers, state: None })
}

/// Shows a record in Foxglove, or writes a layout for it.
fn show(arguments: &Arguments, record: &Path) -> Result<(), Failure> {
    viewer::local("--foxglove", arguments.foxglove)?;
    let timeline = recorder::read_timeline(record).map_err(anyhow::Error::from)?;
    if timeline.is_damaged {
        console::note(&format!("warning: the record `{}` is not whole: parts of it are not shown", record.display()));
    }
    if timeline.topics.iter().any(|topic| topic.name == MISSING) {
        console::note(&format!("warning: the topic `{MISSING}` counts values of wires that are not in the record"));
    }
    if let Some(file) = &arguments.layout {
        named_file::not_over(file, [record])?;
        return Ok(put_layout(file, &layout_of_record(&timeline), timeline.topics.len())?);
    }
    let Some(address) = arguments.foxglove else { return Ok(()) };
    block_on(async {
        let mut reader = Reader::new()?;
        Ok(serve_record(address, arguments.origins.clone(), timeline, &mut reader).await?)
    })
}

/// Returns the number of values that the record has for each output.
fn counts(recorded: &Run) -> BTreeMap<String, u64> {
    let mut counts = BTreeMap::new();
    for value in &recorded.values {
        *counts.entry(value.from.clone()).or_default() += 1;
    }
    counts
}

/// Returns the time of the last entry of the record, since GO.
fn end(recorded: &Run) -> Duration {
    let last = recorded.values.iter().map(|value| value.at).max().unwrap_or_default();
    last.max(recorded.mission().now())
}

/// Writes the steps of each stand-in, and puts the stand-in into the plan.
fn prepare(spec: &mut Spec, recorded: &Run, stand_ins: &[StandIn], folder: &Path, rate: f64) -> anyhow::Result<()> {
    let program = programs::beside(PLAYER);
    if !program.is_file() {
        return Err(anyhow!("a replay needs `{PLAYER}` of the same build in the folder of `dca`"));
    }
    let making = || format!("making the folder `{}`", folder.display());
    DirBuilder::new().recursive(true).mode(0o700).create(folder).with_context(making)?;
    let types = messages(&spec.modules);
    for stand_in in stand_ins {
        let Some(leaf) = spec.plan.leaves.get(stand_in.leaf as usize) else { continue };
        let path = leaf.path.clone();
        let of_output = |output| {
            let port = LeafPort { leaf: stand_in.leaf, port: String::clone(output) };
            Some((output.as_str(), output_message(&spec.plan, &types, &port)?))
        };
        let of_outputs: BTreeMap<&str, _> = stand_in.outputs.iter().filter_map(of_output).collect();
        let message = |output: &str| of_outputs.get(output);
        let steps = replay::steps(recorded, &path, stand_in, message).map_err(|why| anyhow!("`{path}`: {why}"))?;
        for (output, counts) in &steps.counts {
            console::note(&format!("plays {path}.{output}: {}", steps.plays(output)));
            if counts.lost > 0 {
                let lost = counted(counts.lost, "value");
                console::note(&format!(
                    "warning: {path}.{output}: {lost} cannot be played: the record does not have the complete values, or they have \
                     another type"
                ));
            }
        }
        for silent in stand_in.outputs.iter().skip(stand_in.recorded) {
            console::note(&format!("warning: {path}.{silent} sends nothing: the record has no values of it"));
        }
        let file = folder.join(stand_in.leaf.to_string());
        std::fs::write(&file, steps.steps).with_context(|| format!("writing `{}`", file.display()))?;
        replay::replace(&mut spec.plan, stand_in, Playing { program: &program, file: &file, rate });
    }
    Ok(())
}

/// Says which outputs of the record are not played.
fn tell_unused(spec: &Spec, counts: &BTreeMap<String, u64>, stand_ins: &[StandIn]) {
    let outputs = stand_ins.iter().filter_map(|one| {
        let path = &spec.plan.leaves.get(one.leaf as usize)?.path;
        Some(one.outputs.iter().map(move |output| format!("{path}/{output}")))
    });
    let played: Vec<String> = outputs.flatten().collect();
    for (output, count) in counts.iter().filter(|(output, _)| !played.contains(output)) {
        let (path, name) = output.rsplit_once('/').unwrap_or(("", output));
        console::note(&format!("does not play {path}.{name}: {}", counted(*count, "value")));
    }
}
