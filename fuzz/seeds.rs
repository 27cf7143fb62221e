//! Writes what fuzzing begins with: each file of the language's corpus and of `specs/` as text for `parse`, `format` and
//! `check`, and as the bytes of its plan, followed by some events, for `plan`.
//!
//! ```text
//! cargo run --manifest-path fuzz/Cargo.toml --bin seeds -- FOLDER        then: cargo fuzz run plan FOLDER/plan
//! ```

use language::{Options, Source, compile};
use std::error::Error;
use std::path::{Path, PathBuf};
use std::{env, fs};

/// Events for a plan: half of them ends of members.
const EVENTS: &[u8] = &[16, 0, 16, 1, 18, 2, 30, 0, 17, 3, 48, 1, 21, 0, 19, 0, 34, 1];

fn main() -> Result<(), Box<dyn Error>> {
    let folder = env::args().nth(1).map(PathBuf::from).ok_or("say where the seeds go")?;
    let (texts, plans) = (folder.join("text"), folder.join("plan"));
    fs::create_dir_all(&texts)?;
    fs::create_dir_all(&plans)?;
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    for source in ["language/tests/corpus", "specs"] {
        for entry in fs::read_dir(root.join(source))? {
            let path = entry?.path();
            let Some(name) = path.file_name().filter(|_| path.extension().is_some_and(|found| found == "dca")) else {
                continue;
            };
            let text = fs::read_to_string(&path)?;
            fs::write(texts.join(name), &text)?;
            if let Some(plan) = compile(&Source::new("seed.dca", text), &[], &Options::named("seed")).plan {
                let mut bytes = postcard::to_stdvec(&plan)?;
                bytes.extend_from_slice(EVENTS);
                fs::write(plans.join(name), bytes)?;
            }
        }
    }
    Ok(())
}
