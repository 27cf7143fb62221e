//! Reads the secrets that a node gives to a program. They come as files in memory when the program
//! is started, and over the control channel when they change.

use crate::sdk::arguments::{Arguments, SECRET_MAX, Secret};
use std::fs::File;
use std::io::{self, Read as _};
use zeroize::Zeroizing;

impl Arguments {
    /// Reads a secret parameter; the returned bytes are wiped when they are dropped. If a secret has changed in the
    /// database, the new value comes with [`Controller::configure`], like every other parameter.
    ///
    /// [`Controller::configure`]: crate::sdk::Controller::configure
    ///
    /// # Errors
    /// If its file cannot be read or has more than 64 KiB, or if the type does not declare this parameter.
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
