//! Asks the kernel about its calendar clock. No safe crate of this workspace has `adjtimex`.
//!
//! The service that disciplines the clock (chrony with `rtcsync`, ntpd, ptp4l with phc2sys, systemd-timesyncd) clears
//! the flag `STA_UNSYNC`. The kernel sets it again by itself once its estimated error exceeds 16 s, about nine hours
//! after the service's last correction. Source: adjtimex(2), Linux `kernel/time/ntp.c`.

/// Returns whether a service keeps the calendar clock synchronised; `None` if the kernel does not report it.
pub(super) fn is_kept() -> Option<bool> {
    let timex = read()?;
    Some(timex.status & libc::STA_UNSYNC == 0)
}

#[expect(unsafe_code, reason = "no crate in use has a safe signature for adjtimex")]
fn read() -> Option<libc::timex> {
    // SAFETY: `timex` is a plain C structure of integers, for which all zeros are a valid value.
    let mut timex: libc::timex = unsafe { std::mem::zeroed() };
    // SAFETY: the pointer is valid for the call, and the kernel writes no more than the structure. `modes` is 0, so nothing is set.
    let state = unsafe { libc::adjtimex(&raw mut timex) };
    (state >= 0).then_some(timex)
}
