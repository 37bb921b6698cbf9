//! The C library's calls, as simulated threads find them.
//!
//! The program calls the system through the C library. Its functions that touch files, locks, threads, the clock or a process's
//! identity are defined here once more, and the linker prefers these. A thread that is not simulated gets what it would
//! otherwise get. A simulated one gives way first, may meet a fault, and is then served by the real system on a file
//! system in memory, where `/dev/shm` is a directory of its world's. What it changes is told to the model of the disk.

#![allow(unsafe_code)]

use super::DISK;
use super::disk::Change;
use super::schedule::Flaw;
use super::world::{On, Place, here, next_thread, within};
use libc::{
    AT_EMPTY_PATH, AT_FDCWD, DIR, EIO, ENOENT, O_CREAT, SYS_chmod, SYS_clock_nanosleep, SYS_fdatasync,
    SYS_flock, SYS_fsync, SYS_ftruncate, SYS_getpid, SYS_linkat, SYS_mkdir, SYS_openat, SYS_readlink,
    SYS_renameat, SYS_rmdir, SYS_statx, SYS_symlink, SYS_unlink, SYS_unlinkat, SYS_write, c_char, c_int,
    c_long, c_uint, c_void, clockid_t, mode_t, off64_t, pid_t, pthread_attr_t, pthread_t, size_t, ssize_t,
    timespec,
};
use std::borrow::Cow;
use std::ffi::{CStr, CString, OsStr};
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

const SHM: &[u8] = b"/dev/shm";

fn fail(errno: c_int) -> c_int {
    // SAFETY: the address is this thread's own.
    unsafe { *libc::__errno_location() = errno };
    -1
}

/// What path a simulated thread means. None: there is nothing.
fn mapped<'a>(place: &Place, path: &'a CStr) -> Option<Cow<'a, CStr>> {
    let bytes = path.to_bytes();
    if bytes.starts_with(b"/proc") {
        return None;
    }
    let Some(rest) = bytes.strip_prefix(SHM).filter(|rest| rest.is_empty() || rest[0] == b'/') else {
        return Some(Cow::Borrowed(path));
    };
    if bytes.starts_with(place.world.root.as_os_str().as_bytes()) {
        return Some(Cow::Borrowed(path));
    }
    let path = [place.world.root.as_os_str().as_bytes(), b"/shm", rest].concat();
    CString::new(path).ok().map(Cow::Owned)
}

/// The path of an argument.
///
/// # Safety
/// As the C library's functions require of theirs.
unsafe fn path_of<'a>(path: *const c_char) -> &'a CStr {
    // SAFETY: the caller's promise.
    unsafe { CStr::from_ptr(path) }
}

fn as_path(path: &CStr) -> &Path {
    Path::new(OsStr::from_bytes(path.to_bytes()))
}

/// What is behind a descriptor.
fn of_descriptor(fd: c_int) -> Option<PathBuf> {
    std::fs::read_link(format!("/proc/self/fd/{fd}")).ok()
}

/// Gives way before a call. The call fails where the process has ended meanwhile.
fn before(place: &Place, what: &'static str) -> Result<(), c_int> {
    if place.world.step(place.thread, what) { Ok(()) } else { Err(EIO) }
}

/// The errno with which the disk refuses to change `path`, if it does.
fn refused(place: &Place, what: &'static str, path: &Path) -> Option<c_int> {
    let mut state = place.world.lock();
    let role = state.processes[state.process_of(place.thread)].role;
    let (broken, calls, errno) = state.broken?;
    if broken != role || !path.starts_with(place.world.root.join(DISK)) {
        return None;
    }
    state.broken = (calls > 1).then_some((broken, calls - 1, errno));
    state.note(|| format!("{role:?}: {what} of {} fails with {errno}", path.display()));
    Some(errno)
}

/// Tells the disk what has changed.
fn after(place: &Place, change: &Change<'_>) {
    let mut state = place.world.lock();
    let process = state.process_of(place.thread);
    state.has_changed(process, change);
}

// SAFETY of all the functions that follow: each has the signature of the C library's function of its name, except that those with
// optional arguments always have them (the calling conventions of Linux pass them alike), and asks of its arguments what
// that asks. The system calls they make are those that the C library would make.

