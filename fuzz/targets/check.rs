//! The checker never panics, and its result can be used: places are in the text, fixes apply, a plan keeps its
//! invariants, can be drawn and simulated, and every run can be stopped.
#![no_main]

use language::{RandomRun, Compiled, Options, Origin, Severity, Simulation, Source, Style};
use language::{apply_fixes, compile, fix, graph, render};
use libfuzzer_sys::fuzz_target;

const STEPS: usize = 100;

fuzz_target!(|bytes: &[u8]| {
    let text = String::from_utf8_lossy(bytes);
    let (spec, options) = (Source::new("fuzz.dca", &*text), Options::named("fuzz"));
    let Compiled { plan, diagnostics, .. } = compile(&spec, &[], &options);
    assert_eq!(plan.is_none(), diagnostics.iter().any(|found| found.severity == Severity::Error));
    for found in &diagnostics {
        let edits = found.fix.iter().flat_map(|fix| &fix.edits).map(|edit| edit.span);
        for span in std::iter::once(found.primary.span).chain(edits) {
            assert_eq!(span.origin, Origin::Spec, "{found:?}");
            assert!(text.get(span.start as usize..span.end as usize).is_some(), "{found:?}");
        }
    }
    render(&diagnostics, &spec, &[], Style::Plain);
    let fixed = Source::new("fuzz.dca", apply_fixes(&text, &diagnostics));
    compile(&fixed, &[], &options);
    fix(&spec, &[], &options);
    let Some(plan) = plan else { return };
    assert_eq!(plan.validate(), Ok(()));
    graph(&spec, &[], &options).0.expect("a plan can be drawn").svg();

    let mut simulation = Simulation::start(&plan);
    let mut chance = RandomRun::new(&plan, bytes.len() as u64, 20);
    let mut run = |simulation: &mut Simulation<'_>| {
        let mut steps = 0..STEPS;
        while simulation.outcome().is_none() && steps.next().is_some() && chance.step(simulation) {}
    };
    run(&mut simulation);
    if simulation.outcome().is_none() {
        simulation.stop();
        run(&mut simulation);
    }
    assert!(simulation.outcome().is_some(), "it cannot be stopped");
    assert!(simulation.running().is_empty(), "something outlives its scope");
});
