//! The direction in which a door opens, and the attempts that find it: first gently in both directions.

/// The pull at which the hand stops (N): at first, and for a door that has not moved for some time.
pub const PULL_MAX: (f64, f64) = (50.0, 70.0);
/// The greatest allowed vector sum (N) of the pull and the force across it, such as the force of the lever.
pub const TOTAL_MAX: f64 = 72.0;
/// The gentle attempts while the direction of opening is unknown (N): pull, push, pull, push.
const GENTLE: [Attempt; 4] = [
    Attempt { pull: 40.0, total: 48.0 },
    Attempt { pull: 40.0, total: 50.0 },
    Attempt { pull: 46.0, total: 54.0 },
    Attempt { pull: 55.0, total: 58.0 },
];
/// The attempt for a door that does not move with these forces, or whose direction of opening is known.
pub const HARD: Attempt = Attempt { pull: PULL_MAX.1, total: TOTAL_MAX };

/// The forces of one attempt (N).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Attempt {
    /// The pull at which the hand finally stops (N).
    pub pull: f64,
    /// The greatest allowed vector sum (N) of the pull and the force across it, such as the force of the lever.
    pub total: f64,
}

/// The direction in which the hand tries to move the door.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Swing {
    /// Towards the robot.
    Pull,
    /// Away from the robot.
    Push,
}

/// The direction in which the door opens, as far as known.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Opens {
    /// The direction is unknown. The hand finds it out.
    #[default]
    Either,
    /// Towards the robot.
    Pull,
    /// Away from the robot.
    Push,
}

impl Opens {
    /// Returns the attempts, in the order in which they are made.
    pub fn attempts(self) -> &'static [(Swing, Attempt)] {
        const EITHER: [(Swing, Attempt); 6] = [
            (Swing::Pull, GENTLE[0]),
            (Swing::Push, GENTLE[1]),
            (Swing::Pull, GENTLE[2]),
            (Swing::Push, GENTLE[3]),
            (Swing::Pull, HARD),
            (Swing::Push, HARD),
        ];
        match self {
            Self::Either => &EITHER,
            Self::Pull => &[(Swing::Pull, HARD)],
            Self::Push => &[(Swing::Push, HARD)],
        }
    }
}
