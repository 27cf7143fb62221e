//! A hostile user: good specs with random mistakes in them, and texts that exceed a limit.
//!
//! Nothing panics, every place of every remark is in its text, and each fix that is offered removes its remark and brings no
//! new error. More mistakes by hand: `DCA_HOSTILE_CASES=100000 cargo test -p language --test all hostile::mistakes`

use crate::random;
mod words;

use crate::good_files::good_files;
use crate::random::Random;
use language::syntax::{SyntaxKind, lex};
use language::{Compiled, Diagnostic, Edit, Fix, Options, Severity, Source, Span, Style, apply_fix, compile, render};
use std::collections::BTreeSet;
use words::{KEYWORDS, WORDS};

fn run(text: &str, interfaces: &[Source]) -> Compiled {
    compile(&Source::new("hostile.dca", text), interfaces, &Options::named("hostile"))
}

/// A text with a mistake: a token is lost, doubled, misspelt, exchanged or moved.
fn with_mistake(text: &str, random: &mut Random) -> String {
    let tokens: Vec<_> = lex(text).into_iter().filter(|token| !token.kind.is_trivia()).collect();
    if tokens.is_empty() {
        return random.pick(WORDS).to_owned();
    }
    let at = |index: usize| tokens[index].start as usize..tokens[index].end as usize;
    let (one, other) = (at(random.below(tokens.len())), at(random.below(tokens.len())));
    let with = |new: &str| format!("{}{new}{}", &text[..one.start], &text[one.end..]);
    let (word, second) = (&text[one.clone()], &text[other]);
    match random.below(8) {
        0 => with(" "),
        1 => with(&format!("{word} {word}")),
        2 => with(&format!(" {} ", random.pick(WORDS))),
        3 => with(&format!("{word} {} ", random.pick(WORDS))),
        4 => with(second),
        _ => with(&misspelt(word, random)),
    }
}

fn misspelt(word: &str, random: &mut Random) -> String {
    let mut letters: Vec<char> = word.chars().collect();
    let place = random.below(letters.len());
    match random.below(5) {
        0 if letters.len() > 1 => drop(letters.remove(place)),
        1 => letters.insert(place, letters[place]),
        2 if place > 0 => letters.swap(place - 1, place),
        3 => letters[place] = if letters[place].is_lowercase() { 'X' } else { 'l' },
        _ => letters.push('x'),
    }
    letters.into_iter().collect()
}

/// Checks the diagnostics of a text, and that each fix helps; returns how many fixes there were.
fn check_all(name: &str, text: &str, interfaces: &[Source]) -> usize {
    let before = check(name, text, interfaces);
    let fixes = before.diagnostics.iter().flat_map(|found| changes(found).map(move |fix| (found, fix)));
    fixes.map(|found| check_fix(name, text, interfaces, &before, found)).count()
}

/// The fix of a diagnostic and its choices.
fn changes(found: &Diagnostic) -> impl Iterator<Item = &Fix> {
    found.fix.iter().chain(&found.choices)
}

/// Checks that every place of every remark is in its text.
fn check(name: &str, text: &str, interfaces: &[Source]) -> Compiled {
    let before = run(text, interfaces);
    let errors = |compiled: &Compiled| compiled.diagnostics.iter().filter(|it| it.severity == Severity::Error).count();
    assert_eq!(before.plan.is_some(), errors(&before) == 0, "{name}:\n{text}");
    let source = Source::new("hostile.dca", text);
    let shown = render(&before.diagnostics, &source, interfaces, Style::Plain);
    assert_eq!(shown.is_empty(), before.diagnostics.is_empty(), "{name}:\n{text}");
    for found in &before.diagnostics {
        let spans = std::iter::once(found.primary.span).chain(found.secondary.iter().map(|label| label.span));
        for span in spans {
            assert!(is_in(span, text, interfaces), "{name}: {found:?} is nowhere in\n{text}");
        }
        assert!(!found.message.is_empty() && !found.message.contains("Name {"), "{name}: {found:?}");
    }
    before
}

/// As many times a fix may be needed: as many brackets may be missing at one place.
const REPEATED_MAX: usize = 6;

