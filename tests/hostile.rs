//! Input of peers, files and people that is wrong on purpose: refused by its reader, never a panic.

use proptest::prelude::*;
use trestle_fuzz::{ALL, seeds};

/// A change to sound bytes.
#[derive(Clone, Debug)]
enum Damage {
    Flip(prop::sample::Index, u8),
    Set(prop::sample::Index, u8),
    Word(prop::sample::Index, u32),
    Cut(prop::sample::Index),
    Insert(prop::sample::Index, Vec<u8>),
    Remove(prop::sample::Index),
    Repeat(prop::sample::Index),
}

fn damage() -> impl Strategy<Value = Damage> {
    let at = any::<prop::sample::Index>;
    // Numbers at the edges of ranges are likelier to be misread than others.
    let edge = prop::sample::select(vec![0, 1, 0x7fff_ffff, 0x8000_0000, u32::MAX, 0x7fc0_0000, 0x7f80_0000]);
    prop_oneof![
        (at(), 0u8..8).prop_map(|(at, bit)| Damage::Flip(at, bit)),
        (at(), any::<u8>()).prop_map(|(at, byte)| Damage::Set(at, byte)),
        (at(), edge).prop_map(|(at, word)| Damage::Word(at, word)),
        at().prop_map(Damage::Cut),
        (at(), prop::collection::vec(any::<u8>(), 1..9)).prop_map(|(at, bytes)| Damage::Insert(at, bytes)),
        at().prop_map(Damage::Remove),
        at().prop_map(Damage::Repeat),
    ]
}

fn apply(bytes: &mut Vec<u8>, damage: &Damage) {
    if bytes.is_empty() {
        return;
    }
    let len = bytes.len();
    match damage {
        Damage::Flip(at, bit) => bytes[at.index(len)] ^= 1 << bit,
        Damage::Set(at, byte) => bytes[at.index(len)] = *byte,
        Damage::Word(at, word) => {
            let at = at.index(len) / 4 * 4;
            let end = (at + 4).min(len);
            bytes[at..end].copy_from_slice(&word.to_le_bytes()[..end - at]);
        }
        Damage::Cut(at) => bytes.truncate(at.index(len)),
        Damage::Insert(at, more) => {
            let at = at.index(len);
            bytes.splice(at..at, more.iter().copied());
        }
        Damage::Remove(at) => _ = bytes.remove(at.index(len)),
        Damage::Repeat(at) => {
            let tail = bytes[at.index(len)..].to_vec();
            bytes.extend(tail);
        }
    }
}

#[test]
fn sound_inputs_are_sound() {
    for (name, bytes) in seeds() {
        let (_, decoder) = ALL.into_iter().find(|(other, _)| *other == name).unwrap();
        decoder(&bytes);
        decoder(&[]);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(600))]

    #[test]
    fn damaged_inputs_do_no_harm(
        which in any::<prop::sample::Index>(), changes in prop::collection::vec(damage(), 1..6),
    ) {
        let seeds = seeds();
        let (name, mut bytes) = seeds[which.index(seeds.len())].clone();
        changes.iter().for_each(|change| apply(&mut bytes, change));
        let (_, decoder) = ALL.into_iter().find(|(other, _)| *other == name).unwrap();
        decoder(&bytes);
    }

    #[test]
    fn random_bytes_do_no_harm(
        which in any::<prop::sample::Index>(), bytes in prop::collection::vec(any::<u8>(), 0..400),
    ) {
        ALL[which.index(ALL.len())].1(&bytes);
    }
}
