//! Which directories a process of this host has locked, as a run's supervisor does with its own. Nothing is locked to find out.

use crate::root::Identity;
use std::collections::BTreeSet;
use std::fs::File;
use std::io::{BufRead, BufReader, Read};

/// Most bytes of the system's list that are read.
const MAX_BYTES: u64 = 4 << 20;

/// The inodes on which there is a lock.
#[derive(Clone, Debug, Default)]
pub(crate) struct Locks(BTreeSet<u64>);

impl Locks {
    /// Those of this moment; empty where the system has no list.
    pub(crate) fn now() -> Self {
        File::open("/proc/locks").map_or_else(|_| Self::default(), Self::parse)
    }

    /// Reads lines such as `1: FLOCK  ADVISORY  WRITE 1234 08:01:5678 0 EOF`.
    fn parse(list: impl Read) -> Self {
        let lines = BufReader::new(list.take(MAX_BYTES)).lines().map_while(Result::ok);
        let inode = |line: String| {
            let mut words = line.split_whitespace();
            words.find(|word| *word == "FLOCK")?;
            // File systems in layers give the device of one layer here and that of another to `stat`: only the inode counts.
            words.nth(3)?.rsplit(':').next()?.parse().ok()
        };
        Self(lines.filter_map(inode).collect())
    }

    /// Whether the file or directory is locked.
    pub(crate) fn hold(&self, identity: Identity) -> bool {
        self.0.contains(&identity.ino)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::root::{Below, Root};

    #[test]
    fn locks_of_directories_are_seen() {
        let place = tempfile::tempdir().unwrap();
        let identity = Root::new(place.path()).unwrap().dir(&Below::default()).unwrap().identity().unwrap();
        let held = File::open(place.path()).unwrap();
        held.try_lock().unwrap();
        assert!(Locks::now().hold(identity));
        drop(held);
        assert!(!Locks::now().hold(identity));
    }

    #[test]
    fn other_kinds_and_rubbish_are_no_locks() {
        let list = "1: FLOCK  ADVISORY  WRITE 77 08:01:5 0 EOF\n1: -> FLOCK ADVISORY READ 78 00:2a:6 0 EOF\n\
            2: POSIX  ADVISORY  WRITE 79 08:01:7 0 EOF\nFLOCK\n3: FLOCK a b c d:e:f";
        let locks = Locks::parse(list.as_bytes());
        assert_eq!(locks.0.into_iter().collect::<Vec<_>>(), [5, 6]);
    }
}
