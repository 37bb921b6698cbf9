//! Measuring: medians of samples in which the things to compare take turns, so that whatever else the machine does
//! meets all of them alike.

use super::Effort;
use anyhow::{Context, Result};
use nix::time::{ClockId, clock_gettime};
use std::time::Duration;

/// Samples of each case: as many as figures need, and for a quick look.
const SAMPLES: [usize; 2] = [31, 1];
/// What a sample takes, at least.
const SAMPLE: [Duration; 2] = [Duration::from_millis(2), Duration::ZERO];
/// A case of which one call takes longer is given up.
const TOO_LONG: Duration = Duration::from_secs(1);
/// Samples of a case of which one call takes longer than this many samples' time are fewer.
const LONG: u32 = 10;
/// So many times fewer.
const FEWER: usize = 6;

/// Something to repeat.
pub(super) type Case<'a> = Box<dyn FnMut() -> Result<()> + 'a>;

/// What time is taken.
#[derive(Clone, Copy)]
pub(super) enum Clock {
    /// CPU time of this thread: what other processes do to a shared machine is not in it.
    Thread,
    /// The time that passes: for what several threads do.
    Wall,
}

impl Clock {
    fn now(self) -> Result<Duration> {
        let id = match self {
            Clock::Thread => ClockId::CLOCK_THREAD_CPUTIME_ID,
            Clock::Wall => ClockId::CLOCK_MONOTONIC,
        };
        Ok(clock_gettime(id).context("no such clock")?.into())
    }

    /// The time of `calls` calls.
    fn time(self, case: &mut Case<'_>, calls: u32) -> Result<Duration> {
        let start = self.now()?;
        for _ in 0..calls {
            case()?;
        }
        Ok(self.now()? - start)
    }
}

/// Nanoseconds of CPU time that a call of each case takes: the median of its samples, after a warm-up. None where one
/// call takes longer than a second.
pub(super) fn medians(cases: &mut [Case<'_>], effort: Effort) -> Result<Vec<Option<f64>>> {
    let samples = samples(cases, effort, Clock::Thread)?;
    Ok(samples.into_iter().map(|samples| (!samples.is_empty()).then(|| median(samples))).collect())
}

/// Nanoseconds of each sample of each case, in which the cases took turns; none of a case of which one call takes longer than a second.
pub(super) fn samples(cases: &mut [Case<'_>], effort: Effort, clock: Clock) -> Result<Vec<Vec<f64>>> {
    let (most, sample) = (effort.pick(SAMPLES[0], SAMPLES[1]), effort.pick(SAMPLE[0], SAMPLE[1]));
    let mut calls = Vec::with_capacity(cases.len());
    for case in cases.iter_mut() {
        calls.push(calibrate(case, most, sample, clock)?);
    }
    let mut samples = vec![Vec::with_capacity(most); cases.len()];
    for round in 0..most {
        for ((case, calls), samples) in cases.iter_mut().zip(&calls).zip(&mut samples) {
            match *calls {
                Some(Calls { each, samples: most }) if round < most => {
                    // The case before has left the caches full of its own. A single call is long enough not to mind.
                    if each > 1 {
                        case()?;
                    }
                    samples.push(clock.time(case, each)?.as_nanos() as f64 / f64::from(each));
                }
                _ => {}
            }
        }
    }
    Ok(samples)
}

struct Calls {
    each: u32,
    samples: usize,
}

/// How many calls make a sample of `case`, which is to take `sample`, and how many of `most` samples it gets; warms it
/// up.
fn calibrate(case: &mut Case<'_>, most: usize, sample: Duration, clock: Clock) -> Result<Option<Calls>> {
    let mut calls = 1;
    loop {
        let taken = clock.time(case, calls)?;
        if taken > TOO_LONG {
            return Ok(None);
        }
        if taken >= sample {
            let samples = if taken > LONG * sample { most.div_ceil(FEWER) } else { most };
            return Ok(Some(Calls { each: calls, samples }));
        }
        calls *= 2;
    }
}

/// The middle one of `samples`, of which there must be one, or the mean of the two in the middle.
pub(super) fn median(mut samples: Vec<f64>) -> f64 {
    samples.sort_by(f64::total_cmp);
    let n = samples.len();
    (samples[(n - 1) / 2] + samples[n / 2]) / 2.0
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn medians_take_turns_and_tell_more_from_less() {
        assert_eq!(median(vec![3.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(vec![4.0, 1.0, 2.0, 3.0]), 2.5);
        let work = |n: u64| (0..n).fold(0, |sum: u64, i| sum.wrapping_mul(31) ^ std::hint::black_box(i));
        let case = |n: u64| -> Case<'_> {
            Box::new(move || {
                std::hint::black_box(work(n));
                Ok(())
            })
        };
        let found = medians(&mut [case(1_000), case(20_000)], Effort::Full).unwrap();
        assert!(found[1].unwrap() > 5.0 * found[0].unwrap(), "{found:?}");
    }
}
