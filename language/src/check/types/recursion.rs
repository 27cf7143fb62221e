//! Reports groups that contain themselves, groups nested too deeply, and plans that are too large.

use crate::check::diagnostics::Diagnostics;
use crate::check::spec::{Spec, Target};
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::{DEPTH_MAX, LEAVES_MAX};

/// Returns whether the plan is finite and within its limits. Reports each recursion once.
pub(crate) fn is_finite(spec: &Spec, root: Option<usize>, diagnostics: &mut Diagnostics) -> bool {
    let count = spec.processes.len();
    let mut walk = Walk { spec, states: vec![State::New; count], path: Vec::new(), found: Vec::new() };
    for process in 0..count {
        walk.visit(process);
    }
    let found = walk.found;
    let is_finite = found.is_empty();
    diagnostics.extend(found);
    if !is_finite {
        return false;
    }
    let sizes = sizes(spec, &walk.states);
    match root {
        Some(root) if sizes[root] > LEAVES_MAX as u64 => {
            let name = &spec.processes[root].name;
            let message = format!("the plan has {} processes; the limit is {LEAVES_MAX}", sizes[root]);
            diagnostics.push(Diagnostic::new(Code::E0701, name.span, message));
            false
        }
        Some(_) | None => true,
    }
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum State {
    New,
    /// The group is on the path from the start of the walk.
    Open,
    /// All groups below this group are known. The number of levels.
    Closed(usize),
}

struct Walk<'a> {
    spec: &'a Spec,
    states: Vec<State>,
    /// The groups on the path from the start of the walk, each with its next slot.
    path: Vec<(usize, usize)>,
    found: Vec<Diagnostic>,
}

impl Walk<'_> {
    /// Walks depth first. It uses no recursion, because the depth of the input is not known yet.
    fn visit(&mut self, start: usize) {
        if self.states[start] != State::New {
            return;
        }
        self.states[start] = State::Open;
        self.path.push((start, 0));
        while let Some(&(process, slot)) = self.path.last() {
            let instances = &self.spec.processes[process].instances;
            let Some(instance) = instances.get(slot) else {
                self.close(process);
                continue;
            };
            if let Some(last) = self.path.last_mut() {
                last.1 += 1;
            }
            let Target::Process(target) = instance.target else { continue };
            if self.states[target] == State::New {
                self.states[target] = State::Open;
                self.path.push((target, 0));
            } else if self.states[target] == State::Open {
                self.report_cycle(target);
            }
        }
    }

    fn close(&mut self, process: usize) {
        let below = self.spec.processes[process].instances.iter().filter_map(|instance| match instance.target {
            Target::Process(target) => match self.states[target] {
                State::Closed(levels) => Some(levels),
                State::New | State::Open => None,
            },
            Target::Module(_) | Target::Unknown => None,
        });
        let levels = below.max().unwrap_or(0) + 1;
        if levels == DEPTH_MAX {
            let name = &self.spec.processes[process].name;
            let message = format!("groups are nested deeper than {DEPTH_MAX} levels from `{}` on", name.text);
            self.found.push(Diagnostic::new(Code::E0004, name.span, message));
        }
        self.states[process] = State::Closed(levels);
        self.path.pop();
    }

    fn report_cycle(&mut self, target: usize) {
        let from = self.path.iter().position(|&(process, _)| process == target).unwrap_or(0);
        let cycle = &self.path[from..];
        let name = |process: usize| self.spec.processes[process].name.text.as_str();
        let mut path: Vec<&str> = cycle.iter().map(|&(process, _)| name(process)).collect();
        path.push(name(target));
        // The next slot is one past the instance on the path.
        let step = |&(process, next): &(usize, usize)| &self.spec.processes[process].instances[next - 1];
        let Some((last, others)) = cycle.split_last() else { return };
        let instance = step(last);
        let message = format!("`{}` contains itself: {}", name(target), path.join(" -> "));
        let mut diagnostic = Diagnostic::new(Code::E0102, instance.name.span, message).label("closes the circle");
        for other in others {
            diagnostic = diagnostic.reason(step(other).name.span, "goes on here");
        }
        let help = format!("to repeat a process, run `{0} ;; {0}` in the group around it", "p");
        self.found.push(diagnostic.help(format!("instantiate another type here; {help}")));
    }
}

/// Returns the number of leaves and groups in one instance of each process.
fn sizes(spec: &Spec, states: &[State]) -> Vec<u64> {
    let levels = |process: &usize| match states[*process] {
        State::Closed(levels) => levels,
        State::New | State::Open => 0,
    };
    let mut order: Vec<usize> = (0..spec.processes.len()).collect();
    order.sort_by_key(levels);
    let mut sizes = vec![0_u64; spec.processes.len()];
    for process in order {
        let instances = spec.processes[process].instances.iter();
        sizes[process] = instances.fold(1, |size, instance| {
            size.saturating_add(match instance.target {
                Target::Process(target) => sizes[target],
                Target::Module(_) | Target::Unknown => 1,
            })
        });
    }
    sizes
}
