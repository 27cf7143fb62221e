//! The operands of `,`, `#` and `&`. Some operands may be added or removed while others run.

use super::alike::sets;
use super::{Carrying, Misfit};
use crate::algebra::event::Command;
use crate::algebra::phase::Phase;
use crate::algebra::program::Kind;
use crate::algebra::state::Cell;
use std::mem::discriminant;

impl Carrying<'_> {
    /// Places `,`, `#` or `&`, whose operands may have changed.
    pub(super) fn align(&mut self, o: usize, n: usize, calm: bool) -> Result<(), Misfit> {
        self.put(o, n);
        let (old, new) = (self.program, self.next);
        let mut free: Vec<usize> = new.operands(n).collect();
        let mut changed = Vec::new();
        for operand in old.operands(o) {
            match free.iter().position(|&other| self.is_same(operand, other)) {
                Some(place) => self.place(operand, free.remove(place), calm)?,
                None => changed.push(operand),
            }
        }
        for operand in changed {
            if !self.state.cells[operand].phase.is_active() {
                // It has ended, and does not begin again since its text is another now.
                if let Some(place) = free.iter().position(|&other| self.have_in_common(operand, other)) {
                    self.place(operand, free.remove(place), calm)?;
                }
                continue;
            }
            let mut misfit = self.misfit(operand, "the new event actions have no place for it there");
            let is_only = free.len() == 1;
            let place = free.iter().position(|&other| {
                let placed = self.place(operand, other, calm);
                placed.map_err(|why| misfit = if is_only { why } else { misfit.clone() }).is_ok()
            });
            match place {
                Some(place) => drop(free.remove(place)),
                None if calm && self.may_end(operand) => self.end(operand),
                None => return Err(misfit),
            }
        }
        if calm {
            self.draft.starts.extend(free.into_iter().map(|operand| (n, operand)));
        }
        self.draft.counted.insert(n);
        Ok(())
    }

    /// Places the running expression as one operand of a new `,`, `#` or `&`, whose other operands start.
    pub(super) fn wrap(&mut self, o: usize, n: usize) -> Result<(), Misfit> {
        let operators = [Kind::Concurrent { tasks: 0 }, Kind::FailFast { operands: 0 }, Kind::Disable]
            .map(|kind| discriminant(&kind));
        if !operators.contains(&discriminant(&self.next.nodes[n].kind)) {
            return Err(self.misfit(o, ""));
        }
        let next = self.next;
        let mut operands: Vec<usize> = next.operands(n).collect();
        let same = operands.iter().position(|&other| self.is_same(o, other));
        let place = same.filter(|&place| self.place(o, operands[place], true).is_ok());
        let place = place.or_else(|| operands.iter().position(|&other| self.place(o, other, true).is_ok()));
        let Some(place) = place else { return Err(self.misfit(o, "")) };
        operands.remove(place);
        self.draft.cells[n] = Cell { phase: Phase::Running, ..Cell::default() };
        self.draft.starts.extend(operands.into_iter().map(|operand| (n, operand)));
        self.draft.counted.insert(n);
        Ok(())
    }

    /// Places the one remaining operand of a `,`, `#` or `&` that is gone.
    pub(super) fn unwrap(&mut self, o: usize, n: usize) -> Result<(), Misfit> {
        let cell = &self.state.cells[o];
        let is_open =
            matches!(self.program.nodes[o].kind, Kind::Concurrent { .. } | Kind::FailFast { .. } | Kind::Disable)
                && cell.phase == Phase::Running
                && cell.outcome.is_none();
        let program = self.program;
        let active: Vec<usize> =
            program.operands(o).filter(|&operand| is_open && self.state.cells[operand].phase.is_active()).collect();
        for &stays in &active {
            let others = active.iter().copied().filter(|&other| other != stays);
            if others.clone().all(|other| self.may_end(other)) && self.place(stays, n, true).is_ok() {
                others.for_each(|other| self.end(other));
                return Ok(());
            }
        }
        Err(self.misfit(o, ""))
    }

    /// Whether some member is in both.
    fn have_in_common(&self, o: usize, n: usize) -> bool {
        let member = |kind: &Kind| if let Kind::Run { member, .. } = kind { Some(*member) } else { None };
        let (old, new) = (&self.program.nodes, &self.next.nodes);
        let others: Vec<u32> = new[n..new[n].end].iter().filter_map(|node| member(&node.kind)).collect();
        old[o..old[o].end].iter().filter_map(|node| member(&node.kind)).any(|member| others.contains(&member))
    }

    /// Whether nothing runs in an operand except members that are taken away.
    fn may_end(&self, o: usize) -> bool {
        let cells = (o..self.program.nodes[o].end).map(|node| self.state.cells[node].phase);
        let is_held_up = cells.clone().any(|phase| phase == Phase::Stopping);
        !is_held_up && self.members(o).iter().all(|member| self.gone.contains(member))
    }

    /// Completes an operand that no operator waits for.
    fn end(&mut self, o: usize) {
        for node in o..self.program.nodes[o].end {
            let phase = self.state.cells[node].phase;
            let kind = &self.program.nodes[node].kind;
            if let (Kind::Run { member, .. }, true) = (kind, phase.is_active()) {
                let activation = self.state.seats[*member as usize].activation;
                self.draft.ended.push(Command::Stop { member: *member, activation });
                let closed = sets(self.program, node).iter().map(|&set| Command::Disconnect { set });
                self.draft.ended.extend(closed);
            } else if let (Kind::Wait { timer, .. }, Phase::Running) = (kind, phase) {
                self.cancel(*timer);
            } else if let (Kind::Shield { bound: Some(bound) }, Phase::Second) = (kind, phase) {
                self.cancel(bound.timer);
            }
        }
    }

    fn cancel(&mut self, timer: u32) {
        let activation = self.state.timers[timer as usize];
        self.draft.ended.push(Command::Cancel { timer, activation });
    }
}
