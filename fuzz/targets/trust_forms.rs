//! Bytes from a stranger: certificates, credentials, revocations, sealed values, joining messages. A value that can be
//! read is rewritten as the same bytes. The first byte selects the form.
#![no_main]

use libfuzzer_sys::fuzz_target;
use trust::audit::Head;
use trust::certificate::{Certificate, Renewal};
use trust::delegation::Delegation;
use trust::invite::Message;
use trust::locked::LockedKeys;
use trust::revocation::RevokedSet;
use trust::seal::Sealed;
use trust::team::{Credential, Team};

fuzz_target!(|bytes: &[u8]| {
    let Some((kind, bytes)) = bytes.split_first() else { return };
    let again = match kind % 10 {
        0 => Certificate::from_bytes(bytes).map(|read| read.to_bytes()),
        1 => Renewal::from_bytes(bytes).map(|read| read.to_bytes()),
        2 => Credential::from_bytes(bytes).map(|read| read.to_bytes()),
        3 => RevokedSet::from_bytes(bytes).map(|read| read.to_bytes()),
        4 => Sealed::from_bytes(bytes).map(|read| read.to_bytes()),
        5 => LockedKeys::from_bytes(bytes).map(|read| read.to_bytes()),
        6 => Message::from_bytes(bytes).map(|read| read.to_bytes()),
        7 => Team::from_bytes(bytes).map(|read| read.to_bytes()),
        8 => Delegation::from_bytes(bytes).map(|read| read.to_bytes()),
        _ => Head::from_bytes(bytes).map(|read| read.to_bytes()),
    };
    assert!(again.is_err() || again.as_deref() == Ok(bytes), "a value has one form");
});
