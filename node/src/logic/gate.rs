//! The gate of a node in a team. It checks requests that start, stop or change something. Such a request passes only if
//! it is signed by a user with the permission for it.
//!
//! ```text
//! dca ──Signed(Deploy)──▶ gate of the home ──▶ Coordinator ──Ordered(Prepare)──▶ gate of each host ──▶ Participant
//! ```
//! The home passes on the request that the user has signed, and each host compares the home's orders with the request.
//! So a home or a relay that lies cannot start anything. Each node accepts a request only once. Its number is in the
//! [`Ledger`], which is on the disk before anything is done.
//!
//! Orders to end an activation, or to end everything, need no signature: they follow from the signed plan.

mod action;
mod ledger;
mod outcome;

use action::plan_of;
pub use action::{action, audience, subject};
pub use ledger::{ENTRIES_MAX, Found, LEDGER_MAX, Ledger, LedgerError};
pub use outcome::{Outcome, outcome, outcome_of_order};

use crate::logic::protocol::{
    CallRequest, ChangeOrder, ChangeRequest, Deployment, Order, Ordered, Request, Signed, ToParticipant,
};
use language::plan::{OnBoot, Plan, difference};
use ledger::{Place, Start};
use std::collections::BTreeSet;
use thiserror::Error;
use trust::identity::KeyId;
use trust::name::{Name, UnixTime};
use trust::request::{self, Context};
use trust::role::Action;
use trust::team::{Judge, TrustError};

/// The gate of a node.
#[derive(Debug)]
pub struct Gate {
    node: KeyId,
    name: Name,
    ledger: Ledger,
    /// The records of requests accepted since the last call of [`Gate::take_news`].
    news: Vec<u8>,
}

/// A user and an action, for the audit log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Attempt {
    /// The user, if known.
    pub who: String,
    /// The action.
    pub what: String,
}

/// A call that may pass.
#[derive(Clone, Debug, PartialEq)]
pub enum Passed {
    /// The call needs no signature.
    Open(Request),
    /// The call is signed by a user who may ask for it. The ledger has to be on the disk before the call is carried out.
    Signed(Attempt, Box<Signed>),
}

/// A refusal. Nothing is done, and nothing has changed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Refused {
    /// The refused user and action.
    pub attempt: Attempt,
    /// The reason.
    pub why: Refusal,
}

/// Why a request or an order was refused.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum Refusal {
    /// It has no signature, but this action needs one.
    #[error("it is not signed: in a team, to {0} needs the key of a user (`dca team key`)")]
    Unsigned(Action),
    /// The signed payload is not a request, or the request needs no signature.
    #[error("the signed payload is not a request that needs a signature")]
    Unreadable,
    /// The signature is for another action.
    #[error("the request is signed to {signed}, but asks to {asked}")]
    Action {
        /// The signed action.
        signed: Action,
        /// The requested action.
        asked: Action,
    },
    /// The call of a program differs from the signed call.
    #[error("the received call is not the signed call")]
    OtherCall,
    /// The order differs from the signed request.
    #[error("the order of `{0}` differs from the signed request")]
    Altered(String),
    /// The epoch of the order is outdated.
    #[error("it is of epoch {found}, but epoch {known} is known")]
    Epoch {
        /// The epoch of the order.
        found: u64,
        /// The highest epoch that was accepted.
        known: u64,
    },
    /// The signature, its time, its number, or the role of the signer.
    #[error("{0}{hint}", hint = hint(.0))]
    Request(request::Refusal),
}

impl From<request::Refusal> for Refusal {
    fn from(why: request::Refusal) -> Self {
        if let request::Refusal::Epoch { found, known } = why {
            return Self::Epoch { found, known };
        }
        Self::Request(why)
    }
}

