//! Statistics over runs.
//!
//! Times to an event may be infinite: a run that never got there. Order statistics take that as it is, so a median is
//! finite as soon as more than half of the runs got there, and nobody has to guess how much longer the others would
//! have taken.
//!
//! Intervals are percentile intervals of the bootstrap (Efron 1979). Where several tasks are pooled it is stratified:
//! runs are drawn anew within each task (Agarwal et al. 2021, *Deep Reinforcement Learning at the Edge of the
//! Statistical Precipice*). The same numbers always give the same interval.

use rand::Rng;
use serde::Serialize;
use trestle_proto::rng::{Purpose, Stream, stream};

/// Bootstrap resamples of an interval.
pub const RESAMPLES: usize = 2_000;
/// Share of the resamples within an interval.
pub const CONFIDENCE: f64 = 0.95;

/// A value with its interval. All three may be infinite; `mid` is NaN where it is undefined. In JSON either is null.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Estimate {
    /// The value for the runs as they are.
    pub mid: f64,
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

/// Arithmetic mean; NaN of nothing.
pub fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Standard deviation of the population (divided by n), as NumPy's `std` and the shaded areas of learning curves; NaN
/// of nothing.
pub fn standard_deviation(values: &[f64]) -> f64 {
    let mean = mean(values);
    (values.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / values.len() as f64).sqrt()
}

/// Median; of an even number the mean of the middle two, infinite if one of them is; NaN of nothing. `values` are
/// reordered.
pub fn median(values: &mut [f64]) -> f64 {
    if values.is_empty() {
        return f64::NAN;
    }
    values.sort_unstable_by(f64::total_cmp);
    let upper = values.len() / 2;
    if values.len() % 2 == 1 { values[upper] } else { (values[upper - 1] + values[upper]) / 2.0 }
}

/// The quantile `q` (0 to 1) of ascending `sorted` values: between two of them in proportion (NumPy's default) if both
/// are finite, otherwise the nearer one. NaN without values.
pub fn quantile(sorted: &[f64], q: f64) -> f64 {
    let Some(last) = sorted.len().checked_sub(1) else { return f64::NAN };
    let at = q * last as f64;
    let (low, high) = (sorted[at.floor() as usize], sorted[at.ceil() as usize]);
    let share = at - at.floor();
    match low.is_finite() && high.is_finite() {
        true => low + share * (high - low),
        false if share < 0.5 => low,
        false => high,
    }
}

/// Share of `hits` among `n` with Wilson's interval (1927); undefined of nothing.
pub fn share(hits: usize, n: usize) -> Estimate {
    // The normal distribution's quantile at 0.975.
    const Z: f64 = 1.959_963_984_540_054;
    let (k, n) = (hits as f64, n as f64);
    let p = k / n;
    let centre = (p + Z * Z / (2.0 * n)) / (1.0 + Z * Z / n);
    let half = Z / (1.0 + Z * Z / n) * (p * (1.0 - p) / n + Z * Z / (4.0 * n * n)).sqrt();
    // At the ends the formula is exact but for rounding.
    let low = if hits == 0 { 0.0 } else { centre - half };
    let high = if hits as f64 == n { 1.0 } else { centre + half };
    Estimate { mid: p, low, high }
}

/// Probability that a run of `a` has a smaller value than one of `b` on the same task, ties counted half: Mann and
/// Whitney's U over the number of pairs, averaged over tasks ("probability of improvement", where small is good).
/// `a` and `b` hold the values of each task, the same tasks in the same order, none of them empty.
pub fn probability_smaller(a: &[Vec<f64>], b: &[Vec<f64>]) -> f64 {
    let of_task = |(a, b): (&Vec<f64>, &Vec<f64>)| {
        let mut b = b.clone();
        b.sort_unstable_by(f64::total_cmp);
        let wins: usize = a
            .iter()
            .map(|x| {
                let not_larger = b.partition_point(|y| y <= x);
                let smaller = b.partition_point(|y| y < x);
                2 * (b.len() - not_larger) + (not_larger - smaller)
            })
            .sum();
        wins as f64 / (2 * a.len() * b.len()) as f64
    };
    mean(&a.iter().zip(b).map(of_task).collect::<Vec<_>>())
}