macro_rules! through {
    ($number:expr $(, $arg:expr)*) => {
        // SAFETY: see above.
        unsafe { libc::syscall($number $(, $arg)*) }
    };
}

fn open_at(dir: c_int, path: *const c_char, flags: c_int, mode: mode_t) -> c_int {
    let flags = flags | libc::O_LARGEFILE;
    let open = |path: *const c_char| through!(SYS_openat, dir, path, flags, mode) as c_int;
    let Some(place) = here() else { return open(path) };
    // SAFETY: see above.
    let typed = unsafe { path_of(path) };
    let creates = flags & O_CREAT != 0;
    if let Err(errno) = before(place, if creates { "create" } else { "open" }) {
        return fail(errno);
    }
    let Some(path) = mapped(place, typed) else { return fail(ENOENT) };
    if creates && let Some(errno) = refused(place, "create", as_path(&path)) {
        return fail(errno);
    }
    let fd = open(path.as_ptr());
    if fd >= 0 && creates && dir == AT_FDCWD {
        after(place, &Change::Made { path: as_path(&path) });
    }
    fd
}

#[unsafe(no_mangle)]
extern "C" fn open64(path: *const c_char, flags: c_int, mode: mode_t) -> c_int {
    open_at(AT_FDCWD, path, flags, mode)
}

#[unsafe(no_mangle)]
extern "C" fn open(path: *const c_char, flags: c_int, mode: mode_t) -> c_int {
    open_at(AT_FDCWD, path, flags, mode)
}

#[unsafe(no_mangle)]
extern "C" fn openat64(dir: c_int, path: *const c_char, flags: c_int, mode: mode_t) -> c_int {
    open_at(dir, path, flags, mode)
}

#[unsafe(no_mangle)]
extern "C" fn openat(dir: c_int, path: *const c_char, flags: c_int, mode: mode_t) -> c_int {
    open_at(dir, path, flags, mode)
}

/// A call that changes the entry at one path.
fn at_path(
    path: *const c_char,
    what: &'static str,
    call: impl Fn(*const c_char) -> c_int,
    change: impl for<'a> Fn(&'a Path) -> Change<'a>,
) -> c_int {
    let Some(place) = here() else { return call(path) };
    if let Err(errno) = before(place, what) {
        return fail(errno);
    }
    // SAFETY: see above.
    let Some(path) = mapped(place, unsafe { path_of(path) }) else { return fail(ENOENT) };
    if let Some(errno) = refused(place, what, as_path(&path)) {
        return fail(errno);
    }
    let change = change(as_path(&path));
    place.world.lock().disk.before(&change);
    let outcome = call(path.as_ptr());
    if outcome == 0 {
        after(place, &change);
    }
    outcome
}

#[unsafe(no_mangle)]
extern "C" fn mkdir(path: *const c_char, mode: mode_t) -> c_int {
    let call = |path: *const c_char| through!(SYS_mkdir, path, mode) as c_int;
    at_path(path, "mkdir", call, |path| Change::Made { path })
}

#[unsafe(no_mangle)]
extern "C" fn unlink(path: *const c_char) -> c_int {
    at_path(path, "unlink", |path| through!(SYS_unlink, path) as c_int, |path| Change::Removed { path })
}

#[unsafe(no_mangle)]
extern "C" fn rmdir(path: *const c_char) -> c_int {
    at_path(path, "rmdir", |path| through!(SYS_rmdir, path) as c_int, |path| Change::Removed { path })
}

#[unsafe(no_mangle)]
extern "C" fn chmod(path: *const c_char, mode: mode_t) -> c_int {
    at_path(path, "chmod", |path| through!(SYS_chmod, path, mode) as c_int, |_| Change::Other)
}

#[unsafe(no_mangle)]
extern "C" fn symlink(target: *const c_char, path: *const c_char) -> c_int {
    let call = |path: *const c_char| through!(SYS_symlink, target, path) as c_int;
    at_path(path, "symlink", call, |path| Change::Made { path })
}

