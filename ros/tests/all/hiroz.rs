//! Compares quality of service with the tables of `hiroz-protocol`, which were written by the C++ of `rmw_zenoh`.

#![expect(clippy::unwrap_used, reason = "a test stops where something is not as it should be")]

use ros::logic::qos::{Durability, History, Liveliness, Qos, Reliability, Span};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// A form that the C++ refuses and others write: a history without a comma.
const MORE: [&str; 1] = [":::,:,:,,"];

/// Returns the folder of the tables, or why there is none.
fn tables(folder: &Path) -> Result<PathBuf, String> {
    let why = |error: std::io::Error| error.to_string();
    let manifest = "[package]\nname = \"tables\"\nedition = \"2024\"\n[workspace]\n[dependencies]\n\
                    hiroz-protocol = { version = \"=0.2.1\", default-features = false }\n";
    fs::create_dir_all(folder.join("src")).map_err(why)?;
    fs::write(folder.join("Cargo.toml"), manifest).map_err(why)?;
    fs::write(folder.join("src/lib.rs"), "").map_err(why)?;
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let output =
        Command::new(cargo).args(["metadata", "--format-version", "1"]).current_dir(folder).output().map_err(why)?;
    let metadata: serde_json::Value = serde_json::from_slice(&output.stdout)
        .map_err(|_no_json| String::from_utf8_lossy(&output.stderr).lines().last().unwrap_or_default().to_owned())?;
    let packages = metadata["packages"].as_array().ok_or("cargo lists no packages")?;
    let found = packages.iter().find(|package| package["name"] == "hiroz-protocol").ok_or("it is not listed")?;
    let manifest = Path::new(found["manifest_path"].as_str().ok_or("it has no path")?);
    Ok(manifest.with_file_name("tests/fixtures/rmw_zenoh_qos"))
}

/// Reads the eleven numbers of a profile.
fn profile(text: &str) -> Qos {
    let numbers: Vec<u64> = text.split(' ').map(|number| number.parse().unwrap()).collect();
    let [reliability, durability, history, depth, a, b, c, d, liveliness, e, f] = numbers[..] else { panic!("{text}") };
    let span = |seconds, nanos| Span { seconds, nanos };
    Qos {
        reliability: if reliability == 2 { Reliability::BestEffort } else { Reliability::Reliable },
        durability: if durability == 1 { Durability::TransientLocal } else { Durability::Volatile },
        history: if history == 2 { History::KeepAll } else { History::KeepLast },
        depth,
        deadline: span(a, b),
        lifespan: span(c, d),
        liveliness: if liveliness == 3 { Liveliness::ManualByTopic } else { Liveliness::Automatic },
        lease: span(e, f),
    }
}

#[test]
#[ignore = "long: it needs the registry of crates"]
fn qos_is_that_of_the_tables_of_rmw_zenoh() {
    let folder = std::env::temp_dir().join(format!("dca-ros-hiroz-{}", std::process::id()));
    let found = tables(&folder);
    fs::remove_dir_all(&folder).unwrap();
    let tables = match found {
        Ok(tables) => tables,
        Err(why) => return println!("skipped: hiroz-protocol cannot be had: {why}"),
    };
    let rows = |name: &str| {
        let text = fs::read_to_string(tables.join(name)).unwrap();
        let rows = text.lines().filter(|line| !line.starts_with('#') && !line.is_empty());
        rows.map(|row| row.split_once('\t').map(|(a, b)| (a.to_owned(), b.to_owned())).unwrap()).collect::<Vec<_>>()
    };
    let mut written = 0;
    for name in ["qos_grid.tsv", "qos_depths.tsv", "qos_durations.tsv"] {
        for (numbers, text) in rows(name) {
            let expected = profile(&numbers);
            assert_eq!((expected.to_string(), Qos::parse(&text)), (text, Some(expected)), "{name}");
            written += 1;
        }
    }
    let decoded = rows("qos_decode.tsv");
    for (text, numbers) in &decoded {
        let expected = (numbers != "NULL").then(|| profile(numbers));
        if !MORE.contains(&text.as_str()) {
            assert_eq!(Qos::parse(text), expected, "{text}");
        }
    }
    assert!(written > 900 && decoded.len() > 15, "{written} written, {} decoded", decoded.len());
}
