//! Records the commit of the sources, where there is one, for `build.json`, and a hash of the sources themselves, by which two
//! programs tell whether they are of one build.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::process::Command;

/// What the program is built from.
const SOURCES: [&str; 8] =
    ["Cargo.toml", "actor", "algorithm", "deploy", "learner", "mentor-server", "proto", "qnet"];

/// Other projects among them.
const OTHERS: [&str; 2] = ["python", "relay"];

fn main() -> io::Result<()> {
    println!("cargo::rerun-if-changed=.git/HEAD");
    println!("cargo::rerun-if-changed=.git/refs/heads");
    let head = Command::new("git").args(["rev-parse", "HEAD"]).output();
    if let Ok(output) = head
        && output.status.success()
    {
        println!("cargo::rustc-env=TRESTLE_COMMIT={}", String::from_utf8_lossy(&output.stdout).trim());
    }
    let mut files = Vec::new();
    for source in SOURCES {
        for path in below(Path::new(source))? {
            println!("cargo::rerun-if-changed={}", path.display());
            collect(&path, &mut files)?;
        }
    }
    files.sort();
    let mut hash = FNV_OFFSET;
    for file in files {
        hash = mixed(hash, file.as_os_str().as_encoded_bytes());
        hash = mixed(hash, &fs::read(&file)?);
    }
    println!("cargo::rustc-env=TRESTLE_SOURCES={hash:016x}");
    Ok(())
}

/// The files in `source`, or `source` itself where it is a file. The Python package and the relay are projects of their own.
fn below(source: &Path) -> io::Result<Vec<PathBuf>> {
    if source.is_file() {
        return Ok(vec![source.to_path_buf()]);
    }
    let all = fs::read_dir(source)?.map(|entry| Ok(entry?.path()));
    Ok(all
        .collect::<io::Result<Vec<_>>>()?
        .into_iter()
        .filter(|path| !OTHERS.iter().any(|other| path.ends_with(other)))
        .collect())
}

/// The Rust sources, and what is compiled in, in and below `path`.
fn collect(path: &Path, files: &mut Vec<PathBuf>) -> io::Result<()> {
    if path.is_dir() {
        for entry in fs::read_dir(path)? {
            collect(&entry?.path(), files)?;
        }
    } else if path.extension().is_some_and(|kind| kind == "rs" || kind == "toml") {
        files.push(path.to_path_buf());
    }
    Ok(())
}

/// Fowler, Noll and Vo's hash of 64 bits, variant 1a.
const FNV_OFFSET: u64 = 0xcbf2_9ce4_8422_2325;

fn mixed(hash: u64, bytes: &[u8]) -> u64 {
    bytes.iter().fold(hash, |hash, &byte| (hash ^ u64::from(byte)).wrapping_mul(0x100_0000_01b3))
}
