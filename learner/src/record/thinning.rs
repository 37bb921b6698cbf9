//! Which of ever more events are written down: all of them at first, then every second one, every fourth, and so on.
//!
//! Of the first `full` events all are kept, and with each doubling of their number half of `full` more. What is kept never
//! has to be removed again, so files only grow at their end, and it depends on the event's number alone: a resumed run keeps
//! the same ones.

/// Episodes that all have a row of `metrics.jsonl`.
pub(super) const EPISODES: u64 = 1 << 14;
/// Interval rows before their distance grows.
pub(super) const INTERVALS: u64 = 1 << 13;
/// Greedy evaluations that all have points in TensorBoard's file. `evals.csv` has a line for every one.
pub(super) const EVALUATIONS: u64 = 1 << 13;

/// The distance between events that are kept around event `number`: the smallest power of two of which fewer than `full`
/// multiples come before.
pub(super) fn stride(number: u64, full: u64) -> u64 {
    let mut doublings = 0;
    while number >> doublings >= full {
        doublings += 1;
    }
    1 << doublings
}

/// Whether event `number`, counted from 1, is kept.
pub(super) fn is_kept(number: u64, full: u64) -> bool {
    number.is_multiple_of(stride(number, full))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_are_all_kept_and_many_are_few() {
        let full = 16;
        let kept: Vec<u64> = (1..=1024).filter(|&number| is_kept(number, full)).collect();
        assert_eq!(kept[..15], (1..16).collect::<Vec<_>>());
        for doublings in 0..6 {
            let until = kept.iter().filter(|&&number| number < full << doublings).count() as u64;
            assert_eq!(until, full - 1 + doublings * full / 2, "{doublings}");
            // As fine everywhere as the bound allows.
            let after = kept.windows(2).filter(|pair| pair[1] < full << doublings);
            let gap = after.map(|pair| pair[1] - pair[0]).max();
            assert_eq!(gap, Some(1 << doublings), "{doublings}");
        }
    }

    /// A hundred years of seconds, and a million episodes in each of them.
    #[test]
    fn the_longest_run_has_an_end() {
        let rows = |number, full| full + u64::from(stride(number, full).ilog2()) * full / 2;
        assert!(rows(3_200_000_000, INTERVALS) < 100_000);
        assert!(rows(3_200_000_000_000_000, EPISODES) < 400_000);
        assert_eq!(stride(u64::MAX, EPISODES), 1 << 50);
    }
}
