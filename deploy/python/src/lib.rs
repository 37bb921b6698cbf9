//! The extension module `trestle._trestle`: the whole program, the host of Gymnasium's environments, and trained policies.

mod flat;
mod host;
mod policy;

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::ffi::OsString;
use std::sync::atomic::{AtomicBool, Ordering};

/// Whether this process is a copy that Python code has made of it. Such a copy must never come back into the program: it would
/// act in the name of the original.
static FORKED: AtomicBool = AtomicBool::new(false);

/// Ends a copy of the process that has come back from Python code.
fn end_if_forked() {
    if FORKED.load(Ordering::Relaxed) {
        // Without anything that the original is to do at its end.
        let _ = Python::attach(|py| py.import("os")?.call_method1("_exit", (0,)).map(drop));
        std::process::abort();
    }
}

/// Says that this process is a copy; for `os.register_at_fork`.
#[pyfunction]
fn forked() {
    FORKED.store(true, Ordering::Relaxed);
}

/// Carries out the command line `args`, whose first entry is the program's name, and returns the exit status. `again` is the
/// command that starts this program. To be called once in a process.
#[pyfunction]
fn main(py: Python<'_>, args: Vec<OsString>, again: Vec<String>) -> PyResult<u8> {
    trestle_actor::env::gym::install_host(host::HOST)
        .map_err(|_| PyValueError::new_err("the program has been started in this process before"))?;
    Ok(py.detach(|| trestle::Program::new().started_by(again).run(args)))
}

#[pymodule]
fn _trestle(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("VERSION", env!("CARGO_PKG_VERSION"))?;
    module.add("BUILD", trestle::BUILD)?;
    module.add("MAX_ACTIONS", trestle_proto::limits::MAX_ACTIONS)?;
    module.add("MAX_FEATURES", trestle_proto::limits::MAX_OBS_DIM)?;
    module.add_function(wrap_pyfunction!(main, module)?)?;
    module.add_function(wrap_pyfunction!(forked, module)?)?;
    module.add_class::<flat::Flattener>()?;
    module.add_class::<policy::Policy>()?;
    Ok(())
}
