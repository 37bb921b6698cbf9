//! Exit statuses beyond success (0), failure (1) and wrong arguments (2).

/// A process whose supervisor is gone.
pub(crate) const ORPHANED: u8 = 3;
/// A process that lost another one of its run: that one is to blame.
pub(crate) const LOST_PEER: u8 = 4;
/// A relay that lost another host: its last line says why.
pub(crate) const LOST_HOST: u8 = 5;
/// A training that Ctrl-C ended, as shells have it: 128 + SIGINT.
pub(crate) const INTERRUPTED: u8 = 130;
/// A process that was told to leave, as shells have it: 128 + SIGTERM. It is what a mentor-server ends with; before the
/// learner's end it is a failure of the run.
pub(crate) const TOLD: u8 = 143;

/// What a command ends with. Unlike [`std::process::ExitCode`] it can be read, for a caller that is no process of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct ExitCode(u8);

impl ExitCode {
    pub(crate) const SUCCESS: Self = Self(0);
}

impl From<u8> for ExitCode {
    fn from(status: u8) -> Self {
        Self(status)
    }
}

impl From<ExitCode> for u8 {
    fn from(code: ExitCode) -> Self {
        code.0
    }
}
