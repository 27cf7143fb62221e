//! The simulator plays the stories of the verifier. It is a different program from the explorer, and comes to the same
//! result, event by event.

use language::{Options, ReplayError, Source, compile_with_sites};
use std::path::Path;
use verify::{Alone, Always, Faults, Finding, Limits, PlayResult, Script, Story};

const LIMITS: Limits<'static> = Limits { states: 200_000, memory: 256 << 20, threads: &Alone, goes_on: &Always };

/// Returns the specs of a folder with the sentences in their first lines.
fn specs(folder: &str) -> Vec<Source> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests").join(folder);
    let files = std::fs::read_dir(&folder).expect("the folder is there").map(|file| file.expect("a file").path());
    let mut files: Vec<_> = files.filter(|file| file.extension().is_some_and(|kind| kind == "dca")).collect();
    files.sort();
    let read = |file: std::path::PathBuf| {
        let text = std::fs::read_to_string(&file).expect("a text");
        let sentences = text.lines().filter_map(|line| line.strip_prefix("// verify: "));
        let sentences: String = sentences.map(|sentence| format!("    {sentence};\n")).collect();
        let block = if sentences.is_empty() { String::new() } else { format!("\nverify main {{\n{sentences}}}\n") };
        Source::new(file.display().to_string(), format!("{text}{block}"))
    };
    files.into_iter().map(read).collect()
}

/// Plays a story. Returns the mistake, or whether the story could be played.
fn played(name: &str, story: &Story, plan: &language::plan::Plan) -> Result<bool, String> {
    let Some(script) = Script::of(story) else { return Ok(false) };
    assert_eq!(script.to_string().parse().as_ref(), Ok(&script), "{name}");
    let played = script.play(plan);
    match played.result {
        PlayResult::Same => Ok(true),
        PlayResult::Ends(ReplayError::Unsupported { .. }) => Ok(false),
        result @ (PlayResult::Other(_) | PlayResult::Ends(_)) => {
            Err(format!("{name}: {result:?}\n{}\n{}\n", story.lines().join("\n"), played.lines.join("\n")))
        }
    }
}

#[test]
fn what_is_told_of_a_mistake_happens_in_the_simulator_too() {
    let (mut count, mut left, mut wrong) = (0, 0, Vec::new());
    for spec in specs("corpus/bad").into_iter().chain(specs("mistakes/bad")) {
        let (compiled, sites) = compile_with_sites(&spec, &[], &Options::named("spec"));
        let (plan, sites) = compiled.plan.zip(sites).expect("it has a plan");
        let report = verify::verify(&plan, &sites, &LIMITS);
        for Finding { sentence, story, .. } in &report.findings {
            let Some(story) = story else { continue };
            match played(&format!("{}: {sentence}", spec.name), story, &plan) {
                Ok(true) => count += 1,
                Ok(false) => left += 1,
                Err(why) => wrong.push(why),
            }
        }
    }
    println!("{count} stories are the same, {left} were left out");
    assert!(wrong.is_empty(), "{} of {count}:\n{}", wrong.len(), wrong.join("\n"));
    assert!(count >= 80, "only {count} stories, {left} left out");
}

#[test]
fn what_fmea_tells_of_the_door_happens_in_the_simulator_too() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let read = |file: &str| Source::new(file, std::fs::read_to_string(root.join(file)).expect("it is there"));
    let interfaces = [read("language/tests/graph/door_opening.interface")];
    let spec = read("specs/door_opening.dca");
    let (compiled, sites) = compile_with_sites(&spec, &interfaces, &Options::named("door_opening"));
    let (plan, sites) = compiled.plan.zip(sites).expect("the door has a plan");
    let table = verify::fmea(&plan, &sites, &LIMITS, Faults::One);
    let (mut count, mut wrong) = (0, Vec::new());
    for row in &table.rows {
        match played(&format!("{} {} {}", row.program, row.fault, row.phase), &row.story, &plan) {
            Ok(is_played) => count += usize::from(is_played),
            Err(why) => wrong.push(why),
        }
    }
    println!("{count} of {} rows are the same", table.rows.len());
    assert!(wrong.is_empty(), "{} of {count}:\n{}", wrong.len(), wrong.join("\n"));
    assert!(count >= 100, "only {count} rows");
}
