//! The quality of service of a publisher or subscriber, as tokens of ROS 2 have it: `2::,5:,:,:,,`.
//!
//! Six parts: reliability, durability, history, deadline, lifespan, liveliness. Each number that is the default is left out, also
//! seconds and nanoseconds of one duration. Source: `rmw_zenoh_cpp/src/detail/liveliness_utils.cpp`.

use std::fmt;

/// The depth that a token does not write.
const DEPTH: u64 = 42;
/// The longest text.
const LENGTH_MAX: usize = 256;

/// The quality of service.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Qos {
    /// Whether lost messages are sent again.
    pub reliability: Reliability,
    /// Whether late subscribers get earlier messages.
    pub durability: Durability,
    /// Which earlier messages are kept.
    pub history: History,
    /// The number of messages that are kept, with [`History::KeepLast`].
    pub depth: u64,
    /// The longest time between two messages.
    pub deadline: Span,
    /// The age at which a message is of no use.
    pub lifespan: Span,
    /// How a publisher shows that it lives.
    pub liveliness: Liveliness,
    /// The time after which a publisher that does not show it is dead.
    pub lease: Span,
}

/// Whether lost messages are sent again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reliability {
    /// They are.
    Reliable,
    /// They are not.
    BestEffort,
}

/// Whether late subscribers get earlier messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Durability {
    /// They do.
    TransientLocal,
    /// They do not.
    Volatile,
}

/// Which earlier messages are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum History {
    /// The last ones.
    KeepLast,
    /// All of them.
    KeepAll,
}

/// How a publisher shows that it lives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Liveliness {
    /// This is not necessary, because its process lives.
    Automatic,
    /// It says so, for each topic.
    ManualByTopic,
}

/// A duration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Span {
    /// Whole seconds.
    pub seconds: u64,
    /// The rest in nanoseconds.
    pub nanos: u64,
}

impl Span {
    /// No limit.
    pub const INFINITE: Self = Self { seconds: 9_223_372_036, nanos: 854_775_807 };
}

impl Qos {
    /// The default of `rmw_zenoh`.
    pub const DEFAULT: Self = Self {
        reliability: Reliability::Reliable,
        durability: Durability::Volatile,
        history: History::KeepLast,
        depth: DEPTH,
        deadline: Span::INFINITE,
        lifespan: Span::INFINITE,
        liveliness: Liveliness::Automatic,
        lease: Span::INFINITE,
    };
}

impl Default for Qos {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// The one form that `rmw_zenoh` writes.
impl fmt::Display for Qos {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let reliability = if self.reliability == Reliability::BestEffort { "2" } else { "" };
        let durability = if self.durability == Durability::TransientLocal { "1" } else { "" };
        let history = if self.history == History::KeepAll { "2" } else { "" };
        let liveliness = if self.liveliness == Liveliness::ManualByTopic { "3" } else { "" };
        let number = |number: u64, default: u64| if number == default { String::new() } else { number.to_string() };
        let span = |Span { seconds, nanos }: Span| {
            let Span { seconds: most, nanos: rest } = Span::INFINITE;
            format!("{},{}", number(seconds, most), number(nanos, rest))
        };
        let (depth, deadline) = (number(self.depth, DEPTH), span(self.deadline));
        let (lifespan, lease) = (span(self.lifespan), span(self.lease));
        write!(f, "{reliability}:{durability}:{history},{depth}:{deadline}:{lifespan}:{liveliness},{lease}")
    }
}

