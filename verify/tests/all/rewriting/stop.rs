//! `stop(C)`, and the search through a configuration.

use super::completion::drained;
use super::rules::{Next, Order, Reference};
use super::term::{Conf, Outcome, Slots};

impl Reference {
    /// Asks a configuration to stop.
    pub(crate) fn stop(&mut self, conf: Conf) -> Next {
        match conf {
            Conf::Active(member, sets) => {
                self.orders.push(Order::Stop(member));
                Ok(Conf::Stopping(member, sets))
            }
            Conf::Stopping(..) | Conf::ShieldK(..) => Ok(conf),
            Conf::Never => Err(Outcome::Killed),
            Conf::Timer(timer) => {
                self.orders.push(Order::Cancel(timer));
                Err(Outcome::Killed)
            }
            Conf::Seq(c, _)
            | Conf::Cond(c, _)
            | Conf::Else(c, _)
            | Conf::Rec1(c, ..)
            | Conf::Rec2(c, ..)
            | Conf::As(_, c)
            | Conf::Repeat(_, c, _)
            | Conf::Catch(c, _) => self.stop(*c),
            Conf::Named(number, value, c) => self.stop(*c).map(|c| Conf::Named(number, value, c.into())),
            Conf::Par(Slots { slots, .. })
            | Conf::And(Slots { slots, .. })
            | Conf::Any(_, Slots { slots, .. })
            | Conf::Least(_, Slots { slots, .. }) => {
                self.drain(Outcome::Killed, slots.into_iter().filter_map(Result::ok).collect())
            }
            Conf::Dis(of) => self.drain(Outcome::Killed, of),
            Conf::Drain(outcome, of) => {
                let outcome = if outcome.is_unconfirmed() { outcome } else { Outcome::Killed };
                drained(outcome, of.into_iter().map(Ok).collect())
            }
            Conf::Shield(bound, c) => {
                if let Some((timer, after)) = bound {
                    self.orders.push(Order::Arm(timer, after));
                }
                Ok(Conf::ShieldK(bound.map(|(timer, _)| timer), c))
            }
            Conf::Waiting(number, ..) => {
                self.queue.retain(|(waiting, _)| *waiting != number);
                Err(Outcome::Killed)
            }
            Conf::Using(number, c) => {
                let next = self.stop(*c);
                self.using(number, next)
            }
            Conf::Fin1(c, q) => match self.stop(*c) {
                Ok(c) => Ok(Conf::Fin1(c.into(), q)),
                Err(outcome) => self.fin1(outcome, &q),
            },
            Conf::Fin2(outcome, c) if outcome.is_unconfirmed() => Ok(Conf::Fin2(outcome, c)),
            Conf::Fin2(_, c) => Ok(Conf::Fin2(Outcome::Killed, c)),
            Conf::Pool(pool) => {
                let was_stopped = pool.failed.is_some();
                let mut parts: Vec<Next> = Vec::new();
                match pool.running {
                    Some(conf) if was_stopped => parts.push(Ok(conf)),
                    Some(conf) => parts.push(self.stop(conf)),
                    None => {}
                }
                for conf in pool.places.into_iter().flatten() {
                    parts.push(self.stop(conf));
                }
                let outcome = match pool.failed.map(Outcome::Aborted) {
                    Some(outcome) if outcome.is_unconfirmed() => outcome,
                    Some(_) | None => Outcome::Killed,
                };
                drained(outcome, parts)
            }
        }
    }
}

impl Conf {
    /// Returns whether a condition holds of this configuration or of a part of it.
    pub(crate) fn any(&self, is_it: &dyn Fn(&Self) -> bool) -> bool {
        is_it(self) || self.parts().into_iter().any(|part| part.any(is_it))
    }

    /// Returns the direct running parts.
    pub(crate) fn parts(&self) -> Vec<&Self> {
        match self {
            Self::Active(..) | Self::Stopping(..) | Self::Never | Self::Timer(_) | Self::Waiting(..) => Vec::new(),
            Self::Seq(c, _) | Self::Cond(c, _) | Self::Else(c, _) | Self::Fin1(c, _) => vec![c],
            Self::Rec1(c, ..) | Self::Rec2(c, ..) | Self::Repeat(_, c, _) | Self::Catch(c, _) => vec![c],
            Self::Shield(_, c)
            | Self::ShieldK(_, c)
            | Self::Using(_, c)
            | Self::Fin2(_, c)
            | Self::As(_, c)
            | Self::Named(_, _, c) => vec![c],
            Self::Par(slots) | Self::And(slots) | Self::Any(_, slots) | Self::Least(_, slots) => {
                slots.slots.iter().filter_map(|slot| slot.as_ref().ok()).collect()
            }
            Self::Dis(of) | Self::Drain(_, of) => of.iter().collect(),
            Self::Pool(pool) => pool.running.iter().chain(pool.places.iter().flatten()).collect(),
        }
    }
}
