//! Random specs with random comments and white space between their tokens.

mod numbers;

use language::syntax::lex;
pub(crate) use numbers::Random;

/// A spec as the tokens that mean something.
struct Writer {
    random: Random,
    tokens: Vec<String>,
    instances: usize,
}

/// Returns a random spec; `seed` decides everything.
pub(crate) fn spec(seed: u64) -> String {
    let mut writer = Writer { random: Random(seed), tokens: Vec::new(), instances: 0 };
    for _ in 0..=writer.random.below(2) {
        writer.item();
    }
    let Writer { mut random, tokens, .. } = writer;
    // Some texts have comments everywhere, most have a few; some have no lines, most have many.
    let (rarity, airy) = ([2, 4, 10, 25][random.below(4)], [1, 4, 40][random.below(3)]);
    let mut text = String::new();
    for pair in std::iter::once("").chain(tokens.iter().map(String::as_str)).zip(tokens.iter()) {
        between(&mut random, (rarity, airy), &mut text, (pair.0, pair.1));
        text += pair.1;
    }
    between(&mut random, (rarity, airy), &mut text, ("", ""));
    text
}

/// Writes the text between two tokens: white space, comments, or nothing if that means the same.
fn between(random: &mut Random, (rarity, airy): (usize, usize), text: &mut String, (before, next): (&str, &str)) {
    let length = text.len();
    blank(random, airy, text);
    if random.one_in(rarity) {
        for _ in 0..=random.below(3) {
            // A slash before a comment would become a part of it.
            *text += if text.ends_with('/') && !text.ends_with("*/") { " " } else { "" };
            comment(random, text);
            blank(random, airy, text);
        }
    }
    // Two tokens that touch must not become others.
    if length == text.len() {
        let joined = format!("{before}{next}");
        let own = lex(&joined).iter().any(|token| token.start as usize == before.len());
        *text += if own { "" } else { " " };
    }
}

fn blank(random: &mut Random, airy: usize, text: &mut String) {
    let is_airy = random.one_in(airy);
    *text += random.pick(if is_airy { &["\n", "\n", "\n\n", "\n \n\n", "\t\n "] } else { &["", " ", " ", "  ", "\t"] });
}

fn comment(random: &mut Random, text: &mut String) {
    let words = ["", "x", "why", "ß😀", "a few words that take their place", "* * *"];
    let long = "long ".repeat(random.below(18));
    let (one, other) = (random.pick(&words), random.pick(&words));
    *text += &match random.below(8) {
        0..=2 => format!("/*{one}*/"),
        3 => format!("/* {one} {long}*/"),
        4 => format!("/*{one}\n{other}*/"),
        5 => format!("//{one} {long}\n"),
        6 => format!("///{one}\n"),
        _ => format!("// {one}\n"),
    };
}

impl Writer {
    fn put(&mut self, text: &str) {
        self.tokens.extend(text.split_whitespace().map(str::to_owned));
    }

    fn name(&mut self) -> String {
        let stem = self.random.pick(&["a", "b", "m", "robot", "opengrip", "presshandle", "a_long_name_of_an_instance"]);
        if self.random.one_in(3) { stem.to_owned() } else { format!("{stem}{}", self.random.below(9)) }
    }

    fn item(&mut self) {
        match self.random.below(9) {
            0 => {
                let value =
                    self.random.pick(&["5 s", "\"text\"", "[ c1 , c2 , c3 ]", "{ x = 1 m , y = 2 m }", "- 3 m / s"]);
                self.put(&format!("const limit = {value} ;"));
            }
            1 => self.put("type Grasp = { force : Force = 20 N , width : Length } ;"),
            2 => self.module(),
            _ => self.process(),
        }
    }

    fn module(&mut self) {
        let name = self.name();
        self.put(&format!("module {name} ( host : Host , gain : Number = 3 ) {{"));
        for _ in 0..self.random.below(4) {
            let fact = [
                "service ;",
                "done ( found : Pose | missing ) ;",
                "in In : T [ 6 ] optional ;",
                "out Out : T ;",
                "init goal : Place in 1 .. 5 ;",
            ];
            let fact = self.random.pick(&fact);
            self.put(fact);
        }
        self.put("}");
    }

    fn process(&mut self) {
        let name = self.name();
        let params = self.random.pick(&[
            "",
            "h",
            "h : Host = c1 , n : Number",
            "host1 , host2 , a_long_parameter : Length ,",
            "h : Host , arm : Resource , gripper : Resource",
            "n : Number in 1 .. 4 = 2 , limit : Time = 5 s , tries",
        ]);
        self.put(&format!("process {name} ( {params} ) {{"));
        if self.random.one_in(2) {
            self.put("host { c1 }");
        }
        if self.random.one_in(4) {
            self.put("resource arm , gripper ;");
        } else if self.random.one_in(6) {
            self.put("resource arm ; resource gripper , table ;");
        }
        if self.random.one_in(2) {
            self.instances();
        }
        if self.random.one_in(4) {
            self.put("external_io { Out = a , Out ; In = b . In ; }");
        }
        if self.random.one_in(3) {
            self.put("internal_connections ( a , on ) { a , Out -> b . In pull queue 5 ; b . In <- c [ i ] . Out rate 10 Hz ; }");
        }
        if !self.random.one_in(5) {
            self.put("internal_event_actions {");
            self.expression(4);
            if self.random.one_in(6) {
                self.put(";");
            }
            self.put("}");
        }
        self.put("}");
    }

