//! One decoder of `tests/decoders.rs` under libFuzzer: that which the environment variable TRESTLE_DECODER names. See
//! `run.sh`.

#![no_main]
#![allow(clippy::unwrap_used)]

#[path = "../decoders.rs"]
#[allow(dead_code)]
mod decoders;

use decoders::{ALL, seeds};
use libfuzzer_sys::fuzz_target;
use std::path::Path;
use std::sync::OnceLock;

/// The decoder that is asked for. The sound inputs of all of them are written to the directory TRESTLE_SEEDS, if that is
/// named, where libFuzzer may begin from them.
fn decoder() -> fn(&[u8]) {
    static DECODER: OnceLock<fn(&[u8])> = OnceLock::new();
    *DECODER.get_or_init(|| {
        let name = std::env::var("TRESTLE_DECODER").unwrap_or_default();
        let names: Vec<&str> = ALL.iter().map(|(name, _)| *name).collect();
        let found = ALL.iter().find(|(other, _)| *other == name);
        let (_, decoder) = found.unwrap_or_else(|| panic!("TRESTLE_DECODER is `{name}`; accepted: {names:?}"));
        *decoder
    })
}

fuzz_target!(
    init: {
        if let Some(dir) = std::env::var_os("TRESTLE_SEEDS") {
            for (index, (name, bytes)) in seeds().into_iter().enumerate() {
                let dir = Path::new(&dir).join(name);
                std::fs::create_dir_all(&dir).unwrap();
                std::fs::write(dir.join(format!("seed-{index}")), bytes).unwrap();
            }
            std::process::exit(0);
        }
    },
    |bytes: &[u8]| decoder()(bytes)
);
