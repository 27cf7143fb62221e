//! The program of an instance: its start, its messages, and the state of the instance after its end.

use super::{
    CONNECT_WITHIN, Current, DeathTold, GRACE, Instance, InstanceContext, KILL_WITHIN, Note, Program, SHIM_KILL_WITHIN,
    Stage, watchdog,
};
use crate::logic::effect::Effect;
use crate::logic::protocol::{Change, Ending, FailureCause, LeafFacts};
use comms::logic::codec::WIRE_VERSION;
use comms::logic::control::{self, Notice, Order};
use shim::protocol::{ShimOrder, ShimReport};

impl Instance {
    /// Takes a notice of the controller.
    pub fn hear(&mut self, notice: Notice, context: &mut InstanceContext<'_>) {
        match notice {
            Notice::Hello { version, location, owns, needs, signals, .. } => {
                if !matches!(self.stage, Stage::Starting { .. }) {
                    return;
                }
                if version != WIRE_VERSION {
                    let why = format!(
                        "it speaks version {version} of the control protocol, this node version {WIRE_VERSION}; build it again \
                         with the library of its node's DCA"
                    );
                    return self.turn_away(&why, context);
                }
                let leaf = self.start.order.process.leaf;
                self.prepared(LeafFacts { leaf, location, owns, needs, signals }, context);
            }
            Notice::Connected if matches!(self.stage, Stage::Connecting { .. }) => {
                self.stage = Stage::Idle;
                let again = std::mem::replace(&mut self.joined, true);
                context.notes.push(if again { Note::Rejoined } else { Note::Connected });
            }
            Notice::ConnectFailed { reason } if matches!(self.stage, Stage::Connecting { .. }) => {
                self.turn_away(&reason, context);
            }
            Notice::Connected if self.is_linked() => context.notes.push(Note::Linked(Ok(()))),
            Notice::ConnectFailed { reason } if self.is_linked() => context.notes.push(Note::Linked(Err(reason))),
            Notice::Switched { generation } => context.notes.push(Note::Switched(generation)),
            Notice::Message(message) => context.notes.push(Note::Message(message)),
            Notice::Sent { number } => context.notes.push(Note::Sent(number)),
            Notice::Expecting { ticket } => context.notes.push(Note::Expecting(ticket)),
            Notice::Taken { ticket, lost, late, missing } => {
                context.notes.push(Note::Taken { ticket, lost, late, missing });
            }
            Notice::Done { .. }
                if self.is_new_service() && self.is_turned_away(FailureCause::ServiceEnded, context) => {}
            Notice::Done { activation, value } => {
                let ending = match control::too_large(value.len()) {
                    None => Ending::Done(value),
                    Some(why) => Ending::Aborted(self.failure(FailureCause::Reported(why), context)),
                };
                self.ended(activation, ending, context);
            }
            Notice::Aborted { ref reason, .. }
                if self.is_turned_away(FailureCause::Reported(reason.clone()), context) => {}
            Notice::Aborted { activation, reason } => {
                let failure = self.failure(FailureCause::Reported(reason), context);
                self.ended(activation, Ending::Aborted(failure), context);
            }
            Notice::Stopping { activation } => {
                let until = context.now + self.start.stop_within;
                let current = self.current.as_mut().filter(|current| current.number == activation);
                current.into_iter().for_each(|current| current.stops_by = Some(until));
            }
            Notice::Stopped { activation } => self.ended(activation, Ending::Stopped, context),
            Notice::StopUnconfirmed { activation, reason } => self.ended_unconfirmed(activation, reason, context),
            Notice::Running { activation } => {
                if self.current.as_ref().is_some_and(|current| current.number == activation) {
                    self.is_up(context);
                }
            }
            Notice::Connected | Notice::ConnectFailed { .. } | Notice::Resume { .. } => {}
            // None of these notices reaches the agent.
            Notice::Database { .. } | Notice::Losses { .. } | Notice::Refused { .. } | Notice::Judge { .. } => {}
        }
    }

