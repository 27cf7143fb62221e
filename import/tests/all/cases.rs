//! Files and the specs that they become: `tests/cases/NAME.xml` becomes `NAME.dca`, with the remarks in `NAME.remarks`.

use expect_test::expect_file;
use import::{Remark, import};
use language::{Options, Severity, Source, compile};
use std::path::{Path, PathBuf};

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/cases")
}

fn read(path: &Path) -> Source {
    let name = path.file_name().expect("it is a file").to_string_lossy().into_owned();
    Source::new(name, std::fs::read_to_string(path).expect("it can be read"))
}

#[test]
fn each_file_becomes_the_spec_beside_it() {
    let entries = std::fs::read_dir(folder()).expect("a folder of cases");
    let mut files: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    files.retain(|path| {
        path.extension().is_some_and(|extension| ["xml", "scxml", "yaml"].iter().any(|known| extension == *known))
    });
    files.sort();
    assert!(files.len() > 5, "the cases are there");
    for file in files {
        let source = read(&file);
        let imported = import(&source, &[]).unwrap_or_else(|error| panic!("{error}"));
        expect_file![file.with_extension("dca")].assert_eq(&imported.text);
        let remarks: String = imported.remarks.iter().map(|remark: &Remark| format!("{remark}\n")).collect();
        expect_file![file.with_extension("remarks")].assert_eq(&remarks);
        let compiled = compile(&Source::new("case.dca", imported.text), &[], &Options::named("case"));
        let errors: Vec<_> = compiled.diagnostics.iter().filter(|found| found.severity == Severity::Error).collect();
        assert!(errors.is_empty(), "{}: {errors:?}", file.display());
    }
}
