//! Pieces of event actions; parentheses are added where they are needed.

/// How tightly a piece is bound.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Tie {
    /// A process, perhaps with `?`, `within` or `as` behind it.
    Operand,
    /// With `retry(…)` before it.
    Prefixed,
    /// Two operands and more.
    Joined,
}

/// The ends that a piece can have. A spec must not wait for an end that cannot come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Ends {
    pub(super) done: bool,
    pub(super) failed: bool,
}

impl Ends {
    /// Both ends can come.
    pub(super) const ANY: Self = Self { done: true, failed: true };

    /// The ends of pieces with an operator between them.
    fn joined(operator: &str, pieces: &[Piece]) -> Self {
        let (some, all) = (
            Self { done: pieces.iter().any(|piece| piece.ends.done), failed: pieces.iter().any(|p| p.ends.failed) },
            Self { done: pieces.iter().all(|piece| piece.ends.done), failed: pieces.iter().all(|p| p.ends.failed) },
        );
        match operator {
            "else" => Self { done: some.done, failed: all.failed },
            "#" => some,
            ";;" => Self { done: false, failed: some.failed },
            _ => Self { done: all.done, failed: some.failed },
        }
    }
}

/// A part of an expression of event actions.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Piece {
    text: String,
    tie: Tie,
    ends: Ends,
}

impl Piece {
    fn operand(text: impl Into<String>, done: bool, failed: bool) -> Self {
        Self { text: text.into(), tie: Tie::Operand, ends: Ends { done, failed } }
    }

    /// Returns a process with these ends.
    pub(super) fn process(name: impl Into<String>, ends: Ends) -> Self {
        Self::operand(name, ends.done, ends.failed)
    }

    /// Returns `skip`.
    pub(super) fn skip() -> Self {
        Self::operand("skip", true, false)
    }

    /// Returns `never`.
    pub(super) fn never() -> Self {
        Self::operand("never", false, false)
    }

    /// Returns `fail("why")`.
    pub(super) fn fail(why: &str) -> Self {
        Self::operand(format!("fail({})", crate::name::quoted(why)), false, true)
    }

    /// Returns a pause.
    pub(super) fn wait(milliseconds: u64) -> Self {
        Self::operand(format!("wait({})", crate::name::duration(milliseconds)), true, false)
    }

    /// Returns the text.
    pub(super) fn text(&self) -> &str {
        &self.text
    }

    /// Returns the ends that can come.
    pub(super) fn ends(&self) -> Ends {
        self.ends
    }

    fn within(&self, tie: Tie) -> String {
        if self.tie <= tie { self.text.clone() } else { format!("({})", self.text) }
    }

    /// Returns these pieces with an operator between them.
    pub(super) fn joined(operator: &str, pieces: Vec<Self>) -> Self {
        if let [only] = pieces.as_slice() {
            return only.clone();
        }
        if pieces.is_empty() {
            return Self::skip();
        }
        let texts: Vec<String> = pieces.iter().map(|piece| piece.within(Tie::Prefixed)).collect();
        let ends = Ends::joined(operator, &pieces);
        Self { text: texts.join(&format!(" {operator} ")), tie: Tie::Joined, ends }
    }

    /// Returns `self ; next`.
    pub(super) fn then(self, next: Self) -> Self {
        Self::joined(";", vec![self, next])
    }

    /// Returns `self # other`.
    pub(super) fn until(self, others: Vec<Self>) -> Self {
        Self::joined("#", std::iter::once(self).chain(others).collect())
    }

    /// Returns `self else other`.
    pub(super) fn or_else(self, other: Self) -> Self {
        Self::joined("else", vec![self, other])
    }

    /// Returns `self finally next`.
    pub(super) fn finally(self, next: Self) -> Self {
        Self::joined("finally", vec![self, next])
    }

    /// Returns `self ;; wait(…)`: again and again until it fails.
    pub(super) fn forever(self) -> Self {
        // The tree waits for its next tick; a loop of a spec has to take time.
        Self::joined(";;", vec![self, Self::wait(10)])
    }

    /// Returns `self ?`: a failure counts as success.
    pub(super) fn tolerated(self) -> Self {
        let Ends { done, failed } = self.ends;
        Self { ends: Ends { done: done || failed, failed: false }, ..self.suffixed("?") }
    }

    /// Returns `self within 5 s`.
    pub(super) fn limited(self, milliseconds: u64) -> Self {
        let ends = Ends { failed: true, ..self.ends };
        Self { ends, ..self.suffixed(&format!("within {}", crate::name::duration(milliseconds))) }
    }

    /// Returns `self as tag`.
    pub(super) fn tagged(self, tag: &str) -> Self {
        self.suffixed(&format!("as {tag}"))
    }

    /// Returns the piece with something before it, such as `retry(3)`.
    pub(super) fn prefixed(self, prefix: &str) -> Self {
        Self { text: format!("{prefix} {}", self.within(Tie::Prefixed)), tie: Tie::Prefixed, ends: self.ends }
    }

    fn suffixed(self, suffix: &str) -> Self {
        Self { text: format!("{} {suffix}", self.within(Tie::Operand)), tie: Tie::Operand, ends: self.ends }
    }

    /// Returns `any 2 of (…)`.
    pub(super) fn any_of(count: usize, pieces: Vec<Self>) -> Self {
        let failed = pieces.iter().any(|piece| piece.ends.failed);
        let done = pieces.iter().filter(|piece| piece.ends.done).count() >= count;
        Self::operand(format!("any {count} of ({})", Self::joined(",", pieces).text), done, failed)
    }

    /// Returns `each INDEX in 0..3 (self)`.
    pub(super) fn repeated(self, index: &str, count: i64) -> Self {
        let Ends { done, failed } = self.ends;
        Self::operand(format!("each {index} in 0..{count} ({})", self.text), done, failed)
    }

    /// Returns the piece, which continues with one of the others by its end.
    pub(super) fn choice(self, yes: Self, no: Self) -> Self {
        match self.ends {
            Ends { done: true, failed: true } => {
                let ends = self.tagged("yes").or_else(Self::skip().tagged("no"));
                ends.matched(vec![("yes".into(), yes), ("no".into(), no)])
            }
            Ends { done: true, failed: false } => self.then(yes),
            Ends { done: false, failed: true } => self.or_else(no),
            Ends { done: false, failed: false } => self,
        }
    }

    /// Returns the piece, which continues with one arm by its outcome.
    pub(super) fn matched(self, arms: Vec<(String, Self)>) -> Self {
        let ends = Ends {
            done: arms.iter().any(|(_, arm)| arm.ends.done),
            failed: self.ends.failed || arms.iter().any(|(_, arm)| arm.ends.failed),
        };
        let arms: Vec<String> =
            arms.iter().map(|(tag, arm)| format!("{tag} => {}", arm.within(Tie::Prefixed))).collect();
        let text = format!("{} : match {{ {} }}", self.within(Tie::Operand), arms.join(", "));
        Self { text, tie: Tie::Joined, ends }
    }

    /// Returns a piece that fails when this one is done, and is done when this one fails.
    pub(super) fn inverted(self, why: &str) -> Self {
        self.choice(Self::fail(why), Self::skip())
    }
}