    /// Makes the program's links.
    pub fn connect(&mut self, orders: impl IntoIterator<Item = Order>, context: &mut InstanceContext<'_>) {
        if self.stage != Stage::Prepared {
            return;
        }
        self.stage = Stage::Connecting { until: context.now + CONNECT_WITHIN };
        if self.joined {
            self.tell(Order::Rejoin, context);
        }
        for order in orders {
            self.tell(order, context);
        }
    }

    /// Adds and removes links of a program that has its own already. Returns whether it will answer by [`Note::Linked`].
    pub fn link_again(&mut self, orders: impl IntoIterator<Item = Order>, context: &mut InstanceContext<'_>) -> bool {
        let answers = self.is_linked();
        if answers {
            orders.into_iter().for_each(|order| self.tell(order, context));
        }
        answers
    }

    /// Confirms the links of a plain program, which has none.
    pub fn connect_plain(&mut self) {
        if self.stage == Stage::Prepared && !self.is_controller() {
            (self.stage, self.joined) = (Stage::Idle, true);
        }
    }

    /// Gives the program an order that it answers. Returns whether it will answer.
    pub fn ask(&self, order: Order, effects: &mut Vec<Effect>) -> bool {
        let answers = self.is_linked();
        effects.extend(answers.then(|| self.control(order)));
        answers
    }

    /// Passes on the new place of another program that was started again. A program that is making its links knows the old place.
    pub fn relink(&self, order: Order, effects: &mut Vec<Effect>) {
        let takes_it = self.is_linked() || matches!(self.stage, Stage::Connecting { .. });
        effects.extend(takes_it.then(|| self.control(order)));
    }

    /// Takes a message from the shim. `output` is the end of the program's output.
    pub fn observe(&mut self, report: ShimReport, output: Vec<String>, context: &mut InstanceContext<'_>) {
        match report {
            ShimReport::Ready => {
                if matches!(self.stage, Stage::Starting { .. }) && !self.is_controller() {
                    self.prepared(LeafFacts::plain(self.start.order.process.leaf), context);
                }
            }
            ShimReport::Started { pid } => {
                self.program.pid = Some(pid);
                context.notes.push(Note::Changed(Change::Started { pid }));
            }
            ShimReport::Exited { .. } | ShimReport::Signalled { .. } | ShimReport::Ended { .. } => {
                if let Some(cause) = FailureCause::of_end(&report) {
                    self.program.cause.get_or_insert(cause);
                }
                self.program.output = output;
                self.clear(context);
            }
            ShimReport::ExecFailed { reason } => {
                self.program.cause.get_or_insert(FailureCause::Exec(reason));
            }
            ShimReport::Gone => self.gone(context),
        }
    }

    /// Lets time pass.
    pub fn tick(&mut self, context: &mut InstanceContext<'_>) {
        if self.deadline().is_none_or(|at| at > context.now) {
            return;
        }
        self.tick_probation(context);
        self.tick_clearing(context);
        if self.deadline().is_none_or(|at| at > context.now) || self.kill_shim(context) {
            return;
        }
        match self.stage {
            Stage::Starting { .. } => {
                self.give_up(
                    FailureCause::StartTimeout(watchdog::start_within(self.start.order.kind, &self.start.order.policy)),
                    context,
                );
            }
            Stage::Connecting { .. } => {
                let why = format!("it did not make its links within {} s", CONNECT_WITHIN.as_secs());
                self.give_up(FailureCause::Exec(why), context);
            }
            Stage::Waiting { .. } => self.start(context),
            Stage::Stopping { forced: false, .. } => self.force_stop(context),
            Stage::Running if self.stops_by().is_some_and(|at| at <= context.now) => self.force_stop(context),
            Stage::Removing { .. } if !self.joined => {
                self.gone(context);
                self.program.cause = Some(FailureCause::StopUnconfirmed);
            }
            Stage::Stopping { forced: true, .. } | Stage::Removing { .. } => {
                self.give_up_end(context);
            }
            Stage::Replacing { forced, is_stopping, .. } => self.tick_replacing(forced, is_stopping, context),
            Stage::Leaving { forced: false, .. } => self.force_out(context),
            Stage::Leaving { forced: true, .. } => {
                self.program.cause = Some(FailureCause::StopUnconfirmed);
                self.gone(context);
            }
            Stage::Prepared | Stage::Idle | Stage::Running | Stage::Refused | Stage::Dead => {}
        }
    }