fn check_fix(name: &str, text: &str, interfaces: &[Source], before: &Compiled, (found, fix): (&Diagnostic, &Fix)) {
    let tell = |text: &str, compiled: &Compiled| {
        render(&compiled.diagnostics, &Source::new("hostile.dca", text), interfaces, Style::Plain)
    };
    // A choice is for a user: the user may choose a wrong name.
    let is_choice = found.fix.as_ref() != Some(fix);
    let (mut fixed, mut at, mut fix) = (text.to_owned(), found.primary.span, fix.clone());
    for round in 0.. {
        fixed = apply_fix(&fixed, &fix);
        let after = run(&fixed, interfaces);
        let place = moved(at, &fix.edits);
        let is_same = |other: &&Diagnostic| {
            let is_there = i64::from(other.primary.span.start) == place;
            is_there && other.code == found.code && other.message == found.message
        };
        let Some(again) = after.diagnostics.iter().find(is_same) else { break };
        let next = changes(again).find(|other| other.title == fix.title).filter(|_| round < REPEATED_MAX);
        let Some(next) = next else {
            let (told, after) = (tell(text, before), tell(&fixed, &after));
            panic!("{name}: the fix does not remove {:?}\n{text}\n{told}\nfixed:\n{fixed}\n{after}", found.message);
        };
        (at, fix) = (again.primary.span, next.clone());
    }
    let after = run(&fixed, interfaces);
    // Once the syntax is fixed, hidden errors appear; no other fix adds an error.
    let is_syntax = |it: &Diagnostic| it.code.as_str() < "E0006";
    let errors = |compiled: &Compiled, is_counted: &dyn Fn(&Diagnostic) -> bool| {
        compiled.diagnostics.iter().filter(|it| it.severity == Severity::Error && is_counted(it)).count()
    };
    // The fields of a type are known once its name is right.
    let is_type = ["W0204", "W0206"].contains(&found.code.as_str());
    let is_counted = |it: &Diagnostic| !is_type && (!is_syntax(found) || is_syntax(it));
    if !is_choice && errors(&after, &is_counted) > errors(before, &is_counted) {
        let (told, after) = (tell(text, before), tell(&fixed, &after));
        panic!("{name}: the fix of {:?} brings more\n{text}\n{told}\nfixed:\n{fixed}\n{after}", found.message);
    }
}

fn is_in(span: Span, text: &str, interfaces: &[Source]) -> bool {
    let text = match span.origin {
        language::Origin::Spec => text,
        language::Origin::Interface(index) => &interfaces[index as usize].text,
    };
    text.get(span.start as usize..span.end as usize).is_some()
}

/// Where a place begins after the edits.
fn moved(span: Span, edits: &[Edit]) -> i64 {
    let before = edits.iter().filter(|edit| edit.span.start < span.start);
    let growth: i64 = before.map(|edit| edit.text.len() as i64 - i64::from(edit.span.end - edit.span.start)).sum();
    i64::from(span.start) + growth
}

/// As many mistakes in the suite.
const CASES: u64 = 2000;

#[test]
fn mistakes_are_told_and_fixed() {
    let cases = std::env::var("DCA_HOSTILE_CASES").ok().and_then(|cases| cases.parse().ok()).unwrap_or(CASES);
    let files = good_files();
    let (mut fixes, mut wrong) = (0, 0);
    for seed in 0..cases {
        let mut random = Random(seed);
        let (spec, interfaces) = &files[random.below(files.len())];
        let is_random = random.below(8) == 0;
        let mut text = if is_random { random::spec(seed) } else { spec.text.clone() };
        for _ in 0..=random.below(2) {
            text = with_mistake(&text, &mut random);
        }
        let name = format!("seed {seed}");
        if !is_random && std::env::var("DCA_HOSTILE_ALL").is_ok() {
            let hook = std::panic::catch_unwind(|| check_all(&name, &text, interfaces));
            wrong += usize::from(hook.is_err());
        } else if is_random {
            // It has other mistakes, and one of them may hide behind another.
            check(&name, &text, interfaces);
        } else {
            fixes += check_all(&name, &text, interfaces);
        }
    }
    println!("{cases} specs, {fixes} fixes, {wrong} wrong");
    assert_eq!(wrong, 0);
}

/// Bytes that are not a text of this language.
#[test]
fn bytes_are_told() {
    for seed in 0..2000 {
        let mut random = Random(seed);
        let length = random.below(300);
        let text: String = (0..length).map(|_| random_letter(&mut random)).collect();
        check(&format!("seed {seed}"), &text, &[]);
    }
}

fn random_letter(random: &mut Random) -> char {
    let ranges = [0x20..0x7f, 0..0x20, 0x80..0x800, 0x2000..0x2100, 0x1f300..0x1f600, 0xe000..0xe100];
    let range = &ranges[[0, 0, 0, 0, 1, 2, 3, 4, 5][random.below(9)]];
    let offset = random.below((range.end - range.start) as usize);
    char::from_u32(range.start + u32::try_from(offset).expect("a small offset")).unwrap_or('x')
}

/// The lexer sees the trivia and tokens that the generator intends.
#[test]
fn the_generator_writes_tokens() {
    assert!(lex("process").iter().all(|token| token.kind == SyntaxKind::Ident));
}

