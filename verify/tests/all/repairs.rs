//! The repairs that are offered for the known mistakes. Each repair was verified before it was offered. The list
//! shows the offered repairs and their changes.

use language::{Options, Source, compile_with_sites};
use std::path::Path;
use verify::{Alone, Always, Limits, Verified, applied, repairs};

const LIMITS: Limits<'static> = Limits { states: 100_000, memory: 64 << 20, threads: &Alone, goes_on: &Always };

#[test]
fn the_usual_mistakes_have_repairs() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/corpus/bad");
    let files = std::fs::read_dir(&folder).expect("the folder is there").map(|file| file.expect("a file").path());
    let mut files: Vec<_> = files.filter(|file| file.extension().is_some_and(|kind| kind == "dca")).collect();
    files.sort();
    let mut all = String::new();
    for file in files {
        let name = file.file_stem().expect("a name").to_string_lossy().into_owned();
        let spec = Source::new(name.clone(), std::fs::read_to_string(&file).expect("a text"));
        let (compiled, sites) = compile_with_sites(&spec, &[], &Options::named("spec"));
        let (plan, sites) = compiled.plan.zip(sites).expect("a plan");
        let report = verify::verify(&plan, &sites, &LIMITS);
        let before = Verified { spec: &spec, plan: &plan, sites: &sites, report: &report };
        for repair in repairs(&before, &[], &Options::named("spec"), &LIMITS) {
            all += &format!("{name}: {}: {}\n", repair.sentence, repair.fix.title);
            let new = applied(&spec, &repair.fix);
            let (old, new): (Vec<&str>, Vec<&str>) = (spec.text.lines().collect(), new.text.lines().collect());
            assert_eq!(old.len(), new.len(), "{name}: a repair changes lines, and adds none");
            for (old, new) in old.iter().zip(&new).filter(|(old, new)| old != new) {
                all += &format!("  - {}\n  + {}\n", old.trim(), new.trim());
            }
        }
    }
    expect_test::expect_file![Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/repairs.txt")].assert_eq(&all);
}