    fn instances(&mut self) {
        self.put("instantiated_processes {");
        for _ in 0..self.random.below(4) {
            let (name, kind) = (self.name(), self.name());
            self.instances += 1;
            let count = self.random.pick(&["", "", "[ 4 ]", "[ n ]"]);
            let args = [
                "c1",
                "c1 , 5 m / s",
                "hosts [ i ] , grasp = { force = 3 N , width = 2 cm }",
                "\"a\" , [ 1 , 2 , 3 ]",
                "",
                "c1 , arm , gripper",
                "c2 , n = 3 , limit = 2 min , tries = n ,",
            ];
            let args = self.random.pick(&args);
            let end = self.random.pick(&[";", ";", "{ memory 5 MB ; nice 3 ; }"]);
            self.put(&format!("{name} {count} instof {kind} ( {args} ) {end}"));
        }
        self.put("}");
    }

    fn expression(&mut self, depth: usize) {
        let operators = [",", ",", ";", ";", "#", "&", "finally", "finally", "else", ":", ";;", ":;", "::"];
        let operands = if depth == 0 { 1 } else { 1 + self.random.below(5) };
        let operator = self.random.pick(&operators);
        for index in 0..operands {
            if index > 0 {
                self.put(operator);
                if operator == "::" {
                    let places = self.random.pick(&["[ 2 ]", "[ n ]"]);
                    self.put(places);
                }
            }
            if self.random.one_in(9) {
                let result = self.random.pick(&["p =>", "p => q =>"]);
                self.put(result);
            }
            self.operand(depth);
        }
    }

    fn operand(&mut self, depth: usize) {
        if self.random.one_in(12) {
            self.put("repeat");
            self.operand(depth.saturating_sub(1));
            let until = self.random.pick(&["until found", "until found | gone"]);
            return self.put(until);
        }
        if self.random.one_in(12) && depth > 0 {
            self.put("(");
            self.leaf();
            self.put("else match { timeout =>");
            self.leaf();
            self.put(", \"why\" => (");
            self.expression(depth - 1);
            let end = self.random.pick(&[") }", ") , else => skip }", ") , }"]);
            self.put(end);
            return self.put(")");
        }
        if self.random.one_in(8) {
            let prefix =
                ["retry ( 3 )", "retry ( tries , pause 1 s )", "shield", "shield ( limit )", "using ( arm , gripper )"];
            let prefix = self.random.pick(&prefix);
            self.put(prefix);
        }
        if depth == 0 || self.random.one_in(2) {
            self.leaf();
        } else {
            let before = [
                "(",
                "(",
                "(",
                "any 2 of (",
                "any n of (",
                "at least 2 of (",
                "all i in 0 .. 4 (",
                "race i in 0 .. n (",
            ];
            if self.random.one_in(9) {
                return self.arms(depth - 1);
            }
            let before = self.random.pick(&before);
            self.put(before);
            self.expression(depth - 1);
            self.put(")");
        }
        if self.random.one_in(8) {
            let suffix = self.random.pick(&[
                "?",
                "within 5 s",
                "? within 20 ms",
                "within limit ?",
                "as found",
                "within limit as late ?",
                "as a as b",
                "with shelf",
                "with { x = 2 m , way = [ 1 , - 2 ] } within 5 s as there",
                "with 5 m / s ?",
                "with p",
            ]);
            self.put(suffix);
        }
    }

    fn arms(&mut self, depth: usize) {
        self.put("match {");
        for tag in ["found", "missing", "else"] {
            let value = self.random.pick(&["", "", "p"]);
            self.put(&format!("{tag} {value} =>"));
            if depth == 0 {
                self.leaf();
            } else {
                self.put("(");
                self.expression(depth - 1);
                self.put(")");
            }
            self.put(",");
        }
        self.put("}");
    }

    fn leaf(&mut self) {
        let name = self.name();
        match self.random.below(8) {
            0 => self.put(&format!("{name} [ on ]")),
            1 => self.put(&format!("{name} [ i ] [ on , off ]")),
            2 => self.put(&format!("{name} < v , w >")),
            3 => {
                let constant = self.random.pick(&["skip", "never", "fail ( \"why\" )", "wait ( 5 s )", "wait ( 8 s )"]);
                self.put(constant);
            }
            _ => self.put(&name),
        }
    }
}
