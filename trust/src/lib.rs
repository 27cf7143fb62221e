//! The members of a team, their rights, and the proofs of both: keys, certificates, revocations, signed requests,
//! invitations, sealed secrets, the audit log, and the policy of a node.
//!
//! This crate is pure: the time and random bytes are parameters, and everything to be written or sent is a result. No
//! function reads a clock, a file or a socket. The crate implements no cryptography of its own. Signatures are Ed25519,
//! secrets are sealed with X25519 and XChaCha20-Poly1305, passphrases are hashed with Argon2id, and hashes and derived
//! keys are BLAKE3. All data that is signed, sent or stored has one canonical form, a version and a longest size.
//!
//! A team begins with its key, [`team::Team::found`]. The key signs [`certificate::Certificate`]s of admins, and
//! admins sign the certificates of nodes and users, for example in the handshake of [`invite`]. A client sends a
//! [`team::Credential`], which a [`team::Judge`] checks offline. A [`request`] is signed end to end. Members that are
//! no longer trusted are in [`revocation::Revocations`].
//!
//! ```
//! use trust::certificate::{Certificate, Claims, DAY};
//! use trust::identity::{Entropy, SecretKeys};
//! use trust::name::UnixTime;
//! use trust::revocation::Revocations;
//! use trust::role::{Action, Role};
//! use trust::team::{Credential, Judge, Team};
//!
//! let mut entropy = Entropy::new(&[7; 32]); // here: 32 bytes from the system
//! let (root, ann) = (SecretKeys::generate(&mut entropy), SecretKeys::generate(&mut entropy));
//! let team = Team::found("acme".parse()?, &root);
//! let now = UnixTime(1_800_000_000);
//! let claims = Claims {
//!     team: team.id(),
//!     name: "ann".parse()?,
//!     role: Role::Operator,
//!     keys: *ann.public(),
//!     not_before: now,
//!     not_after: now.plus(30 * DAY),
//!     renewable_until: now.plus(365 * DAY),
//!     serial: entropy.bytes(),
//! };
//! let credential = Credential::new(Certificate::issue(claims, &root)?, None);
//! let judge = Judge { team: &team, revoked: &Revocations::default(), now, grace: 0 };
//! assert!(credential.require(Action::Stop, &judge).is_ok());
//! assert!(credential.require(Action::Deploy, &judge).is_err());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod audit;
pub mod bundle;
pub mod certificate;
pub mod delegation;
pub mod heads;
pub mod identity;
pub mod invite;
pub mod locked;
pub mod name;
pub mod policy;
pub mod renewal;
pub mod request;
pub mod revocation;
pub mod role;
pub mod seal;
pub mod statement;
pub mod team;
mod text;
mod wire;
pub mod wire_key;

pub use text::TextError;
pub use wire::FormError;
