//! Tokens: what a client shows to be let in. The server keeps only their SHA-256, which is of no use to whoever reads it.
//!
//! Tokens are random and long, so a fast hash is enough; a password that somebody made up is not one.

use std::fmt;

use ring::digest::{SHA256, digest};
use ring::rand::{SecureRandom, SystemRandom};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use subtle::{Choice, ConstantTimeEq};

/// Bytes of a hash, and random bytes of a token.
const BYTES: usize = 32;
/// What tokens begin with, so that whoever finds one knows what it is.
const PREFIX: &str = "stereod_";

/// The SHA-256 of a token. It is never shown: not as text, not in logs, not in the effective configuration.
#[derive(Clone)]
pub struct TokenHash(Option<[u8; BYTES]>);

impl TokenHash {
    /// The hash of `token`.
    #[must_use]
    pub fn of(token: &[u8]) -> Self {
        Self(digest(&SHA256, token).as_ref().try_into().ok())
    }

    /// Whether this was 64 hexadecimal digits in the file. If not, it is equal to nothing.
    #[must_use]
    pub fn is_well_formed(&self) -> bool {
        self.0.is_some()
    }

    /// Whether both are the same, in a time that does not depend on where they differ.
    #[must_use]
    pub fn is(&self, other: &Self) -> Choice {
        match (&self.0, &other.0) {
            (Some(one), Some(other)) => one.ct_eq(other),
            _ => Choice::from(0),
        }
    }

    /// The hash as the configuration file has it.
    fn to_hex(&self) -> String {
        hex(self.0.as_ref().map_or(&[], <[u8; BYTES]>::as_slice))
    }
}

impl PartialEq for TokenHash {
    fn eq(&self, other: &Self) -> bool {
        self.is(other).into()
    }
}

impl Eq for TokenHash {}

impl fmt::Debug for TokenHash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("TokenHash(not shown)")
    }
}

impl Serialize for TokenHash {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str("not shown")
    }
}

impl<'de> Deserialize<'de> for TokenHash {
    /// Never fails at a string: the error would show it, and it may be the token itself that somebody has put here.
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Ok(Self(unhex(&String::deserialize(deserializer)?)))
    }
}

/// A new token, for the only time that it is shown.
pub struct NewToken(String);

impl NewToken {
    /// 256 random bits from the system.
    ///
    /// # Errors
    /// If the system has none.
    pub fn new() -> Result<Self, NoRandomness> {
        let mut secret = [0; BYTES];
        SystemRandom::new().fill(&mut secret).map_err(|_| NoRandomness)?;
        Ok(Self(format!("{PREFIX}{}", hex(&secret))))
    }

    /// What to give to the client called `name`, and what to write into the server's file.
    #[must_use]
    pub fn instructions(&self, name: &str) -> String {
        let hash = TokenHash::of(self.0.as_bytes()).to_hex();
        format!(
            "# For {name} alone, who shows it with every request; it can't be shown again:\n{}\n\n\
             # For the server's configuration file (stereod serve --config FILE):\n[clients.{name}]\ntoken_sha256 = \"{hash}\"\n",
            self.0
        )
    }
}

/// The system gives no random numbers.
#[derive(Debug, thiserror::Error)]
#[error("the system gives no random numbers: make a token on another machine")]
pub struct NoRandomness;

fn hex(bytes: &[u8]) -> String {
    use std::fmt::Write as _;
    bytes.iter().fold(String::new(), |mut text, byte| {
        // Writing to a string can't fail.
        let _ = write!(text, "{byte:02x}");
        text
    })
}

fn unhex(text: &str) -> Option<[u8; BYTES]> {
    if text.len() != 2 * BYTES || !text.bytes().all(|byte| byte.is_ascii_hexdigit()) {
        return None;
    }
    let mut bytes = [0; BYTES];
    for (byte, digits) in bytes.iter_mut().zip(text.as_bytes().chunks(2)) {
        *byte = u8::from_str_radix(std::str::from_utf8(digits).ok()?, 16).ok()?;
    }
    Some(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_token_is_known_by_what_is_written_into_the_file() {
        let token = NewToken::new().unwrap();
        let text = token.instructions("lab");
        let hash = text.split('"').nth(1).unwrap();
        let read: TokenHash = serde_json::from_value(hash.into()).unwrap();
        assert_eq!(read, TokenHash::of(token.0.as_bytes()));
        assert_ne!(read, TokenHash::of(b"another"));
        assert!(token.0.starts_with(PREFIX) && token.0.len() == PREFIX.len() + 64);
        assert!(text.lines().any(|line| line == token.0) && text.contains("[clients.lab]"));
        assert_ne!(NewToken::new().unwrap().0, token.0);
    }

    #[test]
    fn the_hash_is_the_one_that_everybody_else_makes() {
        let abc = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(TokenHash::of(b"abc").to_hex(), abc);
    }

    #[test]
    fn a_hash_is_never_shown_and_a_malformed_one_is_equal_to_nothing() {
        let hash = TokenHash::of(b"abc");
        let shown = format!("{hash:?} {}", serde_json::to_string(&hash).unwrap());
        assert!(!shown.contains("ba78") && !shown.contains("186, 120"), "{shown}");
        let malformed: TokenHash = serde_json::from_value("secret".into()).unwrap();
        assert!(!malformed.is_well_formed());
        assert_ne!(malformed, malformed.clone());
    }
}
