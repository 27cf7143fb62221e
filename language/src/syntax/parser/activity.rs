//! Parses activities: states, their runs, and their transitions.

use super::Parser;
use crate::diagnostic::Fix;
use crate::syntax::SyntaxKind::{
    self, Ampersand, Arrow, Bang, Bar, Colon, Comma, Constant, Dot, DotDot, Equals, Greater, Ident, LeftBrace,
    LeftParen, Less, Minus, Number, Plus, RightBrace, RightParen, Semicolon, Star, Text,
};

/// The words that a state begins with.
const STATE_WORDS: [&str; 7] = ["state", "initial", "final", "suspended", "parallel", "history", "deep"];
/// The words that a trigger may begin with.
const TRIGGERS: &str = "a trigger: `done`, `aborted`, `complete`, `message`, `after`, `every`, `always`, `signal`, `any`, `suspend`, \
                        `resume`, `host`, `link`, `parameter`, `entry`, `exit` or `INSTANCE.done`";
/// The loosest level of operators in a formula, and one past the tightest.
const LEVELS: std::ops::Range<u8> = 0..5;

impl Parser<'_> {
    /// One statement of an activity: a port, a variable, an instance, or a part of a state.
    pub(super) fn activity_item(&mut self) {
        if self.kind(1) == Ident && self.word(1) == "instof" || self.at_word("instof") {
            self.start(SyntaxKind::Instances);
            self.instance();
            self.finish();
            return;
        }
        match self.word(0) {
            "in" | "out" => self.activity_port(),
            "var" => self.state_variable(),
            "done" => self.flag(),
            _ => self.state_item(),
        }
    }

    /// `in speech: Text queue 8;`, `out say: Text;`
    fn activity_port(&mut self) {
        self.start(SyntaxKind::Port);
        let is_input = self.at_word("in");
        self.bump();
        self.expect_name("the name of a port");
        if self.expect(Colon) {
            self.type_name();
        }
        if is_input && self.eat_word("queue") && !self.eat(Number) {
            self.expected("the number of messages that may wait");
        }
        self.end_statement();
        self.finish();
    }

    /// `var tries: 0..3 = 0;`, `var mode: slow | fast = slow;`, `var place: opaque = ();`, `var place: opaque Pose = ();`
    fn state_variable(&mut self) {
        self.start(SyntaxKind::StateVariable);
        self.bump();
        self.expect_name("the name of a variable");
        if self.expect(Colon) {
            self.start(SyntaxKind::Domain);
            if self.at_any(&[Number, Minus]) {
                self.plain_number();
                self.expect(DotDot);
                self.plain_number();
            } else {
                let may_have_type = self.at_word("opaque");
                self.expect_name("`bool`, a range such as `0..3`, names such as `slow | fast`, or `opaque`");
                if may_have_type && self.at_any(&[Ident, LeftBrace]) {
                    self.type_name();
                }
                while self.eat(Bar) {
                    self.expect_name("a name");
                }
            }
            self.finish();
        }
        if self.expect(Equals) {
            self.formula();
        }
        self.end_statement();
        self.finish();
    }

    /// `3`, `-3`
    fn plain_number(&mut self) {
        self.start(Constant);
        self.eat(Minus);
        if !self.eat(Number) {
            self.expected("a whole number");
        }
        self.finish();
    }

    /// One statement of a state.
    fn state_item(&mut self) {
        if self.at_word("run") {
            self.state_run();
        } else if self.at_word("on") {
            self.transition();
        } else if STATE_WORDS.contains(&self.word(0)) {
            self.chart_state();
        } else {
            self.expected("`run`, `on` or `state`");
            self.skip_statement();
        }
    }

    /// `initial state search { ... }`, `final state found;`, `history last -> search;`
    fn chart_state(&mut self) {
        if !self.descend() {
            return self.skip_as_error();
        }
        self.start(SyntaxKind::State);
        let is_history = self.at_word("history") || self.at_word("deep");
        let is_prefix = |parser: &Self| {
            let is_last = parser.at_word("state") || parser.at_word("history");
            !is_last && STATE_WORDS.contains(&parser.word(0))
        };
        while is_prefix(self) {
            self.bump();
        }
        let word = if is_history { "history" } else { "state" };
        if !self.eat_word(word) {
            self.expected(&format!("`{word}`"));
        }
        self.expect_name("the name of a state");
        if self.eat(Arrow) {
            self.target();
        }
        if self.at(LeftBrace) {
            self.statements(Self::state_item);
        } else {
            self.end_statement();
        }
        self.finish();
        self.ascend();
    }

    /// `run find within 30 s;`, `run goto with place;`
    fn state_run(&mut self) {
        self.start(SyntaxKind::StateRun);
        self.bump();
        self.run_expression();
        self.end_statement();
        self.finish();
    }

    /// `on done(found p) when tries < 3 -> approach { where = p; }`
    fn transition(&mut self) {
        self.start(SyntaxKind::Transition);
        self.bump();
        self.trigger();
        if self.at_word("when") {
            self.guard();
        }
        if self.at_word("confirm") {
            self.asking();
        } else if self.eat(Arrow) {
            // Before a `;`, a `,` or a block, `internal` is the name of a state.
            if self.at_word("internal") && self.kind(1) == Ident {
                self.bump();
            }
            self.target();
        }
        if self.at(LeftBrace) {
            self.start(SyntaxKind::Block);
            self.statements(Self::block_statement);
            self.finish();
            self.eat(Semicolon);
        } else {
            self.end_statement();
        }
        self.finish();
    }

    fn trigger(&mut self) {
        self.start(SyntaxKind::Trigger);
        if self.at(Ident) && self.kind(1) == Dot {
            self.child_trigger();
            return self.finish();
        }
        match self.word(0) {
            "done" | "aborted" => {
                self.bump();
                if self.at(LeftParen) {
                    self.pattern();
                }
            }
            "message" => {
                self.bump();
                self.expect_name("the name of an input port");
                if self.at_word("where") {
                    self.guard();
                }
            }
            "after" | "every" => {
                self.bump();
                self.constant();
            }
            "signal" => {
                self.bump();
                self.expect_name("the name of a signal");
            }
            "host" | "link" => {
                self.bump();
                self.constant();
                self.expect_word("lost");
            }
            "parameter" => {
                self.bump();
                self.expect_name("the name of an instance");
                if self.expect(Dot) {
                    self.expect_name("the name of a parameter");
                }
                self.expect_word("changed");
            }
            "always" | "entry" | "exit" | "any" | "complete" | "suspend" | "resume" => self.bump(),
            _ => {
                self.expected(TRIGGERS);
                if self.at(Ident) && !self.ends_block() {
                    self.skip_as_error();
                }
            }
        }
        self.finish();
    }

    /// `look.done`, `look.aborted`
    fn child_trigger(&mut self) {
        self.bump();
        self.bump();
        if !self.eat_word("done") && !self.eat_word("aborted") {
            self.expected("`done` or `aborted`");
            self.eat(Ident);
        }
    }

    fn expect_word(&mut self, word: &str) {
        if !self.eat_word(word) {
            self.expected(&format!("`{word}`"));
        }
    }

    /// `(found p)`, `("no way")`
    fn pattern(&mut self) {
        self.start(SyntaxKind::Pattern);
        self.bump();
        if !self.eat(Text) {
            self.expect_name("an outcome");
            self.eat(Ident);
        }
        self.expect(RightParen);
        self.finish();
    }

    /// `when tries < 3`, `where text == "stop"`
    fn guard(&mut self) {
        self.start(SyntaxKind::Guard);
        self.bump();
        self.formula();
        self.finish();
    }

    /// `approach`, `left, right`, `resume`, `done(v)`, `done(held v)`, `abort("why")`
    fn target(&mut self) {
        self.start(SyntaxKind::Target);
        let (is_done, is_abort) = (self.at_word("done"), self.at_word("abort"));
        self.expect_name("a state, `resume`, `done` or `abort`");
        if is_abort && self.expect(LeftParen) {
            if !self.eat(Text) {
                self.expected("a string with the reason");
            }
            self.expect(RightParen);
        } else if is_done && self.eat(LeftParen) {
            let has_outcome = self.at(Ident) && (matches!(self.kind(1), Ident | Text | LeftParen));
            if has_outcome && !self.at_word("in") && !self.at_word("not") {
                self.bump();
            }
            if !self.at(RightParen) {
                self.formula();
            }
            self.expect(RightParen);
        } else {
            // Behind `yes -> left` a comma may begin the next answer.
            while self.at(Comma) && self.kind(2) != Arrow {
                self.bump();
                self.expect_name("a state");
            }
        }
        self.finish();
    }

    /// `confirm operator "Take it?" options(yes -> take, no -> search) default no after 30 s`
    fn asking(&mut self) {
        self.start(SyntaxKind::Asking);
        self.bump();
        self.expect_word("operator");
        if !self.eat(Text) {
            self.expected("a string with the question");
        }
        self.expect_word("options");
        if self.expect(LeftParen) {
            loop {
                self.start(SyntaxKind::Choice);
                if self.expect_name("an answer") && self.expect(Arrow) {
                    self.target();
                }
                self.finish();
                if !self.eat(Comma) {
                    break;
                }
            }
            self.expect(RightParen);
        }
        if self.eat_word("default") {
            self.expect_name("an answer");
            self.expect_word("after");
            self.constant();
        }
        self.finish();
    }

    /// `tries += 1;`, `where = p;`, `where = script { seen[0] };`, `say.send("hello");`, `log("now " + tries);`, `raise found;`
    fn block_statement(&mut self) {
        self.start(SyntaxKind::Statement);
        let is_call = self.at_word("log") && self.kind(1) == LeftParen;
        if self.at_word("raise") && self.kind(1) == Ident {
            self.bump();
            self.bump();
        } else if is_call || self.at(Ident) && self.kind(1) == Dot {
            if !is_call {
                self.bump();
                self.bump();
                if !self.at_word("send") {
                    self.expected("`send`");
                }
            }
            self.eat(Ident);
            if self.expect(LeftParen) {
                self.formula();
                self.expect(RightParen);
            }
        } else {
            self.expect_name("the name of a variable, `log`, `raise` or a port");
            if self.at_any(&[Plus, Minus]) {
                self.bump();
            }
            if self.expect(Equals) && !self.script() {
                self.formula();
            }
        }
        self.end_statement();
        self.finish();
    }

    /// `script { let best = seen[0]; best }`
    fn script(&mut self) -> bool {
        let is_script = self.at_word("script") && self.kind(1) == SyntaxKind::Script;
        (0..if is_script { 2 } else { 0 }).for_each(|_| self.bump());
        is_script
    }

    /// `tries < 3 && !busy`
    fn formula(&mut self) {
        if self.descend() {
            self.formula_from(LEVELS.start);
            self.ascend();
        } else {
            self.skip_as_error();
        }
    }

    fn formula_from(&mut self, level: u8) {
        if level == LEVELS.end {
            return self.formula_operand();
        }
        let checkpoint = self.checkpoint();
        self.formula_from(level + 1);
        let mut is_started = false;
        while let Some(length) = self.formula_operator(level) {
            if !is_started {
                self.start_at(checkpoint, SyntaxKind::Formula);
                is_started = true;
            }
            (0..length).for_each(|_| self.bump());
            self.formula_from(level + 1);
        }
        if is_started {
            self.finish();
        }
    }

    /// How many tokens the operator of this level has that stands here.
    fn formula_operator(&mut self, level: u8) -> Option<usize> {
        let pair = |first: SyntaxKind, second: SyntaxKind| {
            let touches = self.token(0).zip(self.token(1)).is_some_and(|(one, other)| one.end == other.start);
            self.at(first) && self.kind(1) == second && touches
        };
        match level {
            0 if pair(Bar, Bar) => Some(2),
            0 if self.at_word("or") => Some(1),
            1 if pair(Ampersand, Ampersand) => Some(2),
            1 if self.at_word("and") => Some(1),
            2 if [Equals, Bang, Less, Greater].into_iter().any(|first| pair(first, Equals)) => Some(2),
            2 if self.at_any(&[Less, Greater]) => Some(1),
            2 if self.at(Equals) => {
                let span = self.span();
                if let Some(diagnostic) = self.expected("`==`") {
                    diagnostic.fix = Some(Fix::replace(span, "=="));
                }
                Some(1)
            }
            3 if self.at_any(&[Plus, Minus]) => Some(1),
            4 if self.at(Star) => Some(1),
            _ => None,
        }
    }

    /// A name, a number, a text, `()`, `(formula)`, `!formula`, `in(state)`
    fn formula_operand(&mut self) {
        self.start(SyntaxKind::Formula);
        if self.at_any(&[Number, Minus]) {
            self.plain_number();
        } else if self.at(Text) {
            self.start(Constant);
            self.bump();
            self.finish();
        } else if self.at(LeftParen) && self.kind(1) == RightParen {
            self.start(Constant);
            self.bump();
            self.bump();
            self.finish();
        } else if self.eat(LeftParen) {
            self.formula();
            self.expect(RightParen);
        } else if self.eat(Bang) || self.eat_word("not") {
            if self.descend() {
                self.formula_operand();
                self.ascend();
            }
        } else if self.at_word("in") && self.kind(1) == LeftParen {
            self.bump();
            self.bump();
            self.expect_name("the name of a state");
            self.expect(RightParen);
        } else if self.ends_block() || self.at(RightBrace) {
            self.expected("a value");
        } else {
            self.expect_name("a value");
        }
        self.finish();
    }
}
