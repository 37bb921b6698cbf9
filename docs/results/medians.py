"""Ratios of medians, for the scripts beside this file."""

import random
import statistics

RESAMPLES = 2000


def ratio(times: list[float], base: list[float]) -> str:
    """The ratio of two medians with its 95 % interval (percentile bootstrap, from a fixed seed)."""
    draw = random.Random(1)
    resample = lambda of: statistics.median(draw.choices(of, k=len(of)))
    all_ = sorted(resample(times) / resample(base) for _ in range(RESAMPLES))
    low, high = all_[RESAMPLES // 40], all_[-RESAMPLES // 40 - 1]
    return f"{statistics.median(times) / statistics.median(base):.2f} [{low:.2f}, {high:.2f}]"
