//! MuJoCo's functions as this program uses them: a dozen of them, over opaque pointers, and what differs between versions.
//!
//! Source: MuJoCo's API reference (functions) and its headers from 2.3.7 to 4.0.0, against which every signature here was
//! checked. No structure of MuJoCo is looked into, because their layouts differ from version to version.

// The boundary to a library in C: every block says why it is sound.
#![allow(unsafe_code)]

use super::MujocoError;
use libloading::Library;
use std::cell::RefCell;
use std::ffi::{CStr, c_char, c_int};
use std::fmt;
use std::path::Path;

/// `mjModel`.
#[repr(C)]
pub(super) struct Model {
    _opaque: [u8; 0],
}

/// `mjData`.
#[repr(C)]
pub(super) struct Data {
    _opaque: [u8; 0],
}

/// `mjSpec`.
#[repr(C)]
pub(super) struct Spec {
    _opaque: [u8; 0],
}

/// `mjVFS`, of which there is never one.
#[repr(C)]
pub(super) struct Vfs {
    _opaque: [u8; 0],
}

/// A version of MuJoCo.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Version {
    /// Major.
    pub major: u32,
    /// Minor.
    pub minor: u32,
    /// Patch.
    pub patch: u32,
}

impl Version {
    /// The version that `mj_version()` means: 237 is 2.3.7, and from 3.5.0 on 3005000 is 3.5.0.
    pub(super) fn decode(number: c_int) -> Self {
        let number = number.unsigned_abs();
        let base = if number < 1000 { 10 } else { 1000 };
        Self { major: number / (base * base), minor: number / base % base, patch: number % base }
    }

    /// Whether this program knows how to use it.
    pub(super) fn supported(self) -> bool {
        (Self { major: 2, minor: 3, patch: 7 }..Self { major: 5, minor: 0, patch: 0 }).contains(&self)
    }

    fn since(self, major: u32, minor: u32) -> bool {
        self >= Self { major, minor, patch: 0 }
    }

    /// Whether the margins of two geoms add up; before, the larger one counted.
    pub(super) fn adds_margins(self) -> bool {
        self.since(3, 5)
    }

    /// Axes along which the ball must be able to slide.
    ///
    /// Before 3.0.0 MuJoCo averages a body's inverse inertia, and with it the stiffness of contacts, over x, y and z even
    /// where it has no freedom along z. There the model gives it that freedom, which nothing ever makes use of.
    pub(super) fn axes(self) -> usize {
        if self.since(3, 0) { 2 } else { 3 }
    }

    /// Bits of `mj_getState` for positions, velocities and controls, in this order in the state as well.
    pub(super) fn state_bits(self) -> c_int {
        let control = if self.since(3, 5) { 1 << 6 } else { 1 << 5 };
        1 << 1 | 1 << 2 | control
    }
}

impl fmt::Display for Version {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{}.{}", self.major, self.minor, self.patch)
    }
}

/// How a model is made from XML.
pub(super) enum Loader {
    /// From 3.2.0 on: from text in memory.
    Text {
        parse: unsafe extern "C" fn(*const c_char, *const Vfs, *mut c_char, c_int) -> *mut Spec,
        compile: unsafe extern "C" fn(*mut Spec, *const Vfs) -> *mut Model,
        delete: unsafe extern "C" fn(*mut Spec),
    },
    /// Before: from a file.
    File { load: unsafe extern "C" fn(*const c_char, *const Vfs, *mut c_char, c_int) -> *mut Model },
}

/// A loaded library's functions.
pub(super) struct Api {
    pub(super) version: Version,
    pub(super) loader: Loader,
    pub(super) delete_model: unsafe extern "C" fn(*mut Model),
    pub(super) make_data: unsafe extern "C" fn(*const Model) -> *mut Data,
    pub(super) delete_data: unsafe extern "C" fn(*mut Data),
    pub(super) step: unsafe extern "C" fn(*const Model, *mut Data),
    pub(super) state_size: unsafe extern "C" fn(*const Model, c_int) -> c_int,
    pub(super) get_state: unsafe extern "C" fn(*const Model, *const Data, *mut f64, c_int),
    pub(super) set_state: unsafe extern "C" fn(*const Model, *mut Data, *const f64, c_int),
    /// The functions are only there as long as the library is.
    _library: Library,
}

