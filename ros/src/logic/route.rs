//! Routes: the topics and services that a bridge carries, each with its type, its direction and its quality of service.
//!
//! A bridge gets its routes as one text, `>/cmd_vel geometry_msgs/msg/Twist ::,10:,:,:,,;</scan sensor_msgs/msg/LaserScan 2::,5:,:,:,,`.
//! The sign in front comes from its [`Way`]. A route whose frames have a prefix has that behind it.

use super::frame::FramePrefix;
use super::key::GraphName;
use super::name::{Folder, TypeName};
use super::qos::{Durability, Qos, Reliability};
use super::token::Role;
use std::collections::BTreeSet;
use std::fmt;

/// The most routes of one bridge.
pub const ROUTES_MAX: usize = 500;
/// The greatest depth that a route may have: so many messages of the largest size fill the memory of no robot.
pub const DEPTH_MAX: u64 = 1000;
/// Stands between two routes.
const END: char = ';';
/// The type of transforms.
const TRANSFORMS: (&str, &str) = ("tf2_msgs", "TFMessage");
/// Behind the name of a topic to which a mission publishes transforms: no topic has this name, and the mission may also
/// subscribe to that topic.
const OUT: &str = "-out";

/// The quality of service of a service without another one, as in ROS 2.
pub const SERVICE: Qos = Qos { depth: 10, ..Qos::DEFAULT };

/// A topic or a service that a bridge carries.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Route {
    /// The name of the topic or service.
    pub name: GraphName,
    /// The type of the messages, or of the service.
    pub of: TypeName,
    /// The direction of the messages or calls.
    pub way: Way,
    /// The quality of service of the bridge's endpoint.
    pub qos: Qos,
    /// The prefix of the frames of the robot in ROS 2.
    pub frames: Option<FramePrefix>,
}

/// The direction of messages and calls.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Way {
    /// The bridge publishes messages.
    ToRos,
    /// The bridge subscribes to messages.
    FromRos,
    /// The bridge is the client of a service.
    Call,
    /// The bridge is the server of a service.
    Serve,
}

impl Way {
    const SIGNS: [(Self, char); 4] = [(Self::ToRos, '>'), (Self::FromRos, '<'), (Self::Call, '?'), (Self::Serve, '!')];

    /// Returns whether calls and not messages go this way.
    pub fn is_service(self) -> bool {
        matches!(self, Self::Call | Self::Serve)
    }

    /// Returns whether the messages or calls go from a mission to ROS 2.
    pub fn is_outward(self) -> bool {
        matches!(self, Self::ToRos | Self::Call)
    }

    /// Returns the role of the endpoint in ROS 2 at the other end.
    pub fn partner(self) -> Role {
        match self {
            Self::ToRos => Role::Subscriber,
            Self::FromRos => Role::Publisher,
            Self::Call => Role::Server,
            Self::Serve => Role::Client,
        }
    }

    fn of(sign: char) -> Option<Self> {
        Self::SIGNS.into_iter().find(|(_, other)| *other == sign).map(|(way, _)| way)
    }

    fn sign(self) -> char {
        Self::SIGNS.into_iter().find(|(way, _)| *way == self).map_or('>', |(_, sign)| sign)
    }
}

impl Route {
    /// Returns whether its messages are transforms. Any number of processes on any number of hosts
    /// may publish and subscribe to their topic at the same time.
    pub fn has_transforms(&self) -> bool {
        is_transforms(&self.of)
    }

    /// Returns whether the messages are static transforms. Then the last message of each publisher is valid, and not
    /// only the last message of all.
    pub fn has_static_transforms(&self) -> bool {
        self.has_transforms() && self.qos.durability == Durability::TransientLocal
    }

    /// Returns the name of the route in its bridge: `/robot1/cmd_vel`, and `/tf-out` for transforms that a mission publishes.
    pub fn label(&self) -> String {
        let end = if self.has_transforms() && self.way == Way::ToRos { OUT } else { "" };
        format!("{}{end}", self.name)
    }

    /// Returns the name of the port of the bridge that stands for the topic or service: `robot1.cmd_vel`.
    pub fn port(&self) -> String {
        self.label().trim_start_matches('/').replace('/', ".")
    }

    /// Reads the routes of a bridge. None if a route cannot be read, if two routes have the same name, or if there are too many routes.
    pub fn list(text: &str) -> Option<Vec<Self>> {
        let routes: Vec<Self> = text.split(END).map(Self::parse).collect::<Option<_>>()?;
        let mut labels = BTreeSet::new();
        let is_fit = routes.len() <= ROUTES_MAX && routes.iter().all(|route| labels.insert(route.label()));
        is_fit.then_some(routes)
    }

    /// Returns the text of the routes of a bridge.
    pub fn text(routes: &[Self]) -> String {
        let texts: Vec<String> = routes.iter().map(Self::to_string).collect();
        texts.join(&END.to_string())
    }

    fn parse(text: &str) -> Option<Self> {
        let mut words = text.split(' ');
        let (name, of, qos) = (words.next()?, words.next()?, words.next()?);
        let way = Way::of(name.chars().next()?)?;
        let name = GraphName::parse(name.get(1..)?)?;
        let folder = if way.is_service() { Folder::Srv } else { Folder::Msg };
        let of = TypeName::parse(of).filter(|of| of.folder() == folder)?;
        let qos = Qos::parse(qos).filter(|qos| (1..=DEPTH_MAX).contains(&qos.depth))?;
        let frames = match words.next() {
            Some(prefix) => Some(FramePrefix::parse(prefix)?),
            None => None,
        };
        words.next().is_none().then_some(Self { name, of, way, qos, frames })
    }
}