/// The stratified bootstrap of `statistic` over `groups` of strata: for an estimate of one arm a single group, for a
/// comparison two.
///
/// Where the statistic of a resample is undefined (NaN, as the ratio of two medians that are both infinite), it could
/// be anything: it then counts as the lowest for the lower end and as the highest for the upper one.
pub fn bootstrap(groups: &[&[Vec<f64>]], mut statistic: impl FnMut(&mut [Vec<Vec<f64>>]) -> f64) -> Estimate {
    let mut rng: Stream = stream(0, Purpose::Bootstrap, 0);
    let mut sample: Vec<Vec<Vec<f64>>> = groups.iter().map(|group| group.to_vec()).collect();
    let mid = statistic(&mut sample);
    let mut values = Vec::with_capacity(RESAMPLES);
    for _ in 0..RESAMPLES {
        for (group, into) in groups.iter().zip(&mut sample) {
            for (stratum, into) in group.iter().zip(into) {
                into.clear();
                into.extend((0..stratum.len()).map(|_| stratum[rng.random_range(0..stratum.len())]));
            }
        }
        values.push(statistic(&mut sample));
    }
    let undefined = values.iter().filter(|v| v.is_nan()).count();
    let mut defined: Vec<f64> = values.into_iter().filter(|v| !v.is_nan()).collect();
    defined.sort_unstable_by(f64::total_cmp);
    let padded = |with: f64, first: bool| {
        let padding = std::iter::repeat_n(with, undefined);
        match first {
            true => padding.chain(defined.iter().copied()).collect::<Vec<_>>(),
            false => defined.iter().copied().chain(padding).collect(),
        }
    };
    let tail = (1.0 - CONFIDENCE) / 2.0;
    Estimate {
        mid,
        low: quantile(&padded(f64::NEG_INFINITY, true), tail),
        high: quantile(&padded(f64::INFINITY, false), 1.0 - tail),
    }
}

/// Median of the pooled strata with its interval.
pub fn median_interval(strata: &[Vec<f64>]) -> Estimate {
    bootstrap(&[strata], |sample| median(&mut sample[0].concat()))
}

/// Interquartile mean of the pooled strata with its interval.
pub fn iqm_interval(strata: &[Vec<f64>]) -> Estimate {
    let mut sorted = strata.concat();
    sorted.sort_unstable_by(f64::total_cmp);
    // Resamples are of ranks: to count them takes a fraction of the time that sorting takes, and a curve has an interval
    // at every point.
    let rank = |value: &f64| sorted.partition_point(|other| other.total_cmp(value).is_lt()) as f64;
    let ranks: Vec<Vec<f64>> = strata.iter().map(|stratum| stratum.iter().map(rank).collect()).collect();
    let mut counts = vec![0_usize; sorted.len()];
    bootstrap(&[&ranks], |sample| {
        counts.fill(0);
        sample[0].iter().flatten().for_each(|&rank| counts[rank as usize] += 1);
        let cut = sorted.len() / 4;
        let kept = cut..sorted.len() - cut;
        let (mut sum, mut before) = (0.0, 0);
        for (value, count) in sorted.iter().zip(&counts) {
            let within = (before + count).min(kept.end).saturating_sub(before.max(kept.start));
            sum += value * within as f64;
            before += count;
        }
        sum / kept.len() as f64
    })
}

/// Median of `a` over median of `b`, each of its pooled strata, with its interval. Infinite over finite is infinite, finite
/// over infinite 0, and both infinite undefined.
pub fn ratio_interval(a: &[Vec<f64>], b: &[Vec<f64>]) -> Estimate {
    let mut estimate =
        bootstrap(&[a, b], |sample| median(&mut sample[0].concat()) / median(&mut sample[1].concat()));
    // Times are not negative, so neither is a ratio that could be anything.
    estimate.low = estimate.low.max(0.0);
    estimate
}