/// A spec that multiplies is refused, at once.
#[test]
fn multiplication_is_limited() {
    let group = |instances: &str, actions: &str| {
        format!(
            "process main() {{ host{{c1}} instantiated_processes {{ {instances} }} internal_event_actions {{ {actions} }} }} module A(h, n) {{ done; }}"
        )
    };
    let nested = |inner: &str| format!("all i in 0..1000 (all j in 0..1000 (all k in 0..1000 ({inner})))");
    let pools = "skip ::[1000] skip ::[1000] skip ::[1000] a";
    let arrays: String = (0..3000).map(|n| format!("a{n}[1000] instof A(c1, i); ")).collect();
    let labels: String = (0..3000).map(|n| format!(", l{n}")).collect();
    let wires = "a, Out -> a, In; ".repeat(3000);
    let sets = format!(
        "process main() {{ instantiated_processes {{ a instof A(c1, 1); }} internal_connections(a{labels}) {{ {wires} }} internal_event_actions {{ a }} }}"
    );
    let readings: String = (0..3000).map(|n| format!("g{n} instof G({n}.5); ")).collect();
    let readings = format!(
        "process G(n) {{ instantiated_processes {{ a[1000] instof A(c1, i); }} internal_event_actions {{ a[0], wait(n) }} }}\n{}",
        group(&readings, "skip")
    );
    let taken: Vec<String> = (0..3000).map(|n| format!("r{n}")).collect();
    let (outer, inner) = taken.split_at(1500);
    let using = format!(
        "process main() {{ resource {}; instantiated_processes {{ a instof A(c1, 1); }} internal_event_actions {{ using({}) using({}) a }} }}",
        taken.join(", "),
        outer.join(", "),
        inner.join(", ")
    );
    for text in [group("", &nested("skip")), group("a instof A(c1, 1);", pools), group(&arrays, "skip"), sets, readings]
    {
        let compiled = run(&text, &[]);
        let codes: BTreeSet<_> = compiled.diagnostics.iter().map(|found| found.code.as_str()).collect();
        assert!(codes.contains("E0701"), "{codes:?}: {}", &text[..text.len().min(200)]);
    }
    run(&using, &[]);
}

#[test]
fn words_of_the_language_are_good_names() {
    let mut refused = Vec::new();
    for word in KEYWORDS {
        let instance = format!(
            "process main(){{ host{{c1}} instantiated_processes{{ {word} instof A(c1); b instof A(c1); }}
             internal_connections({word}, on){{ {word}, Out -> b, In; b.Out -> {word}.In; }}
             internal_event_actions{{ {word}[on] ; (b, {word}[on]) }} }}
             module A(host: Host) {{ in In: T; out Out: T; done; }}"
        );
        let port = format!(
            "process main(){{ host{{c1}} instantiated_processes{{ a instof A(c1); b instof A(c1); }}
             internal_connections(a, {word}){{ a, {word} -> b, In; a.{word} -> b.In; }} internal_event_actions{{ a[{word}], b }} }}
             module A(host: Host) {{ in In: T; out {word}: T; done; }}"
        );
        let kind = format!(
            "process main(){{ host{{c1}} instantiated_processes{{ a instof {word}(c1); }} internal_event_actions{{ a }} }}
             module {word}(host: Host) {{ done; }}"
        );
        let param = format!(
            "process G({word}: Number){{ instantiated_processes{{ a[{word}] instof A(c1, {word} = {word}); }}
             internal_event_actions{{ retry({word}) any {word} of (all j in 0..{word} (a[j])) }} }}
             process main(){{ host{{c1}} instantiated_processes{{ g instof G({word} = 2); }} internal_event_actions{{ g }} }}
             module A(h: Host, {word}: Number) {{ done; }}"
        );
        let outcome = format!(
            "process main(){{ host{{c1}} resource {word}; instantiated_processes{{ a instof A(c1); }}
             internal_event_actions{{ using({word}) a : match {{ {word} => skip }} }} }}
             module A(host: Host) {{ done({word}); }}"
        );
        let result = format!(
            "process main(){{ host{{c1}} instantiated_processes{{ a instof A(c1); b instof B(c1); }}
             internal_event_actions{{ a : {word} => (b with {word} ; b with {word}) ; a : match {{ t {word} => b with {word} }} }} }}
             module A(host: Host) {{ done(t: Number); }} module B(host: Host) {{ init it; done; }}"
        );
        // `host` is the first argument of every module; truth values and the names of types are reserved.
        let texts = [
            ("instance", instance),
            ("port", port),
            ("type", kind),
            ("parameter", param),
            ("outcome", outcome),
            ("result", result),
        ];
        for (what, text) in texts {
            let source = Source::new("words.dca", &*text);
            let compiled = run(&text, &[]);
            if compiled.plan.is_none() {
                let told = render(&compiled.diagnostics, &source, &[], Style::Plain);
                refused.push(format!("{what} {word}: {}", told.lines().next().unwrap_or_default()));
            }
            check(&format!("{what} {word}"), &text, &[]);
            if let Ok(once) = language::format(&source) {
                assert_eq!(language::format(&Source::new("again", &*once)), Ok(once), "{text}");
            }
        }
    }
    // `true` is a value, and `main` is where the spec starts.
    assert_eq!(
        refused,
        [
            "type main: error[E0102]: `main` contains itself: main -> main",
            "parameter true: error[E0213]: `true` has to be a Number",
            "result true: error[E0430]: `true` has another meaning here already",
        ]
    );
}

