//! Parses the operators that stand before their operand, `retry`, `shield` and `using`, the arms of `match`, and `repeat`.

use super::super::Parser;
use crate::diagnostic::{Code, Edit, Fix};
use crate::source::Span;
use crate::syntax::SyntaxKind::{
    self, Ampersand, Bar, Colon, Comma, DoubleColon, End, FatArrow, Greater, Hash, Ident, LeftBrace, LeftBracket,
    LeftParen, Less, Number, Recur, RightBrace, RightBracket, RightParen, Semicolon, Text,
};

/// How many tokens behind a `repeat` are searched for its `until`, where parentheses are missing.
const UNTIL_WITHIN: usize = 64;

impl Parser<'_> {
    /// `retry(3)`, `retry(n, pause 2 s)`
    pub(super) fn retry(&mut self) {
        self.start(SyntaxKind::Retry);
        self.bump();
        self.bump();
        let is_named = self.at(Ident) && [Comma, RightParen].contains(&self.kind(1));
        if self.at(Number) || is_named {
            self.count();
        } else {
            self.expected("the number of further tries");
        }
        if self.eat(Comma) {
            if !self.eat_word("pause") {
                let (span, is_only) = (self.span().at_start(), self.at(Number));
                if let Some(diagnostic) = self.expected("`pause`").filter(|_| is_only) {
                    let edits = vec![Edit { span, text: "pause ".to_owned() }];
                    diagnostic.fix = Some(Fix { title: "insert `pause`".to_owned(), edits });
                }
            }
            self.constant();
        }
        self.expect(RightParen);
    }

    /// A number, or the name of one.
    pub(super) fn count(&mut self) {
        self.start(SyntaxKind::Count);
        self.bump();
        self.finish();
    }

    /// `shield`, `shield(10 s)`. The parentheses contain a time if an operand follows them.
    pub(super) fn shield(&mut self) {
        self.start(SyntaxKind::Shield);
        self.bump();
        let is_named = self.kind(1) == Ident && self.kind(2) == RightParen && self.opens_operand(3);
        if self.at(LeftParen) && (self.kind(1) == Number || is_named) {
            self.bump();
            self.constant();
            self.expect(RightParen);
        }
    }

    /// `using(arm, gripper)`
    pub(super) fn using(&mut self) {
        self.start(SyntaxKind::Using);
        self.bump();
        self.start(SyntaxKind::Resources);
        self.bump();
        if self.at(RightParen) {
            self.expected("a resource");
        }
        self.list(RightParen, "a resource", |parser| parser.eat(Ident));
        self.finish();
    }

    /// Whether a `repeat` with its operand begins here, and not an instance of that name.
    pub(in crate::syntax::parser) fn begins_repeat(&self) -> bool {
        let is_count = self.kind(1) == LeftParen && self.kind(2) == Number;
        self.at_word("repeat") && self.opens_operand(1) && !is_count && !self.ends_block()
    }

    /// `repeat operand until found | gone`
    pub(super) fn repeat(&mut self) {
        if !self.descend() {
            return self.skip_as_error();
        }
        self.start(SyntaxKind::Repeat);
        self.bump();
        let is_inner = std::mem::replace(&mut self.ends.at_until, true);
        match self.until_of_several() {
            Some(until) => self.several(until),
            None => self.prefixed(),
        }
        self.ends.at_until = is_inner;
        if self.at_word("until") {
            self.until();
        } else if let Some(diagnostic) = self.expected("`until` and an outcome") {
            let help = "`repeat look until found` runs `look` again and again, until it ends with this outcome";
            diagnostic.help.push(help.to_owned());
            diagnostic.help.push(
                "`look ;; wait(1 s)` runs `look` for ever; `retry(3) look` runs `look` again when it fails".to_owned(),
            );
        }
        self.finish();
        self.ascend();
    }

    /// `until found | gone`
    fn until(&mut self) {
        self.start(SyntaxKind::Until);
        self.bump();
        loop {
            self.expect_name("the outcome that ends the `repeat`");
            if !self.eat(Bar) {
                break;
            }
        }
        self.finish();
    }

    /// The place of the `until` of this `repeat`, if operators stand between without parentheses: `repeat a ; b until found`.
    fn until_of_several(&self) -> Option<usize> {
        let joins = [Comma, Ampersand, Hash, Semicolon, Colon, Recur, DoubleColon];
        let (mut depth, mut repeats, mut is_joined) = (0_usize, 0_usize, false);
        for ahead in 0..UNTIL_WITHIN {
            let (kind, word) = (self.kind(ahead), self.word(ahead));
            let is_over = kind == End || depth == 0 && kind == Semicolon && self.ends.at_semicolon;
            if [LeftParen, LeftBrace, LeftBracket, Less].contains(&kind) {
                depth += 1;
            } else if [RightParen, RightBrace, RightBracket, Greater].contains(&kind) {
                depth = depth.checked_sub(1)?;
            } else if is_over || depth == 0 && repeats == 0 && word == "until" {
                return Some(ahead).filter(|_| is_joined && !is_over);
            } else if depth == 0 && word == "until" {
                repeats -= 1;
            } else if depth == 0 {
                repeats += usize::from(word == "repeat");
                is_joined |= joins.contains(&kind) || ["else", "finally"].contains(&word);
            }
        }
        None
    }

    /// Several operands of `repeat` up to its `until`, which is `ahead` tokens from here, without parentheses.
    fn several(&mut self, ahead: usize) {
        let start = self.span().at_start();
        let end = ahead.checked_sub(1).and_then(|last| self.token(last)).map_or(start.end, |last| last.end);
        let insert =
            |start: u32, text: &str| Edit { span: Span { start, end: start, ..self.span() }, text: text.to_owned() };
        let edits = vec![insert(start.start, "("), insert(end, ")")];
        if let Some(diagnostic) = self.report(Code::E0001, "`repeat` needs parentheses around several operands") {
            diagnostic.fix = Some(Fix { title: "put parentheses around them".to_owned(), edits });
        }
        self.start(SyntaxKind::Paren);
        self.concurrent();
        self.finish();
    }

    /// `resource arm, gripper;`
    pub(in crate::syntax::parser) fn resources(&mut self) {
        self.start(SyntaxKind::Resources);
        self.bump();
        loop {
            self.expect_name("a resource");
            if !self.eat(Comma) {
                break;
            }
        }
        self.end_statement();
        self.finish();
    }

    /// `match { found => a, missing => b, else => c }`; an arm with a `,` in it stands in parentheses. Behind `else` an arm may
    /// have the text of a failure.
    pub(super) fn matching(&mut self) {
        let ends = std::mem::take(&mut self.ends);
        self.arms();
        self.ends = ends;
    }

    fn arms(&mut self) {
        self.start(SyntaxKind::Match);
        self.bump();
        self.bump();
        if self.at(RightBrace) {
            self.expected("an outcome");
        }
        while self.at_any(&[Ident, Text]) && !self.ends_block() {
            self.start(SyntaxKind::Arm);
            self.bump();
            // `found p => goto with p`
            if self.at(Ident) && self.kind(1) == FatArrow {
                self.bump();
            }
            if !self.eat(FatArrow) {
                self.expected("`=>`");
            }
            if self.descend() {
                self.fail_fast();
                self.ascend();
            } else {
                self.skip_as_error();
            }
            self.finish();
            let is_named = self.kind(1) == Ident && self.kind(2) == FatArrow;
            let goes_on = self.at_any(&[Ident, Text]) && (self.kind(1) == FatArrow || is_named);
            if !self.eat(Comma) && !goes_on {
                break;
            }
            if goes_on {
                self.expect(Comma);
            }
        }
        self.expect(RightBrace);
        self.finish();
    }
}