/// [`probability_smaller`] with its interval.
pub fn improvement_interval(a: &[Vec<f64>], b: &[Vec<f64>]) -> Estimate {
    bootstrap(&[a, b], |sample| probability_smaller(&sample[0], &sample[1]))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use proptest::prelude::*;
    use serde::Deserialize;

    const NEVER: f64 = f64::INFINITY;

    /// Written by tests/golden/report_statistics.py.
    #[derive(Deserialize)]
    struct Golden {
        cases: Vec<Case>,
        shares: Vec<Share>,
    }

    /// Wilson's interval.
    #[derive(Deserialize)]
    struct Share {
        hits: usize,
        runs: usize,
        low: f64,
        high: f64,
    }

    #[derive(Deserialize)]
    struct Case {
        a: Vec<Vec<f64>>,
        b: Vec<Vec<f64>>,
        mean: f64,
        std: f64,
        iqm: f64,
        median: f64,
        quantile_10: f64,
        probability_smaller: f64,
        iqm_interval: [f64; 2],
        improvement_interval: [f64; 2],
        /// Standard deviation of the interval's ends over repeated bootstraps.
        iqm_noise: f64,
        improvement_noise: f64,
    }

    /// Interquartile mean: the mean of the values that remain when a quarter of them, rounded down, is cut off at either end
    /// (SciPy's `trim_mean` of 0.25, which rliable uses).
    fn interquartile_mean(values: &mut [f64]) -> f64 {
        values.sort_unstable_by(f64::total_cmp);
        let cut = values.len() / 4;
        mean(&values[cut..values.len() - cut])
    }

    fn close(found: f64, expected: f64, within: f64) {
        assert!((found - expected).abs() <= within, "{found} is not {expected} within {within}");
    }

    #[test]
    fn equals_scipy_and_rliable() {
        let golden: Golden =
            serde_json::from_str(include_str!("../../../tests/golden/report_statistics.json")).unwrap();
        assert!(golden.cases.len() > 2);
        for case in golden.cases {
            let mut pooled = case.a.concat();
            close(mean(&pooled), case.mean, 1e-12);
            close(standard_deviation(&pooled), case.std, 1e-12);
            close(interquartile_mean(&mut pooled), case.iqm, 1e-12);
            close(median(&mut pooled), case.median, 1e-12);
            close(quantile(&pooled, 0.1), case.quantile_10, 1e-12);
            close(probability_smaller(&case.a, &case.b), case.probability_smaller, 1e-12);
            // Two bootstraps differ by chance: five standard deviations of that.
            let iqm = iqm_interval(&case.a);
            close(iqm.mid, case.iqm, 1e-12);
            close(iqm.low, case.iqm_interval[0], 5.0 * case.iqm_noise);
            close(iqm.high, case.iqm_interval[1], 5.0 * case.iqm_noise);
            let improvement = improvement_interval(&case.a, &case.b);
            close(improvement.low, case.improvement_interval[0], 5.0 * case.improvement_noise);
            close(improvement.high, case.improvement_interval[1], 5.0 * case.improvement_noise);
        }
        assert!(golden.shares.len() > 2);
        for Share { hits, runs, low, high } in golden.shares {
            let found = share(hits, runs);
            close(found.low, low, 1e-12);
            close(found.high, high, 1e-12);
        }
    }

    #[test]
    fn runs_that_never_got_there_are_later_than_all_others() {
        assert_eq!(median(&mut [NEVER, 10.0, 30.0]), 30.0);
        assert_eq!(median(&mut [NEVER, 10.0]), NEVER);
        assert_eq!(quantile(&[10.0, 20.0, NEVER], 0.7), 20.0);
        assert_eq!(quantile(&[10.0, 20.0, NEVER], 0.8), NEVER);
        assert_eq!(probability_smaller(&[vec![5.0, NEVER]], &[vec![NEVER, NEVER]]), 0.75);
        assert_eq!(median_interval(&[vec![NEVER; 5]]), Estimate { mid: NEVER, low: NEVER, high: NEVER });
    }

    #[test]
    fn a_ratio_that_could_be_anything_has_an_interval_that_says_so() {
        let nobody = ratio_interval(&[vec![NEVER; 4]], &[vec![NEVER; 4]]);
        assert!(nobody.mid.is_nan());
        assert_eq!((nobody.low, nobody.high), (0.0, NEVER));
        let clear = ratio_interval(&[vec![10.0; 4]], &[vec![NEVER; 4]]);
        assert_eq!(clear, Estimate { mid: 0.0, low: 0.0, high: 0.0 });
        let plain = ratio_interval(&[vec![10.0, 10.0, 12.0]], &[vec![20.0; 3]]);
        assert_eq!((plain.mid, plain.low, plain.high), (0.5, 0.5, 0.6));
    }

    proptest! {
        #[test]
        fn an_interval_holds_its_value_and_stays_within_the_data(
            values in prop::collection::vec(prop_oneof![5 => 0.0f64..1e3, 1 => Just(NEVER)], 1..12),
        ) {
            let found = median_interval(std::slice::from_ref(&values));
            let least = values.iter().copied().fold(NEVER, f64::min);
            prop_assert!(least <= found.low && found.low <= found.mid && found.mid <= found.high);
        }

        #[test]
        fn interquartile_means_by_rank_are_those_of_the_values(
            strata in prop::collection::vec(prop::collection::vec(-9i8..9, 1..9), 1..4),
        ) {
            let strata: Vec<Vec<f64>> =
                strata.into_iter().map(|stratum| stratum.into_iter().map(f64::from).collect()).collect();
            let naive = bootstrap(&[&strata], |sample| interquartile_mean(&mut sample[0].concat()));
            let found = iqm_interval(&strata);
            for (found, naive) in [(found.mid, naive.mid), (found.low, naive.low), (found.high, naive.high)] {
                prop_assert!((found - naive).abs() < 1e-9, "{found} is not {naive}");
            }
        }

        #[test]
        fn probabilities_of_two_arms_add_up_to_one(
            a in prop::collection::vec(0u8..9, 1..12), b in prop::collection::vec(0u8..9, 1..12),
        ) {
            let [a, b] = [a, b].map(|v| vec![v.into_iter().map(f64::from).collect::<Vec<_>>()]);
            let naive = {
                let pairs = a[0].iter().flat_map(|x| b[0].iter().map(move |y| (x, y)));
                mean(&pairs.map(|(x, y)| if x < y { 1.0 } else if x == y { 0.5 } else { 0.0 }).collect::<Vec<_>>())
            };
            prop_assert!((probability_smaller(&a, &b) - naive).abs() < 1e-12);
            prop_assert!((probability_smaller(&a, &b) + probability_smaller(&b, &a) - 1.0).abs() < 1e-12);
        }
    }
}
