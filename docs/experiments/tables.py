"""Rows of runs and figures over tasks, for the scripts beside this file."""

import json
import math
import random
import statistics
from collections.abc import Callable
from pathlib import Path

RESAMPLES = 2000

Resample = Callable[[list[float]], float]


def rows_of(out: Path, fields: list[str]) -> list[dict]:
    """A row of task, arm, seed and these fields of its result for each run below `out`, which has directories for groups, tasks, arms
    and seeds."""
    rows = []
    for path in sorted(out.glob("**/seed-*/result.json")):
        result = json.loads(path.read_text())
        *_, group, task, arm, seed, _ = path.parts
        rows.append({"task": f"{group}/{task}", "arm": arm, "seed": seed.removeprefix("seed-")})
        rows[-1] |= {field: result.get(field) for field in fields}
    return rows


def geometric_mean(values: list[float]) -> float:
    return math.exp(statistics.fmean(map(math.log, values)))


def with_interval(figure: Callable[[Resample], float]) -> str:
    """A figure over the medians of several runs each, with its 95 % interval by the percentile bootstrap, from a fixed seed. `figure`
    gets the median, or the median of a resample."""
    draw = random.Random(1)
    resample = lambda of: statistics.median(draw.choices(of, k=len(of)))
    all_ = sorted(figure(resample) for _ in range(RESAMPLES))
    low, high = all_[RESAMPLES // 40], all_[-RESAMPLES // 40 - 1]
    return f"{figure(statistics.median):.2f} [{low:.2f}, {high:.2f}]"