#[unsafe(no_mangle)]
extern "C" fn unlinkat(dir: c_int, path: *const c_char, flags: c_int) -> c_int {
    let call = |path: *const c_char| through!(SYS_unlinkat, dir, path, flags) as c_int;
    let Some(place) = here() else { return call(path) };
    // SAFETY: see above.
    let name = unsafe { path_of(path) };
    if dir == AT_FDCWD {
        return at_path(path, "unlink", call, |path| Change::Removed { path });
    }
    if let Err(errno) = before(place, "unlink") {
        return fail(errno);
    }
    let Some(full) = of_descriptor(dir).map(|dir| dir.join(as_path(name))) else { return call(path) };
    if let Some(errno) = refused(place, "unlink", &full) {
        return fail(errno);
    }
    let change = Change::Removed { path: &full };
    place.world.lock().disk.before(&change);
    let outcome = call(path);
    if outcome == 0 {
        after(place, &change);
    }
    outcome
}

/// A call that gives one path's file to another one.
fn at_paths(
    from: *const c_char,
    to: *const c_char,
    what: &'static str,
    call: impl Fn(*const c_char, *const c_char) -> c_int,
    change: impl for<'a> Fn(&'a Path, &'a Path) -> Change<'a>,
) -> c_int {
    let Some(place) = here() else { return call(from, to) };
    if let Err(errno) = before(place, what) {
        return fail(errno);
    }
    // SAFETY: see above.
    let (from, to) = unsafe { (mapped(place, path_of(from)), mapped(place, path_of(to))) };
    let (Some(from), Some(to)) = (from, to) else { return fail(ENOENT) };
    if let Some(errno) = refused(place, what, as_path(&to)) {
        return fail(errno);
    }
    let change = change(as_path(&from), as_path(&to));
    place.world.lock().disk.before(&change);
    let outcome = call(from.as_ptr(), to.as_ptr());
    if outcome == 0 {
        after(place, &change);
    }
    outcome
}

#[unsafe(no_mangle)]
extern "C" fn rename(from: *const c_char, to: *const c_char) -> c_int {
    let call = |from: *const c_char, to: *const c_char| {
        through!(SYS_renameat, AT_FDCWD, from, AT_FDCWD, to) as c_int
    };
    at_paths(from, to, "rename", call, |from, to| Change::Renamed { from, to })
}

#[unsafe(no_mangle)]
extern "C" fn linkat(
    from_dir: c_int,
    from: *const c_char,
    to_dir: c_int,
    to: *const c_char,
    flags: c_int,
) -> c_int {
    let call = |from: *const c_char, to: *const c_char| {
        through!(SYS_linkat, from_dir, from, to_dir, to, flags) as c_int
    };
    at_paths(from, to, "link", call, |_, to| Change::Made { path: to })
}

#[unsafe(no_mangle)]
extern "C" fn link(from: *const c_char, to: *const c_char) -> c_int {
    linkat(AT_FDCWD, from, AT_FDCWD, to, 0)
}

/// A call about an open file.
fn at_descriptor(
    fd: c_int,
    what: &'static str,
    changes: bool,
    call: impl Fn() -> c_long,
    change: impl for<'a> Fn(&'a Path, c_int) -> Change<'a>,
) -> c_long {
    let Some(place) = here() else { return call() };
    if let Err(errno) = before(place, what) {
        return c_long::from(fail(errno));
    }
    let path = if changes { of_descriptor(fd) } else { None };
    if let Some(errno) = path.as_ref().and_then(|path| refused(place, what, path)) {
        return c_long::from(fail(errno));
    }
    let outcome = call();
    if let Some(path) = path.filter(|_| outcome >= 0) {
        after(place, &change(&path, fd));
    }
    outcome
}

#[unsafe(no_mangle)]
extern "C" fn write(fd: c_int, bytes: *const c_void, count: size_t) -> ssize_t {
    if fd <= 2 && here().is_some() {
        // What is said is nobody's here.
        return count as ssize_t;
    }
    let call = || through!(SYS_write, fd, bytes, count);
    at_descriptor(fd, "write", true, call, |path, fd| Change::Written { path, fd }) as ssize_t
}

