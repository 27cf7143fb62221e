//! Applies every fix of a spec that allows only one reading, round by round: `dca fix`.

use crate::source::Source;
use crate::{Options, apply_fixes, compile};

/// The largest number of rounds. One fix may reveal another mistake, but this must end.
const ROUNDS_MAX: usize = 16;

/// Returns the spec's text with every fix applied. Fixes that only appear after other fixes are included.
///
/// ```
/// use language::{Options, Source, fix};
///
/// // The `;` first; then the name can be seen to be wrong. A name that only looks like `lamp` is left to its author.
/// let spec = Source::new("a.dca", "process main() {
///     instantiated_processes { camera instof Camera(c1) lamp instof Lamp(c1); }
///     internal_event_actions { CAMERA, lomp }
/// }");
/// assert!(fix(&spec, &[], &Options::named("a")).contains("camera instof Camera(c1);"));
/// assert!(fix(&spec, &[], &Options::named("a")).contains("{ camera, lomp }"));
/// ```
pub fn fix(spec: &Source, interfaces: &[Source], options: &Options) -> String {
    let mut fixed = spec.clone();
    for _ in 0..ROUNDS_MAX {
        let text = apply_fixes(&fixed.text, &compile(&fixed, interfaces, options).diagnostics);
        if text == fixed.text {
            break;
        }
        fixed.text = text;
    }
    fixed.text
}
