//! The result of an exploration is the same for every number of threads.

use language::{Options, Source, compile_with_sites};
use verify::{Always, Detail, Flat, Limits, Story, Threads, Verdict, flat, verify};

#[derive(Debug)]
struct Crew(usize);

impl Threads for Crew {
    fn count(&self) -> usize {
        self.0
    }

    fn run(&self, work: &(dyn Fn(usize) + Sync)) {
        std::thread::scope(|scope| (0..self.0).for_each(|thread| drop(scope.spawn(move || work(thread)))));
    }
}

/// Returns some objects. Each is found and placed while a timeout runs. A sentence does not hold for the last of
/// them.
fn spec(objects: usize) -> String {
    let each = |write: fn(usize) -> String| (0..objects).map(write).collect::<Vec<_>>();
    let instances = each(|i| format!("f{i} instof Step(c1); p{i} instof Step(c1);")).join("\n");
    let actions = each(|i| format!("(f{i} : p{i})")).join(", ");
    format!(
        "module Step {{ done; }}\nprocess main(){{ host{{c1}} instantiated_processes{{ timeout instof Step(c1); {instances} }}\n\
         internal_event_actions{{ timeout # ({actions}) }}\n\
         verify{{ never p{0} with p{1}; after p{0}.done: p{1} stopped; }} }}",
        objects - 1,
        objects - 2
    )
}

#[test]
fn numbers_and_stories_are_the_same_with_any_number_of_threads() {
    let source = Source::new("tidy_up.dca", spec(7));
    let (compiled, sites) = compile_with_sites(&source, &[], &Options::named("tidy_up"));
    let (plan, sites) = compiled.plan.zip(sites).expect("the spec has no errors");
    let with = |threads: usize| {
        let limits = Limits { states: 1_000_000, memory: 1 << 30, threads: &Crew(threads), goes_on: &Always };
        let Flat { states, transitions, situations, .. } = flat(&plan, &sites, &limits, Detail::All);
        let findings = verify(&plan, &sites, &limits).findings;
        let stories: Vec<(Verdict, Option<Story>)> =
            findings.into_iter().map(|found| (found.verdict, found.story)).collect();
        (states, transitions, situations, stories)
    };
    let alone = with(1);
    assert!(alone.0 > 10_000 && alone.3.iter().any(|(_, story)| story.is_some()), "{} states", alone.0);
    for threads in [2, 3, 8] {
        assert_eq!(with(threads), alone, "{threads} threads");
    }
}