/// Returns the command that solves the problem, if there is one.
fn hint(why: &request::Refusal) -> &'static str {
    match why {
        request::Refusal::Trust(TrustError::Role { .. }) => "; an admin gives roles with `dca team user add`",
        request::Refusal::Trust(TrustError::Expired(_)) => " with `dca team user add`, then `dca team import`",
        request::Refusal::Trust(TrustError::Revoked(_)) => "; its owner makes a new key, and an admin adds the new key",
        request::Refusal::Late(_) | request::Refusal::NotYet => "; compare the clocks with `dca clock`",
        request::Refusal::Ahead(_) => {
            ": compare the clocks with `dca clock`; if they are right, the file `number` in the folder with your keys is damaged: \
             remove it"
        }
        request::Refusal::Form(_)
        | request::Refusal::BodyTooLong
        | request::Refusal::OtherTeam
        | request::Refusal::Audience
        | request::Refusal::Window(_)
        | request::Refusal::Epoch { .. }
        | request::Refusal::Replay(_)
        | request::Refusal::Signature
        | request::Refusal::Trust(
            TrustError::OtherTeam(_)
            | TrustError::Issuer(_)
            | TrustError::Signature(_)
            | TrustError::NotYet(_)
            | TrustError::Renewal(_),
        )
        | request::Refusal::Body => "",
    }
}

impl Gate {
    /// Returns the gate of the node that has this key and this name in its certificate.
    pub const fn new(node: KeyId, name: Name, ledger: Ledger) -> Self {
        Self { node, name, ledger, news: Vec::new() }
    }

    /// Returns the accepted requests.
    pub const fn ledger(&self) -> &Ledger {
        &self.ledger
    }