#[unsafe(no_mangle)]
extern "C" fn ftruncate64(fd: c_int, length: off64_t) -> c_int {
    let call = || through!(SYS_ftruncate, fd, length);
    at_descriptor(fd, "truncate", true, call, |path, fd| Change::Written { path, fd }) as c_int
}

#[unsafe(no_mangle)]
extern "C" fn fsync(fd: c_int) -> c_int {
    // Where the files are in memory, there is nothing for the system to do.
    let call = || if here().is_some() { 0 } else { through!(SYS_fsync, fd) };
    at_descriptor(fd, "fsync", true, call, |path, fd| Change::Synced { path, fd }) as c_int
}

#[unsafe(no_mangle)]
extern "C" fn fdatasync(fd: c_int) -> c_int {
    let call = || if here().is_some() { 0 } else { through!(SYS_fdatasync, fd) };
    at_descriptor(fd, "fdatasync", true, call, |path, fd| Change::Synced { path, fd }) as c_int
}

#[unsafe(no_mangle)]
extern "C" fn flock(fd: c_int, operation: c_int) -> c_int {
    if let Some(place) = here()
        && place.world.flaw == Some(Flaw::NothingCleared)
        && operation & libc::LOCK_SH != 0
    {
        // As if somebody lived.
        return fail(libc::EWOULDBLOCK);
    }
    let call = || through!(SYS_flock, fd, operation);
    at_descriptor(fd, "flock", false, call, |_, _| Change::Other) as c_int
}

#[unsafe(no_mangle)]
extern "C" fn opendir(path: *const c_char) -> *mut DIR {
    static REAL: OnceLock<usize> = OnceLock::new();
    let real = *REAL.get_or_init(|| next_of(c"opendir"));
    // SAFETY: it is the C library's function of this name.
    let real: extern "C" fn(*const c_char) -> *mut DIR = unsafe { std::mem::transmute(real) };
    let Some(place) = here() else { return real(path) };
    if let Err(errno) = before(place, "list") {
        fail(errno);
        return std::ptr::null_mut();
    }
    // SAFETY: see above.
    match mapped(place, unsafe { path_of(path) }) {
        Some(path) => real(path.as_ptr()),
        None => {
            fail(ENOENT);
            std::ptr::null_mut()
        }
    }
}

#[unsafe(no_mangle)]
extern "C" fn statx(dir: c_int, path: *const c_char, flags: c_int, mask: c_uint, into: *mut c_void) -> c_int {
    let call = |path: *const c_char| through!(SYS_statx, dir, path, flags, mask, into) as c_int;
    let Some(place) = here().filter(|_| flags & AT_EMPTY_PATH == 0) else { return call(path) };
    if let Err(errno) = before(place, "stat") {
        return fail(errno);
    }
    // SAFETY: see above.
    match mapped(place, unsafe { path_of(path) }) {
        Some(path) => call(path.as_ptr()),
        None => fail(ENOENT),
    }
}

#[unsafe(no_mangle)]
extern "C" fn readlink(path: *const c_char, into: *mut c_char, size: size_t) -> ssize_t {
    let call = |path: *const c_char| through!(SYS_readlink, path, into, size) as ssize_t;
    let Some(place) = here() else { return call(path) };
    // SAFETY: see above.
    let typed = unsafe { path_of(path) };
    // The simulation's own question.
    if typed.to_bytes().starts_with(b"/proc/self/fd/") {
        return call(path);
    }
    if let Err(errno) = before(place, "readlink") {
        return fail(errno) as ssize_t;
    }
    match mapped(place, typed) {
        Some(path) => call(path.as_ptr()),
        None => fail(ENOENT) as ssize_t,
    }
}

#[unsafe(no_mangle)]
extern "C" fn getpid() -> pid_t {
    match here() {
        None => through!(SYS_getpid) as pid_t,
        Some(place) => 1000 + place.world.lock().process_of(place.thread) as pid_t,
    }
}

