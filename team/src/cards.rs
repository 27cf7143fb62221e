//! The credentials of other nodes, by their signing keys, so that later messages do not have to contain them.

use comms::io::session::{Author, Digest, PublicKey};
use comms::logic::proof::Proof;
use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};
use trust::certificate::Certificate;
use trust::name::UnixTime;
use trust::renewal;
use trust::role::Kind;
use trust::statement;
use trust::team::{Credential, Judge};

/// How many credentials are kept. Only credentials of the team are kept, so there are at most as many as nodes.
const CARDS_MAX: usize = 1024;
/// For how many seconds a member counts as trusted before its certificate is checked again.
const JUDGED_FOR: u64 = 5;

/// The credentials of others.
#[derive(Debug, Default)]
pub(crate) struct Cards(Mutex<BTreeMap<PublicKey, Card>>);

#[derive(Debug)]
struct Card {
    credential: Credential,
    /// When the certificate was last found to be trusted.
    judged: Option<UnixTime>,
}

impl Cards {
    /// Stores the credential of a trusted node.
    pub(crate) fn note(&self, credential: &Credential) {
        let key = *credential.certificate().claims().keys.signing();
        let mut cards = self.cards();
        if cards.len() < CARDS_MAX || cards.contains_key(&key) {
            cards.insert(key, Card { credential: credential.clone(), judged: Some(crate::now()) });
        }
    }

    /// Returns a credential of the same holder that is valid for longer, if one is stored.
    pub(crate) fn newer(&self, credential: &Credential, judge: &Judge<'_>) -> Option<Credential> {
        let key = *credential.certificate().claims().keys.signing();
        let known = self.cards().get(&key)?.credential.clone();
        let is_other = known != *credential && known.chain == credential.chain;
        (is_other && renewal::end(&known, judge) > renewal::end(credential, judge)).then_some(known)
    }

    /// Returns all known credentials.
    pub(crate) fn all(&self) -> Vec<Credential> {
        self.cards().values().map(|card| card.credential.clone()).collect()
    }

    /// Makes every credential be checked again, because a key was revoked.
    pub(crate) fn judge_again(&self) {
        self.cards().values_mut().for_each(|card| card.judged = None);
    }

    /// Returns the node that has signed a digest. The node of this machine, whose certificate is `own`, is trusted here even if it is
    /// revoked: the team refuses the node, but not the users at its machine.
    pub(crate) fn check(
        &self,
        own: &Certificate,
        proof: &Proof,
        digest: &Digest,
        judge: impl Fn(&Credential) -> Result<(), String>,
    ) -> Author {
        let own = own.claims();
        if proof.key == *own.keys.signing() && statement::is_signed(digest, &own.keys, &proof.signature) {
            return Author::Member(own.name.to_string());
        }
        match self.name(proof, digest, judge) {
            Ok(Some(name)) => Author::Member(name),
            Ok(None) => Author::Stranger,
            Err(why) => Author::Nobody(why),
        }
    }

    /// Returns the name of the signer; none if the owner of the key is unknown.
    fn name(
        &self,
        proof: &Proof,
        digest: &Digest,
        judge: impl Fn(&Credential) -> Result<(), String>,
    ) -> Result<Option<String>, String> {
        let now = crate::now();
        if let Some(shown) = &proof.credential {
            let credential = Credential::from_bytes(shown).map_err(|error| format!("its credential: {error}"))?;
            let claims = credential.certificate().claims();
            if *claims.keys.signing() != proof.key || credential.certificate().kind() != Kind::Node {
                return Err("its credential belongs to another key".to_owned());
            }
            if self.cards().get(&proof.key).is_none_or(|card| card.credential != credential) {
                judge(&credential)?;
                self.note(&credential);
            }
        }
        let mut cards = self.cards();
        let Some(card) = cards.get_mut(&proof.key) else { return Ok(None) };
        if card.judged.is_none_or(|at| now.0.abs_diff(at.0) >= JUDGED_FOR) {
            judge(&card.credential)?;
            card.judged = Some(now);
        }
        let claims = card.credential.certificate().claims();
        let (keys, name) = (claims.keys, claims.name.to_string());
        drop(cards);
        if statement::is_signed(digest, &keys, &proof.signature) {
            Ok(Some(name))
        } else {
            Err(format!("its signature was not made by `{name}`"))
        }
    }

    fn cards(&self) -> MutexGuard<'_, BTreeMap<PublicKey, Card>> {
        // A card is inserted as a whole, so the map is valid even after a panic.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