    /// Tells the shim to end a program, because its stop has not finished in time.
    fn force_stop(&mut self, context: &mut InstanceContext<'_>) {
        self.program.cause.get_or_insert(FailureCause::StopTimeout(self.start.stop_within));
        self.stage = Stage::Stopping { until: context.now + GRACE + KILL_WITHIN, forced: true };
        self.tell_shim(ShimOrder::Stop { grace: GRACE }, context);
    }

    /// It cannot be confirmed that nothing of the program is left.
    pub(super) fn give_up_end(&mut self, context: &mut InstanceContext<'_>) {
        (self.stage, self.program.cause) = (Stage::Dead, Some(FailureCause::StopUnconfirmed));
        if self.current.is_none() {
            context.notes.push(Note::Changed(Change::Died(FailureCause::StopUnconfirmed)));
        }
        self.finish(Ending::Unconfirmed, context);
    }

    pub(super) fn start(&mut self, context: &mut InstanceContext<'_>) {
        if self.obstacles.checks_in {
            self.stage = Stage::Waiting { until: Some(context.now) };
            return;
        }
        self.stage = Stage::Starting {
            until: context.now + watchdog::start_within(self.start.order.kind, &self.start.order.policy),
        };
        self.program.shim_was_killed = false;
        context.effects.push(Effect::Spawn(Box::new(self.start.order.clone())));
    }

    fn prepared(&mut self, facts: LeafFacts, context: &mut InstanceContext<'_>) {
        self.stage = Stage::Prepared;
        if !self.joined {
            context.notes.push(Note::Prepared(facts));
        } else if self.is_controller() {
            context.notes.push(Note::Moved(facts));
        } else {
            self.stage = Stage::Idle;
            self.resume(None, context);
        }
    }

    pub(super) fn run(&mut self, value: Vec<u8>, context: &mut InstanceContext<'_>) {
        let Some(Current { number: activation, decided: since, ref mut stops_by, .. }) = self.current else { return };
        (self.stage, *stops_by) = (Stage::Running, None);
        if self.is_controller() {
            self.suspend_probation();
            self.tell(Order::Activate { activation, value, since }, context);
        } else {
            self.tell_shim(ShimOrder::Go, context);
        }
    }

    fn gone(&mut self, context: &mut InstanceContext<'_>) {
        let cause =
            self.program.cause.clone().unwrap_or_else(|| FailureCause::NotAvailable("its shim was killed".into()));
        let ends_well = cause == FailureCause::Exit(0) && !self.is_controller();
        let cause = if ends_well && self.is_new_service() { FailureCause::ServiceEnded } else { cause };
        let before = std::mem::replace(&mut self.stage, Stage::Dead);
        self.program.clearing = None;
        context.effects.push(Effect::CloseProcess { process: self.start.order.process.clone() });
        match before {
            Stage::Starting { .. } | Stage::Prepared | Stage::Connecting { .. } | Stage::Removing { .. }
                if !self.joined =>
            {
                let why = self.refusal(&cause);
                self.turn_away(&why, context);
            }
            Stage::Running if self.has_done(&cause) => {
                self.finish(Ending::Done(Vec::new()), context);
                self.hold_ready(context);
            }
            Stage::Stopping { .. } => {
                let ending = self.end_of_stop(&cause, context);
                self.finish(ending, context);
                if !self.is_controller() {
                    self.hold_ready(context);
                } else if self.probation.is_some() {
                    self.died(cause, context);
                } else if self.restarts.are_allowed() {
                    // The program is not needed now, and the mission may be about to end.
                    self.forget_program();
                    self.stage = Stage::Waiting { until: None };
                } else {
                    (self.program.cause, self.program.death) = (Some(cause), Some(DeathTold::Yes));
                }
            }
            Stage::Running
            | Stage::Idle
            | Stage::Starting { .. }
            | Stage::Prepared
            | Stage::Connecting { .. }
            | Stage::Waiting { .. }
            | Stage::Removing { .. } => self.died(cause, context),
            Stage::Replacing { is_stopping, .. } => self.replaced(is_stopping, context),
            Stage::Leaving { .. } => self.left(context),
            // It has ended after all.
            Stage::Dead if self.is_unconfirmed() => {
                self.program.cause = Some(FailureCause::NotAvailable("it was not ended in time".into()));
                context.notes.extend(self.unconfirmed.take().map(Note::EndedLate));
            }
            Stage::Refused | Stage::Dead => {}
        }
    }

