//! `dca fix` applies only certain fixes: a fix leaves no other reading, and everything else is for a person to choose.
//!
//! More mistakes by hand: `DCA_FIX_CASES=100000 cargo test -p language --test all fixes::`

use crate::good_files::good_files;
use crate::random::Random;
use crate::shown::shown;
use language::plan::Plan;
use language::syntax::{SyntaxKind, lex};
use language::{Options, Source, compile, fix};

const INSTANCES: &str = "undock instof Step(c1); drive instof Step(c1); unclamp instof Step(c1); lock instof Step(c1); open1 instof Step(c1); \
                         arm_left instof Step(c1); a instof Step(c1); b instof Step(c1); c instof Step(c1);";

fn written(instances: &str, actions: &str) -> String {
    format!(
        "module Step(host: Host) {{ done; }}\nprocess main(){{\n  instantiated_processes{{ {instances} }}\n  internal_event_actions{{ {actions} }}\n}}\n"
    )
}

fn fixed(text: &str) -> String {
    fix(&Source::new("fixes.dca", text), &[], &Options::named("fixes"))
}

/// A word that only looks like a name, and a bracket that fits in several places, are left alone; the author is offered choices.
#[test]
fn what_is_not_known_is_not_written() {
    let actions = [
        "drive ; dock",
        "clamp ; drive",
        "unlock ; drive",
        "open3 ; drive",
        "arm_lift ; drive",
        "(a ; b # c",
        "a, (b # c ; drive",
        "a ; (b, (c ; drive)",
        "retri(3) a",
    ];
    for actions in actions {
        let text = written(INSTANCES, actions);
        assert_eq!(fixed(&text), text, "{actions}");
        let compiled = compile(&Source::new("fixes.dca", text), &[], &Options::named("fixes"));
        let choices = compiled.diagnostics.iter().map(|found| found.choices.len()).sum::<usize>();
        assert!(choices > 0, "{actions}: {:?}", compiled.diagnostics);
    }
    for instances in ["arm instof Stepc1);", "arm instof Stepc1;", "left arm Step(c1);"] {
        let text = written(instances, "arm");
        assert_eq!(fixed(&text), text, "{instances}");
    }
    let waits = written(INSTANCES, "a ; wait 5 s ; b");
    assert!(fixed(&waits).contains("5 s"), "{}", fixed(&waits));
}

/// A name that differs in case alone, and a token that the grammar allows in one place only, are written.
#[test]
fn what_has_one_reading_is_written() {
    let check = |instances: &str, actions: &str, expect: &str| {
        let text = fixed(&written(instances, actions));
        assert!(text.contains(expect), "{text}");
    };
    check("arm instof Step(c1);", "ARM", "{ arm }");
    check("arm instof Step(c1) leg instof Step(c1);", "arm, leg", "Step(c1); leg");
    check("arm instanceof Step(c1);", "arm", "arm instof Step(c1)");
    check("arm instof Step(c1;", "arm", "Step(c1);");
    check("arm instof Step(c1);", "(arm", "{ (arm) }");
    assert!(fixed(&written("arm instof Step(c1);", "arm").replace("main()", "main")).contains("process main(){"));
    check("arm instof Step(c1);", "wait(5 s ; arm", "wait(5 s) ; arm");
}

/// Of several names that look alike each can be chosen.
#[test]
fn similar_names_are_choices() {
    let text = written("arm1 instof Step(c1); arm2 instof Step(c1);", "arm3");
    let compiled = compile(&Source::new("fixes.dca", text), &[], &Options::named("fixes"));
    let titles: Vec<&str> =
        compiled.diagnostics.iter().flat_map(|found| &found.choices).map(|fix| fix.title.as_str()).collect();
    assert_eq!(titles, ["replace with `arm1`", "replace with `arm2`"]);
}

/// A text with a token that is lost, or a word that is misspelt.
fn with_mistake(text: &str, random: &mut Random) -> String {
    let tokens: Vec<_> = lex(text).into_iter().filter(|token| !token.kind.is_trivia()).collect();
    let token = tokens[random.below(tokens.len())];
    let (start, end) = (token.start as usize, token.end as usize);
    let word = &text[start..end];
    let first = word.chars().next().map_or(0, char::len_utf8);
    let written = match random.below(4) {
        1 if token.kind == SyntaxKind::Ident => word.to_uppercase(),
        2 if token.kind == SyntaxKind::Ident => format!("{word}{}", &word[..first]),
        3 if token.kind == SyntaxKind::Ident && word.len() > first => word[first..].to_owned(),
        _ => " ".to_owned(),
    };
    format!("{}{written}{}", &text[..start], &text[end..])
}

/// A good spec with one mistake: if fixes make a plan of it again, it is the same plan. Fixes never change the plan of a spec that has one.
#[test]
fn fixes_bring_back_what_was_meant_or_nothing() {
    let cases = std::env::var("DCA_FIX_CASES").ok().and_then(|cases| cases.parse().ok()).unwrap_or(300);
    let (files, mut random, mut mended) = (good_files(), Random(29), 0);
    for case in 0..cases {
        let (spec, interfaces) = &files[random.below(files.len())];
        let text = with_mistake(&spec.text, &mut random);
        let options = Options::named("fixes");
        let plan = |text: &str| compile(&Source::new("fixes.dca", text), interfaces, &options).plan;
        let (broken, meant) = (plan(&text), plan(&spec.text));
        let written = fix(&Source::new("fixes.dca", text.as_str()), interfaces, &options);
        let Some(after) = plan(&written) else { continue };
        mended += usize::from(written != text);
        // Of a name in two cases either may be the right one.
        let told = |plan: &Plan| shown(plan).to_lowercase();
        let is_it = [broken, meant].into_iter().flatten().any(|plan| told(&plan) == told(&after));
        assert!(is_it, "case {case}, {}:\n{text}\nfixed:\n{written}", spec.name);
    }
    assert!(mended > cases / 100, "{mended} of {cases} were mended");
}