thread_local! {
    /// What MuJoCo has reported in a call of this thread.
    static REPORT: RefCell<Option<String>> = const { RefCell::new(None) };
}

/// Takes MuJoCo's errors and warnings. Its own handlers would write a log file into the working directory, and after an
/// error wait for a key and end the process.
extern "C" fn report(message: *const c_char) {
    let text = if message.is_null() {
        "an error without a message".into()
    } else {
        // SAFETY: MuJoCo hands over a string that ends with 0 and lives until this function returns.
        unsafe { CStr::from_ptr(message) }.to_string_lossy().into_owned()
    };
    // The first one is the cause.
    REPORT.with_borrow_mut(|report| _ = report.get_or_insert(text));
}

/// What MuJoCo has reported in this thread since the last question.
pub(super) fn take_report() -> Result<(), MujocoError> {
    match REPORT.take() {
        None => Ok(()),
        Some(message) => Err(MujocoError::Simulation { message }),
    }
}

impl Api {
    /// Loads the library at `path`; a name without a directory is looked for where the system looks for libraries.
    pub(super) fn load(path: &Path) -> Result<Self, MujocoError> {
        let fault =
            |error: libloading::Error| MujocoError::Load { path: path.into(), message: error.to_string() };
        // SAFETY: loading runs the library's initialisers. That the file is MuJoCo is what the user, or the name in
        // one of the documented places, says; nothing can check it before.
        let library = unsafe { Library::new(path) }.map_err(fault)?;
        macro_rules! function {
            ($name:literal) => {
                // SAFETY: the type is that of the field it is assigned to, which is the function's signature in
                // MuJoCo's headers of all accepted versions (see the top of the file).
                *unsafe { library.get(concat!($name, "\0").as_bytes()) }.map_err(fault)?
            };
        }
        let version: unsafe extern "C" fn() -> c_int = function!("mj_version");
        // SAFETY: no arguments, no state.
        let version = Version::decode(unsafe { version() });
        if !version.supported() {
            return Err(MujocoError::Unsupported { path: path.into(), version });
        }
        for hook in [&b"mju_user_error\0"[..], b"mju_user_warning\0"] {
            // SAFETY: both are variables of this type; nothing else of this process writes them, and MuJoCo reads them in
            // calls that come after.
            unsafe {
                let variable: libloading::Symbol<'_, *mut Option<extern "C" fn(*const c_char)>> =
                    library.get(hook).map_err(fault)?;
                **variable = Some(report);
            }
        }
        let loader = if version.since(3, 2) {
            Loader::Text {
                parse: function!("mj_parseXMLString"),
                compile: function!("mj_compile"),
                delete: function!("mj_deleteSpec"),
            }
        } else {
            Loader::File { load: function!("mj_loadXML") }
        };
        Ok(Self {
            version,
            loader,
            delete_model: function!("mj_deleteModel"),
            make_data: function!("mj_makeData"),
            delete_data: function!("mj_deleteData"),
            step: function!("mj_step"),
            state_size: function!("mj_stateSize"),
            get_state: function!("mj_getState"),
            set_state: function!("mj_setState"),
            _library: library,
        })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn both_ways_to_count_versions_are_read() {
        let version = |major, minor, patch| Version { major, minor, patch };
        assert_eq!(Version::decode(237), version(2, 3, 7));
        assert_eq!(Version::decode(340), version(3, 4, 0));
        assert_eq!(Version::decode(3_005_000), version(3, 5, 0));
        assert_eq!(Version::decode(4_000_000).to_string(), "4.0.0");
        assert_eq!(Version::decode(3_010_002), version(3, 10, 2));
        for (number, supported) in
            [(236, false), (237, true), (4_001_000, true), (5_000_000, false), (0, false)]
        {
            assert_eq!(Version::decode(number).supported(), supported, "{number}");
        }
        assert!(!version(3, 4, 9).adds_margins() && version(3, 5, 0).adds_margins());
        assert_eq!((version(3, 4, 0).state_bits(), version(4, 0, 0).state_bits()), (0b10_0110, 0b100_0110));
    }

    #[test]
    fn what_is_no_library_is_refused() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let message = Api::load(file.path()).err().unwrap().to_string();
        assert!(message.starts_with(&file.path().display().to_string()), "{message}");
    }
}
