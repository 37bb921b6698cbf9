//! A model of a maze with its state.

// The boundary to a library in C: every block says why it is sound.
#![allow(unsafe_code)]

use super::MujocoError;
use super::api::{Api, Data, Loader, Model, Version, take_report};
use super::model::xml;
use crate::env::point_maze::geometry::{Geometry, Vector};
use crate::env::point_maze::physics::Body;
use std::ffi::{CStr, CString, c_char, c_int};
use std::io::Write;
use std::ptr::{self, NonNull};
use std::sync::Arc;
use tempfile::NamedTempFile;

/// Room for MuJoCo's words about a model, bytes.
const MESSAGE: usize = 1000;

/// MuJoCo's simulation of one maze.
pub struct Simulation {
    api: Arc<Api>,
    model: NonNull<Model>,
    data: NonNull<Data>,
}

// SAFETY: model and data belong to this value alone and are used by one thread at a time, which is all that MuJoCo asks
// for; it keeps nothing about them in the thread that made them.
unsafe impl Send for Simulation {}

impl Simulation {
    /// The maze of `geometry` in the library `api`, with walls that push from `margin` metres on.
    ///
    /// # Errors
    /// A map with too many walls, or a model that MuJoCo does not accept.
    pub(super) fn new(api: &Arc<Api>, geometry: &Geometry, margin: f64) -> Result<Self, MujocoError> {
        let api = api.clone();
        let text = xml(geometry, margin, api.version)?;
        let model = load(&api, &text)?;
        // SAFETY: `model` is a model of this library.
        let data = unsafe { (api.make_data)(model.as_ptr()) };
        let Some(data) = NonNull::new(data) else {
            // SAFETY: as above, and nothing uses it any more.
            unsafe { (api.delete_model)(model.as_ptr()) };
            take_report()?;
            return Err(MujocoError::Model { message: "no room for its data".into() });
        };
        let simulation = Self { api, model, data };
        // SAFETY: `model` is a model of this library.
        let size = unsafe { (simulation.api.state_size)(model.as_ptr(), simulation.bits()) };
        take_report()?;
        let expected = 2 * simulation.api.version.axes() + 2;
        if usize::try_from(size) != Ok(expected) {
            return Err(MujocoError::Model {
                message: format!("its state has {size} numbers; accepted: {expected}"),
            });
        }
        Ok(simulation)
    }

    /// The library's version.
    pub(super) fn version(&self) -> Version {
        self.api.version
    }

    fn bits(&self) -> c_int {
        self.api.version.state_bits()
    }

    /// `frames` steps from `body` with `control`, each component -1 to 1. `body` is unchanged after an error.
    ///
    /// # Errors
    /// What MuJoCo reports; the state is not to be relied on then.
    pub fn advance(&mut self, body: &mut Body, control: Vector, frames: u32) -> Result<(), MujocoError> {
        // Positions, velocities, controls; with a third axis, which stays at 0, two more numbers.
        let axes = self.api.version.axes();
        let mut state = [0.0; 8];
        for (place, values) in [(0, body.position), (axes, body.velocity), (2 * axes, control)] {
            state[place..place + 2].copy_from_slice(&values);
        }
        let (model, data) = (self.model.as_ptr(), self.data.as_ptr());
        // SAFETY: model and data were made for each other by this library, and `&mut self` keeps other calls away. The
        // state has 6 or 8 numbers: `new` has asked for its size under the same bits.
        unsafe {
            (self.api.set_state)(model, data, state.as_ptr(), self.bits());
            for _ in 0..frames {
                (self.api.step)(model, data);
            }
            (self.api.get_state)(model, data, state.as_mut_ptr(), self.bits());
        }
        take_report()?;
        *body = Body { position: [state[0], state[1]], velocity: [state[axes], state[axes + 1]] };
        Ok(())
    }
}

impl Drop for Simulation {
    fn drop(&mut self) {
        // SAFETY: both were made by this library, and nothing uses them any more.
        unsafe {
            (self.api.delete_data)(self.data.as_ptr());
            (self.api.delete_model)(self.model.as_ptr());
        }
    }
}

/// The model that `text` describes.
fn load(api: &Api, text: &str) -> Result<NonNull<Model>, MujocoError> {
    let refused = |message: String| MujocoError::Model { message };
    let mut message: [c_char; MESSAGE] = [0; MESSAGE];
    let model = match &api.loader {
        Loader::Text { parse, compile, delete } => {
            let text = CString::new(text).map_err(|e| refused(e.to_string()))?;
            // SAFETY: the text ends with 0, no virtual file system is needed, and the message has the room that is
            // said. A spec that was parsed is compiled and deleted once.
            unsafe {
                let spec = parse(text.as_ptr(), ptr::null(), message.as_mut_ptr(), MESSAGE as c_int);
                if spec.is_null() {
                    ptr::null_mut()
                } else {
                    let model = compile(spec, ptr::null());
                    delete(spec);
                    model
                }
            }
        }
        Loader::File { load } => {
            let file = text_file(text).map_err(|e| refused(format!("cannot write its file: {e}")))?;
            let path = CString::new(file.path().as_os_str().as_encoded_bytes());
            let path = path.map_err(|e| refused(e.to_string()))?;
            // SAFETY: as above; the path ends with 0.
            unsafe { load(path.as_ptr(), ptr::null(), message.as_mut_ptr(), MESSAGE as c_int) }
        }
    };
    let report = take_report();
    let Some(model) = NonNull::new(model) else {
        message[MESSAGE - 1] = 0;
        // SAFETY: the array ends with 0.
        let words = unsafe { CStr::from_ptr(message.as_ptr()) }.to_string_lossy().into_owned();
        report?;
        return Err(refused(if words.is_empty() { "no reason given".into() } else { words }));
    };
    // A warning about a model that was made all the same: it would come again in every run.
    if let Err(warning) = report {
        tracing::warn!("{warning}");
    }
    Ok(model)
}

/// A file with `text`, which is removed when this goes. Its directory is everybody's: it has a name that nobody can guess,
/// and is never somebody else's file or link.
fn text_file(text: &str) -> std::io::Result<NamedTempFile> {
    let mut file = tempfile::Builder::new().prefix("trestle-model-").suffix(".xml").tempfile()?;
    file.write_all(text.as_bytes())?;
    Ok(file)
}
