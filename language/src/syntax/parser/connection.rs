//! Parses connections and their ends.

use super::Parser;
use crate::syntax::SyntaxKind::{
    self, Arrow, BackArrow, Comma, Dot, Equals, Ident, LeftParen, Number, RightParen, Semicolon, Text,
};

/// Connection qualities that are read; `push` and `pull` mean something already.
const QUALITIES: [&str; 6] = ["push", "pull", "latch", "drop", "queue", "rate"];

impl Parser<'_> {
    /// `internal_connections ( owner, label ) { connections }`
    pub(super) fn connections(&mut self) {
        self.start(SyntaxKind::Connections);
        self.bump();
        if self.at_any(&[LeftParen, Ident]) && !self.ends_block() {
            self.start(SyntaxKind::Owner);
            self.open(LeftParen);
            self.list(RightParen, "a name", Self::owner_name);
            self.finish();
        }
        self.statements(Self::connection);
        self.finish();
    }

    fn owner_name(&mut self) -> bool {
        let is_there = self.eat(Ident);
        if is_there {
            self.index();
        }
        is_there
    }

    /// `a, Out -> b, In push ;`
    fn connection(&mut self) {
        self.start(SyntaxKind::Connection);
        self.end_of_connection();
        if !self.eat(Arrow) && !self.eat(BackArrow) {
            self.expected("`->`");
            if !self.at_any(&[Ident, Comma, Dot, Semicolon]) && !self.ends_block() {
                self.skip_as_error();
            }
        }
        self.end_of_connection();
        while self.at(Ident) && QUALITIES.contains(&self.word(0)) && self.kind(1) != Comma {
            self.quality();
        }
        self.end_statement();
        self.finish();
    }

    fn quality(&mut self) {
        self.start(SyntaxKind::Quality);
        let is_rate = self.at_word("rate");
        self.bump();
        if is_rate && self.at(Number) {
            self.constant();
        } else {
            self.eat(Number);
        }
        self.finish();
    }

    /// `instance, Port`, `db("team/flat/**")`, or `topic("/scan")`
    fn end_of_connection(&mut self) {
        if self.at_word("db") && self.kind(1) == LeftParen {
            self.keys();
        } else if self.at_word("topic") && self.kind(1) == LeftParen {
            self.topic();
        } else {
            self.endpoint();
        }
    }

    /// `db("team/flat/**")`
    fn keys(&mut self) {
        self.start(SyntaxKind::Keys);
        self.bump();
        self.bump();
        if !self.eat(Text) {
            self.expected("a key or a prefix of the database, such as `\"team/flat/**\"`");
        }
        self.expect(RightParen);
        self.finish();
    }

    /// `topic("/cmd_vel", qos = reliable(10))`
    fn topic(&mut self) {
        self.start(SyntaxKind::Topic);
        self.bump();
        self.bump();
        if !self.eat(Text) {
            self.expected("the name of a topic of ROS 2, such as `\"/cmd_vel\"`");
        }
        if self.eat(Comma) {
            if !self.eat_word("qos") {
                self.expected("`qos`");
            }
            self.expect(Equals);
            self.topic_quality();
        }
        self.expect(RightParen);
        self.finish();
    }

    /// `reliable(10)`, `sensor`
    fn topic_quality(&mut self) {
        self.start(SyntaxKind::TopicQuality);
        self.expect_name("a quality of service, such as `reliable(10)` or `sensor`");
        if self.eat(LeftParen) {
            if !self.eat(Number) {
                self.expected("the depth, a number");
            }
            self.expect(RightParen);
        }
        self.finish();
    }

    /// `instance, Port` or `instance.Port`
    pub(super) fn endpoint(&mut self) {
        self.start(SyntaxKind::Endpoint);
        self.expect_name("an instance");
        self.index();
        if self.eat(Comma) || self.eat(Dot) {
            self.expect_name("a port");
        } else {
            self.expected("`,` and a port");
            self.eat(Ident);
        }
        self.finish();
    }
}
