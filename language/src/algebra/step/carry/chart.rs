//! An activity whose states have changed while it runs.

use super::{Carrying, Misfit};
use crate::algebra::event::Command;
use crate::automaton;

/// Finds the place of an activity in its changed states: its active states, and their runs.
pub(super) fn place(carrying: &mut Carrying<'_>, o: usize, n: usize, calm: bool) -> Result<(), Misfit> {
    let charts = carrying.program.chart.as_deref().zip(carrying.next.chart.as_deref());
    let Some(((old, new), configuration)) = charts.zip(carrying.state.chart.as_deref()).filter(|_| calm) else {
        return Err(carrying.misfit(o, "the activity is being stopped"));
    };
    let moved = automaton::carry(&old.automaton, configuration, &new.automaton);
    let moved = moved.map_err(|why| carrying.misfit(o, why))?;
    carrying.put(o, n);
    for (state, there) in moved.states.iter().enumerate() {
        let places = old.node_of(state).zip(there.and_then(|there| new.node_of(there)));
        if let Some((from, to)) = places {
            carrying.place(from, to, calm)?;
        }
    }
    for &(from, to) in &moved.timers {
        carrying.draft.timers.extend(old.timer_of(from).zip(new.timer_of(to)));
    }
    for timer in moved.cancelled.iter().filter_map(|&transition| old.timer_of(transition)) {
        let activation = carrying.state.timers[timer as usize];
        carrying.draft.ended.push(Command::Cancel { timer, activation });
    }
    let armed = moved.armed.iter().filter_map(|&transition| new.timer_of(transition).zip(new.time_of(transition)));
    carrying.draft.armed.extend(armed);
    carrying.draft.chart = Some(Box::new(moved.place));
    Ok(())
}