#[unsafe(no_mangle)]
extern "C" fn clock_gettime(clock: clockid_t, into: *mut timespec) -> c_int {
    static REAL: OnceLock<usize> = OnceLock::new();
    let Some(place) = here() else {
        let real = *REAL.get_or_init(|| next_of(c"clock_gettime"));
        // SAFETY: it is the C library's function of this name.
        let real: extern "C" fn(clockid_t, *mut timespec) -> c_int = unsafe { std::mem::transmute(real) };
        return real(clock, into);
    };
    let now = place.world.lock().now;
    // SAFETY: the caller's promise.
    unsafe {
        (*into).tv_sec = (now / 1_000_000_000) as i64;
        (*into).tv_nsec = (now % 1_000_000_000) as i64;
    }
    0
}

#[unsafe(no_mangle)]
extern "C" fn clock_nanosleep(
    clock: clockid_t,
    flags: c_int,
    time: *const timespec,
    rest: *mut timespec,
) -> c_int {
    let Some(place) = here() else {
        return match through!(SYS_clock_nanosleep, clock, flags, time, rest) {
            0 => 0,
            _ => std::io::Error::last_os_error().raw_os_error().unwrap_or(EIO),
        };
    };
    // SAFETY: the caller's promise.
    let time = unsafe { *time };
    place.world.wait(place.thread, On::Time, Some(time.tv_sec as u64 * 1_000_000_000 + time.tv_nsec as u64));
    0
}

#[unsafe(no_mangle)]
extern "C" fn nanosleep(time: *const timespec, rest: *mut timespec) -> c_int {
    match clock_nanosleep(libc::CLOCK_MONOTONIC, 0, time, rest) {
        0 => 0,
        errno => fail(errno),
    }
}

/// The address of the function `name` that these hide.
fn next_of(name: &CStr) -> usize {
    // SAFETY: the name ends with a zero.
    let found = unsafe { libc::dlsym(libc::RTLD_NEXT, name.as_ptr()) };
    assert!(!found.is_null(), "the C library has no {name:?}");
    found as usize
}

type Main = extern "C" fn(*mut c_void) -> *mut c_void;

/// What a new simulated thread begins with.
struct Begin {
    place: Place,
    main: Main,
    argument: usize,
}

extern "C" fn begin(argument: *mut c_void) -> *mut c_void {
    // SAFETY: the box that `pthread_create` below has given away.
    let Begin { place, main, argument } = *unsafe { Box::from_raw(argument.cast::<Begin>()) };
    within(place, || {
        main(argument as *mut c_void);
    });
    std::ptr::null_mut()
}

#[unsafe(no_mangle)]
extern "C" fn pthread_create(
    handle: *mut pthread_t,
    attributes: *const pthread_attr_t,
    main: Main,
    argument: *mut c_void,
) -> c_int {
    static REAL: OnceLock<usize> = OnceLock::new();
    let real = *REAL.get_or_init(|| next_of(c"pthread_create"));
    type Create = extern "C" fn(*mut pthread_t, *const pthread_attr_t, Main, *mut c_void) -> c_int;
    // SAFETY: it is the C library's function of this name.
    let real: Create = unsafe { std::mem::transmute(real) };
    let Some(place) = next_thread() else { return real(handle, attributes, main, argument) };
    let (world, thread) = (place.world.clone(), place.thread);
    let begin_with = Box::into_raw(Box::new(Begin { place, main, argument: argument as usize }));
    let outcome = real(handle, attributes, begin, begin_with.cast());
    assert_eq!(outcome, 0, "the machine has no more threads");
    // SAFETY: the C library has written it.
    world.joins(unsafe { *handle }, thread);
    outcome
}

#[unsafe(no_mangle)]
extern "C" fn pthread_join(handle: pthread_t, into: *mut *mut c_void) -> c_int {
    static REAL: OnceLock<usize> = OnceLock::new();
    let real = *REAL.get_or_init(|| next_of(c"pthread_join"));
    // SAFETY: it is the C library's function of this name.
    let real: extern "C" fn(pthread_t, *mut *mut c_void) -> c_int = unsafe { std::mem::transmute(real) };
    if let Some(place) = here()
        && let Some(thread) = place.world.joined(handle)
    {
        place.world.wait(place.thread, On::Thread(thread), None);
    }
    real(handle, into)
}
