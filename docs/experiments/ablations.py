#!/usr/bin/env python3
"""The table of docs/experiments.md about the parts of `trestle`.

    docs/experiments/ablations.py            the table, from ablations.csv
    docs/experiments/ablations.py OUT        rows for ablations.csv, from the runs of ablations.sh in OUT

A run that was not solved counts with the steps that it took, its budget.
"""

import csv
import json
import math
import random
import statistics
import sys
from pathlib import Path

FIELDS = ["task", "arm", "seed", "complete", "episodes", "env_steps", "solved_episode", "solved_env_steps"]
GROUPS = ["mazes-one-hot", "mazes-coordinates", "point-maze", "bad-mentors"]
LOSS = 1.1
RESAMPLES = 2000


def rows_of(out: Path) -> list[dict]:
    """A row for each run below `out`, which has directories for groups, tasks, arms and seeds."""
    rows = []
    for path in sorted(out.glob("*/*/*/seed-*/result.json")):
        result = json.loads(path.read_text())
        group, task, arm, seed, _ = path.relative_to(out).parts
        rows.append({"task": f"{group}/{task}", "arm": arm, "seed": seed.removeprefix("seed-")})
        rows[-1] |= {"complete": str(not result["interrupted"]).lower()}
        rows[-1] |= {field: result.get(field) for field in FIELDS[4:]}
    return rows


def ratios(found: dict, arm: str, tasks: list[str], pick) -> list[float]:
    """For each task the ratio of `arm`'s value to that of `dqn`, each of which `pick` makes of its seeds' steps."""
    return [pick(found[task, arm]) / pick(found[task, "dqn"]) for task in tasks]


def mean(values: list[float]) -> float:
    """The geometric mean."""
    return math.exp(statistics.fmean(map(math.log, values)))


def cell(found: dict, arm: str, tasks: list[str]) -> str:
    """The geometric mean of the ratios of medians, with its 95 % interval (percentile bootstrap of the seeds of each task, from a
    fixed seed)."""
    draw = random.Random(1)
    resample = lambda of: statistics.median(draw.choices(of, k=len(of)))
    all_ = sorted(mean(ratios(found, arm, tasks, resample)) for _ in range(RESAMPLES))
    low, high = all_[RESAMPLES // 40], all_[-RESAMPLES // 40 - 1]
    return f"{mean(ratios(found, arm, tasks, statistics.median)):.2f} [{low:.2f}, {high:.2f}]"


def table(rows: list[dict]) -> None:
    """Prints the table, the best arm first."""
    found: dict = {}
    for row in rows:
        found.setdefault((row["task"], row["arm"]), []).append(float(row["solved_env_steps"] or row["env_steps"]))
    tasks = list(dict.fromkeys(row["task"] for row in rows))
    overall = lambda arm: mean(ratios(found, arm, tasks, statistics.median))
    arms = sorted({row["arm"] for row in rows} - {"dqn"}, key=overall)
    print("| arm | " + " | ".join([*GROUPS, "all", "losses", "largest ratio"]) + " |\n" + "|---" * 8 + "|")
    for arm in arms:
        groups = [cell(found, arm, [task for task in tasks if task.startswith(f"{group}/")]) for group in GROUPS]
        each = ratios(found, arm, tasks, statistics.median)
        losses = sum(ratio > LOSS for ratio in each)
        print(f"| `{arm}` | " + " | ".join([*groups, cell(found, arm, tasks), str(losses), f"{max(each):.2f}"]) + " |")


def main() -> None:
    if len(sys.argv) > 1:
        writer = csv.DictWriter(sys.stdout, FIELDS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows_of(Path(sys.argv[1])))
        return
    with Path(__file__).with_suffix(".csv").open() as file:
        table(list(csv.DictReader(file)))


main()
