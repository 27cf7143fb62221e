//! The files of the corpus that are good specs.

use language::{Options, Source, compile};
use std::path::Path;

/// Every file of the corpus that is accepted, with its interfaces.
pub(crate) fn good_files() -> Vec<(Source, Vec<Source>)> {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/corpus");
    let entries = std::fs::read_dir(corpus).expect("the corpus is a folder");
    let mut paths: Vec<_> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    paths.retain(|path| path.extension().is_some_and(|extension| extension == "dca"));
    paths.sort();
    let files = paths.into_iter().map(|path| {
        let read = |path: &Path| Source::new(path.to_string_lossy(), std::fs::read_to_string(path).unwrap_or_default());
        let interface = path.with_extension("interface");
        let interfaces = if interface.exists() { vec![read(&interface)] } else { Vec::new() };
        (read(&path), interfaces)
    });
    files.filter(|(spec, interfaces)| compile(spec, interfaces, &Options::named("test")).plan.is_some()).collect()
}
