//! `dca view --layout`: writes a layout for the missions that run.
//!
//! It looks at the robots as one client does that has subscribed to nothing: programs tell their outputs, and one sample tells the
//! names of the signals of a program.

use super::robots::Robots;
use crate::io::whole_file;
use crate::live::Live;
use crate::logic::foxglove::Hub;
use crate::reader::Reader;
use anyhow::{Context as _, anyhow};
use comms::io::clock;
use comms::logic::time::Time;
use node::console::{self, Failure};
use node::logic::table::counted;
use serde_json::Value;
use std::path::Path;
use std::time::Duration;
use view::Model;

/// How long after the last new topic the layout is written.
const QUIET_FOR: Duration = Duration::from_secs(2);
/// How long topics are looked for at most.
const LOOK_WITHIN: Duration = Duration::from_secs(15);
/// How often robots are looked at.
const LOOK_EVERY: Duration = Duration::from_millis(200);

/// Writes a layout with panels for all topics that are found.
pub(in crate::viewer) async fn write(file: &Path, mut live: Live, reader: &mut Reader) -> Result<(), Failure> {
    let (mut hub, mut robots, mut model) = (Hub::new(0), Robots::new(), Model::new(0));
    hub.enter();
    let begun = clock::now();
    let (mut changed, mut channels) = (begun, 0);
    let mut look = tokio::time::interval(LOOK_EVERY);
    let is_left = loop {
        tokio::select! {
            input = live.next() => model.apply(clock::now(), input),
            news = robots.next() => robots.take(news, &mut hub),
            _ = look.tick() => {
                live.follow(&model, None, None);
                hub.look(&model, clock::now(), Duration::ZERO);
                robots.follow(&live, &model, &mut hub);
                let now = clock::now();
                if hub.channels() != channels {
                    (changed, channels) = (now, hub.channels());
                }
                if is_enough(begun, changed, now) {
                    break false;
                }
            }
            () = reader.left() => break true,
        }
    };
    let layout = hub.layout(&model);
    robots.close().await;
    live.close().await;
    if is_left {
        return Ok(());
    }
    let layout = layout.ok_or_else(|| {
        anyhow!("no mission runs, so a layout would have no panels; deploy one, and then run the same command again")
    })?;
    put(file, &layout, channels)?;
    Ok(())
}

/// Writes a layout, and says how to open it.
pub(crate) fn put(file: &Path, layout: &Value, topics: usize) -> anyhow::Result<()> {
    whole_file::put(file, format!("{layout:#}\n").as_bytes()).context("writing the layout")?;
    console::say(&file.display().to_string());
    let topics = counted(topics, "topic");
    console::note(&format!("a layout for {topics}; import this file as a layout in Foxglove or Lichtblick"));
    Ok(())
}

/// Returns whether no new topic has come for a while.
fn is_enough(begun: Time, changed: Time, now: Time) -> bool {
    now.since(changed) >= QUIET_FOR || now.since(begun) >= LOOK_WITHIN
}
