//! Reads the secrets that a node hands to a program: as files in memory when it is started, and over the control channel when they
//! change.

use crate::sdk::arguments::{Arguments, SECRET_MAX, Secret};
use std::fs::File;
use std::io::{self, Read as _};
use zeroize::Zeroizing;

impl Arguments {
    /// Reads a secret parameter; what is returned is wiped when it is dropped. A secret that has changed in the database comes with
    /// [`Controller::configure`], like every other parameter.
    ///
    /// [`Controller::configure`]: crate::sdk::Controller::configure
    ///
    /// # Errors
    /// Its file cannot be read, has more than 64 KiB, or the type declares no such parameter.
    pub fn secret(&self, name: &str) -> io::Result<Zeroizing<Vec<u8>>> {
        let path = match self.place_of_secret(name) {
            Some(Secret::File(path)) => path,
            Some(Secret::Renewed(value)) => return Ok(Zeroizing::new(value.expose().to_vec())),
            None => {
                return Err(io::Error::new(io::ErrorKind::NotFound, format!("no parameter `{name}` is a secret")));
            }
        };
        // Allocated at full size from the start: a buffer that grows leaves copies behind.
        let mut secret = Zeroizing::new(Vec::with_capacity(SECRET_MAX + 1));
        File::open(path)?.take(SECRET_MAX as u64 + 1).read_to_end(&mut secret)?;
        if secret.len() > SECRET_MAX { Err(io::ErrorKind::FileTooLarge.into()) } else { Ok(secret) }
    }
}
