//! Parses the interfaces of controller modules.

use super::Parser;
use crate::diagnostic::Code;
use crate::syntax::SyntaxKind::{self, Arrow, Colon, Ident, LeftBrace, LeftParen, Semicolon, Text};

impl Parser<'_> {
    /// `module Name ( params ) { items }`
    pub(super) fn module(&mut self) {
        self.start(SyntaxKind::Module);
        self.bump();
        self.expect_name("the name of the module");
        if !self.at(LeftBrace) {
            self.params();
        }
        self.statements(Self::module_item);
        self.finish();
    }

    fn module_item(&mut self) {
        match self.word(0) {
            "in" | "out" => self.port(),
            "proc" | "calls" => self.procedure(),
            "state" => self.state(),
            "done" | "service" | "plain" | "remembers" => self.flag(),
            "init" => self.init(),
            "exec" => self.text_item(SyntaxKind::Exec, "a string with the program and its arguments"),
            "python" => self.text_item(SyntaxKind::Python, "a string with the path of a Python program"),
            "venv" => self.text_item(SyntaxKind::Venv, "a string with the path of a virtual environment"),
            "action" => self.ros_action(),
            "ros" => self.text_item(SyntaxKind::RosProgram, "a string with a package of ROS 2 and an executable"),
            "setup" => self.text_item(SyntaxKind::RosSetup, "a string with the path of a setup file of ROS 2"),
            "node" => self.text_item(SyntaxKind::RosName, "a string with the name of a node of ROS 2"),
            "params" => self.text_item(SyntaxKind::RosParams, "a string with the path of a file of parameters"),
            "remap" => self.ros_remap(),
            "components" => self.ros_components(),
            "lifecycle" => self.lifecycle(),
            "env" => self.environment(),
            "inherit" => self.inherit(),
            "directory" => self.text_item(SyntaxKind::Folder, "a string with the path of a folder"),
            "stop" => self.stop_within(),
            "claims" => self.claims(),
            "duration" => self.takes(),
            "aborts" | "resumable" => {
                self.report(Code::W0007, format!("`{}` is not supported yet and has no effect", self.word(0)));
                self.skip_statement();
            }
            _ => {
                self.expected(
                    "`in`, `out`, `proc`, `state`, `calls`, `init`, `service`, `done`, `remembers`, `claims`, `duration`, `exec`, \
                     `python`, `venv`, `action`, `ros`, `setup`, `node`, `remap`, `params`, `components`, `lifecycle`, `env`, \
                     `inherit`, `directory`, `plain` or `stop within`",
                );
                self.skip_statement();
            }
        }
    }

    /// `in Port: Type;`, `in Port: Type optional;`
    fn port(&mut self) {
        self.start(SyntaxKind::Port);
        self.bump();
        self.expect_name("the name of a port");
        if self.eat(Colon) {
            self.type_name();
        }
        if !self.eat_word("optional") && self.at(Ident) && self.kind(1) == Semicolon {
            self.report(Code::W0007, format!("`{}` is not supported yet and has no effect", self.word(0)));
            self.bump();
        }
        self.end_statement();
        self.finish();
    }

    /// `proc Grip(Force) -> Width;`, `proc Grip(Force) -> Width idle;`, `calls Grip(Force) -> Width optional;`
    fn procedure(&mut self) {
        self.start(SyntaxKind::Port);
        let is_call = self.at_word("calls");
        self.bump();
        self.expect_name(if is_call { "the name of the called process" } else { "the name of a procedure" });
        self.start(SyntaxKind::Called);
        if self.expect(LeftParen) {
            if !self.at(SyntaxKind::RightParen) {
                self.type_name();
            }
            self.expect(SyntaxKind::RightParen);
        }
        self.finish();
        if self.eat(Arrow) {
            self.type_name();
        }
        self.eat_word(if is_call { "optional" } else { "idle" });
        self.end_statement();
        self.finish();
    }

    /// `state opening: Width;`
    fn state(&mut self) {
        self.start(SyntaxKind::Port);
        self.bump();
        self.expect_name("the name of a state");
        if self.expect(Colon) {
            self.type_name();
        }
        self.end_statement();
        self.finish();
    }

    /// `init goal: Place;`, `init side: Text in "left" | "right";`
    fn init(&mut self) {
        self.start(SyntaxKind::Init);
        self.bump();
        if !self.param() {
            self.expected("the name of the start value");
        }
        self.end_statement();
        self.finish();
    }

    /// `service;`, `plain;`, `remembers;`, `done;`, `done(found: Pose | missing);`
    pub(super) fn flag(&mut self) {
        self.start(SyntaxKind::Flag);
        let has_outcomes = self.at_word("done");
        self.bump();
        if has_outcomes && self.eat(LeftParen) {
            self.outcomes();
        }
        self.end_statement();
        self.finish();
    }

    /// `found: Pose | missing)`
    fn outcomes(&mut self) {
        loop {
            self.start(SyntaxKind::Outcome);
            self.expect_name("an outcome");
            if self.eat(Colon) {
                self.type_name();
            }
            self.finish();
            if !self.eat(SyntaxKind::Bar) {
                break;
            }
        }
        self.expect(SyntaxKind::RightParen);
    }

    /// `claims arm, gripper(read);`
    fn claims(&mut self) {
        self.start(SyntaxKind::Claims);
        self.bump();
        loop {
            self.start(SyntaxKind::Claim);
            self.expect_name("what is claimed");
            if self.eat(LeftParen) {
                if !self.eat_word("read") && !self.eat_word("write") {
                    self.expected("`read` or `write`");
                }
                self.expect(SyntaxKind::RightParen);
            }
            self.finish();
            if !self.eat(SyntaxKind::Comma) {
                break;
            }
        }
        self.end_statement();
        self.finish();
    }

    /// `exec "program arg";`, `python "keep.py";`, `venv ".venv";`, `ros "package executable";`, `directory "/opt/robot";`
    fn text_item(&mut self, kind: SyntaxKind, expected: &str) {
        self.start(kind);
        self.bump();
        if !self.eat(Text) {
            self.expected(expected);
        }
        self.end_statement();
        self.finish();
    }

    /// `action "/navigate_to_pose": ros.nav2.NavigateToPose;`
    fn ros_action(&mut self) {
        self.start(SyntaxKind::RosAction);
        self.bump();
        if !self.eat(Text) {
            self.expected("the name of an action of ROS 2, such as `\"/navigate_to_pose\"`");
        }
        if self.expect(Colon) {
            self.type_name();
        }
        self.end_statement();
        self.finish();
    }

    /// `remap "/cmd_vel" -> "/robot1/cmd_vel";`
    fn ros_remap(&mut self) {
        self.start(SyntaxKind::RosRemap);
        self.bump();
        if !self.eat(Text) {
            self.expected("a string with the name that the program uses");
        }
        if self.expect(Arrow) && !self.eat(Text) {
            self.expected("a string with the name that it gets");
        }
        self.end_statement();
        self.finish();
    }

    /// `components{ rectify "image_proc image_proc::RectifyNode"; }`, `components within 30 s { … }`
    fn ros_components(&mut self) {
        self.start(SyntaxKind::RosComponents);
        self.bump();
        if self.eat_word("within") {
            self.constant();
        }
        self.statements(Self::ros_component);
        self.finish();
    }

    /// `rectify "image_proc image_proc::RectifyNode";`, `rectify "…" { remap "image" -> "image_mono"; }`
    fn ros_component(&mut self) {
        if !self.at(Ident) {
            self.expected("the name of a component");
            return self.skip_statement();
        }
        self.start(SyntaxKind::RosComponent);
        self.bump();
        if !self.eat(Text) {
            self.expected("a string with a package of ROS 2 and a class of a component");
        }
        if self.at(LeftBrace) {
            self.statements(Self::ros_component_item);
        } else {
            self.end_statement();
        }
        self.finish();
    }

    fn ros_component_item(&mut self) {
        match self.word(0) {
            "node" => self.text_item(SyntaxKind::RosName, "a string with the name of a node of ROS 2"),
            "params" => self.text_item(SyntaxKind::RosParams, "a string with the path of a file of parameters"),
            "remap" => self.ros_remap(),
            "intra_process" => self.flag(),
            _ => {
                self.expected("`node`, `remap`, `params` or `intra_process`");
                self.skip_statement();
            }
        }
    }

    /// `lifecycle;`, `lifecycle within 30 s;`
    fn lifecycle(&mut self) {
        self.start(SyntaxKind::Lifecycle);
        self.bump();
        if self.eat_word("within") {
            self.constant();
        }
        self.end_statement();
        self.finish();
    }

    /// `env { NAME = "value"; }`
    fn environment(&mut self) {
        self.start(SyntaxKind::Environment);
        self.bump();
        self.statements(Self::variable);
        self.finish();
    }

    /// `NAME = "value";`
    fn variable(&mut self) {
        if !self.at(Ident) {
            self.expected("the name of a variable");
            return self.skip_statement();
        }
        self.start(SyntaxKind::Variable);
        self.bump();
        self.expect(SyntaxKind::Equals);
        if !self.eat(Text) {
            self.expected("a string with the value of the variable");
        }
        self.end_statement();
        self.finish();
    }

    /// `inherit LC_ALL, ROS_*;`
    fn inherit(&mut self) {
        self.start(SyntaxKind::Inherit);
        self.bump();
        loop {
            self.start(SyntaxKind::Inherited);
            self.expect_name("the name of a variable, or a beginning of names, such as `ROS_*`");
            self.eat(SyntaxKind::Star);
            self.finish();
            if !self.eat(SyntaxKind::Comma) {
                break;
            }
        }
        self.end_statement();
        self.finish();
    }

    /// `duration 1 s .. 15 s;`
    fn takes(&mut self) {
        self.start(SyntaxKind::Takes);
        self.bump();
        self.constant();
        self.expect(SyntaxKind::DotDot);
        self.constant();
        self.end_statement();
        self.finish();
    }

    /// `stop within 2 s;`
    fn stop_within(&mut self) {
        self.start(SyntaxKind::StopWithin);
        self.bump();
        if !self.eat_word("within") {
            self.expected("`within`");
        }
        self.constant();
        self.end_statement();
        self.finish();
    }
}
