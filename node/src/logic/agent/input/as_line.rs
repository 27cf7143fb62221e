//! A report of a shim in the log of inputs: the line that the shim writes.

use serde::de::Error as _;
use serde::{Deserialize as _, Deserializer, Serializer};
use shim::protocol::ShimReport;

pub(super) fn serialize<S: Serializer>(report: &ShimReport, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_str(report)
}

pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<ShimReport, D::Error> {
    let line = String::deserialize(deserializer)?;
    ShimReport::parse(&line).ok_or_else(|| D::Error::custom("no report of a shim"))
}
