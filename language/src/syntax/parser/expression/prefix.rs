//! Parses the operators that stand before their operand, `retry`, `shield` and `using`, and the arms of `match`.

use super::super::Parser;
use crate::diagnostic::{Edit, Fix};
use crate::syntax::SyntaxKind::{self, Comma, FatArrow, Ident, LeftParen, Number, RightBrace, RightParen};

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
            self.expected("how many times to try again");
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

    /// `shield`, `shield(10 s)`; what is in parentheses is a time when an operand follows them.
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

    /// `match { found => a, missing => b, else => c }`; an arm with a `,` in it stands in parentheses.
    pub(super) fn matching(&mut self) {
        let ends_at_semicolon = std::mem::take(&mut self.ends_at_semicolon);
        self.arms();
        self.ends_at_semicolon = ends_at_semicolon;
    }

    fn arms(&mut self) {
        self.start(SyntaxKind::Match);
        self.bump();
        self.bump();
        if self.at(RightBrace) {
            self.expected("an outcome");
        }
        while self.at(Ident) && !self.ends_block() {
            self.start(SyntaxKind::Arm);
            self.bump();
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
            let goes_on = self.at(Ident) && self.kind(1) == FatArrow;
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
