//! Parses files, process groups and their sections.

use super::Parser;
use super::repair::{ITEMS, SECTIONS};
use crate::diagnostic::{Code, Fix};
use crate::similar;
use crate::syntax::SyntaxKind::{
    self, Arrow, BackArrow, Comma, Dot, End, Equals, Ident, LeftBrace, LeftBracket, LeftParen, Number, RightBrace,
    RightParen, Semicolon, Text,
};
use rowan::Language;

/// Connection qualities that are read; `push` and `pull` mean something already.
const QUALITIES: [&str; 6] = ["push", "pull", "latch", "drop", "queue", "rate"];

impl Parser<'_> {
    pub(super) fn file(&mut self) {
        // The root takes all trivia, the first too.
        self.builder.start_node(crate::syntax::Dca::kind_to_raw(SyntaxKind::File));
        while !self.at(End) {
            self.item();
        }
        self.place_trivia();
        self.finish();
    }

    fn item(&mut self) {
        if self.is_item(0) {
            // A new item is a safe point: mistakes after this point have separate causes.
            self.reports.reported_at = None;
        }
        if self.at_word("module") {
            self.module();
        } else if self.at_word("process") || self.is_item(0) && self.at_word("activity") {
            self.process();
        } else if self.is_item(0) && self.at_word("verify") {
            self.properties();
        } else if self.is_item(0) && self.at_word("const") {
            self.const_item();
        } else if self.is_item(0) && self.at_word("type") {
            self.type_item();
        } else if self.is_item(0) {
            self.use_item();
        } else if self.is_section(0) {
            // The process was closed too early; its sections are read for their own errors.
            self.report(Code::E0001, format!("`{}` stands outside of any process", self.word(0)));
            self.start(SyntaxKind::Error);
            while self.is_section(0) {
                self.section();
            }
            self.eat(RightBrace);
            self.finish();
        } else if self.at(Ident) && self.kind(1) == Ident && [LeftParen, LeftBrace].contains(&self.kind(2)) {
            self.misspelt_item();
        } else if self.at(Ident) && self.kind(1) == LeftParen {
            self.expected("`process`");
            self.process();
        } else {
            self.expected("`process` or `module`");
            self.start(SyntaxKind::Error);
            while !self.at(End) && !self.is_item(0) && !self.is_section(0) {
                let is_end = self.at_any(&[Semicolon, RightBrace]);
                self.skip_tree();
                if is_end {
                    break;
                }
            }
            self.finish();
        }
    }

    /// `const name = 5 s ;`
    fn const_item(&mut self) {
        self.start(SyntaxKind::ConstItem);
        self.bump();
        self.bump();
        self.bump();
        self.constant();
        self.end_statement();
        self.finish();
    }

    /// `type Name = Type ;`
    fn type_item(&mut self) {
        self.start(SyntaxKind::TypeItem);
        self.bump();
        self.bump();
        self.expect(Equals);
        self.type_name();
        self.end_statement();
        self.finish();
    }

    /// `use "file.dca" ;`
    fn use_item(&mut self) {
        self.start(SyntaxKind::Use);
        self.bump();
        self.bump();
        self.end_statement();
        self.finish();
    }

    /// `proces Name (`: a word that is nearly one of ours is taken as such.
    fn misspelt_item(&mut self) {
        let span = self.span();
        let suggestion = similar::nearest(self.word(0), ITEMS);
        if let (Some(diagnostic), Some(word)) = (self.expected("`process` or `module`"), suggestion) {
            diagnostic.choices.push(Fix::replace(span, word));
        }
        match suggestion {
            Some("module") => self.module(),
            Some("verify") => self.properties(),
            Some(_) | None => self.process(),
        }
    }

    /// `process Name ( params ) { sections }`, `activity Name ( params ) { items }`; the word may be missing or misspelt.
    fn process(&mut self) {
        self.start(SyntaxKind::Process);
        let is_activity = self.at_word("activity");
        if self.at(Ident) && (self.kind(1) == Ident || self.at_word("process")) {
            self.bump();
        }
        self.expect_name("the name of the process");
        self.params();
        self.open(LeftBrace);
        while !self.at(End) && !self.is_item(0) {
            if self.at(RightBrace) {
                // A brace too many in front of a section: the process continues.
                if !self.is_section(1) {
                    break;
                }
                self.expected("a section");
                self.skip_as_error();
            }
            self.empty_statements();
            let before = self.cursor;
            if self.at(RightBrace) || self.is_item(0) || self.at(End) {
                continue;
            }
            if is_activity && !self.is_section(0) {
                self.activity_item();
            } else {
                self.section();
            }
            if self.cursor == before {
                self.skip_as_error();
            }
        }
        self.expect(RightBrace);
        self.finish();
        self.empty_statements();
    }

    /// `;` where no statement is: a habit from other languages.
    fn empty_statements(&mut self) {
        while self.at_any(&[Semicolon, SyntaxKind::Recur]) {
            self.report(Code::W0009, "an empty statement");
            self.bump();
        }
    }

    fn section(&mut self) {
        match self.word(0) {
            "host" => self.host(),
            "instantiated_processes" => self.block(SyntaxKind::Instances, Self::instance),
            "external_io" => self.block(SyntaxKind::External, Self::export),
            "internal_connections" => self.connections(),
            "internal_event_actions" => self.actions(),
            "supervision" => self.block(SyntaxKind::Supervision, Self::supervision_rule),
            "verify" => self.properties(),
            "on_boot" => self.on_boot(),
            "resource" if self.kind(1) == Ident => self.resources(),
            _ => self.unknown_section(),
        }
    }

    /// A misspelt section is read as the intended section. Any other text is skipped.
    fn unknown_section(&mut self) {
        let span = self.span();
        let opens = self.kind(1) == LeftBrace || self.kind(1) == LeftParen;
        let meant = if self.at(Ident) && opens { similar::nearest(self.word(0), SECTIONS) } else { None };
        let diagnostic = self.expected("a section");
        if let (Some(diagnostic), Some(word)) = (diagnostic, meant) {
            diagnostic.choices.push(Fix::replace(span, word));
        }
        match meant {
            Some("host") => self.host(),
            Some("instantiated_processes") => self.block(SyntaxKind::Instances, Self::instance),
            Some("external_io") => self.block(SyntaxKind::External, Self::export),
            Some("internal_connections") => self.connections(),
            Some("supervision") => self.block(SyntaxKind::Supervision, Self::supervision_rule),
            Some("verify") => self.properties(),
            Some("on_boot") => self.on_boot(),
            Some(_) => self.actions(),
            None => self.skip_section(),
        }
    }

    /// `on_boot{resume}`
    fn on_boot(&mut self) {
        self.start(SyntaxKind::OnBoot);
        self.bump();
        self.open(LeftBrace);
        self.expect_name("`none` or `resume`");
        self.expect(RightBrace);
        self.finish();
    }

    fn skip_section(&mut self) {
        self.start(SyntaxKind::Error);
        while !self.ends_block() {
            let is_end = self.at(LeftBrace);
            self.skip_tree();
            if is_end {
                break;
            }
        }
        self.finish();
    }

    /// `host { c1 }`
    fn host(&mut self) {
        self.start(SyntaxKind::Host);
        self.bump();
        self.open(LeftBrace);
        if !self.at(RightBrace) && !self.eat(Text) {
            self.expect_name("a host");
        }
        let is_list = self.at_any(&[Comma, Semicolon]) && [Ident, Text].contains(&self.kind(1));
        if is_list && !self.is_item(1) && !self.is_section(1) {
            self.other_hosts();
        } else if !self.at(RightBrace) && self.kind(1) == RightBrace && !self.is_section(0) {
            self.expected("`}`");
            self.skip_as_error();
        }
        self.expect(RightBrace);
        self.finish();
    }

    /// More than one host, all of which are skipped.
    fn other_hosts(&mut self) {
        if let Some(diagnostic) = self.expected("`}`") {
            let help = "a group runs on one host; the host of an instance is its argument: `a instof A(c2)`";
            diagnostic.help.push(help.to_owned());
        }
        self.start(SyntaxKind::Error);
        while !self.ends_block() {
            self.bump();
        }
        self.finish();
    }

    /// `word { statements }`
    fn block(&mut self, kind: SyntaxKind, statement: fn(&mut Self)) {
        self.start(kind);
        self.bump();
        self.statements(statement);
        self.finish();
    }

    /// `{ statements }`; every statement reads at least one token.
    pub(super) fn statements(&mut self, statement: fn(&mut Self)) {
        self.open(LeftBrace);
        while !self.ends_block() {
            let before = self.cursor;
            self.empty_statements();
            if !self.ends_block() {
                statement(self);
            }
            if self.cursor == before {
                self.skip_as_error();
            }
        }
        self.expect(RightBrace);
    }

    /// Reads the `;` that ends a statement; skips to it when something else is in between.
    pub(super) fn end_statement(&mut self) {
        if self.at(SyntaxKind::Recur) {
            self.report(Code::W0009, "an empty statement");
            self.bump();
        } else if !self.eat(Semicolon) {
            let starts_next = self.at(Ident) || self.ends_block();
            if starts_next {
                self.expect(Semicolon);
            } else {
                self.expected(Semicolon.describe());
                self.skip_statement();
            }
        }
    }

    /// `name instof Type ( args ) ;`
    pub(super) fn instance(&mut self) {
        self.start(SyntaxKind::Instance);
        let is_nameless = self.at_word("instof") && self.kind(1) == Ident && self.word(1) != "instof";
        if is_nameless {
            // Either the name is missing or the two words changed places.
            self.expected("the name of an instance");
            self.bump();
            if self.kind(1) == Ident {
                self.bump();
            }
        } else {
            self.expect_name("the name of an instance");
            if self.at(LeftBracket) {
                self.bracketed(SyntaxKind::Count, "the number of instances");
            }
            self.instof();
        }
        if self.at(Ident) {
            self.type_name();
        } else {
            self.expected("the type of the instance");
        }
        self.args();
        if self.at(LeftBrace) {
            self.start(SyntaxKind::Policies);
            self.statements(Self::policy);
            self.finish();
            self.eat(Semicolon);
        } else {
            self.end_statement();
        }
        self.finish();
    }

    /// The word between the name and the type: missing, misspelt, or behind the type.
    fn instof(&mut self) {
        if self.eat_word("instof") {
            return;
        }
        let span = self.span();
        let is_misspelt = self.at(Ident) && self.kind(1) == Ident;
        // `a insof Arm(c1)` has no other reading; `a b Arm(c1)` may be two names, or a name in two words.
        let is_nearly = self.word(0).starts_with("inst") || similar::nearest(self.word(0), ["instof"]).is_some();
        let is_only = is_nearly && self.kind(2) == LeftParen;
        let diagnostic = self.expected("`instof`");
        if let (Some(diagnostic), true) = (diagnostic, is_misspelt) {
            let fix = Fix::replace(span, "instof");
            if is_only {
                diagnostic.fix = Some(fix);
            } else {
                diagnostic.choices.push(fix);
            }
        }
        if is_misspelt {
            self.skip_as_error();
            if self.at_word("instof") {
                self.bump();
            }
        }
    }

    /// `Out = instance, Port ;`
    fn export(&mut self) {
        self.start(SyntaxKind::Export);
        self.expect_name("the name of an external port");
        if !self.eat(Equals) {
            self.expected("`=`");
        }
        self.endpoint();
        self.end_statement();
        self.finish();
    }

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

    /// `instance, Port`, `db("team/flat/**")`, `topic("/scan")`, or `service("/reset")`
    fn end_of_connection(&mut self) {
        if self.at_word("db") && self.kind(1) == LeftParen {
            self.keys();
        } else if (self.at_word("topic") || self.at_word("service")) && self.kind(1) == LeftParen {
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

    /// `topic("/cmd_vel", qos = reliable(10))`, `topic("/tf", frame_prefix = "r1/")`, `service("/reset")`
    fn topic(&mut self) {
        let expected = if self.at_word("topic") {
            "the name of a topic of ROS 2, such as `\"/cmd_vel\"`"
        } else {
            "the name of a service of ROS 2, such as `\"/reset\"`"
        };
        self.start(SyntaxKind::Topic);
        self.bump();
        self.bump();
        if !self.eat(Text) {
            self.expected(expected);
        }
        while self.eat(Comma) {
            if self.eat_word("frame_prefix") {
                self.expect(Equals);
                self.frame_prefix();
                continue;
            }
            if !self.eat_word("qos") {
                self.expected("`qos` or `frame_prefix`");
            }
            self.expect(Equals);
            self.topic_quality();
        }
        self.expect(RightParen);
        self.finish();
    }

    /// `"r1/"`
    fn frame_prefix(&mut self) {
        self.start(SyntaxKind::FramePrefix);
        if !self.eat(Text) {
            self.expected("a string with the prefix of the robot's frames, such as `\"r1/\"`");
        }
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