    /// Returns and clears the records of the requests accepted since the last call of this method. They are to be added
    /// to the ledger on the disk.
    pub fn take_news(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.news)
    }

    /// Decides about the call of a command line. `epoch_of` says which epoch of a deployment runs here; 0 if no epoch runs.
    ///
    /// # Errors
    /// The call is refused.
    pub fn call(
        &mut self,
        request: Request,
        judge: &Judge<'_>,
        epoch_of: impl Fn(&str) -> u64,
    ) -> Result<Passed, Refused> {
        let Request::Signed(signed) = request else {
            let Some(action) = action(&request) else { return Ok(Passed::Open(request)) };
            let attempt = Attempt { who: "somebody".to_owned(), what: subject(&request) };
            return Err(Refused { attempt, why: Refusal::Unsigned(action) });
        };
        // A call of a program is judged later, by `procedure`: only then is it known which call the program has received.
        let asked = signed.request().ok().filter(|request| !matches!(request, Request::Call(_)));
        let asked = asked.and_then(|request| Some((action(&request)?, request)));
        let who = signer(&signed);
        let Some((action, request)) = asked else {
            let attempt = Attempt { who, what: "something".to_owned() };
            return Err(Refused { attempt, why: Refusal::Unreadable });
        };
        let attempt = Attempt { who, what: subject(&request) };
        match self.check_call(&signed, action, &request, judge, epoch_of) {
            Ok(()) => Ok(Passed::Signed(attempt, signed)),
            Err(why) => Err(Refused { attempt, why }),
        }
    }

    /// Decides about a user's call of a program of this node.
    ///
    /// # Errors
    /// The call is refused.
    pub fn procedure(&mut self, asked: CallRequest, signed: &Signed, judge: &Judge<'_>) -> Result<Attempt, Refused> {
        let request = Request::Call(Box::new(asked));
        let attempt = Attempt { who: signer(signed), what: subject(&request) };
        let refused = |why| Err(Refused { attempt: attempt.clone(), why });
        let Ok(found) = signed.request() else { return refused(Refusal::Unreadable) };
        let Some(action) = action(&request).filter(|_| found == request) else { return refused(Refusal::OtherCall) };
        match self.check_call(signed, action, &request, judge, |_| 0) {
            Ok(()) => Ok(attempt),
            Err(why) => refused(why),
        }
    }

    fn check_call(
        &mut self,
        signed: &Signed,
        asked: Action,
        request: &Request,
        judge: &Judge<'_>,
        epoch_of: impl Fn(&str) -> u64,
    ) -> Result<(), Refusal> {
        let epoch = check_action(signed, asked)?;
        let about = if let Request::Stop { name } = request { Some(name).filter(|_| epoch > 0) } else { None };
        let about = if let Request::Change(change) = request { Some(&change.name) } else { about };
        let about =
            if let Request::Switch(switch) = request { Some(&switch.name).filter(|_| epoch > 0) } else { about };
        let about = if let Request::Tell(tell) = request { Some(&tell.name).filter(|_| epoch > 0) } else { about };
        let epoch_min = about.map_or(0, |name| epoch_of(name));
        let plan = plan_of(request);
        let deployment = plan.filter(|plan| self.takes_part(plan)).and_then(|plan| plan.name.parse().ok());
        let Self { node, name, ledger, news } = self;
        let context = Context { judge: *judge, node: *node, name, deployment: deployment.as_ref(), epoch_min };
        let accepted = request::check(&signed.head, &signed.body, &context, ledger.replays())?;
        news.extend(ledger.accept(accepted.write, None));
        Ok(())
    }

    /// Decides about an order of another node that starts something.
    ///
    /// # Errors
    /// The order is refused.
    pub fn order(
        &mut self,
        deployment: &Deployment,
        from: &str,
        order: &ToParticipant,
        judge: &Judge<'_>,
    ) -> Result<Attempt, Refused> {
        let what = format!("start `{deployment}` for `{from}`");
        let ToParticipant::Ordered(ordered) = order else {
            let attempt = Attempt { who: format!("node {from}"), what };
            return Err(Refused { attempt, why: Refusal::Unsigned(Action::Deploy) });
        };
        let attempt = Attempt { who: signer(&ordered.by), what };
        match self.check_order(deployment, from, ordered, judge) {
            Ok(()) => Ok(attempt),
            Err(why) => Err(Refused { attempt, why }),
        }
    }

    fn check_order(
        &mut self,
        deployment: &Deployment,
        from: &str,
        ordered: &Ordered,
        judge: &Judge<'_>,
    ) -> Result<(), Refusal> {
        let Ordered { by, order } = ordered;
        let request = by.request().map_err(|_unreadable| Refusal::Unreadable)?;
        check_action(by, Action::Deploy)?;
        let plan = plan_of(&request).ok_or(Refusal::Unreadable)?;
        let is_meant = plan.name == deployment.name && plan.home() == Some(from) && self.takes_part(plan);
        let mark = request::Request::mark(&by.head).map_err(request::Refusal::Form)?;
        let (place, deployed) = (Place::new(from, &deployment.name), plan.name.parse().ok());
        let (is_first, epoch) = (*order == Order::Prepare, deployment.epoch);
        let known = self.ledger.epoch(&place);
        // After a reboot, the home begins the deployment again under a later epoch. The signed plan allows this.
        let may_resume = is_first && plan.on_boot == OnBoot::Resume && epoch > known;
        let resumed = may_resume.then(|| self.ledger.accepted(&place, known, mark.0, mark.1)).flatten();
        let follows = match resumed {
            Some(_) => true,
            None => follows(order, &request, plan, epoch),
        };
        if !is_meant || !follows {
            return Err(Refusal::Altered(from.to_owned()));
        }
        if epoch < known || (is_first && epoch == known) {
            return Err(Refusal::Epoch { found: epoch, known });
        }
        let Self { node, name, ledger, news } = self;
        // A request that was accepted for this epoch of the deployment stays valid, although its number is already used
        // and it may have expired.
        let before = ledger.accepted(&place, epoch, mark.0, mark.1).filter(|_| !is_first).or(resumed);
        let judge = Judge { now: before.unwrap_or(judge.now), ..*judge };
        let context = Context { judge, node: *node, name, deployment: deployed.as_ref(), epoch_min: 0 };
        if before.is_some() {
            request::check_again(&by.head, &by.body, &context)?;
            if let Some(UnixTime(at)) = resumed {
                news.extend(ledger.accept_again(mark.0, Start { place, epoch, number: mark.1, at }));
            }
            return Ok(());
        }
        let accepted = request::check(&by.head, &by.body, &context, ledger.replays())?;
        let start = Start { place, epoch, number: mark.1, at: judge.now.0 };
        news.extend(ledger.accept(accepted.write, Some(start)));
        Ok(())
    }

    /// Decides whether a deployment of this home may begin again after a reboot. The home has accepted the request when
    /// the deployment was begun, but its signer may have been revoked since.
    ///
    /// # Errors
    /// The deployment is refused.
    pub fn resumed(
        &self,
        deployment: &Deployment,
        signed: Option<&Signed>,
        judge: &Judge<'_>,
    ) -> Result<Attempt, Refused> {
        let who = signed.map_or_else(|| "somebody".to_owned(), signer);
        let attempt = Attempt { who, what: format!("begin `{deployment}` again after a reboot") };
        match self.check_resumed(deployment, signed, judge) {
            Ok(()) => Ok(attempt),
            Err(why) => Err(Refused { attempt, why }),
        }
    }

    fn check_resumed(
        &self,
        deployment: &Deployment,
        signed: Option<&Signed>,
        judge: &Judge<'_>,
    ) -> Result<(), Refusal> {
        let signed = signed.ok_or(Refusal::Unsigned(Action::Deploy))?;
        let request = signed.request().map_err(|_unreadable| Refusal::Unreadable)?;
        check_action(signed, Action::Deploy)?;
        let plan = plan_of(&request).ok_or(Refusal::Unreadable)?;
        let is_meant = plan.name == deployment.name && plan.home() == Some(self.name.as_str());
        if !is_meant || plan.on_boot != OnBoot::Resume {
            return Err(Refusal::Altered(self.name.to_string()));
        }
        let (head, _) = request::Request::peek(&signed.head).map_err(request::Refusal::Form)?;
        let deployed = plan.name.parse().ok();
        // The request was accepted while it was valid, and may have expired since.
        let judge = Judge { now: head.not_before, ..*judge };
        let context = Context { judge, node: self.node, name: &self.name, deployment: deployed.as_ref(), epoch_min: 0 };
        request::check_again(&signed.head, &signed.body, &context)?;
        Ok(())
    }

    fn takes_part(&self, plan: &Plan) -> bool {
        plan.hosts.iter().any(|host| host == self.name.as_str())
    }
}

