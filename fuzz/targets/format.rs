//! Formatting twice is formatting once, tokens and comments stay, and a damaged text is left alone.
#![no_main]

use language::syntax::{SyntaxKind, lex};
use language::{Code, Options, Source, compile, format};
use libfuzzer_sys::fuzz_target;

/// The codes of lexical and syntactic mistakes.
const DAMAGE: [Code; 4] = [Code::E0001, Code::E0002, Code::E0003, Code::E0005];

/// The tokens that mean something, and the comments.
fn content(text: &str) -> (Vec<&str>, Vec<&str>) {
    let (mut tokens, mut comments) = (Vec::new(), Vec::new());
    for token in lex(text) {
        let word = &text[token.start as usize..token.end as usize];
        match token.kind {
            SyntaxKind::Whitespace => {}
            SyntaxKind::Comment | SyntaxKind::DocComment => comments.push(word.trim_end()),
            _ => tokens.push(if word == ":;" { ";;" } else { word }),
        }
    }
    (tokens, comments)
}

fuzz_target!(|bytes: &[u8]| {
    let text = String::from_utf8_lossy(bytes);
    let source = Source::new("fuzz.dca", &*text);
    let Ok(once) = format(&source) else { return };
    let formatted = Source::new("fuzz.dca", &*once);
    assert_eq!(format(&formatted).as_ref(), Ok(&once), "formatted twice is something else");
    assert_eq!(content(&text), content(&once), "something is lost");
    let (before, after) = (compile(&source, &[], &Options::named("a")), compile(&formatted, &[], &Options::named("a")));
    assert_eq!(before.plan, after.plan, "it means something else");
    assert!(before.diagnostics.iter().all(|found| !DAMAGE.contains(&found.code)), "damaged text was formatted");
});
