//! Any text becomes tokens that cover it and a tree that keeps every byte of it.
//!
//! That the tree keeps every byte is an assertion of the parser itself, which fuzzing turns on.
#![no_main]

use language::syntax::lex;
use language::{Source, gather};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let text = String::from_utf8_lossy(bytes);
    let mut end = 0;
    for token in lex(&text) {
        assert_eq!(token.start, end, "a gap between two tokens");
        assert!(token.end > token.start, "an empty token");
        assert!(text.get(token.start as usize..token.end as usize).is_some(), "half a character");
        end = token.end;
    }
    assert_eq!(end as usize, text.len(), "the tokens end before the text");
    // Looking for the files that it uses parses the text, and nothing else.
    let refuse = |_: &str| Err("no files here".to_owned());
    gather(&Source::new("fuzz.dca", &*text), &refuse);
});
