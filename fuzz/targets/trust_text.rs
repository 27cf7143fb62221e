//! Texts that people copy, and manipulated files: the line of an invitation, a key, a bundle, a policy, an audit log.
#![no_main]

use libfuzzer_sys::fuzz_target;
use trust::audit::{Head, Verifier};
use trust::bundle::Bundle;
use trust::heads::Heads;
use trust::identity::PublicKeys;
use trust::invite::Invite;
use trust::policy::Policy;

fuzz_target!(|text: &str| {
    if let Ok(invite) = Invite::from_line(text) {
        let line = invite.to_line();
        let again = Invite::from_line(&line).expect("what was written can be read");
        assert_eq!((again.team, &again.addresses), (invite.team, &invite.addresses));
    }
    if let Ok(bundle) = Bundle::from_text(text) {
        let again = Bundle::from_text(&bundle.to_text()).expect("what was written can be read");
        assert_eq!(again, bundle);
    }
    if let Ok(heads) = Heads::from_text(text) {
        assert_eq!(Heads::from_text(&heads.to_text()), Ok(heads));
    }
    drop((PublicKeys::from_text(text), Head::from_text(text), Policy::parse(text)));
    let mut verifier = Verifier::new(Vec::new()).expect("no heads are not too many");
    if text.lines().try_for_each(|line| verifier.line(line)).is_ok() {
        drop(verifier.finish());
    }
});
