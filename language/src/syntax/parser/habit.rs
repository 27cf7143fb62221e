//! Recognises words of other languages and answers each with the word of this one.
//!
//! The parser then skips everything up to the next operator, so that one cause is one diagnostic.

use super::Parser;
use super::expression::INFIX;
use crate::diagnostic::{Code, Edit, Fix};
use crate::source::Span;
use crate::syntax::SyntaxKind::{
    self, Ampersand, Arrow, BackArrow, Bar, Colon, Comma, DoubleColon, FatArrow, Greater, Hash, Ident, LeftBrace,
    LeftParen, Number, Recur, RightBrace, RightBracket, RightParen, Semicolon, Text,
};

const BOTH: &str =
    "`a, b` runs both; `a & b` runs both, and fails when one of them fails; `a # b` runs both until one has ended";
const TURN: &str = "`a ; b` runs b when a is done";
const ROUND: &str = "`a ;; b` runs both in turn for ever; `(a ;; b) # until` runs both in turn until `until` ends";
const FAILURE: &str = "`a else b` runs b when a fails; `a finally b` runs b when a has ended in any way";
const CHOICE: &str = "to continue by the outcome of a process, write `p : match { found => q, else => r }`; to continue after a failure, write `p else q`";
const LIMIT: &str = "write a time limit after its operand: `a within 5 s`";
const OFTEN: &str = "`each i in 0..3 (a)` runs a three times; `a ;; wait(1 s)` runs a for ever; `repeat a until found` runs a until it ends with this outcome; `retry(3) a` runs a again when it fails";
const PAUSE: &str = "`wait(5 s)` waits, as in `a ; wait(5 s) ; b`";
const NAME: &str = "a name alone runs its process, as in `a ; b`; `a # b` stops one when the other ends";
const NOT: &str = "a process cannot be negated: `a else b` runs b when a fails";

/// Words of other languages that begin an operand there, and what to write here.
const PREFIX: [(&str, &str); 29] = [
    ("if", CHOICE),
    ("switch", CHOICE),
    ("case", CHOICE),
    ("match", CHOICE),
    ("while", ROUND),
    ("loop", ROUND),
    ("forever", ROUND),
    ("do", ROUND),
    ("for", "`all i in 0..4 (a[i])` runs all four instances at the same time"),
    ("all", "`a, b` runs both; `all i in 0..4 (a[i])` runs all of an array"),
    ("any", "`any 1 of (a, b)` is done when one of them is"),
    ("race", "`a # b` runs both until one has ended; `race i in 0..4 (a[i])` does this with all instances of an array"),
    ("select", "`a # b` runs both until one has ended"),
    ("repeat", OFTEN),
    ("times", OFTEN),
    ("timeout", LIMIT),
    ("within", LIMIT),
    ("parallel", BOTH),
    ("par", BOTH),
    ("seq", TURN),
    ("sequence", TURN),
    ("try", FAILURE),
    ("not", NOT),
    ("sleep", PAUSE),
    ("delay", PAUSE),
    ("start", NAME),
    ("run", NAME),
    ("stop", NAME),
    ("call", NAME),
];
/// Words of other languages between two operands.
const BETWEEN: [(&str, &str); 20] = [
    ("and", BOTH),
    ("or", "`a # b` runs both until one has ended; `a else b` runs b when a fails"),
    ("then", TURN),
    ("after", TURN),
    ("before", TURN),
    ("catch", FAILURE),
    ("except", FAILURE),
    ("otherwise", FAILURE),
    ("on", FAILURE),
    ("on_fail", FAILURE),
    ("unless", FAILURE),
    ("timeout", LIMIT),
    ("for", LIMIT),
    (
        "until",
        "`a # b` runs a and b until one of them has ended; `repeat a until found` runs a until it ends with this outcome",
    ),
    ("while", "`a # b` runs a and b until one of them has ended"),
    ("times", OFTEN),
    ("repeat", OFTEN),
    ("if", CHOICE),
    ("parallel", BOTH),
    ("in", "`all i in 0..4 (a[i])` runs all four instances at the same time"),
];
/// The operators of other languages between two operands.
const SIGNS: [(SyntaxKind, &str); 4] = [
    (Arrow, "`a ; b` runs b when a is done; `->` connects ports, in `internal_connections`"),
    (BackArrow, "`a ; b` runs b when a is done; `<-` connects ports, in `internal_connections`"),
    (FatArrow, "`a ; b` runs b when a is done; `=>` follows a name, in `a : p => b with p` and `match { found => b }`"),
    (Greater, TURN),
];

/// Returns the help for a character that means nothing here.
pub(super) fn instead_of(character: &str) -> Option<&'static str> {
    match character {
        "!" | "~" => Some(NOT),
        "+" => Some(BOTH),
        "*" => Some(OFTEN),
        _ => None,
    }
}

