//! Standard output and standard error, which may be closed or full.

use anyhow::{Context, Error, Result};
use nix::errno::Errno;
use nix::sys::resource::{RLIM_INFINITY, Resource, getrlimit};
use std::fmt::Arguments;
use std::io::{self, Write, stderr, stdout};

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

/// What `error` says, and its causes, none of them twice. Where the cause is a limit of the shell's, also which.
pub(crate) fn words(error: &Error) -> String {
    let mut text = error.to_string();
    for cause in error.chain().skip(1).map(ToString::to_string) {
        // Many messages have their cause's words in them already.
        if !text.contains(&cause) {
            text += &format!(": {cause}");
        }
    }
    let errno = |cause: &(dyn std::error::Error + 'static)| cause.downcast_ref::<io::Error>()?.raw_os_error();
    let limit = match error.chain().find_map(errno).map(Errno::from_raw) {
        Some(Errno::EFBIG) => " (ulimit -f)",
        Some(Errno::EMFILE) => " (ulimit -n)",
        // Of a process or thread that could not be started; nothing else here can be tried again.
        // A thread's stack may have had no room.
        Some(Errno::EAGAIN) if bounded_space() => " (ulimit -u or -v)",
        Some(Errno::EAGAIN) => " (ulimit -u)",
        Some(Errno::ENOMEM) if bounded_space() => " (ulimit -v)",
        _ => "",
    };
    bounded(text) + limit
}

/// Whether the address space of this process is limited.
fn bounded_space() -> bool {
    getrlimit(Resource::RLIMIT_AS).is_ok_and(|(soft, _)| soft != RLIM_INFINITY)
}

/// Longest message of a failure that is shown whole, characters: several screens.
const MAX_WORDS: usize = 4000;
/// What is shown of the end of a longer one.
const END: usize = 1000;

/// `text`, without its middle where it is long. Data of the user's can be in it, such as the names of a million columns.
fn bounded(text: String) -> String {
    let count = text.chars().count();
    if count <= MAX_WORDS {
        return text;
    }
    let begin: String = text.chars().take(MAX_WORDS - END).collect();
    let end: String = text.chars().skip(count - END).collect();
    format!("{begin} ... [{} characters are left out] ... {end}", count - MAX_WORDS)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flood_of_words_loses_its_middle() {
        let names: Vec<String> = (0..1_000_000).map(|i| format!("column_{i}")).collect();
        let said = words(&Error::msg(format!("`x`; accepted: {}; what else", names.join(", "))));
        assert!(said.len() < MAX_WORDS + 100, "{}", said.len());
        assert!(said.starts_with("`x`; accepted: column_0, ") && said.ends_with("column_999999; what else"));
        assert!(said.contains("characters are left out"));
        let exact = "ä".repeat(MAX_WORDS);
        assert_eq!(words(&Error::msg(exact.clone())), exact);
    }

    #[test]
    fn nothing_is_said_twice() {
        let cause = || Error::msg("ff is a pipe");
        assert_eq!(words(&cause().context("cannot read ff")), "cannot read ff: ff is a pipe");
        assert_eq!(words(&cause().context("ff is a pipe; try a file")), "ff is a pipe; try a file");
    }

    #[test]
    fn a_limit_of_the_shell_is_named() {
        let said = |errno: Errno| words(&Error::from(io::Error::from(errno)).context("cannot write x.csv"));
        assert!(said(Errno::EFBIG).starts_with("cannot write x.csv: File too large"));
        assert!(said(Errno::EFBIG).ends_with("(ulimit -f)") && said(Errno::EMFILE).ends_with("(ulimit -n)"));
        assert!(!said(Errno::ENOSPC).contains("ulimit"));
    }
}
