//! Parses parameters, types and values.

use super::Parser;
use crate::diagnostic::{Edit, Fix};
use crate::syntax::SyntaxKind::{
    self, Bar, Colon, Dot, DotDot, Equals, Ident, LeftBrace, LeftBracket, LeftParen, Minus, Number, RightBrace,
    RightBracket, RightParen, Slash, Text,
};

/// Words that can follow a number and are not units.
const NO_UNITS: [&str; 8] = ["else", "finally", "within", "as", "with", "of", "pause", "optional"];

impl Parser<'_> {
    pub(super) fn params(&mut self) {
        self.start(SyntaxKind::Params);
        self.open(LeftParen);
        self.list(RightParen, "a parameter", Self::param);
        self.finish();
    }

    /// `name`, `name: Type`, `name: Type in 1..5 = value`.
    pub(super) fn param(&mut self) -> bool {
        self.typed(|parser| parser.eat(Colon))
    }

    /// A name, its type if one `follows`, and its value if it has one.
    fn typed(&mut self, follows: fn(&mut Self) -> bool) -> bool {
        if !self.at(Ident) {
            return false;
        }
        self.start(SyntaxKind::Param);
        self.bump();
        if follows(self) {
            self.type_name();
        }
        if self.at_word("in") {
            self.range();
        }
        if self.eat(Equals) {
            self.constant();
        }
        self.finish();
        true
    }

    /// `in 1..200`, `in 1 N..`, `in "open" | "close"`
    fn range(&mut self) {
        self.start(SyntaxKind::Range);
        self.bump();
        if !self.at(DotDot) {
            self.bound();
        }
        if self.eat(DotDot) {
            if self.at_any(&[Number, Minus]) {
                self.bound();
            }
        } else {
            while self.eat(Bar) {
                self.bound();
            }
        }
        self.finish();
    }

    /// A constant of a range: `=` may follow its unit.
    fn bound(&mut self) {
        self.start(SyntaxKind::Constant);
        let is_negative = self.eat(Minus);
        if self.eat(Number) {
            if self.at(Ident) && !NO_UNITS.contains(&self.word(0)) {
                self.unit_words();
            }
        } else if is_negative {
            self.expected("a number");
        } else if !self.eat(Text) {
            self.expect_name("a value");
        }
        self.finish();
    }

    /// `Name`, `name.Name`, `Name[6]`, `{ field: Name }`.
    pub(super) fn type_name(&mut self) {
        self.start(SyntaxKind::Type);
        if self.at(LeftBrace) {
            self.nested(SyntaxKind::RecordType, Self::field_type);
            return self.finish();
        }
        self.expect_name("a type");
        while self.at(Dot) && self.kind(1) == Ident {
            self.bump();
            self.bump();
        }
        if self.eat(LeftBracket) {
            self.eat(Number);
            self.expect(RightBracket);
        }
        self.finish();
    }

    /// A string, a name, a number with or without a unit, a list, a record, a secret.
    pub(super) fn constant(&mut self) {
        self.start(SyntaxKind::Constant);
        let is_negative = self.eat(Minus);
        if self.eat(Number) {
            self.unit();
        } else if is_negative {
            self.expected("a number");
        } else if self.at(LeftBracket) {
            self.start(SyntaxKind::List);
            self.bump();
            self.list(RightBracket, "a value", Self::list_item);
            self.finish();
        } else if self.at(LeftBrace) {
            self.nested(SyntaxKind::Record, Self::field);
        } else if self.at_word("secret") && self.kind(1) == LeftParen {
            self.secret();
        } else if !self.eat(Text) && self.expect_name("a value") {
            self.index();
        }
        self.finish();
    }

    /// `secret("team/camera/password")`
    fn secret(&mut self) {
        self.start(SyntaxKind::Secret);
        self.bump();
        self.bump();
        if !self.eat(Text) {
            self.expected("the key of a secret, such as `\"team/camera/password\"`");
        }
        self.expect(RightParen);
        self.finish();
    }

    /// `s`, `m/s`; a number without one is a plain number.
    pub(super) fn unit(&mut self) {
        if self.at(Ident) && !NO_UNITS.contains(&self.word(0)) && self.kind(1) != Equals {
            self.unit_words();
        }
    }

    fn unit_words(&mut self) {
        self.bump();
        if self.at(Slash) && self.kind(1) == Ident {
            self.bump();
            self.bump();
        }
    }

    /// `{ part, part }`: the fields of a type, or the values of a record. Both nest.
    fn nested(&mut self, kind: SyntaxKind, part: fn(&mut Self) -> bool) {
        if !self.descend() {
            return self.skip_as_error();
        }
        self.start(kind);
        self.bump();
        self.list(RightBrace, "a field", part);
        self.finish();
        self.ascend();
    }

    /// `name: Type`, `name: Type = value`: a field has a type.
    fn field_type(&mut self) -> bool {
        self.typed(|parser| parser.expect(Colon) || parser.at(Ident))
    }

    /// `name = value`
    fn field(&mut self) -> bool {
        if !self.at(Ident) {
            return false;
        }
        self.start(SyntaxKind::Field);
        self.bump();
        if self.at(Colon) {
            let span = self.span();
            if let Some(diagnostic) = self.expected("`=`") {
                let edits = vec![Edit { span, text: " =".to_owned() }];
                diagnostic.fix = Some(Fix { title: "replace with `=`".to_owned(), edits });
            }
            self.skip_as_error();
        } else {
            self.expect(Equals);
        }
        self.constant();
        self.finish();
        true
    }

    /// `[4]`, `[i]`
    pub(super) fn bracketed(&mut self, kind: SyntaxKind, what: &str) {
        self.start(kind);
        self.bump();
        if !self.eat(Number) && !self.eat(Ident) {
            self.expected(what);
        }
        self.expect(RightBracket);
        self.finish();
    }

    pub(super) fn index(&mut self) {
        if self.at(LeftBracket) {
            self.bracketed(SyntaxKind::Index, "an index");
        }
    }

    fn list_item(&mut self) -> bool {
        let is_there = self.at_any(&[Ident, Text, Number, Minus, LeftBrace]);
        if is_there {
            self.constant();
        }
        is_there
    }

    pub(super) fn args(&mut self) {
        self.start(SyntaxKind::Args);
        if self.open(LeftParen) || (self.at_any(&[Ident, Text, Number, RightParen]) && !self.ends_block()) {
            self.list(RightParen, "an argument", Self::arg);
        }
        self.finish();
    }

    /// `value`, `name = value`
    fn arg(&mut self) -> bool {
        if !self.at_any(&[Ident, Text, Number, Minus, LeftBracket, LeftBrace]) {
            return false;
        }
        self.start(SyntaxKind::Arg);
        if self.at(Ident) && self.kind(1) == Equals {
            self.bump();
            self.bump();
        }
        self.constant();
        self.finish();
        true
    }
}