impl Parser<'_> {
    /// Reports a word of another language where an operand begins, and skips it with its operands. Returns whether that was the
    /// whole operand.
    pub(super) fn habit(&mut self) -> bool {
        if self.ends_block() {
            return false;
        }
        if self.without_parentheses() {
            return self.ends_in_error();
        }
        let counts = self.at(Number) && self.kind(1) == Ident && self.word(1) == "times";
        let Some((word, help)) = PREFIX.iter().find(|(word, _)| self.at_word(word) || counts && *word == "times")
        else {
            return false;
        };
        // The same word in its own form.
        let is_own = match *word {
            "match" => self.kind(1) == LeftBrace,
            "any" => self.kind(1) == Number || self.kind(1) == Ident && self.word(2) == "of",
            "all" | "race" | "each" => self.kind(1) == Ident && self.word(2) == "in",
            "repeat" => self.begins_repeat(),
            _ => false,
        };
        let follows = [LeftParen, LeftBrace, Number].contains(&self.kind(1)) || self.is_operand_name(1);
        if is_own || !counts && !follows {
            return false;
        }
        let is_known = ["match", "any", "all", "race", "each", "within", "repeat"].contains(word);
        let what = if is_known { "cannot stand like this" } else { "is not a word of this language" };
        if let Some(diagnostic) = self.report(Code::E0001, format!("`{word}` {what}")) {
            diagnostic.help.push((*help).to_owned());
        }
        self.skip_operand();
        true
    }

    /// Reports a word or a sign behind an operand that joins two operands in other languages, and skips the second one.
    pub(super) fn habit_between(&mut self) {
        if self.ends_block() || self.at_any(&[RightParen, RightBrace]) {
            return;
        }
        // The run of a state ends here.
        if self.ends.at_semicolon && self.at_word("on") || self.ends.at_until && self.at_word("until") {
            return;
        }
        let word = BETWEEN.iter().find(|(word, _)| self.at_word(word)).map(|(word, help)| (*word, *help));
        let sign = SIGNS.iter().find(|(sign, _)| self.at(*sign)).map(|(_, help)| (self.word(0), *help));
        if let Some((found, help)) = word.or(sign) {
            let message = match word {
                Some(_) => format!("`{found}` is not a word of this language"),
                None => format!("`{found}` joins no processes"),
            };
            if let Some(diagnostic) = self.report(Code::E0001, message) {
                diagnostic.help.push(help.to_owned());
            }
            self.skip_operand();
        }
    }

    /// Reports that an operator is missing, with a help that depends on the next token.
    pub(super) fn expected_operator(&mut self, what: &str) {
        let help = if self.is_operand_name(0) {
            "`a ; b` runs b when a is done; `a, b` runs both at once"
        } else if self.at(LeftParen) {
            "write only the name of a process to run it; write its arguments in its declaration"
        } else {
            ""
        };
        if let Some(diagnostic) = self.expected(what).filter(|_| !help.is_empty()) {
            diagnostic.help.push(help.to_owned());
        }
    }

    /// `wait 5 s`, `retry 3 a`, `fail "why"`: the parentheses are missing.
    fn without_parentheses(&mut self) -> bool {
        let (second, third) = (self.kind(1), self.kind(2));
        let length = match self.word(0) {
            "wait" if second == Number => 2 + usize::from(third == Ident && !INFIX.contains(&self.word(2))),
            "retry" if second == Number => 2,
            "fail" if second == Text => 2,
            _ => return false,
        };
        if !self.at(Ident) {
            return false;
        }
        let word = self.word(0);
        let place = |parser: &Self, ahead: usize| parser.token(ahead).map(|token| (token.start, token.end));
        let Some((((_, start), (first, _)), (_, end))) =
            place(self, 0).zip(place(self, 1)).zip(place(self, length - 1))
        else {
            return false;
        };
        let span = |start: u32, end: u32| Span { origin: self.origin, start, end };
        let edits = vec![
            Edit { span: span(start, first), text: "(".to_owned() },
            Edit { span: span(end, end), text: ")".to_owned() },
        ];
        if let Some(diagnostic) = self.report(Code::E0001, format!("`{word}` needs parentheses")) {
            diagnostic.fix = Some(Fix { title: "put parentheses around it".to_owned(), edits });
        }
        self.start(SyntaxKind::Error);
        (0..length).for_each(|_| self.bump());
        self.finish();
        true
    }

    /// Returns whether no operand follows a word without its parentheses. Behind `retry 3` an operand follows.
    fn ends_in_error(&self) -> bool {
        !self.at_any(&[Ident, LeftParen]) || self.ends_block() || INFIX.contains(&self.word(0))
    }

    /// Whether a name that may be an operand stands `ahead` tokens from here.
    fn is_operand_name(&self, ahead: usize) -> bool {
        self.kind(ahead) == Ident && !INFIX.contains(&self.word(ahead))
    }

    /// Skips to the next operator of this language, or to the end of the block.
    fn skip_operand(&mut self) {
        let ends = [Comma, Semicolon, Hash, Ampersand, Colon, Recur, DoubleColon, RightParen, RightBrace, RightBracket];
        self.start(SyntaxKind::Error);
        self.bump();
        while !self.at_any(&ends) && !self.ends_block() && !self.is_arm() {
            // After a block `else` belongs to a foreign `if`.
            if INFIX.contains(&self.word(0)) && !self.follows(RightBrace) {
                break;
            }
            self.skip_tree();
        }
        self.finish();
    }

    /// Whether the next arm of a `match` begins here.
    fn is_arm(&self) -> bool {
        self.at(Ident) && self.kind(1) == FatArrow
    }

    /// `||` and `&&`, of which the first token comes next: reports them, and skips all of it but the last token.
    pub(super) fn foreign_operator(&mut self) {
        let is_or = self.at(Bar);
        let is_double = self.kind(1) == self.kind(0) && (is_or || self.at(Ampersand));
        if !is_or && !is_double {
            return;
        }
        let (operator, help) = match (is_or, is_double) {
            (true, true) => {
                ("||", "`a, b` runs both; `a # b` runs both until one has ended; `a else b` runs b when a fails")
            }
            (true, false) => {
                ("|", "`a, b` runs both; `a # b` runs both until one has ended; `a else b` runs b when a fails")
            }
            (false, _) => ("&&", "`a & b` runs both, and fails when one of them fails; `a ; b` runs b when a is done"),
        };
        if let Some(diagnostic) = self.report(Code::E0001, format!("`{operator}` is not an operator")) {
            diagnostic.help.push(help.to_owned());
        }
        if is_double {
            self.bump();
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::{Options, Source, compile, fix};

    fn spec(actions: &str) -> Source {
        let text = format!(
            "module Step(host: Host) {{ done; }}\nprocess main(){{\n  instantiated_processes{{ a instof Step(c1); b instof Step(c1); c instof Step(c1); }}\n  \
             internal_event_actions{{ {actions} }}\n}}\n"
        );
        Source::new("habit.dca", text)
    }

    /// Each habit of another language has one diagnostic with a help or a fix.
    #[test]
    fn one_habit_is_one_diagnostic_with_help() {
        let all = [
            "wait 5 s",
            "a ; wait 5 s ; b",
            "retry 3 b",
            "a ; retry 3 b ; c",
            "retry(3, 2 s) b",
            "fail \"x\"",
            "a else fail \"x\"",
            "b timeout 5 s",
            "(b timeout 5 s) ; c",
            "b and c",
            "a ; (b or c)",
            "not b",
            "b -> c",
            "a > b",
            "a >> b",
            "!b",
            "a + b",
            "try { a } catch { b }",
            "try a catch b",
            "try { a } catch (x) { b } ; c",
            "a until b",
            "a until b ; c",
            "3 times a",
            "a ; 3 times b",
            "a times 3",
            "for i in 0..4 { a }",
            "for 3 a",
            "repeat 3 a",
            "repeat { a } until b",
            "seq { a ; b }",
            "seq(a, b)",
            "seq a b",
            "a then b",
            "a b",
            "a ; (b c)",
            "if a then b else c",
            "if a { b } else { c }",
            "do { a } while b",
            "while true { a }",
            "loop a",
            "forever a",
            "sleep(5 s)",
            "a ; sleep 5 s",
            "delay(5 s) ; a",
            "start a",
            "stop a ; b",
            "a()",
            "any(a, b)",
            "any 2 (a, b)",
            "all(a, b)",
            "race(a, b)",
            "match a { x => b }",
            "switch a { b }",
            "a within (5 s)",
            "a on failure b",
            "a catch b",
            "select { a b }",
            "fail",
            "a else fail",
            "within 5 s a",
        ];
        for actions in all {
            let found = compile(&spec(actions), &[], &Options::named("habit")).diagnostics;
            let has_help = found.iter().all(|found| !found.help.is_empty() || found.fix.is_some());
            assert!(found.len() == 1 && has_help, "{actions}: {found:#?}");
        }
    }

    /// Words of other languages are names like any other here.
    #[test]
    fn a_name_may_be_such_a_word() {
        let text = "module Step(host: Host) { done; }\nprocess main(){\n  instantiated_processes{ timeout instof Step(c1); start instof Step(c1); until instof Step(c1); any instof Step(c1); }\n  \
                    internal_event_actions{ timeout # start, (any ; until) }\n}\n";
        let compiled = compile(&Source::new("habit.dca", text), &[], &Options::named("habit"));
        assert!(compiled.plan.is_some(), "{:#?}", compiled.diagnostics);
    }

    #[test]
    fn parentheses_that_are_missing_are_written() {
        let check = |actions: &str, expect: &str| {
            let text = fix(&spec(actions), &[], &Options::named("habit"));
            assert!(text.contains(&format!("{{ {expect} }}")), "{text}");
        };
        check("a ; wait 5 s ; b", "a ; wait(5 s) ; b");
        check("retry 3 b", "retry(3) b");
        check("retry(3, 2 s) b", "retry(3, pause 2 s) b");
        check("a else fail \"x\"", "a else fail(\"x\")");
        check("any 2 of (a, b, c)", "any 2 of (a, b, c)");
        check("any 2 (a, b, c)", "any 2 of (a, b, c)");
        check("a within (5 s) ; b", "a within 5 s ; b");
    }
}