impl fmt::Display for Route {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { name, of, way, qos, frames } = self;
        write!(f, "{}{name} {of} {qos}", way.sign())?;
        frames.iter().try_for_each(|prefix| write!(f, " {prefix}"))
    }
}

/// Returns whether messages of this type are transforms.
pub fn is_transforms(of: &TypeName) -> bool {
    (of.package(), of.name()) == TRANSFORMS
}

/// Returns the quality of service that a spec means by a word and a depth: `reliable(10)`, `best_effort(1)`, `transient_local(1)`,
/// `sensor`.
///
/// # Errors
/// A sentence for a person.
pub fn quality(word: &str, depth: Option<u64>) -> Result<Qos, String> {
    let default = Qos::default();
    let best_effort = Qos { reliability: Reliability::BestEffort, ..default };
    let qos = match word {
        "sensor" if depth.is_some() => return Err("`sensor` has no depth: it is `best_effort(5)`".to_owned()),
        "sensor" => return Ok(Qos { depth: 5, ..best_effort }),
        "reliable" => default,
        "best_effort" => best_effort,
        "transient_local" => Qos { durability: Durability::TransientLocal, ..default },
        _ => {
            let known = "`reliable(10)`, `best_effort(10)`, `transient_local(1)` and `sensor`";
            return Err(format!("`{word}` is not a quality of service; there are {known}"));
        }
    };
    match depth {
        Some(depth @ 1..=DEPTH_MAX) => Ok(Qos { depth, ..qos }),
        Some(_) => Err(format!("the depth is a number from 1 to {DEPTH_MAX}")),
        None => Err(format!("`{word}` needs a depth, such as `{word}(10)`")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = ">/cmd_vel geometry_msgs/msg/Twist ::,10:,:,:,,;</a/scan sensor_msgs/msg/LaserScan 2::,5:,:,:,,;\
                        ?/reset std_srvs/srv/Empty ::,10:,:,:,,;!/set std_srvs/srv/SetBool ::,10:,:,:,,";

    #[test]
    fn routes_are_one_text() {
        let routes = Route::list(TEXT).unwrap();
        assert_eq!(Route::text(&routes), TEXT);
        let ports: Vec<(String, Way)> = routes.iter().map(|route| (route.port(), route.way)).collect();
        let expected = [("cmd_vel", Way::ToRos), ("a.scan", Way::FromRos), ("reset", Way::Call), ("set", Way::Serve)];
        assert_eq!(ports, expected.map(|(port, way)| (port.to_owned(), way)));
        assert_eq!(routes[2].qos, SERVICE);
    }

    #[test]
    fn transforms_go_both_ways() {
        let text = ">/tf tf2_msgs/msg/TFMessage ::,100:,:,:,, r1/;</tf tf2_msgs/msg/TFMessage ::,100:,:,:,, r1/;\
                    </tf_static tf2_msgs/msg/TFMessage :1:,1:,:,:,,";
        let routes = Route::list(text).unwrap();
        assert_eq!(Route::text(&routes), text);
        let found = routes.iter().map(|route| (route.port(), route.has_transforms(), route.has_static_transforms()));
        let expected = [("tf-out", true, false), ("tf", true, false), ("tf_static", true, true)];
        assert_eq!(found.collect::<Vec<_>>(), expected.map(|(port, all, fixed)| (port.to_owned(), all, fixed)));
        assert_eq!(routes[0].frames, FramePrefix::parse("r1/"));
        assert!(Route::list(TEXT).unwrap().iter().all(|route| !route.has_transforms() && route.frames.is_none()));
        for text in [&text.replace('>', "<"), &text.replace("r1/", "r1"), &text.replace("r1/", "r1/ r2/")] {
            assert_eq!(Route::list(text), None, "{text}");
        }
    }

    #[test]
    fn other_texts_are_refused() {
        let one = "</a std_msgs/msg/Bool ::,1:,:,:,,";
        assert!(Route::list(one).is_some());
        let deep = one.replace(",1:", ",1001:");
        let many: Vec<String> = (0..=ROUTES_MAX).map(|number| one.replace("/a", &format!("/a{number}"))).collect();
        let twice = format!("{one};{}", one.replace('<', ">"));
        let service = "?/a std_srvs/srv/Empty ::,1:,:,:,,";
        assert!(Route::list(service).is_some());
        for text in [&service.replace("?", "<"), &service.replace("srv/", "msg/"), &one.replace("<", "?"), "ä"] {
            assert_eq!(Route::list(text), None, "{text}");
        }
        for text in
            ["", ";", &one[1..], &one.replace("/a", "/1"), &one.replace("std_msgs/msg/", ""), &format!("{one} x")]
        {
            assert_eq!(Route::list(text), None, "{text}");
        }
        for text in [&deep, &twice, &many.join(";")] {
            assert_eq!(Route::list(text), None, "{text}");
        }
    }

    #[test]
    fn words_mean_qualities() {
        let texts = [("reliable", Some(10)), ("best_effort", Some(1)), ("transient_local", Some(1)), ("sensor", None)];
        let texts = texts.map(|(word, depth)| quality(word, depth).unwrap().to_string());
        assert_eq!(texts, ["::,10:,:,:,,", "2::,1:,:,:,,", ":1:,1:,:,:,,", "2::,5:,:,:,,"]);
        for (word, depth) in [
            ("sensor", Some(5)),
            ("reliable", None),
            ("reliable", Some(0)),
            ("best_effort", Some(1001)),
            ("fast", None),
        ] {
            assert!(quality(word, depth).is_err(), "{word} {depth:?}");
        }
    }
}