/// Files that use each other, and themselves, by several paths.
#[test]
fn circles_of_files_end() {
    let spec = Source::new(
        "dir/main.dca",
        "use \"main.dca\"; use \"./main.dca\"; use \"../dir/main.dca\"; use \"b.dca\"; use \"nobody.dca\"; process main(){ internal_event_actions{ skip } }",
    );
    let read = |path: &str| match path {
        "dir/b.dca" => Ok(language::Content::File(
            "use \"c.dca\"; use \"main.dca\"; process B(){ internal_event_actions{ skip } }".to_owned(),
        )),
        "dir/c.dca" => Ok(language::Content::File("use \"../dir/b.dca\"; use \"c.dca\";".to_owned())),
        "dir/main.dca" => Ok(language::Content::File(String::new())),
        _ => Err(format!("no file `{path}`")),
    };
    let others = language::gather(&spec, &read);
    let compiled = compile(&spec, &others, &Options::named("circles"));
    let codes: Vec<&str> = compiled.diagnostics.iter().map(|found| found.code.as_str()).collect();
    assert_eq!(codes, ["E0010"], "{}", render(&compiled.diagnostics, &spec, &others, Style::Plain));
}

/// Very many of everything.
#[test]
fn very_many_of_everything_are_told_soon() {
    let many = |count: usize, piece: &dyn Fn(usize) -> String| -> String { (0..count).map(piece).collect() };
    let params = many(10_000, &|n| format!("p{n}, "));
    let args = many(10_000, &|n| format!("p{n} = {n}, "));
    let nested = |count: usize, actions: &str| {
        let group = |n: usize| {
            let inner = n + 1;
            format!(
                "process G{n}() {{ instantiated_processes {{ g instof G{inner}(); }} internal_event_actions {{ {actions} }} }}\n"
            )
        };
        many(count, &group)
            + &format!("process G{count}() {{ internal_event_actions {{ skip }} }} process main() {{ host{{c1}} ")
            + "instantiated_processes { g instof G0(); } internal_event_actions { g : p => g with p } }"
    };
    let texts = [
        nested(40, "p => ((g with p else g with p) : q => (g with q ; g with q))"),
        nested(10_000, "p => (g with p)"),
        many(10_000, &|n| {
            format!(
                "process G{n}() {{ instantiated_processes {{ g instof G{}(); }} internal_event_actions {{ g }} }}\n",
                n + 1
            )
        }),
        format!(
            "process G({params}) {{ internal_event_actions {{ skip }} }} process main() {{ host{{c1}} instantiated_processes {{ g instof G({args}); }} internal_event_actions {{ g }} }}"
        ),
        format!(
            "process main() {{ {} internal_event_actions {{ skip }} }}",
            many(10_000, &|n| format!("host{{c{n}}} "))
        ),
        format!(
            "process main() {{ host{{c1}} instantiated_processes {{ a instof A(c1); }} internal_event_actions {{ {} a }} }}",
            "a else ".repeat(10_000)
        ),
        many(10_000, &|n| format!("use \"f{n}.dca\";\n")) + "process main() { internal_event_actions { skip } }",
        many(10_000, &|n| format!("type T{n} = {{ a: T{}, b: T{} }};\n", n + 1, n + 2))
            + "process main() { internal_event_actions { skip } }",
        format!(
            "module A(host) {{ {} done; }} process main() {{ internal_event_actions {{ skip }} }}",
            many(10_000, &|n| format!("in I{n}: T; claims d{n}; "))
        ),
        format!("process main() {{ internal_event_actions {{ wait({}9 s) }} }}", "9".repeat(100_000)),
        format!("process {}() {{ internal_event_actions {{ skip }} }}", "x".repeat(1_000_000)),
        format!("process main() {{ internal_event_actions {{ {}skip{} }} }}", "(".repeat(100_000), ")".repeat(100_000)),
    ];
    for text in texts {
        check(&text[..60], &text, &[]);
    }
}
