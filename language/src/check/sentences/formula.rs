//! Reads the formula of `holds ltl "G (a -> F b.done)"`.
//!
//! `!`, `G` and `F` bind tightest. Then come `U`, `W` and `R` (to the right), `&`, `|`, `->` (to the right), and `<->`.
//! "Next" does not exist, because the number of steps between two events is not fixed.

use super::names::Names;
use super::words::Words;
use super::{Read, unreadable};
use crate::diagnostic::{Code, Diagnostic};
use crate::sites::Formula;

/// The parts of a formula, which a message shows if a text is not a formula.
pub(super) const FORMS: &str = "a formula is made of `p`, `p.running`, `p.stopping`, `p.started`, `p.done`, `p.aborted`, `p.ended`, \
    `true`, `false`, and of `!a`, `G a` (always), `F a` (at some time), `a U b` (until), `a W b` (until, or for ever), `a R b` (b up to \
    and with a), `a & b`, `a | b`, `a -> b`, `a <-> b`";
/// The largest number of words and signs of a formula. This limits the recursion here.
const WORDS_MAX: usize = 200;

/// Reads the next string as a formula.
pub(super) fn read(sentence: &mut Words, names: &Names<'_>) -> Read<Formula> {
    let Some(mut words) = sentence.string() else { return Err(unreadable(sentence.want("a formula in quotes"))) };
    if words.count_all() > WORDS_MAX {
        let message = format!("this formula has {} words and signs", words.count_all());
        let help = format!("at most {WORDS_MAX} are allowed: write several sentences");
        return Err(Box::new(Diagnostic::new(Code::E0801, words.span(), message).help(help)));
    }
    let formula = same(&mut words, names)?;
    if words.is_over() { Ok(formula) } else { Err(unreadable(words.want("an operator or the end of the formula"))) }
}

fn boxed(formula: Formula) -> Box<Formula> {
    Box::new(formula)
}

fn not(formula: Formula) -> Formula {
    Formula::Not(boxed(formula))
}

/// Reads `a <-> b`.
fn same(words: &mut Words, names: &Names<'_>) -> Read<Formula> {
    let mut left = implies(words, names)?;
    while words.eat_two("<-", ">") {
        left = Formula::Same(boxed(left), boxed(implies(words, names)?));
    }
    Ok(left)
}

/// Reads `a -> b`.
fn implies(words: &mut Words, names: &Names<'_>) -> Read<Formula> {
    let left = or(words, names)?;
    match words.eat("->") {
        true => Ok(Formula::Or(boxed(not(left)), boxed(implies(words, names)?))),
        false => Ok(left),
    }
}

/// Reads `a | b`.
fn or(words: &mut Words, names: &Names<'_>) -> Read<Formula> {
    let mut left = and(words, names)?;
    while words.eat("|") {
        left = Formula::Or(boxed(left), boxed(and(words, names)?));
    }
    Ok(left)
}

/// Reads `a & b`.
fn and(words: &mut Words, names: &Names<'_>) -> Read<Formula> {
    let mut left = until(words, names)?;
    while words.eat("&") {
        left = Formula::And(boxed(left), boxed(until(words, names)?));
    }
    Ok(left)
}

/// Reads `a U b`, `a W b` or `a R b`.
fn until(words: &mut Words, names: &Names<'_>) -> Read<Formula> {
    let left = one(words, names)?;
    let operator = ["U", "W", "R"].into_iter().find(|operator| words.eat(operator));
    let Some(operator) = operator else { return Ok(left) };
    let right = until(words, names)?;
    Ok(match operator {
        "U" => Formula::Until(boxed(left), boxed(right)),
        "W" => Formula::WeakUntil(boxed(left), boxed(right)),
        _ => Formula::Release(boxed(left), boxed(right)),
    })
}

/// Reads `!a`, `G a`, `F a`, `(a)` or `p.done`.
fn one(words: &mut Words, names: &Names<'_>) -> Read<Formula> {
    if words.eat("!") {
        return Ok(not(one(words, names)?));
    }
    if words.eat("G") {
        return Ok(Formula::Release(boxed(Formula::Constant(false)), boxed(one(words, names)?)));
    }
    if words.eat("F") {
        return Ok(Formula::Until(boxed(Formula::Constant(true)), boxed(one(words, names)?)));
    }
    if words.eat("(") {
        let inner = same(words, names)?;
        words.need(")")?;
        return Ok(inner);
    }
    if words.at("X") {
        let found = Diagnostic::new(Code::E0801, words.place(), "the operator `X` (next step) is not supported");
        let help = "the number of steps between two events is not fixed: use `U`, `W` or `F`";
        return Err(Box::new(found.help(help)));
    }
    for constant in [true, false] {
        if words.eat(if constant { "true" } else { "false" }) {
            return Ok(Formula::Constant(constant));
        }
    }
    if !words.is_name() {
        return Err(unreadable(words.want("a process, an event or `(`")));
    }
    Ok(Formula::Atom(names.atom(words)?))
}
