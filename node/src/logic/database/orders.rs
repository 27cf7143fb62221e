//! The orders of an operator: begin a team, join another team, retire a member, heal the clock.

use super::question::{Own, Question, Reply};
use super::{Database, Effect, status, table};
use comms::logic::time::Time;
use dbmanager::logic::replica;
use dbmanager::logic::version_vector::ReplicaId;

impl Database {
    /// Carries out the order of an operator.
    pub(super) fn operate(&mut self, now: Time, question: Question, effects: &mut Vec<Effect>) -> Reply {
        if let Some(why) = self.disk.closed() {
            return Reply::Refused(why.to_owned());
        }
        let wall = self.wall;
        if let Question::Retire { member } = question {
            return match self.member(&member) {
                Ok(origin) => {
                    self.feed(now, replica::Input::Retire(origin, wall), &mut None, effects);
                    if self.replica.members().is_active(origin) {
                        return Reply::Refused(self.why_not_retired(&member, origin));
                    }
                    Reply::Done(format!(
                        "`{member}` ({origin}) is retired; the writes that other robots have received stay"
                    ))
                }
                Err(why) => Reply::Refused(why),
            };
        }
        if let Question::RetireOlder { robot } = question {
            return self
                .older(now, &robot)
                .map_or_else(Reply::Refused, |origins| self.retire_all(now, &robot, origins, effects));
        }
        if question == Question::HealClock {
            self.feed(now, replica::Input::HealClock(wall), &mut None, effects);
            return Reply::Done("new writes get dates in a new epoch, after all wrong dates".to_owned());
        }
        if let Question::Join { robot } = question {
            if self.teams().gives_way_to(now, &robot) {
                return Reply::Done(format!("`{}` gives way to the team of `{robot}` by itself", self.place.robot));
            }
            if self.replica.is_member() && self.replica.members().active().any(|(_, member)| member == robot) {
                return Reply::Done(format!("`{}` and `{robot}` belong to one team already", self.place.robot));
            }
            return match self.teams().replica_of(now, &robot) {
                Ok(peer) => {
                    self.feed(now, replica::Input::Join(peer, wall), &mut None, effects);
                    Reply::Done(format!("`{}` asks `{robot}` to be admitted", self.place.robot))
                }
                Err(why) => Reply::Refused(why),
            };
        }
        if self.replica.is_member() {
            return Reply::Done(format!("`{}` belongs to the team `{}` already", self.place.robot, self.place.team));
        }
        self.found(now, effects)
    }

    /// Returns why keys are not given to a robot; nothing if they may be given. Without a robot of that name in the
    /// team, nothing could be written below these keys.
    pub(super) fn unknown_owner(&self, own: &Own) -> Option<String> {
        let robot = own.robot.as_ref().filter(|robot| **robot != self.place.robot)?;
        if !self.replica.is_member() {
            return Some(format!("`{}` belongs to no team yet, so it can give keys to itself alone", self.place.robot));
        }
        table::no_robot(robot, self.replica.members().active().map(|(_, member)| member))
    }

    /// Retires the previous names of a robot.
    fn retire_all(&mut self, now: Time, robot: &str, origins: Vec<ReplicaId>, effects: &mut Vec<Effect>) -> Reply {
        let wall = self.wall;
        for origin in &origins {
            self.feed(now, replica::Input::Retire(*origin, wall), &mut None, effects);
            if self.replica.members().is_active(*origin) {
                return Reply::Refused(self.why_not_retired(robot, *origin));
            }
        }
        match &origins[..] {
            [] => Reply::Done(format!("`{robot}` has only one name, so there is nothing to retire")),
            _ => {
                let names: Vec<String> = origins.iter().map(ToString::to_string).collect();
                Reply::Done(format!(
                    "older names of `{robot}` are retired: {}; what they had written stays",
                    names.join(", ")
                ))
            }
        }
    }

    /// Returns the names of a robot in the team, except its present name.
    fn older(&self, now: Time, robot: &str) -> Result<Vec<ReplicaId>, String> {
        let members = self.replica.members().active().filter(|(_, name)| *name == robot);
        let names: Vec<ReplicaId> = members.map(|(origin, _)| origin).collect();
        let heard = |origin: &&ReplicaId| {
            let heard = self.heard.get(origin).filter(|heard| now.since(heard.at) < status::HEARD_WITHIN);
            heard.map(|heard| heard.at)
        };
        let present = if robot == self.place.robot {
            Some(self.replica.origin())
        } else {
            names.iter().filter(|origin| heard(origin).is_some()).max_by_key(heard).copied()
        };
        match present {
            _ if names.is_empty() => Err(format!("the database has no member `{robot}`; `dca db status` lists them")),
            _ if names.len() == 1 => Ok(Vec::new()),
            Some(present) => Ok(names.into_iter().filter(|origin| *origin != present).collect()),
            None => Err(format!(
                "`{robot}` does not answer now, so its present name is not known; ask again when the robot answers, or retire one of its \
                 names by the digits"
            )),
        }
    }

    fn why_not_retired(&self, member: &str, origin: ReplicaId) -> String {
        if self.replica.is_member() && !self.replica.may_retire(origin) {
            return format!(
                "the key of `{member}` is not revoked; to retire the robot, run `dca team revoke`; to retire only its older names, run \
                 `dca db retire ROBOT --older` on that robot"
            );
        }
        if self.replica.is_member() {
            return format!(
                "this robot cannot read some writes of `{member}`: upgrade DCA on this robot, or ask another member"
            );
        }
        format!(
            "`{}` waits to be admitted to the team `{}` itself; ask another member",
            self.place.robot, self.place.team
        )
    }

    fn found(&mut self, now: Time, effects: &mut Vec<Effect>) -> Reply {
        if self.heard.values().any(|heard| heard.member && now.since(heard.at) < status::HEARD_WITHIN) {
            return Reply::Refused(format!(
                "there is a team `{}` already; this robot joins it by itself",
                self.place.team
            ));
        }
        self.feed(now, replica::Input::Found(self.wall), &mut None, effects);
        if self.replica.is_member() {
            let (robot, team) = (&self.place.robot, &self.place.team);
            Reply::Done(format!(
                "the team `{team}` begins with `{robot}`; every other robot that can reach this team joins by itself"
            ))
        } else {
            Reply::Refused("this robot was a member of a team before, and waits to be admitted again".to_owned())
        }
    }

    /// Returns the other member that has this name.
    fn member(&self, name: &str) -> Result<ReplicaId, String> {
        let (mine, members) = (self.replica.origin(), self.replica.members());
        if let Some(origin) = ReplicaId::parse(name).filter(|origin| members.is_active(*origin) && *origin != mine) {
            return Ok(origin);
        }
        let of: Vec<ReplicaId> =
            members.active().filter(|(origin, robot)| *robot == name && *origin != mine).map(|(o, _)| o).collect();
        match of.as_slice() {
            [origin] => Ok(*origin),
            [] if name == self.place.robot => Err("a robot cannot retire itself; ask another".to_owned()),
            [] => Err(format!("the database has no member `{name}`; `dca db status` lists them")),
            several => {
                let origins: Vec<String> = several.iter().map(ToString::to_string).collect();
                Err(format!(
                    "`{name}` is a member under several names: `dca db retire {name} --older` retires all but the present one, or \
                     give one of `{}`",
                    origins.join("`, `")
                ))
            }
        }
    }
}
