//! Shared memory and a disk of little size that a thread and the processes it starts have for themselves, and somebody who
//! takes all the room there is.

use crate::util::{Place, available};
use nix::mount::{MsFlags, mount};
use nix::sched::{CloneFlags, unshare};
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

/// Where shared memory lies.
pub(crate) const SHARED_MEMORY: &str = "/dev/shm";
/// Enough for a run of the tests and its checkpoints, and full in a moment.
const SIZE: &str = "size=32m,nr_inodes=4k";
/// Whatever is left of a file system's room, and its name.
const HOG: &str = "full";

/// Whether [`have_own`] works here; says so where it does not.
pub(crate) fn can_have_own() -> bool {
    available(&["unshare", "--mount", "sh", "-c", "mount -t tmpfs tmpfs /dev/shm"])
}

/// Gives this thread, and every process that it starts from now on, a shared memory of its own and a disk of its own, which
/// holds `place`. They go with the thread and these processes.
pub(crate) fn have_own(place: &Place) {
    let none = None::<&str>;
    let own = |target: &Path| {
        mount(Some("tmpfs"), target, Some("tmpfs"), MsFlags::empty(), Some(SIZE)).unwrap();
    };
    unshare(CloneFlags::CLONE_NEWNS).unwrap();
    // Or all others would get it, too.
    mount(none, "/", none, MsFlags::MS_REC | MsFlags::MS_PRIVATE, none).unwrap();
    own(Path::new(SHARED_MEMORY));
    own(place.root());
}

/// Somebody who takes all the room of a file system, and gives it back when he goes.
#[derive(Debug)]
pub(crate) struct Hog {
    dir: PathBuf,
    file: File,
    /// Empty files, where those are to run out as well.
    files: Option<u32>,
}

impl Hog {
    /// Takes the room of the file system at `place`, and the right to make files there if `files` says so.
    pub(crate) fn new(place: &Path, files: bool) -> Self {
        let dir = place.join(HOG);
        fs::create_dir(&dir).unwrap();
        let file = File::create(dir.join("bytes")).unwrap();
        let mut hog = Self { dir, file, files: files.then_some(0) };
        hog.take();
        hog
    }

    /// Takes what has become free meanwhile.
    pub(crate) fn take(&mut self) {
        // It ends when there is no room.
        io::copy(&mut io::repeat(0), &mut self.file).unwrap_err();
        while let Some(n) = &mut self.files
            && File::create(self.dir.join(n.to_string())).is_ok()
        {
            *n += 1;
        }
    }
}

impl Drop for Hog {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.dir);
    }
}
