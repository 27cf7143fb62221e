//! Writes random specs and the corpus as transition systems and as models, so that other tools can compare them.
//!
//! `cargo run --release -p verify --example exports -- FOLDER 1000`

#[path = "../tests/all/rewriting/random.rs"]
mod random;
#[path = "../tests/all/exports/specs.rs"]
mod specs;
#[path = "../tests/all/rewriting/text.rs"]
mod text;

use std::path::Path;
use verify::{Alone, Always, Limits};

const LIMITS: Limits<'static> = Limits { states: 20_000, memory: 64 << 20, threads: &Alone, goes_on: &Always };

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [folder, count] = arguments.as_slice() else { panic!("a folder, and how many random specs") };
    let count = count.parse().expect("a number");
    let random = (0..count).map(|seed| (format!("random{seed}"), specs::random(seed)));
    for (name, text) in random.chain(specs::files()) {
        let Some((plan, sites)) = specs::planned(&name, &text) else { continue };
        let all = verify::transitions(&plan, &sites, &LIMITS);
        if all.reached.is_none() {
            let write =
                |kind: &str, text: String| std::fs::write(Path::new(folder).join(format!("{name}.{kind}")), text);
            write("aut", all.aut()).expect("the folder is there");
            write("jani", verify::jani(&plan, &sites)).expect("the folder is there");
            write("mcrl2", verify::mcrl2(&plan, &sites)).expect("the folder is there");
        }
    }
}
