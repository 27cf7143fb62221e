//! Times ([`span`]), sizes ([`size`]) and errors of the system ([`cause`]) as text for people, and values as JSON for
//! tools. In postcard these values keep their usual encoding.
//!
//! In JSON, times are numbers in seconds. Numbers that identify something are strings of 16 hexadecimal digits, since
//! most JSON readers keep only 53 bits of a number. For use with `#[serde(with = "…")]`.

/// Returns a span of time in words: `5 s`, `1.5 s`, `200 ms`, `0.25 ms`.
pub fn span(time: std::time::Duration) -> String {
    let seconds = time.as_secs_f64();
    let (number, unit) = if seconds >= 1.0 || time.is_zero() { (seconds, "s") } else { (seconds * 1e3, "ms") };
    let text = format!("{number:.3}");
    format!("{} {unit}", text.trim_end_matches('0').trim_end_matches('.'))
}

/// Returns a number of bytes in words, rounded down: `900 B`, `64 KiB`, `3 MiB`.
pub fn size(bytes: u64) -> String {
    match bytes {
        0..1024 => format!("{bytes} B"),
        1024..1_048_576 => format!("{} KiB", bytes / 1024),
        _ => format!("{} MiB", bytes / 1_048_576),
    }
}

/// Returns the system's text for an error in a form that fits into a sentence: `no such file or directory` instead of
/// the standard library's `No such file or directory (os error 2)`.
pub fn cause(error: &std::io::Error) -> String {
    let text = error.to_string();
    let text = text.split(" (os error").next().unwrap_or_default();
    let mut chars = text.chars();
    chars.next().map(|first| first.to_lowercase().chain(chars).collect()).unwrap_or_default()
}

/// A time in seconds.
pub mod seconds {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};
    use std::time::Duration;

    /// Writes a time.
    ///
    /// # Errors
    /// The errors of the serialiser.
    pub fn serialize<S: Serializer>(time: &Duration, to: S) -> Result<S::Ok, S::Error> {
        if to.is_human_readable() { to.serialize_f64(time.as_secs_f64()) } else { time.serialize(to) }
    }

    /// Reads a time.
    ///
    /// # Errors
    /// If the value is not a time, or negative.
    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Duration, D::Error> {
        if !from.is_human_readable() {
            return Duration::deserialize(from);
        }
        Duration::try_from_secs_f64(f64::deserialize(from)?).map_err(serde::de::Error::custom)
    }
}

/// A time in seconds that may be unknown.
pub mod seconds_if_known {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};
    use std::time::Duration;

    #[derive(Serialize, Deserialize)]
    struct Known(#[serde(with = "super::seconds")] Duration);

    /// Writes a time.
    ///
    /// # Errors
    /// The errors of the serialiser.
    pub fn serialize<S: Serializer>(time: &Option<Duration>, to: S) -> Result<S::Ok, S::Error> {
        time.map(Known).serialize(to)
    }

    /// Reads a time.
    ///
    /// # Errors
    /// If the value is not a time, or negative.
    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Duration>, D::Error> {
        Ok(Option::<Known>::deserialize(from)?.map(|Known(time)| time))
    }
}

/// Milliseconds since 1970, as seconds.
pub mod millis {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};
    use std::time::Duration;

    /// Writes a date.
    ///
    /// # Errors
    /// The errors of the serialiser.
    pub fn serialize<S: Serializer>(millis: &u64, to: S) -> Result<S::Ok, S::Error> {
        if to.is_human_readable() {
            super::seconds::serialize(&Duration::from_millis(*millis), to)
        } else {
            millis.serialize(to)
        }
    }

    /// Reads a date.
    ///
    /// # Errors
    /// If the value is not a date, or before 1970.
    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<u64, D::Error> {
        if !from.is_human_readable() {
            return u64::deserialize(from);
        }
        let time = super::seconds::deserialize(from)?.saturating_add(Duration::from_micros(500));
        u64::try_from(time.as_millis()).map_err(serde::de::Error::custom)
    }
}

/// A number that identifies something.
pub mod hex {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    /// Writes a number.
    ///
    /// # Errors
    /// The errors of the serialiser.
    pub fn serialize<S: Serializer>(number: &u64, to: S) -> Result<S::Ok, S::Error> {
        if to.is_human_readable() { to.collect_str(&format_args!("{number:016x}")) } else { number.serialize(to) }
    }

    /// Reads a number.
    ///
    /// # Errors
    /// If the value is not such a number.
    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<u64, D::Error> {
        if !from.is_human_readable() {
            return u64::deserialize(from);
        }
        u64::from_str_radix(&String::deserialize(from)?, 16).map_err(serde::de::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use serde::{Deserialize, Serialize};
    use std::time::Duration;

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    struct Plain {
        at: Duration,
        heard: Option<Duration>,
        id: u64,
    }

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    struct Readable {
        #[serde(with = "super::seconds")]
        at: Duration,
        #[serde(with = "super::seconds_if_known")]
        heard: Option<Duration>,
        #[serde(with = "super::hex")]
        id: u64,
    }

    #[test]
    fn people_get_seconds_and_digits_and_the_wire_what_it_had() {
        let (at, heard, id) = (Duration::from_millis(22_100), Some(Duration::from_nanos(1)), 0xfedc_ba98_7654_3210);
        let readable = Readable { at, heard, id };
        let bytes = postcard::to_stdvec(&readable).unwrap();
        assert_eq!(bytes, postcard::to_stdvec(&Plain { at, heard, id }).unwrap());
        assert_eq!(postcard::from_bytes::<Readable>(&bytes).unwrap(), readable);
    }
}
