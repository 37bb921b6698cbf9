//! Records the commit of the sources, where there is one, for `build.json`.

use std::process::Command;

fn main() {
    println!("cargo::rerun-if-changed=.git/HEAD");
    println!("cargo::rerun-if-changed=.git/refs/heads");
    let head = Command::new("git").args(["rev-parse", "HEAD"]).output();
    if let Ok(output) = head
        && output.status.success()
    {
        println!("cargo::rustc-env=TRESTLE_COMMIT={}", String::from_utf8_lossy(&output.stdout).trim());
    }
}
