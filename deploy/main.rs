//! The program `trestle`, with the environments that come with it.

use std::process::ExitCode;

fn main() -> ExitCode {
    trestle::Program::new().main()
}