    /// Returns why a program that has ended before its links were up cannot take part, with the last lines of its
    /// output. A program that has exited with a single line has given the reason there.
    fn refusal(&self, cause: &FailureCause) -> String {
        let mut said = if let FailureCause::Exec(why) = cause { why.clone() } else { cause.to_string() };
        let may_be_plain =
            self.is_controller() && matches!(cause, FailureCause::Exit(0) | FailureCause::StartTimeout(_));
        if may_be_plain {
            said += "; if it is a program that does not use DCA, its module needs `plain;`";
        }
        match &self.program.output[..] {
            [] => said,
            [words] if !may_be_plain && matches!(cause, FailureCause::Exit(_) | FailureCause::Signal(_)) => {
                words.clone()
            }
            lines => format!("{said}; the end of its output:\n{}", lines.join("\n")),
        }
    }

    /// Returns whether a plain program has done the work it was activated for.
    fn has_done(&self, cause: &FailureCause) -> bool {
        *cause == FailureCause::Exit(0) && !self.is_controller() && !self.restarts.are_permanent()
    }

    /// Starts a program that has ended unexpectedly again, or gives it up.
    fn died(&mut self, cause: FailureCause, context: &mut InstanceContext<'_>) {
        let output = std::mem::take(&mut self.program.output);
        if self.probation.is_some() && self.put_back(&cause.clone().of_program(0, output.clone()), context) {
            return;
        }
        if let Some(until) = self.restarts.next(context.now) {
            self.forget_program();
            self.stage = Stage::Waiting { until: Some(until) };
            let (cause, count) = (cause.of_program(0, output), self.restarts.count());
            context.notes.push(Note::Changed(Change::Restarting { cause, count }));
            return self.tick(context);
        }
        let cause = cause.of_program(self.restarts.count(), output);
        self.program.cause = Some(cause.clone());
        self.program.death = Some(if self.current.is_none() { DeathTold::No } else { DeathTold::Yes });
        if self.current.is_none() {
            return context.notes.push(Note::Changed(Change::Died(cause)));
        }
        let failure = self.failure(cause, context);
        self.finish(Ending::Aborted(failure), context);
        if !self.is_controller() {
            self.hold_ready(context);
        }
    }

    /// Forgets a program of which nothing is left, before another one is started.
    pub(super) fn forget_program(&mut self) {
        self.program = Program { clearing: self.program.clearing, ..Program::default() };
    }

    /// Holds a plain program ready for its next activation: it runs once for each.
    fn hold_ready(&mut self, context: &mut InstanceContext<'_>) {
        self.forget_program();
        self.stage = Stage::Idle;
        context.effects.push(Effect::Spawn(Box::new(self.start.order.clone())));
    }

    /// Takes the controller's word that an activation is over. A stop that has gone as far as a signal ends with the
    /// program, not with its last words.
    fn ended(&mut self, activation: u32, ending: Ending, context: &mut InstanceContext<'_>) {
        let takes_word = matches!(self.stage, Stage::Running | Stage::Stopping { forced: false, .. });
        let is_current = self.current.as_ref().is_some_and(|current| current.number == activation);
        if takes_word && is_current {
            self.stage = Stage::Idle;
            self.finish(ending, context);
            self.is_up(context);
        } else if matches!(self.stage, Stage::Replacing { .. }) && is_current && ending != Ending::Stopped {
            // The activation had ended before the program was told that another program replaces it.
            self.finish(ending, context);
        }
    }

    /// Returns the end of an activation whose program has ended, if work outside of the program may continue.
    fn may_go_on(&mut self, context: &InstanceContext<'_>) -> Option<Ending> {
        let what = self.current.as_mut()?.may_go_on.take()?;
        Some(Ending::Aborted(self.failure(FailureCause::MayGoOn(what), context)))
    }

