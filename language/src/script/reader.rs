//! Reads the texts of scripts without a run, and finds mistakes in them.

use super::value::{Unknown, written};
use super::{ScriptResult, clause, engine};
use rhai::{
    AST, ASTFlags, ASTNode, Array, Dynamic, Engine, Expr, FnCallExpr, Map, ParseErrorType, Position, Scope, Stmt,
};
use std::collections::BTreeSet;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Functions that the engine knows without their parameters.
const BUILT_IN: [&str; 5] = ["call", "is_def_fn", "is_def_var", "is_shared", "type_of"];

/// Reads the scripts of a spec.
#[derive(Debug)]
pub(crate) struct ScriptReader {
    engine: Engine,
    functions: BTreeSet<Function>,
}

/// A function of the engine or of a script.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Function {
    name: String,
    /// The number of its parameters.
    parameters: usize,
}

/// A mistake in the text of a script.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ScriptMistake {
    /// The byte of the text where the mistake is.
    pub(crate) offset: usize,
    pub(crate) mistake: Mistake,
}

/// The kinds of mistakes in a script.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Mistake {
    /// The text is not a script.
    Text(String),
    /// The script uses a name that it does not know.
    Name(String),
    /// The script calls a function that does not exist.
    Function(String),
    /// The script calls a function with another number of values than its parameters.
    Arguments(String),
    /// The result is not of the declared type.
    Result(String),
}

impl ScriptReader {
    pub(crate) fn new() -> Self {
        let engine = engine::limited();
        let function = |info: rhai::FuncInfo<'_>| {
            Some(Function { name: info.metadata.name.to_string(), parameters: info.metadata.num_params })
        };
        let functions = engine.collect_fn_metadata(None, function, true).into_iter().collect();
        Self { engine, functions }
    }

    /// Returns the names of the functions of the engine that a script can write.
    pub(crate) fn functions(&self) -> impl Iterator<Item = &str> {
        let names = self.functions.iter().map(|function| function.name.as_str());
        names.filter(|name| name.chars().all(|c| c.is_alphanumeric() || c == '_'))
    }

    /// Reads a script that knows these names. Returns its first mistake. The result is compared as far as its value is
    /// known without a run.
    pub(crate) fn mistake<'n>(
        &self,
        text: &str,
        names: impl Iterator<Item = &'n str>,
        result: Option<&ScriptResult>,
    ) -> Option<ScriptMistake> {
        let mut scope = Scope::new();
        for name in names {
            scope.push_constant_dynamic(name, Dynamic::UNIT);
        }
        let compiled = catch_unwind(AssertUnwindSafe(|| self.engine.compile_with_scope(&scope, text)));
        let (mistake, position) = match compiled {
            Err(_) => (Mistake::Text("the engine of scripts cannot read this".to_owned()), Position::NONE),
            Ok(Err(error)) => (unreadable(*error.0), error.1),
            Ok(Ok(script)) => {
                self.wrong_call(&script).or_else(|| wrong_result(script.statements().last()?, result?))?
            }
        };
        Some(ScriptMistake { offset: offset(text, position), mistake })
    }

    /// Returns the first call of a function that does not exist.
    fn wrong_call(&self, script: &AST) -> Option<(Mistake, Position)> {
        let own = script.iter_functions();
        let own = own.map(|function| Function { name: function.name.to_owned(), parameters: function.params.len() });
        let own: BTreeSet<Function> = own.collect();
        let mut found = None;
        script.walk(&mut |path| {
            found = path.last().and_then(Call::new).and_then(|call| {
                let mistake = self.compared(&call, &own)?;
                Some((mistake, call.position))
            });
            found.is_none()
        });
        found
    }

    fn compared(&self, call: &Call<'_>, own: &BTreeSet<Function>) -> Option<Mistake> {
        let (name, values) = (call.function.name.to_string(), call.function.args.len());
        let of_engine = Function { name: name.clone(), parameters: values + usize::from(call.is_method) };
        let of_script = Function { name: name.clone(), parameters: values };
        if BUILT_IN.contains(&name.as_str()) || self.functions.contains(&of_engine) || own.contains(&of_script) {
            return None;
        }
        let is_known = self.functions.iter().chain(own).any(|function| function.name == name);
        Some(if is_known { Mistake::Arguments(name) } else { Mistake::Function(name) })
    }
}

/// A call in the text of a script.
struct Call<'s> {
    function: &'s FnCallExpr,
    position: Position,
    /// Whether the first value stands before the name, as in `list.len()`.
    is_method: bool,
}

impl<'s> Call<'s> {
    fn new(node: &ASTNode<'s>) -> Option<Self> {
        let (function, position, is_method) = if let ASTNode::Expr(Expr::FnCall(function, position))
        | ASTNode::Stmt(Stmt::FnCall(function, position)) = node
        {
            (function, *position, false)
        } else if let ASTNode::Expr(Expr::MethodCall(function, position)) = node {
            (function, *position, true)
        } else {
            return None;
        };
        // Operators need no function.
        (!function.is_operator_call()).then_some(Self { function, position, is_method })
    }
}

/// Returns why the result of the last statement is not of the declared type.
fn wrong_result(last: &Stmt, result: &ScriptResult) -> Option<(Mistake, Position)> {
    if let Stmt::Block(block) = last {
        return wrong_result(block.statements().last()?, result);
    }
    if let Stmt::If(parts, _) = last {
        let mut branches = [&parts.body, &parts.branch].into_iter().filter_map(|block| block.statements().last());
        return branches.find_map(|last| wrong_result(last, result));
    }
    let value = if let Stmt::Expr(value) = last {
        value
    } else if let Stmt::Return(Some(value), flags, _) = last
        && !flags.intersects(ASTFlags::BREAK)
    {
        // With this flag, the statement is a `throw`.
        value
    } else {
        return None;
    };
    let error = written(&known(value), result).err()?;
    Some((Mistake::Result(error.why.to_string()), value.start_position()))
}

/// Returns the value of an expression. Parts whose values only a run finds are [`Unknown`].
fn known(value: &Expr) -> Dynamic {
    if let Expr::Array(values, _) = value {
        Dynamic::from_array(values.iter().map(known).collect::<Array>())
    } else if let Expr::Map(fields, _) = value {
        let field = |(name, value): &(rhai::Ident, Expr)| (name.as_str().into(), known(value));
        Dynamic::from_map(fields.0.iter().map(field).collect::<Map>())
    } else if let Expr::InterpolatedString(..) = value {
        Dynamic::from(String::new())
    } else {
        value.get_literal_value(None).unwrap_or_else(|| Dynamic::from(Unknown))
    }
}

fn unreadable(error: ParseErrorType) -> Mistake {
    if let ParseErrorType::VariableUndefined(name) = error {
        Mistake::Name(name)
    } else {
        Mistake::Text(clause(&error.to_string()))
    }
}

/// Returns the byte of a position.
fn offset(text: &str, position: Position) -> usize {
    let line = position.line().unwrap_or(1).saturating_sub(1);
    let starts = std::iter::once(0).chain(text.match_indices('\n').map(|(newline, _)| newline + 1));
    let Some(start) = starts.into_iter().nth(line) else { return text.len() };
    let column = position.position().unwrap_or(1).saturating_sub(1);
    text[start..].char_indices().nth(column).map_or(text.len(), |(place, _)| start + place)
}
