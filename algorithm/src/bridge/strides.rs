//! The longest step among the stored transitions: how far one step can lead at most.

use std::collections::VecDeque;

/// Lengths are rounded up to this many bits of a mantissa, so that there are few different ones.
const BITS: u32 = 5;

/// Lengths of the stored transitions that no newer one exceeds, falling. Memory: a few bytes for each of at most some
/// thousands of different lengths.
#[derive(Clone, Debug, Default)]
pub struct Strides {
    falling: VecDeque<(u64, f32)>,
}

impl Strides {
    /// Transition `index`, the newest, has KL `kl` between s and s'. Transitions before `oldest` are gone.
    pub fn push(&mut self, index: u64, oldest: u64, kl: f32) {
        let kl = round_up(kl);
        while self.falling.back().is_some_and(|&(_, last)| last <= kl) {
            self.falling.pop_back();
        }
        self.falling.push_back((index, kl));
        while self.falling.front().is_some_and(|&(first, _)| first < oldest) {
            self.falling.pop_front();
        }
    }

    /// KL between s and s' of the longest stored transition, rounded up by a few percent.
    pub fn longest(&self) -> f32 {
        self.falling.front().map_or(0.0, |&(_, kl)| kl)
    }
}

/// The smallest number with [`BITS`] bits of mantissa that is not below `kl`, which is not negative.
fn round_up(kl: f32) -> f32 {
    let low = (1 << (f32::MANTISSA_DIGITS - 1 - BITS)) - 1;
    f32::from_bits((kl.to_bits() + low) & !low)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn is_the_maximum_of_the_window(lengths in proptest::collection::vec(0.0f32..9.0, 1..60), window in 1u64..20) {
            let mut strides = Strides::default();
            for (i, &kl) in lengths.iter().enumerate() {
                let oldest = (i as u64 + 1).saturating_sub(window);
                strides.push(i as u64, oldest, kl);
                let longest = lengths[oldest as usize..=i].iter().copied().fold(0.0, f32::max);
                prop_assert!(strides.longest() >= longest && strides.longest() <= longest * 1.04 + 1e-30);
                prop_assert!(strides.falling.len() <= window as usize);
            }
        }
    }

    #[test]
    fn extremes_stay_in_order() {
        for kl in [0.0, f32::MIN_POSITIVE, 1.0, 1.5, 1e30, f32::INFINITY] {
            assert!(round_up(kl) >= kl && round_up(kl) <= kl * 1.04 + 1e-30, "{kl}");
        }
    }
}