    /// Returns the end of an activation whose program has ended during the stop. The loss of a host is a better reason than a stop that
    /// took too long.
    fn end_of_stop(&mut self, cause: &FailureCause, context: &InstanceContext<'_>) -> Ending {
        let is_late = matches!(cause, FailureCause::StopTimeout(_));
        let is_cut = self.current.as_ref().is_some_and(|current| current.lost.is_some());
        let late = || Ending::Aborted(self.failure(cause.clone().of_program(0, self.program.output.clone()), context));
        let late = (is_late && !is_cut).then(late);
        self.may_go_on(context).or(late).unwrap_or(Ending::Stopped)
    }

    /// The controller has stopped, and work outside of it may continue. A program that is being ended says so before its end.
    fn ended_unconfirmed(&mut self, activation: u32, reason: String, context: &mut InstanceContext<'_>) {
        let current = self.current.as_mut().filter(|current| current.number == activation);
        match (&self.stage, current) {
            (Stage::Leaving { .. } | Stage::Stopping { forced: true, .. }, Some(current)) => {
                current.may_go_on = Some(reason);
            }
            (_, Some(_)) => {
                let failure = self.failure(FailureCause::MayGoOn(reason), context);
                self.ended(activation, Ending::Aborted(failure), context);
            }
            (_, None) => {}
        }
    }

    /// Kills a program that has hung at its start. The refusal, sent once the program is gone, quotes its output.
    fn give_up(&mut self, cause: FailureCause, context: &mut InstanceContext<'_>) {
        self.program.cause.get_or_insert(cause);
        self.stage = Stage::Removing { until: context.now + GRACE + KILL_WITHIN };
        self.tell_shim(ShimOrder::Stop { grace: GRACE }, context);
    }

    /// Rejects this program. At the first start, the deployment then does not begin. Later, the
    /// next program may be healthy.
    pub(in crate::logic) fn turn_away(&mut self, why: &str, context: &mut InstanceContext<'_>) {
        if self.joined {
            self.program.cause.get_or_insert(FailureCause::Exec(why.to_owned()));
            self.stage = Stage::Removing { until: context.now + GRACE + KILL_WITHIN };
            return self.tell_shim(ShimOrder::Stop { grace: GRACE }, context);
        }
        if self.stage != Stage::Dead {
            self.stage = Stage::Refused;
        }
        context.notes.push(Note::Refused(why.to_owned()));
    }

    pub(super) fn force_out(&mut self, context: &mut InstanceContext<'_>) {
        self.stage = Stage::Leaving { until: context.now + GRACE + KILL_WITHIN, forced: true };
        self.tell_shim(ShimOrder::Stop { grace: GRACE }, context);
    }

    pub(super) fn left(&mut self, context: &mut InstanceContext<'_>) {
        let ending = if self.is_unconfirmed() {
            Ending::Unconfirmed
        } else {
            let left = || FailureCause::NotAvailable("its host has ended its part".into());
            self.may_go_on(context).unwrap_or_else(|| Ending::Aborted(self.failure(left(), context)))
        };
        self.finish(ending, context);
        context.notes.push(Note::Gone);
    }

    /// The program has ended by itself, and its shim ends the processes it has left. They get the time of a stop.
    pub(super) fn clear(&mut self, context: &InstanceContext<'_>) {
        if matches!(self.stage, Stage::Prepared | Stage::Idle | Stage::Running) {
            self.program.clearing = Some(context.now + KILL_WITHIN);
        }
    }

    /// Gives up the processes that a program which has ended by itself has left.
    pub(super) fn tick_clearing(&mut self, context: &mut InstanceContext<'_>) {
        if self.program.clearing.is_none_or(|at| at > context.now) {
            return;
        }
        self.program.clearing = None;
        // A stop or an end since then has a limit of its own.
        if !matches!(self.stage, Stage::Prepared | Stage::Idle | Stage::Running) {
            return;
        }
        if !self.program.shim_was_killed {
            (self.program.clearing, self.program.shim_was_killed) = (Some(context.now + SHIM_KILL_WITHIN), true);
            return context.effects.push(Effect::KillShim { process: self.start.order.process.clone() });
        }
        // The program itself is gone.
        self.program.pid = None;
        self.give_up_end(context);
    }
}
