#!/usr/bin/env python3
"""The table of docs/experiments.md about how the guide came to correct, from correction.csv.

A run that was not solved counts with the steps that it took, its budget.
"""

import csv
import math
import statistics
from pathlib import Path


def main() -> None:
    rows = list(csv.DictReader(Path(__file__).with_suffix(".csv").open()))
    steps: dict = {}
    for row in rows:
        taken = float(row["solved_env_steps"] or row["env_steps"])
        steps.setdefault(row["arm"], {})[row["task"], row["seed"]] = taken
    for arm, runs in steps.items():
        logs = [math.log(taken / steps["none"][run]) for run, taken in runs.items()]
        centre, error = statistics.fmean(logs), statistics.stdev(logs) / math.sqrt(len(logs))
        mean, low, high = (math.exp(centre + times * error) for times in (0, -1.96, 1.96))
        unsolved = sum(row["arm"] == arm and not row["solved_env_steps"] for row in rows)
        print(f"| `{arm}` | {mean:.2f} [{low:.2f}, {high:.2f}] | {unsolved} |")


main()
