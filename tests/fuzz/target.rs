//! One decoder of `tests/decoders.rs` under libFuzzer: that which the environment variable TRESTLE_DECODER names. See
//! `run.sh`.

#![no_main]
#![allow(clippy::unwrap_used)]

use libfuzzer_sys::fuzz_target;
use std::path::Path;
use std::sync::OnceLock;
use trestle_fuzz::{ALL, seeds};

/// The decoder that is asked for.
fn decoder() -> fn(&[u8]) {
    static DECODER: OnceLock<fn(&[u8])> = OnceLock::new();
    *DECODER.get_or_init(|| {
        let name = std::env::var("TRESTLE_DECODER").unwrap_or_default();
        let names: Vec<&str> = ALL.iter().map(|(name, _)| *name).collect();
        let found = ALL.iter().find(|(other, _)| *other == name);
        let (_, decoder) =
            found.unwrap_or_else(|| panic!("TRESTLE_DECODER is `{name}`; accepted: {names:?}"));
        *decoder
    })
}

fuzz_target!(
    init: {
        // Then nothing is tried: the names of all decoders are printed, and their sound inputs written to the directory that
        // is named, a directory each, for libFuzzer to begin from.
        if let Some(dir) = std::env::var_os("TRESTLE_SEEDS") {
            for (index, (name, bytes)) in seeds().into_iter().enumerate() {
                let dir = Path::new(&dir).join(name);
                std::fs::create_dir_all(&dir).unwrap();
                std::fs::write(dir.join(format!("seed-{index}")), bytes).unwrap();
            }
            ALL.iter().for_each(|(name, _)| println!("{name}"));
            std::process::exit(0);
        }
    },
    |bytes: &[u8]| decoder()(bytes)
);
