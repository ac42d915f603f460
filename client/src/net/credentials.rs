//! What a client shows to be let in, and whom it believes.

use escarp_proto::wire::MAX_TEXT;
use std::fmt;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// The variable of the environment that has the token.
pub const TOKEN_VARIABLE: &str = "ESCARP_TOKEN";

/// A token for the dataset, and a certificate authority of one's own. The token is not shown, not
/// even by `Debug`.
#[derive(Clone, Default, PartialEq, Eq)]
pub struct Credentials {
    /// Bearer token.
    token: Option<String>,
    /// A PEM file whose certificates are believed, in place of those that the system believes.
    pub ca: Option<PathBuf>,
}

/// A token that cannot be one. It is not shown.
#[derive(Debug, Error)]
pub enum TokenError {
    /// Its file cannot be read.
    #[error("the token's file {file}: {error}", file = .0.display(), error = .1)]
    Read(PathBuf, std::io::Error),
    /// It is empty, too long, or has characters that cannot be sent.
    #[error("{0} has no token: 1 to {MAX_TEXT} visible ASCII characters on one line are allowed")]
    Content(String),
}

impl Credentials {
    /// With the token in a file, else that in the environment (`variable`: its value), if any.
    /// Neither stands on a command line, which every user of a machine can read.
    ///
    /// # Errors
    /// [`TokenError`] if there is something else.
    pub fn read(
        file: Option<&Path>,
        variable: Option<String>,
        ca: Option<PathBuf>,
    ) -> Result<Credentials, TokenError> {
        let found = match (file, variable) {
            (Some(path), _) => {
                let text = std::fs::read_to_string(path);
                let text = text.map_err(|error| TokenError::Read(path.into(), error))?;
                Some((text, path.display().to_string()))
            }
            (None, Some(text)) => Some((text, TOKEN_VARIABLE.into())),
            (None, None) => None,
        };
        let token =
            found.map(|(text, place)| checked(text.trim()).ok_or(TokenError::Content(place)));
        Ok(Credentials {
            token: token.transpose()?,
            ca,
        })
    }

    /// The token.
    pub fn token(&self) -> Option<&str> {
        self.token.as_deref()
    }
}

fn checked(text: &str) -> Option<String> {
    let is_token =
        (1..=MAX_TEXT).contains(&text.len()) && text.chars().all(|c| c.is_ascii_graphic());
    is_token.then(|| text.to_owned())
}

impl fmt::Debug for Credentials {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Credentials")
            .field("token", &self.token.as_ref().map(|_| "not shown"))
            .field("ca", &self.ca)
            .finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(variable: &str) -> Result<Credentials, String> {
        Credentials::read(None, Some(variable.into()), None).map_err(|error| error.to_string())
    }

    #[test]
    fn a_token_is_one_line_of_visible_characters_and_is_not_shown() {
        let credentials = of("secret-token\n").unwrap();
        assert_eq!(credentials.token(), Some("secret-token"));
        assert!(!format!("{credentials:?}").contains("secret"));
        for wrong in [
            "",
            "two words",
            "two\nlines",
            "t\u{f6}ken",
            &"t".repeat(MAX_TEXT + 1),
        ] {
            let error = of(wrong).unwrap_err();
            assert!(
                error.starts_with("ESCARP_TOKEN has no token: 1 to "),
                "{error}"
            );
        }
        let missing = Credentials::read(Some(Path::new("/no/token")), None, None).unwrap_err();
        assert!(
            missing
                .to_string()
                .starts_with("the token's file /no/token: ")
        );
        assert_eq!(
            Credentials::read(None, None, None).unwrap(),
            Credentials::default()
        );
    }
}
