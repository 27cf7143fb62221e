//! A large spec is compiled in bounded time; run with `--show-output` to see the figure.

mod spec;

use language::{Options, Source, compile};
use std::time::Instant;

#[test]
fn a_hundred_thousand_lines_compile() {
    let spec = Source::new("large.dca", spec::large_spec());
    // The clock is read for the figure alone; nothing depends on it.
    #[expect(clippy::disallowed_methods, reason = "a test measures")]
    let start = Instant::now();
    let compiled = compile(&spec, &[], &Options::named("large"));
    println!("{} lines, {} bytes: {:?}", spec.text.lines().count(), spec.text.len(), start.elapsed());
    let codes: std::collections::BTreeSet<_> = compiled.diagnostics.iter().map(|found| found.code).collect();
    assert!(compiled.plan.is_some(), "{codes:?}");
}
