//! The engine of scripts, with every limit.
//!
//! The defaults of the engine differ between builds, and most of them have no limit. So each limit is set here. A
//! test compares each with its error.

use rhai::packages::{
    ArithmeticPackage, BasicArrayPackage, BasicFnPackage, BasicIteratorPackage, BasicMapPackage, BasicMathPackage,
    BasicStringPackage, LogicPackage, MoreStringPackage, Package,
};
use rhai::{Array, Dynamic, Engine, EvalAltResult, Map};
use std::cell::Cell;
use std::cmp::Ordering;

/// The longest script, in bytes.
pub(crate) const SCRIPT_TEXT_MAX: usize = 8 * 1024;
/// The most scripts that run in one reaction of an activity.
pub(crate) const SCRIPTS_MAX: u8 = 4;
/// The most values that a script reads.
pub(crate) const SCRIPT_INPUTS_MAX: usize = 32;
/// The most operations of one run.
pub(super) const OPERATIONS_MAX: u64 = 2_000;
/// The most calls inside each other.
pub(super) const CALLS_MAX: usize = 8;
/// The deepest nesting of expressions and blocks, outside and inside of functions.
pub(super) const NESTING_MAX: usize = 32;
/// The most variables at one time, with the inputs.
pub(super) const VARIABLES_MAX: usize = 64;
/// The most functions of a script.
pub(super) const FUNCTIONS_MAX: usize = 16;
/// The longest text, in bytes.
pub(super) const TEXT_MAX: usize = 1024;
/// The most elements of a list, with the elements inside of them, and the most fields of a record, in the same way.
pub(super) const ELEMENTS_MAX: usize = 128;

/// Words of the engine that a script cannot use. `eval` would hide what a script does, `curry` makes values whose size the
/// engine does not count, `Fn` calls functions by a computed name, and `print` would write an unlimited number of lines.
const DISABLED: [&str; 5] = ["eval", "curry", "Fn", "print", "debug"];

/// Makes the engine of one run, which counts the operations of this run. It takes about 0.3 ms.
pub(super) fn limited() -> Engine {
    let mut engine = Engine::new_raw();
    // The other packages have a clock, `sleep`, and functions that write.
    ArithmeticPackage::new().register_into_engine(&mut engine);
    LogicPackage::new().register_into_engine(&mut engine);
    BasicMathPackage::new().register_into_engine(&mut engine);
    BasicArrayPackage::new().register_into_engine(&mut engine);
    BasicMapPackage::new().register_into_engine(&mut engine);
    BasicStringPackage::new().register_into_engine(&mut engine);
    MoreStringPackage::new().register_into_engine(&mut engine);
    BasicIteratorPackage::new().register_into_engine(&mut engine);
    BasicFnPackage::new().register_into_engine(&mut engine);
    engine
        .on_progress(counter())
        .set_max_call_levels(CALLS_MAX)
        .set_max_expr_depths(NESTING_MAX, NESTING_MAX)
        .set_max_variables(VARIABLES_MAX)
        .set_max_functions(FUNCTIONS_MAX)
        .set_max_string_size(TEXT_MAX)
        .set_max_array_size(ELEMENTS_MAX)
        .set_max_map_size(ELEMENTS_MAX)
        .set_max_strings_interned(0)
        .set_strict_variables(true)
        .set_fail_on_invalid_map_property(true);
    replace_slow_functions(&mut engine);
    for symbol in DISABLED {
        engine.disable_symbol(symbol);
    }
    engine
}

/// Returns a function that counts an operation, and ends the script after the last one. The engine's own counter does not
/// count the operations of a function that `map`, `sort` or the like calls, so three of these inside each other could run
/// for hours.
fn counter() -> impl Fn(u64) -> Option<Dynamic> {
    let operations = Cell::new(0);
    move |_| {
        operations.set(operations.get() + 1);
        (operations.get() > OPERATIONS_MAX).then_some(Dynamic::UNIT)
    }
}

