//! Formats event-action expressions: in one line, or broken at the loosest operator.

use super::printer::Printer;
use crate::syntax::SyntaxKind::{self, AnyOf, Comma, Finally, LeftBrace, Match, Otherwise, Paren, RightBrace};
use crate::syntax::{Operator, SyntaxNode};
use rowan::NodeOrToken;

/// The largest number of operands of an operator whose last operand, in parentheses, may begin at the end of a line.
const HANGING_MAX: usize = 3;
/// The columns of the longest operator with the blank before it: ` else`. Only ` finally` is longer.
const OPERATOR: usize = 5;
const FINALLY: usize = 8;

/// Returns whether a node has operands.
pub(super) fn is_expression(kind: SyntaxKind) -> bool {
    is_operator(kind) || kind == Paren || kind == Match
}

/// Returns whether the operands of a node have the same rank, so that each operand may have separate lines.
pub(super) fn is_operator(kind: SyntaxKind) -> bool {
    let Some(operator) = kind.operator() else { return false };
    match operator {
        Operator::Concurrent
        | Operator::FailFast
        | Operator::Disable
        | Operator::Sequence
        | Operator::Finally
        | Operator::Otherwise
        | Operator::Chain => true,
        Operator::Retry
        | Operator::Repeat
        | Operator::Shield
        | Operator::Using
        | Operator::Match
        | Operator::Named
        | Operator::Suffixed
        | Operator::Paren
        | Operator::Run
        | Operator::Fail
        | Operator::Wait
        | Operator::AnyOf
        | Operator::AllOf => false,
    }
}

impl Printer<'_> {
    /// Writes an operator with its operands, or parentheses.
    pub(super) fn expression(&mut self, node: &SyntaxNode, reserve: usize) {
        let range = self.range(node);
        if self.is_flat(&range, reserve) {
            return self.flat(&range);
        }
        if node.kind() == Paren {
            self.parentheses(node);
        } else if node.kind() == Match {
            self.arms(node);
        } else if let Some(last) = self.hanging(node) {
            self.flat(&(range.start..self.range(&last).start));
            self.node(&last, reserve);
        } else {
            self.operands(node, reserve);
        }
    }

    /// Returns whether the author broke the line at one of the node's own operators.
    fn is_broken_here(&self, node: &SyntaxNode) -> bool {
        if !is_operator(node.kind()) {
            return false;
        }
        let end = self.range(node).end;
        node.children_with_tokens().filter_map(NodeOrToken::into_token).filter(|token| !token.kind().is_trivia()).any(
            |operator| {
                let start: u32 = operator.text_range().start().into();
                let index = self.pieces.partition_point(|piece| piece.start < start);
                let breaks =
                    |index: usize| index < end && (self.pieces[index].is_broken || self.pieces[index].forces_lines());
                breaks(index) || breaks(index + 1)
            },
        )
    }

    /// Returns the last operand of `a, (`, or of `a else match {`, if it may begin in this line and continue on the
    /// lines below.
    fn hanging(&self, node: &SyntaxNode) -> Option<SyntaxNode> {
        let operands: Vec<SyntaxNode> = node.children().collect();
        let last = operands.last()?;
        let (range, last_range) = (self.range(node), self.range(last));
        let before = range.start..last_range.start;
        let hangs = ([Paren, AnyOf].contains(&last.kind()) || last.kind() == Match && node.kind() == Otherwise)
            && last_range.end == range.end
            && operands.len() <= HANGING_MAX
            && !self.is_broken_here(node)
            && !self.is_forced(&before)
            && self.fits(&(range.start..last_range.start + 1), 0);
        hangs.then(|| last.clone())
    }

    /// Writes each operand on lines of its own, with the operator at the end.
    fn operands(&mut self, node: &SyntaxNode, reserve: usize) {
        let is_nested = node.parent().is_some_and(|parent| is_operator(parent.kind()));
        let last = node.children().last();
        let operator = if node.kind() == Finally { FINALLY } else { OPERATOR };
        let mut is_first = true;
        for part in node.children_with_tokens() {
            match part {
                NodeOrToken::Token(token) if token.kind().is_trivia() => {}
                NodeOrToken::Token(_) => {
                    self.operator();
                    if is_first && is_nested {
                        self.indent += 1;
                    }
                    is_first = false;
                    self.next_line();
                }
                NodeOrToken::Node(part) => {
                    let is_last = last.as_ref() == Some(&part);
                    self.node(&part, if is_last { reserve } else { operator });
                }
            }
        }
        if is_nested && !is_first {
            self.indent -= 1;
        }
    }

    /// Writes an operator, which ends its line.
    fn operator(&mut self) {
        self.starts_line = false;
        self.token();
    }

    /// Writes `match {`, and each arm on a line of its own.
    fn arms(&mut self, node: &SyntaxNode) {
        for part in node.children_with_tokens() {
            match part {
                NodeOrToken::Token(token) if token.kind().is_trivia() => {}
                NodeOrToken::Token(token) if token.kind() == RightBrace => self.close(),
                NodeOrToken::Token(token) => {
                    self.token();
                    if token.kind() == LeftBrace {
                        self.open();
                    } else if token.kind() == Comma {
                        self.next_line();
                    }
                }
                NodeOrToken::Node(arm) => self.node(&arm, 1),
            }
        }
    }

    fn parentheses(&mut self, node: &SyntaxNode) {
        self.token();
        self.open();
        for part in node.children() {
            self.node(&part, 0);
        }
        self.close();
    }
}
