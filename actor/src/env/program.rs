//! The program that this process is of: its build, and how it is started again.

use std::sync::OnceLock;

/// A program that is its process's executable file.
const SELF: &str = "/proc/self/exe";

/// The program that a process is of.
#[derive(Clone, Debug)]
pub struct Identity {
    /// What tells its sources from all others.
    pub build: &'static str,
    /// The command that starts it again, to which a subcommand is added. Empty where that is the process's executable file.
    pub again: Vec<String>,
}

static IDENTITY: OnceLock<Identity> = OnceLock::new();

/// Says which program this process is of, once, at its start.
///
/// # Errors
/// It has been said before; `identity` comes back.
pub fn identify(identity: Identity) -> Result<(), Identity> {
    IDENTITY.set(identity)
}

/// What tells the sources of this program from all others; nothing where nobody has said it.
pub fn build() -> &'static str {
    IDENTITY.get().map_or("", |identity| identity.build)
}

/// The command that starts this program again. Its executable file is meant even if it has been replaced since: a run is never
/// carried on by another version by accident.
pub fn again() -> Vec<String> {
    match IDENTITY.get() {
        Some(identity) if !identity.again.is_empty() => identity.again.clone(),
        _ => vec![SELF.into()],
    }
}