/// Returns the signer that the request claims, for users.
fn signer(signed: &Signed) -> String {
    request::Request::peek(&signed.head).map_or_else(|_unreadable| "somebody".to_owned(), |(_, name)| name.to_string())
}

/// Checks that the signature is for this action; returns the signed epoch.
fn check_action(signed: &Signed, asked: Action) -> Result<u64, Refusal> {
    let (head, _) = request::Request::peek(&signed.head).map_err(request::Refusal::Form)?;
    if head.action == asked { Ok(head.epoch) } else { Err(Refusal::Action { signed: head.action, asked }) }
}

/// Returns whether an order agrees with a signed request.
fn follows(order: &Order, request: &Request, signed: &Plan, epoch: u64) -> bool {
    let change = if let Request::Change(change) = request { Some(&**change) } else { None };
    if change.is_some_and(|change| change.epoch != epoch || change.name != signed.name) {
        return false;
    }
    match order {
        Order::Prepare => change.is_none(),
        Order::Rejoin { plan, .. } => is_same(plan, signed),
        Order::Change(ChangeOrder::Examine { plan, .. }) => change.is_some() && is_same(plan, signed),
        Order::Change(ChangeOrder::Apply { plan, again, .. }) => {
            is_same(plan, signed) && may_begin(again, plan, change)
        }
        Order::Change(
            ChangeOrder::Link { .. }
            | ChangeOrder::LinkAlso { .. }
            | ChangeOrder::Adopt { .. }
            | ChangeOrder::Settle { .. },
        ) => false,
    }
}

/// Returns whether the change asks to start the program of each of these leaves again.
fn may_begin(again: &[u32], plan: &Plan, change: Option<&ChangeRequest>) -> bool {
    let is_named = |leaf: &u32| {
        let leaf = plan.leaves.get(*leaf as usize);
        leaf.is_some_and(|leaf| change.is_some_and(|change| change.again.contains(&leaf.path)))
    };
    again.iter().all(is_named)
}

/// Returns whether a plan is the signed plan, apart from its numbers. A plan that was changed at run time keeps the
/// numbers of the previous plan. Removed leaves are still listed in it, but are not started.
fn is_same(plan: &Plan, signed: &Plan) -> bool {
    // A leaf with the same path as another could hide that other leaf. Several leaves of one path may have run, but
    // only one of them is live.
    let live = plan.live_leaves();
    let paths = live.iter().filter_map(|number| plan.leaves.get(*number as usize)).map(|leaf| leaf.path.as_str());
    let has_no_more = paths.collect::<BTreeSet<&str>>().len() == live.len()
        && plan.live_leaves().len() == signed.live_leaves().len()
        && plan.live_groups().len() == signed.live_groups().len();
    let found = has_no_more.then(|| difference(plan, signed));
    matches!(found, Some(Ok(found)) if found.changes.is_empty() && found.plan == *plan)
}