/// Replaces functions that look at every value of a list or a record within one operation. The engine's own
/// functions look up and call another function for each value, so they would be the slowest operations of all.
fn replace_slow_functions(engine: &mut Engine) {
    type Refused = Result<String, Box<EvalAltResult>>;
    let print = || -> Refused { Err("a script cannot print whole lists and records".into()) };
    for name in ["to_string", "to_debug"] {
        engine.register_fn(name, move |_: &mut Array| print());
        engine.register_fn(name, move |_: &mut Map| print());
    }
    engine.register_fn("to_json", move |_: &mut Map| print());
    engine.register_fn("==", |one: &mut Array, other: Array| are_equal(one, &other));
    engine.register_fn("!=", |one: &mut Array, other: Array| !are_equal(one, &other));
    engine.register_fn("==", |one: &mut Map, other: Map| are_same(one, &other));
    engine.register_fn("!=", |one: &mut Map, other: Map| !are_same(one, &other));
    engine.register_fn("dedup", |list: &mut Array| list.dedup_by(|one, other| is_equal(one, other)));
    engine.register_fn("contains", |list: &mut Array, value: Dynamic| list.iter().any(|other| is_equal(other, &value)));
    engine.register_fn("index_of", |list: &mut Array, value: Dynamic| {
        let place = list.iter().position(|other| is_equal(other, &value));
        place.and_then(|place| i64::try_from(place).ok()).unwrap_or(-1)
    });
}

fn are_equal(one: &Array, other: &Array) -> bool {
    one.len() == other.len() && one.iter().zip(other).all(|(one, other)| is_equal(one, other))
}

fn are_same(one: &Map, other: &Map) -> bool {
    let is_field = |((name, one), (other_name, other))| name == other_name && is_equal(one, other);
    one.len() == other.len() && one.iter().zip(other).all(is_field)
}

/// Returns whether two values are equal. A whole number is equal to the same number with a fraction.
fn is_equal(one: &Dynamic, other: &Dynamic) -> bool {
    let number = |value: &Dynamic| value.as_float().or_else(|_| value.as_int().map(as_float)).ok();
    if let (Some(one), Some(other)) = (number(one), number(other)) {
        return one.partial_cmp(&other).is_some_and(Ordering::is_eq);
    }
    if let (Ok(one), Ok(other)) = (one.as_array_ref(), other.as_array_ref()) {
        return are_equal(&one, &other);
    }
    if let (Ok(one), Ok(other)) = (one.as_map_ref(), other.as_map_ref()) {
        return are_same(&one, &other);
    }
    if let (Ok(one), Ok(other)) = (one.as_immutable_string_ref(), other.as_immutable_string_ref()) {
        return *one == *other;
    }
    if let (Ok(one), Ok(other)) = (one.as_bool(), other.as_bool()) {
        return one == other;
    }
    one.as_char().is_ok_and(|one| other.as_char() == Ok(one)) || one.is_unit() && other.is_unit()
}

/// Returns a whole number as a number of programs.
#[expect(clippy::cast_precision_loss, reason = "programs have numbers of 64 bits with a fraction")]
pub(super) fn as_float(whole: i64) -> f64 {
    whole as f64
}

/// Returns the limit that a script has reached; none for another error.
pub(super) fn limit_of(error: &EvalAltResult) -> Option<String> {
    let text = if let EvalAltResult::ErrorTerminated(..) = error {
        format!("more than {OPERATIONS_MAX} operations")
    } else if let EvalAltResult::ErrorStackOverflow(_) = error {
        format!("more than {CALLS_MAX} calls inside each other")
    } else if let EvalAltResult::ErrorTooManyVariables(_) = error {
        format!("more than {VARIABLES_MAX} variables")
    } else if let EvalAltResult::ErrorDataTooLarge(..) = error {
        format!("a text of more than {TEXT_MAX} bytes, or a list or record of more than {ELEMENTS_MAX} values")
    } else {
        return None;
    };
    Some(text)
}
