//! The time zone of this machine, read by the C library, which also knows the rules for later years. No safe crate in use does
//! this.

/// Returns by how many minutes local time is ahead of UTC at a moment; 0 if the C library does not know.
#[expect(unsafe_code, reason = "no crate in use has a safe signature for localtime_r")]
pub(super) fn minutes_ahead(millis: u64) -> i64 {
    // Its type is the one of the C library.
    let Ok(seconds) = (millis / 1000).try_into() else { return 0 };
    // SAFETY: `tm` is a plain C structure of integers and a pointer, for which all zeros are a valid value.
    let mut here: libc::tm = unsafe { std::mem::zeroed() };
    // SAFETY: both pointers are valid for the call. The library guards its zone with a lock; nothing in this program sets `TZ`.
    let is_known = unsafe { !libc::localtime_r(&raw const seconds, &raw mut here).is_null() };
    if is_known { here.tm_gmtoff / 60 } else { 0 }
}
