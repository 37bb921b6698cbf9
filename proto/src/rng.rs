//! Random streams: one for each purpose, each a function of the run's seed, the purpose and an index alone.
//!
//! ChaCha8 is keyed directly with (seed, purpose, index), so two streams never overlap and no process needs to
//! know what another has drawn. A stream's whole state is serialisable and goes into checkpoints.

use rand::{RngCore, SeedableRng};
pub use rand_chacha::ChaCha8Rng as Stream;

/// What a random stream is for. The numbers are part of the format of reproducible runs: never reuse one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u64)]
pub enum Purpose {
    /// Initial weights of the Q-network.
    Weights = 1,
    /// Exploration of one actor (index: actor, and its incarnation times 2^32).
    Explore = 2,
    /// Episode resets of one actor's environment (index as of `Explore`).
    Environment = 3,
    /// Draws from the replay.
    Replay = 4,
    /// Which of several similar mentor states belongs to a stored transition.
    MentorPick = 5,
    /// Episode resets of one greedy evaluation (index: number of the evaluation).
    Evaluation = 6,
    /// Generation of a random map.
    Map = 7,
    /// Resamples of the intervals of a report; no run draws from it.
    Bootstrap = 8,
    /// Initial weights of the policy of learned bridges.
    PolicyWeights = 9,
    /// Draws from the replay for that policy.
    PolicyReplay = 10,
    /// Draws from own paths.
    Imitation = 11,
    /// Initial weights of a rival's network.
    RivalWeights = 16,
    /// What a rival draws from the replay and from the mentor's states.
    RivalReplay = 17,
    /// What a mentor of a suite's task does; no run draws from it.
    Demonstration = 32,
}

/// The stream of `purpose` and `index` in the run with `seed`, at its beginning.
pub fn stream(seed: u64, purpose: Purpose, index: u64) -> Stream {
    let mut key = [0; 32];
    key[0..8].copy_from_slice(&seed.to_le_bytes());
    key[8..16].copy_from_slice(&(purpose as u64).to_le_bytes());
    key[16..24].copy_from_slice(&index.to_le_bytes());
    key[24..32].copy_from_slice(b"trestle1");
    Stream::from_seed(key)
}

/// A number in `0..n` from one word of `rng`: uniform to within 2^-32 for `n` up to 2^32, which must not be 0.
pub fn below(rng: &mut Stream, n: usize) -> usize {
    debug_assert!(n > 0);
    ((u64::from(rng.next_u32()) * n as u64) >> 32) as usize
}

/// A choice among `n` candidates that depends on the seed, the purpose and `index` alone, so that it needs no
/// state: uniform to within 2^-32 for `n` up to 2^32. Returns a number in `0..n`; `n` must not be 0.
pub fn pick(seed: u64, purpose: Purpose, index: u64, n: u32) -> u32 {
    debug_assert!(n > 0);
    let word = mix(mix(mix(seed) ^ purpose as u64) ^ index) >> 32;
    ((word * u64::from(n)) >> 32) as u32
}

/// The finaliser of SplitMix64 (Steele, Lea and Flood 2014), a bijection of 64-bit words.
pub fn mix(word: u64) -> u64 {
    let mut z = word.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::RngCore;

    #[test]
    fn streams_differ_by_seed_purpose_and_index_and_repeat() {
        let first = |s, p, i| stream(s, p, i).next_u64();
        let base = first(7, Purpose::Explore, 0);
        assert_eq!(base, first(7, Purpose::Explore, 0));
        assert_ne!(base, first(8, Purpose::Explore, 0));
        assert_ne!(base, first(7, Purpose::Environment, 0));
        assert_ne!(base, first(7, Purpose::Explore, 1));
    }

    #[test]
    fn pick_is_uniform_and_in_range() {
        let mut counts = [0u32; 5];
        for index in 0..50_000 {
            counts[pick(3, Purpose::MentorPick, index, 5) as usize] += 1;
        }
        // Standard deviation of a count is about 89: six of them either way.
        assert!(counts.iter().all(|&c| (9_466..=10_534).contains(&c)), "{counts:?}");
    }
}
