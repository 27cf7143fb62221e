//! Reads the part of mCRL2 that the exporter writes: one linear process over whole numbers.

use super::machine::{Change, Expr, Machine, Variable};

/// Returns the model, and for each word its action.
pub(crate) fn read(text: &str) -> (Machine, Vec<(String, String)>) {
    let comments = text.lines().filter_map(|line| line.strip_prefix("% ")).skip(1);
    let pair = |line: &str| line.split_once(": ").map(|(action, word)| (word.to_owned(), action.to_owned()));
    let words: Vec<(String, String)> = comments.filter_map(pair).collect();
    let code: Vec<&str> = text.lines().filter(|line| !line.starts_with('%')).collect();
    let mut reader = Reader { tokens: tokens(&code.join("\n")), at: 0, variables: Vec::new() };
    reader.word("act");
    let mut actions = vec![reader.next()];
    while reader.takes(",") {
        actions.push(reader.next());
    }
    for sign in [";", "proc", "Plan", "("] {
        reader.word(sign);
    }
    loop {
        let name = reader.next();
        reader.word(":");
        reader.word("Int");
        reader.variables.push(Variable { name, first: 0, most: None });
        if !reader.takes(",") {
            break;
        }
    }
    reader.word(")");
    reader.word("=");
    let mut changes = vec![reader.change(&actions)];
    while reader.takes("+") {
        changes.push(reader.change(&actions));
    }
    for sign in [";", "init", "Plan", "("] {
        reader.word(sign);
    }
    for index in 0..reader.variables.len() {
        if index > 0 {
            reader.word(",");
        }
        reader.word("0");
    }
    reader.word(")");
    reader.word(";");
    assert_eq!(reader.at, reader.tokens.len(), "nothing follows");
    (Machine::new(reader.variables, changes), words)
}

fn tokens(text: &str) -> Vec<String> {
    let letters: Vec<char> = text.chars().collect();
    let (mut tokens, mut at) = (Vec::new(), 0);
    while at < letters.len() {
        let start = at;
        let is_word = |letter: char| letter.is_ascii_alphanumeric() || letter == '_';
        while at < letters.len() && is_word(letters[at]) {
            at += 1;
        }
        if at == start {
            let two: String = letters[at..(at + 2).min(letters.len())].iter().collect();
            at += if ["&&", "||", "==", "!=", "->"].contains(&two.as_str()) { 2 } else { 1 };
        }
        let token: String = letters[start..at].iter().collect();
        if !token.trim().is_empty() {
            tokens.push(token);
        }
    }
    tokens
}

struct Reader {
    tokens: Vec<String>,
    at: usize,
    variables: Vec<Variable>,
}

impl Reader {
    fn next(&mut self) -> String {
        self.at += 1;
        self.tokens[self.at - 1].clone()
    }

    fn word(&mut self, word: &str) {
        let next = self.next();
        assert_eq!(next, word, "token {}", self.at);
    }

    fn takes(&mut self, word: &str) -> bool {
        let is_it = self.tokens.get(self.at).is_some_and(|token| token == word);
        self.at += usize::from(is_it);
        is_it
    }

    /// `(guard) -> action . Plan(a = 1, b = c)`
    fn change(&mut self, actions: &[String]) -> Change {
        self.word("(");
        let guard = self.any();
        self.word(")");
        self.word("->");
        let action = self.next();
        assert!(action == "tau" || actions.contains(&action), "`{action}` is declared");
        for sign in [".", "Plan", "("] {
            self.word(sign);
        }
        let mut sets = Vec::new();
        while !self.takes(")") {
            let name = self.next();
            self.word("=");
            let value = self.sum();
            sets.push((self.position(&name), value));
            self.takes(",");
        }
        Change { word: (action != "tau").then_some(action), guard, sets }
    }

    fn any(&mut self) -> Expr {
        let mut of = vec![self.all()];
        while self.takes("||") {
            of.push(self.all());
        }
        if of.len() == 1 { of.remove(0) } else { Expr::Of("||", of) }
    }

    fn all(&mut self) -> Expr {
        let mut of = vec![self.comparison()];
        while self.takes("&&") {
            of.push(self.comparison());
        }
        if of.len() == 1 { of.remove(0) } else { Expr::Of("&&", of) }
    }

    fn comparison(&mut self) -> Expr {
        if self.takes("!") {
            return Expr::Of("!", vec![self.atom()]);
        }
        let left = self.sum();
        for sign in ["==", "!=", "<"] {
            if self.takes(sign) {
                return Expr::Of(sign, vec![left, self.sum()]);
            }
        }
        left
    }

    fn sum(&mut self) -> Expr {
        let left = self.atom();
        for sign in ["+", "-"] {
            if self.takes(sign) {
                return Expr::Of(sign, vec![left, self.atom()]);
            }
        }
        left
    }

    fn atom(&mut self) -> Expr {
        let token = self.next();
        match token.as_str() {
            "(" => {
                let inside = self.any();
                self.word(")");
                inside
            }
            "if" => {
                self.word("(");
                let test = self.any();
                self.word(",");
                let then = self.sum();
                self.word(",");
                let other = self.sum();
                self.word(")");
                Expr::Of("if", vec![test, then, other])
            }
            "true" => Expr::Number(1),
            "false" => Expr::Number(0),
            _ => match token.parse() {
                Ok(number) => Expr::Number(number),
                Err(_) => Expr::Variable(self.position(&token)),
            },
        }
    }

    fn position(&self, name: &str) -> usize {
        let found = self.variables.iter().position(|variable| variable.name == name);
        found.unwrap_or_else(|| panic!("`{name}` is declared"))
    }
}
