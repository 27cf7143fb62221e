//! A member's signed statement: a signature of the digest of a message. A credential proves the owner of the key.

use crate::identity::{PublicKeys, SIGNATURE_LEN, SecretKeys, has_signed};
use crate::wire::Writer;

const STATEMENT: &str = "dca statement 1";

/// Signs the digest of a message.
pub fn sign(digest: &[u8; 32], keys: &SecretKeys) -> [u8; SIGNATURE_LEN] {
    keys.sign(&form(digest))
}

/// Returns whether these keys have signed the digest of a message.
pub fn is_signed(digest: &[u8; 32], keys: &PublicKeys, signature: &[u8]) -> bool {
    <&[u8; SIGNATURE_LEN]>::try_from(signature).is_ok_and(|signature| keys.has_signed(&form(digest), signature))
}

/// Returns whether the secret key of this public Ed25519 key has signed the digest of a message.
pub(crate) fn is_signed_by(digest: &[u8; 32], key: &[u8; 32], signature: &[u8]) -> bool {
    <&[u8; SIGNATURE_LEN]>::try_from(signature).is_ok_and(|signature| has_signed(key, &form(digest), signature))
}

fn form(digest: &[u8; 32]) -> Vec<u8> {
    let mut writer = Writer::new(STATEMENT);
    writer.fixed(digest);
    writer.finish()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identity::Entropy;

    #[test]
    fn a_statement_is_of_one_key_and_one_digest() {
        let [own, other] = [1, 2].map(|seed| SecretKeys::generate(&mut Entropy::new(&[seed; 32])));
        let signature = sign(&[3; 32], &own);
        assert!(is_signed(&[3; 32], own.public(), &signature));
        assert!(is_signed_by(&[3; 32], own.public().signing(), &signature));
        assert!(!is_signed_by(&[3; 32], other.public().signing(), &signature));
        assert!(!is_signed(&[4; 32], own.public(), &signature));
        assert!(!is_signed(&[3; 32], other.public(), &signature));
        assert!(!is_signed(&[3; 32], own.public(), &signature[..63]));
        // A signature without the name of the form in front is not a statement.
        assert!(!is_signed(&[3; 32], own.public(), &own.sign(&[3; 32])));
    }
}
