//! Writes what fuzzing begins with: each file of the language's corpus and of `specs/` as text for `parse`, `format` and
//! `check`, and as the bytes of its plan, followed by some events, for `plan`; and the golden bytes of the room `trust` for
//! `trust_forms`, `trust_request` and `trust_text`.
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

/// The golden files of forms, in the order in which the first byte of an input of `trust_forms` names them; the next one is a head.
const FORMS: [&str; 10] =
    ["certificate", "renewal", "credential", "revoked", "sealed", "locked", "welcome", "team", "", "head"];

/// Writes the golden bytes of `trust`.
fn trust(folder: &Path, golden: &Path) -> Result<(), Box<dyn Error>> {
    let [forms, requests, texts] = ["trust_forms", "trust_request", "trust_text"].map(|name| folder.join(name));
    for folder in [&forms, &requests, &texts] {
        fs::create_dir_all(folder)?;
    }
    for (kind, name) in (0..).zip(FORMS).filter(|(_, name)| !name.is_empty()) {
        let bytes = unhex(&fs::read_to_string(golden.join(name).with_extension("hex"))?)?;
        fs::write(forms.join(name), [vec![kind], bytes].concat())?;
    }
    fs::write(requests.join("request"), unhex(&fs::read_to_string(golden.join("request.hex"))?)?)?;
    for (number, text) in fs::read_to_string(golden.join("texts.txt"))?.lines().enumerate() {
        fs::write(texts.join(number.to_string()), text)?;
    }
    Ok(())
}

fn unhex(text: &str) -> Result<Vec<u8>, Box<dyn Error>> {
    let digits: Vec<char> = text.chars().filter(|c| !c.is_whitespace()).collect();
    let byte = |pair: &[char]| u8::from_str_radix(&pair.iter().collect::<String>(), 16);
    Ok(digits.chunks(2).map(byte).collect::<Result<_, _>>()?)
}

fn main() -> Result<(), Box<dyn Error>> {
    let folder = env::args().nth(1).map(PathBuf::from).ok_or("say where the seeds go")?;
    let (texts, plans) = (folder.join("text"), folder.join("plan"));
    fs::create_dir_all(&texts)?;
    fs::create_dir_all(&plans)?;
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    trust(&folder, &root.join("trust/tests/golden"))?;
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
