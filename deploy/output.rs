//! Standard output and standard error, which may be closed or full.

use anyhow::{Context, Error, Result};
use std::fmt::Arguments;
use std::io::{Write, stderr, stdout};

/// Prints a line on standard output, as `println!` does, but hands a failure on to the caller with `?`.
macro_rules! outln {
    ($($line:tt)*) => {
        $crate::output::print(format_args!($($line)*))?
    };
}

/// A line on standard output.
pub(crate) fn print(line: Arguments<'_>) -> Result<()> {
    writeln!(stdout().lock(), "{line}").context("cannot write to standard output")
}

/// A line for the user on standard error. Nobody may be reading there: that is no reason for a run to end.
pub(crate) fn say(text: &str) {
    let _ = writeln!(stderr().lock(), "{text}");
}

/// What `error` says, and its causes, none of them twice.
pub(crate) fn words(error: &Error) -> String {
    let mut text = error.to_string();
    for cause in error.chain().skip(1).map(ToString::to_string) {
        // Many messages end with their cause's words already.
        if !text.ends_with(&cause) {
            text += &format!(": {cause}");
        }
    }
    text
}
