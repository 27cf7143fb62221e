//! The quantities that a parameter can have, each with its unit.

/// A quantity type of the `.dca` language. Programs get its values in SI units.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// In seconds.
    Time,
    /// In metres.
    Length,
    /// In radians.
    Angle,
    /// In metres per second.
    Speed,
    /// In radians per second.
    AngularSpeed,
    /// In metres per second squared.
    Acceleration,
    /// In hertz.
    Frequency,
    /// In kilograms.
    Mass,
    /// In newtons.
    Force,
    /// In newton metres.
    Torque,
    /// In newtons per metre.
    Stiffness,
    /// In watts.
    Power,
    /// In amperes.
    Current,
    /// In volts.
    Voltage,
    /// In bytes.
    Size,
}

impl Quantity {
    /// All quantities.
    pub const ALL: [Self; 15] = [
        Self::Time,
        Self::Length,
        Self::Angle,
        Self::Speed,
        Self::AngularSpeed,
        Self::Acceleration,
        Self::Frequency,
        Self::Mass,
        Self::Force,
        Self::Torque,
        Self::Stiffness,
        Self::Power,
        Self::Current,
        Self::Voltage,
        Self::Size,
    ];

    /// Returns the name of the quantity in specs, such as `Force`.
    pub const fn name(self) -> &'static str {
        self.words().0
    }

    /// Returns the symbol of the SI unit, such as `N`.
    pub const fn unit(self) -> &'static str {
        self.words().1
    }

    const fn words(self) -> (&'static str, &'static str) {
        match self {
            Self::Time => ("Time", "s"),
            Self::Length => ("Length", "m"),
            Self::Angle => ("Angle", "rad"),
            Self::Speed => ("Speed", "m/s"),
            Self::AngularSpeed => ("AngularSpeed", "rad/s"),
            Self::Acceleration => ("Acceleration", "m/s2"),
            Self::Frequency => ("Frequency", "Hz"),
            Self::Mass => ("Mass", "kg"),
            Self::Force => ("Force", "N"),
            Self::Torque => ("Torque", "Nm"),
            Self::Stiffness => ("Stiffness", "N/m"),
            Self::Power => ("Power", "W"),
            Self::Current => ("Current", "A"),
            Self::Voltage => ("Voltage", "V"),
            Self::Size => ("Size", "B"),
        }
    }
}
