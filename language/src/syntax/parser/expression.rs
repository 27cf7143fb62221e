//! Parses event-action expressions. The loosest operator comes first: `,` `&` `#` `;` `finally` `else` `: ;; ::` postfix.
//!
//! Every operator makes one node with all its operands, so a long chain makes a wide tree, never a deep one.

mod prefix;

use super::Parser;
use crate::diagnostic::{Code, Edit, Fix};
use crate::similar;
use crate::source::Span;
use crate::syntax::SyntaxKind::{
    self, Ampersand, Bar, Colon, Comma, Disable, DoubleColon, End, FailFast, FatArrow, Greater, Hash, Ident, LeftBrace,
    LeftBracket, LeftParen, Less, Number, Question, Recur, RightBrace, RightBracket, RightParen, Semicolon, Text,
};

/// A form of the language that is known but not read yet.
const LATER: &str = "until";
/// Words that continue an expression after an operand. So the text before such a word is an operand.
pub(super) const INFIX: [&str; 6] = ["else", "finally", "within", "as", "with", "until"];

impl Parser<'_> {
    /// `internal_event_actions { expression ; }`
    pub(super) fn actions(&mut self) {
        self.start(SyntaxKind::Actions);
        self.bump();
        self.open(LeftBrace);
        while !self.ends_block() {
            let before = self.cursor;
            let counts = self.at(Number) && self.kind(1) == Ident && self.word(1) == "times";
            if counts || self.starts_operand() || self.at_any(&[Hash, Comma, Semicolon, Colon, Recur, Ampersand]) {
                self.expression();
            }
            if !self.ends_block() {
                let is_surplus = self.at_any(&[RightParen, RightBracket]);
                let message = format!("`{}` has no counterpart", self.word(0));
                if is_surplus {
                    self.report(Code::E0001, message);
                } else {
                    self.expected_operator("an operator or `}`");
                }
                if self.cursor == before || !self.starts_operand() {
                    self.skip_as_error();
                }
            }
        }
        self.expect(RightBrace);
        self.finish();
    }

    fn starts_operand(&self) -> bool {
        self.at_any(&[Ident, LeftParen])
    }

    fn ends_expression(&self) -> bool {
        self.at_any(&[RightParen, RightBrace, End]) || self.ends_block()
    }

    /// The run of a state. The `;` after it ends the statement, so `a ; b` needs parentheses there.
    pub(super) fn run_expression(&mut self) {
        self.ends.at_semicolon = true;
        self.concurrent();
        self.ends.at_semicolon = false;
    }

    fn expression(&mut self) {
        if self.descend() {
            let ends = std::mem::take(&mut self.ends);
            self.concurrent();
            self.ends = ends;
            self.ascend();
        } else {
            self.skip_as_error();
        }
    }

    fn concurrent(&mut self) {
        self.operators(SyntaxKind::Concurrent, Comma, Self::fail_fast);
    }

    fn fail_fast(&mut self) {
        self.operators(FailFast, Ampersand, Self::disable);
    }

    fn disable(&mut self) {
        self.operators(Disable, Hash, Self::sequence);
    }

    fn sequence(&mut self) {
        if self.ends.at_semicolon {
            return self.finally();
        }
        self.operators(SyntaxKind::Sequence, Semicolon, Self::finally);
    }

    /// `operand op operand op ...`; a `,` or `;` at the very end is accepted.
    fn operators(&mut self, node: SyntaxKind, operator: SyntaxKind, operand: fn(&mut Self)) {
        let checkpoint = self.checkpoint();
        operand(self);
        let mut is_started = false;
        while self.at(operator) || operator == Comma && self.at(Bar) {
            if !is_started {
                self.start_at(checkpoint, node);
                is_started = true;
            }
            self.foreign_operator();
            self.bump();
            if [Comma, Semicolon].contains(&operator) && self.ends_expression() {
                break;
            }
            if operator == Semicolon && self.at(Semicolon) {
                let report = self.report(Code::E0005, "`; ;` is not an operator");
                if let Some(diagnostic) = report {
                    diagnostic.help.push("write `;;` to repeat, or `;` to go on".to_owned());
                }
                self.bump();
            }
            operand(self);
        }
        if is_started {
            self.finish();
        }
    }

    fn finally(&mut self) {
        self.words("finally", SyntaxKind::Finally, Self::otherwise);
    }

    fn otherwise(&mut self) {
        self.words("else", SyntaxKind::Otherwise, Self::chain);
    }

    /// `operand word operand word ...`
    fn words(&mut self, word: &str, node: SyntaxKind, operand: fn(&mut Self)) {
        let checkpoint = self.checkpoint();
        operand(self);
        if self.at_word(word) {
            self.start_at(checkpoint, node);
            while self.eat_word(word) {
                operand(self);
            }
            self.finish();
        }
    }

    /// `a : b ;; c`, to be read from the right.
    fn chain(&mut self) {
        let checkpoint = self.checkpoint();
        self.prefixed();
        if self.at_any(&[Colon, Recur, DoubleColon]) {
            self.start_at(checkpoint, SyntaxKind::Chain);
            while self.at_any(&[Colon, Recur, DoubleColon]) {
                let has_pool = self.at(DoubleColon);
                self.bump();
                if has_pool {
                    self.pool();
                }
                self.prefixed();
            }
            self.finish();
        }
    }

    /// `[3]` after `::`
    fn pool(&mut self) {
        if self.at(LeftBracket) {
            self.bracketed(SyntaxKind::Count, "the number of copies that may run at the same time");
        } else if let Some(diagnostic) = self.expected("`[` and the number of copies that may run at the same time") {
            diagnostic.help.push("write `found ::[3] handle`".to_owned());
        }
    }

    /// `retry(3) operand`, `shield operand`, `using(arm) operand`
    fn prefixed(&mut self) {
        if self.at(Ident) && self.kind(1) == FatArrow && !self.ends_block() {
            return self.named();
        }
        if self.habit() {
            return;
        }
        let word = self.operator_word();
        let head: fn(&mut Self) = match word {
            Some("retry") => Self::retry,
            Some("using") => Self::using,
            Some("shield") => Self::shield,
            Some(_) | None if self.at_word("shield") && self.opens_operand(1) => Self::shield,
            Some(_) | None => return self.suffixed(word),
        };
        if !self.descend() {
            return self.skip_as_error();
        }
        head(self);
        self.prefixed();
        self.finish();
        self.ascend();
    }

    /// `p => goto with p`: a name for the start value of this operand.
    fn named(&mut self) {
        if !self.descend() {
            return self.skip_as_error();
        }
        self.start(SyntaxKind::Named);
        self.bump();
        self.bump();
        self.chain();
        self.finish();
        self.ascend();
    }

    /// The word of the language that an operand begins with. Where no name can stand, a word that is nearly one is reported and
    /// taken as such.
    fn operator_word(&mut self) -> Option<&'static str> {
        if !self.at(Ident) || self.at_word(LATER) || self.begins_repeat() || self.ends_block() {
            return None;
        }
        let next = self.kind(1);
        let words: &[&'static str] = if next == LeftParen {
            &["retry", "using", "shield", "fail", "wait"]
        } else if next == LeftBrace {
            &["match"]
        } else if next == Number || next == Ident && self.word(2) == "of" {
            &["any"]
        } else if next == Ident && self.word(2) == "in" {
            &["all", "race", "each"]
        } else {
            return None;
        };
        if let Some(word) = words.iter().find(|word| self.at_word(word)) {
            return Some(word);
        }
        let (span, word) = (self.span(), similar::nearest(self.word(0), words.iter().copied())?);
        let word = words.iter().copied().find(|known| *known == word)?;
        if let Some(diagnostic) = self.expected(&format!("`{word}`")) {
            diagnostic.choices.push(Fix::replace(span, word));
        }
        Some(word)
    }

    /// Whether an operand may start `ahead` tokens from here, rather than an operator.
    fn opens_operand(&self, ahead: usize) -> bool {
        self.kind(ahead) == LeftParen || self.kind(ahead) == Ident && !INFIX.contains(&self.word(ahead))
    }

    /// `operand?`, `operand within 5 s`, `operand as tag`, `operand with value`
    fn suffixed(&mut self, word: Option<&str>) {
        let checkpoint = self.checkpoint();
        self.operand(word);
        let is_suffix =
            |parser: &Self| parser.at(Question) || ["within", "as", "with"].iter().any(|word| parser.at_word(word));
        if is_suffix(self) {
            self.start_at(checkpoint, SyntaxKind::Suffixed);
            while is_suffix(self) {
                let (is_limit, is_tag, is_given) = (self.at_word("within"), self.at_word("as"), self.at_word("with"));
                self.bump();
                if is_given {
                    self.start(SyntaxKind::StartValue);
                    self.constant();
                    self.finish();
                } else if is_limit && self.at(LeftParen) {
                    self.limit_in_parentheses();
                } else if is_limit {
                    self.constant();
                } else if is_tag {
                    self.expect_name("the name of an outcome");
                }
            }
            self.finish();
        }
        self.habit_between();
    }

    /// `within (5 s)`
    fn limit_in_parentheses(&mut self) {
        let first = self.span();
        let length = 2 + usize::from(self.kind(2) == Ident);
        let last = self.token(length).filter(|last| last.kind == RightParen);
        let found = self.report(Code::E0001, "write a limit without parentheses: `a within 5 s`");
        if let (Some(found), Some(last)) = (found, last) {
            let none = |span: Span| Edit { span, text: String::new() };
            let edits = vec![none(first), none(Span { start: last.start, end: last.end, ..first })];
            found.fix = Some(Fix { title: "remove the parentheses".to_owned(), edits });
        }
        self.skip_one();
        self.constant();
        if self.at(RightParen) {
            self.skip_one();
        }
    }

    /// Skips one token into an error node.
    fn skip_one(&mut self) {
        self.start(SyntaxKind::Error);
        self.bump();
        self.finish();
    }

    /// `word` is the first word of the expression, if the expression begins with a word.
    fn operand(&mut self, word: Option<&str>) {
        if self.at(LeftParen) {
            self.parenthesised();
        } else if !self.at(Ident) || self.ends_block() {
            self.expected("a process");
            if self.at(LeftBracket) {
                self.labels();
            }
        } else if self.begins_repeat() {
            self.repeat();
        } else if self.at_word("at") && self.word(1) == "least" {
            self.any_of();
        } else if let Some(word) = word {
            match word {
                "any" => self.any_of(),
                "all" | "race" | "each" => self.all_of(),
                "match" => self.matching(),
                _ => self.call(if word == "wait" { SyntaxKind::Wait } else { SyntaxKind::Fail }),
            }
        } else if self.at_word(LATER) && self.kind(1) == LeftParen {
            self.report(Code::E0006, format!("`{}` is not supported yet", self.word(0)));
            self.start(SyntaxKind::Error);
            self.bump();
            self.skip_tree();
            self.finish();
            if self.starts_operand() {
                let word = self.operator_word();
                self.operand(word);
            }
        } else {
            self.run();
        }
    }

    fn parenthesised(&mut self) {
        self.start(SyntaxKind::Paren);
        self.bump();
        let first = self.cursor;
        self.expression();
        while self.starts_operand() && !self.ends_block() {
            self.expected_operator("an operator or `)`");
            self.expression();
        }
        // With an operator between, `(a ; b` may be `(a) ; b`.
        let is_only = self.cursor == first + 1;
        self.expect_at(RightParen, is_only);
        self.finish();
    }

    /// `fail("why")`, `wait(5 s)`
    fn call(&mut self, kind: SyntaxKind) {
        self.start(kind);
        self.bump();
        self.bump();
        if kind == SyntaxKind::Wait {
            self.constant();
        } else if !self.eat(Text) {
            self.expected("a string with the reason");
        }
        self.expect(RightParen);
        self.finish();
    }

    /// `any 2 of (a, b, c)`, `any n of (a, b, c)`, `at least 2 of (a, b, c)`
    fn any_of(&mut self) {
        self.start(SyntaxKind::AnyOf);
        if self.at_word("at") {
            self.bump();
        }
        self.bump();
        self.count();
        let place = self.after_last();
        if !self.eat_word("of") {
            let is_only = self.at(LeftParen);
            if let Some(diagnostic) = self.expected("`of`").filter(|_| is_only) {
                let edits = vec![Edit { span: place, text: " of".to_owned() }];
                diagnostic.fix = Some(Fix { title: "insert `of`".to_owned(), edits });
            }
        }
        if self.at(LeftParen) {
            self.parenthesised();
        } else {
            self.expected("`(`");
        }
        self.finish();
    }

    /// `all i in 0..4 (p[i])`, `race i in 0..4 (p[i])`, `each i in 0..4 (p[i])`
    fn all_of(&mut self) {
        self.start(SyntaxKind::AllOf);
        self.bump();
        self.bump();
        self.bump();
        let has_start = self.eat(Number) || self.eat(Ident);
        if !has_start || !self.eat(SyntaxKind::DotDot) {
            self.expected("a range such as `0..4`");
        }
        if !self.eat(Number) && !self.eat(Ident) {
            self.expected("the end of the range");
        }
        if self.at(LeftParen) {
            self.parenthesised();
        } else {
            self.expected("`(`");
        }
        self.finish();
    }

    /// `name[label, label]<value>`, `name[index][label]`
    fn run(&mut self) {
        self.start(SyntaxKind::Run);
        self.bump();
        while self.at(SyntaxKind::Dot) && self.kind(1) == Ident {
            self.report(Code::E0006, "only instances of this group can be run");
            self.bump();
            self.bump();
        }
        if self.at(LeftBracket) || (self.at(Ident) && self.kind(1) == RightBracket) {
            self.labels();
            if self.at(LeftBracket) {
                self.labels();
            }
        }
        if self.at(Less) {
            self.start(SyntaxKind::Binder);
            self.bump();
            self.list(Greater, "a name", |parser| parser.eat(Ident));
            self.finish();
        }
        self.finish();
    }

    fn labels(&mut self) {
        self.start(SyntaxKind::Labels);
        self.expect(LeftBracket);
        let first = self.cursor;
        if self.eat(Number) {
            self.expect(RightBracket);
            return self.finish();
        }
        if self.at(RightBracket) {
            self.expected("a label");
        }
        while !self.at(RightBracket) {
            if !self.eat(Ident) {
                self.expected("a label");
                if !self.at(Comma) {
                    break;
                }
            }
            // `a[l, b[m]`: the bracket is missing, and `b` is not a label.
            let is_next_operand = self.kind(1) == Ident && self.kind(2) != Comma && self.kind(2) != RightBracket;
            if !self.at(Comma) || is_next_operand {
                break;
            }
            self.bump();
        }
        // `a[l, b` may be `a[l], b`.
        let is_only = self.cursor <= first + 1;
        self.expect_at(RightBracket, is_only);
        self.finish();
    }
}