impl Qos {
    /// Reads any of the forms that were published: parts at the end may be missing, 0 is the default, and a history may have no
    /// comma.
    pub fn parse(text: &str) -> Option<Self> {
        let parts: Vec<&str> = text.split(':').collect();
        if text.len() > LENGTH_MAX || !(3..=6).contains(&parts.len()) {
            return None;
        }
        let part = |at: usize| parts.get(at).copied().unwrap_or_default();
        let reliability = match part(0) {
            "" | "0" | "1" => Reliability::Reliable,
            "2" => Reliability::BestEffort,
            _ => return None,
        };
        let durability = match part(1) {
            "" | "0" | "2" => Durability::Volatile,
            "1" => Durability::TransientLocal,
            _ => return None,
        };
        let (history, depth) = part(2).split_once(',').unwrap_or((part(2), ""));
        let history = match history {
            "" | "0" | "1" => History::KeepLast,
            "2" => History::KeepAll,
            _ => return None,
        };
        let (liveliness, lease) = part(5).split_once(',').unwrap_or((part(5), ""));
        let liveliness = match liveliness {
            "" | "0" | "1" => Liveliness::Automatic,
            "3" => Liveliness::ManualByTopic,
            _ => return None,
        };
        let (deadline, lifespan, lease) = (span(part(3))?, span(part(4))?, span(lease)?);
        let depth = number(depth, DEPTH)?;
        Some(Self { reliability, durability, history, depth, deadline, lifespan, liveliness, lease })
    }
}

fn span(text: &str) -> Option<Span> {
    let (seconds, nanos) = text.split_once(',').unwrap_or((text, ""));
    let Span { seconds: most, nanos: rest } = Span::INFINITE;
    Some(Span { seconds: number(seconds, most)?, nanos: number(nanos, rest)? })
}

fn number(text: &str, default: u64) -> Option<u64> {
    let is_plain = text.bytes().all(|byte| byte.is_ascii_digit());
    if text.is_empty() { Some(default) } else { is_plain.then(|| text.parse().ok()).flatten() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[track_caller]
    fn check(text: &str, expected: Qos) {
        assert_eq!(expected.to_string(), text);
        assert_eq!(Qos::parse(text), Some(expected));
    }

    #[test]
    fn what_is_the_default_is_left_out() {
        let default = Qos::default();
        check("::,:,:,:,,", default);
        check("2::,5:,:,:,,", Qos { reliability: Reliability::BestEffort, depth: 5, ..default });
        check(":1:,1:,:,:,,", Qos { durability: Durability::TransientLocal, depth: 1, ..default });
        check("::2,0:,:,:,,", Qos { history: History::KeepAll, depth: 0, ..default });
        let deadline = Span { seconds: 0, ..Span::INFINITE };
        check("::,10:0,:,:,,", Qos { depth: 10, deadline, ..default });
        let lifespan = Span { nanos: 5, ..Span::INFINITE };
        check("::,:,:,5:,,", Qos { lifespan, ..default });
        let lease = Span { seconds: 3, nanos: 0 };
        check("::,:,:,:3,3,0", Qos { liveliness: Liveliness::ManualByTopic, lease, ..default });
    }

    #[test]
    fn all_published_forms_are_read() {
        let default = Qos::default();
        for text in ["::", "::,", "::,:,:,", "0:0:0,:,:,:,,", "1:2:1,42:,:,:,,", ":::,:,:,,", "::,:,:,:1,,"] {
            assert_eq!(Qos::parse(text), Some(default), "{text}");
        }
        assert_eq!(Qos::parse("::2,:,:,:,,"), Some(Qos { history: History::KeepAll, ..default }));
    }

    #[test]
    fn other_texts_are_refused() {
        let long = format!("::,{}:,:,:,,", "1".repeat(LENGTH_MAX));
        for text in
            ["", ":", "3::,:,:,:,,", ":3:,:,:,:,,", "::3,:,:,:,,", "::,:,:,:2,,", "::,-1:,:,:,,", "::,+1:,:,:,,", &long]
        {
            assert_eq!(Qos::parse(text), None, "{text}");
        }
        assert_eq!(Qos::parse("::,:,:,:,,:"), None, "a part more");
        assert_eq!(Qos::parse("::,99999999999999999999:,:,:,,"), None, "no number of 64 bits");
    }
}
