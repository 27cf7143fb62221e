//! The calls and orders that a node in a team judges before its agent has them.

use super::Driver;
use crate::io::caller::Caller;
use crate::io::event::{Connection, Event};
use crate::io::guard::Guard;
use crate::io::policy::ExecutionPolicy;
use crate::logic::agent::Input;
use crate::logic::gate::{Attempt, Outcome, Passed};
use crate::logic::protocol::{Answer, CallRequest, Deployment, Request, Signed, ToParticipant};
use comms::io::control::ControlSender;
use comms::logic::control::{Order, UserCall};
use comms::logic::object::Warrant;

/// How many accepted orders without an answer are remembered; if there are more, the latest ones.
const ACCEPTED_MAX: usize = 256;

impl Driver {
    /// Takes a call. A call that needs no signature is taken at once; in a team, any other call once its acceptance is on the disk.
    pub(super) fn called(&mut self, call: u64, request: Request, caller: Caller) -> Option<Input> {
        let Some(guard) = self.gate.guard.clone() else {
            if matches!(request, Request::Signed(_)) {
                refuse(&caller, "this node is in no team, so it accepts no signed requests".to_owned());
                caller.end();
                return None;
            }
            return self.admit(call, request, caller);
        };
        match guard.call(request, |name| self.state.agent.epoch(name)) {
            Ok(Passed::Open(request)) => {
                if let Request::Estop(estop) = &request {
                    let who = format!("{} (not signed)", estop.bounded().by);
                    guard.note(&Attempt { who, what: estop.bounded().to_string() });
                }
                self.admit(call, request, caller)
            }
            Ok(Passed::Signed(attempt, signed)) => {
                let events = self.queues.events.clone();
                self.queues.tasks.spawn(async move {
                    let (keeper, wanted) = (guard.clone(), attempt.clone());
                    let written = keep(move || keeper.keep(&wanted)).await;
                    let event = match written {
                        Ok(()) => {
                            let caller = caller.witnessed(move |outcome| guard.ended(&attempt, outcome.as_ref()));
                            Event::Admitted(call, Request::Signed(signed), caller)
                        }
                        Err(why) => {
                            refuse(&caller, why);
                            return caller.end();
                        }
                    };
                    events.send(event).await.unwrap_or_default();
                });
                None
            }
            Err(why) => {
                refuse(&caller, why);
                caller.end();
                None
            }
        }
    }

    /// Judges a user's call of a program, and informs the program when the verdict is on the disk.
    pub(super) fn judge_call(&mut self, program: Connection, sender: ControlSender, number: u64, call: UserCall) {
        let Connection { deployment, instance, .. } = program;
        let UserCall { name: procedure, access, digest, warrant: Warrant { head, body } } = call;
        // A number after the path distinguishes it from another program of the same process.
        let path = instance.split('#').next().unwrap_or_default().to_owned();
        let (asked, signed) =
            (CallRequest { deployment, path, procedure, access, digest }, Signed { head: head.0, body: body.0 });
        let guard = self.gate.guard.clone();
        self.queues.tasks.spawn(async move {
            let judged = keep(move || {
                let guard = guard.ok_or("this node is in no team")?;
                guard.procedure(asked, &signed).and_then(|attempt| guard.keep(&attempt))
            });
            let refusal = judged.await.err();
            if let Err(error) = sender.send(&Order::Judged { number, refusal }) {
                tracing::debug!(%error, "cannot tell a program whether a call is allowed");
            }
        });
    }

    /// Hands a call to its receiver.
    pub(super) fn admit(&mut self, call: u64, request: Request, caller: Caller) -> Option<Input> {
        // The agent passes the signatures of its orders on to others; the database passes nothing on.
        let is_for_database = |asked: &Request| matches!(asked, Request::Database(_) | Request::Here { .. });
        let asked = if let Request::Signed(signed) = &request { signed.request().ok() } else { None };
        let request = asked.filter(is_for_database).unwrap_or(request);
        let (request, caller) = self.database.handle().take(call, request, caller)?;
        self.peers.expect(call, caller);
        Some(Input::Call { call, request: Box::new(request) })
    }

    /// Judges the orders of another node, and gives the verdict once it is on the disk.
    pub(super) fn judge(&mut self, number: u64, deployment: &Deployment, from: &str, order: &ToParticipant) {
        let none = || Err("this node is in no team".to_owned());
        let judged = self.gate.guard.as_ref().map_or_else(none, |guard| guard.order(deployment, from, order));
        match (judged, self.gate.guard.clone()) {
            (Ok(attempt), Some(guard)) => {
                let events = self.queues.events.clone();
                self.gate.accepted.insert(number, attempt.clone());
                while self.gate.accepted.len() > ACCEPTED_MAX
                    && let Some((_, oldest)) = self.gate.accepted.pop_first()
                {
                    guard.ended(&oldest, None);
                }
                self.queues.tasks.spawn(async move {
                    let verdict = keep(move || guard.keep(&attempt)).await;
                    events.send(Event::Judged(number, verdict)).await.unwrap_or_default();
                });
            }
            (verdict, _) => self.queues.pending.push_back(Input::Judged { number, verdict: verdict.map(drop) }),
        }
    }

    /// Judges whether a deployment of this home may begin again after a reboot.
    pub(super) fn judge_resumed(&mut self, deployment: Deployment, signed: Option<&Signed>) {
        let none = || Err("this node is in no team".to_owned());
        let verdict = self.gate.guard.as_ref().map_or_else(none, |guard| guard.resumed(&deployment, signed));
        self.queues.pending.push_back(Input::Resumable { deployment, verdict });
    }

    /// Writes the outcome of an accepted order to the audit log.
    pub(super) fn order_ended(&mut self, number: u64, outcome: &Outcome) {
        if let Some((attempt, guard)) = self.gate.accepted.remove(&number).zip(self.gate.guard.as_ref()) {
            guard.ended(&attempt, Some(outcome));
        }
    }

    /// Writes to the audit log that the node leaves before some accepted orders are answered.
    pub(super) fn leave_orders(&mut self) {
        let guard = self.gate.guard.iter();
        guard.for_each(|guard| self.gate.accepted.values().for_each(|attempt| guard.ended(attempt, None)));
        self.gate.accepted.clear();
    }
}

async fn keep(write: impl FnOnce() -> Result<(), String> + Send + 'static) -> Result<(), String> {
    tokio::task::spawn_blocking(write).await.map_err(|error| error.to_string()).flatten()
}

fn refuse(caller: &Caller, why: String) {
    // A caller that is gone needs no answer.
    caller.offer(Answer::Refused(why));
}

/// Returns the gate of a node, if it is in a team, and the execution policy of its host.
pub(super) fn open(config: &super::Config) -> anyhow::Result<(Option<Guard>, ExecutionPolicy)> {
    let guard = config.network.member.as_ref().map(Guard::open).transpose()?;
    Ok((guard, ExecutionPolicy::open(config.state.clone(), config.network.member.clone())?))
}
