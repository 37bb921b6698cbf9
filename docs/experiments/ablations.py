#!/usr/bin/env python3
"""The table of docs/experiments.md about the parts of `trestle`.

    docs/experiments/ablations.py            the table, from ablations.csv
    docs/experiments/ablations.py OUT        rows for ablations.csv, from the runs of ablations.sh in OUT

A run that was not solved counts with the steps that it took, its budget.
"""

import csv
import statistics
import sys
from pathlib import Path

from tables import Resample, geometric_mean, rows_of, with_interval

FIELDS = ["episodes", "env_steps", "solved_episode", "solved_env_steps"]
GROUPS = ["mazes-one-hot", "mazes-coordinates", "point-maze", "bad-mentors"]
LOSS = 1.1


def cell(found: dict, arm: str, tasks: list[str]) -> str:
    """The geometric mean of the ratios of medians, with its interval."""
    return with_interval(lambda pick: geometric_mean(ratios(found, arm, tasks, pick)))


def ratios(found: dict, arm: str, tasks: list[str], pick: Resample) -> list[float]:
    """For each task the ratio of `arm`'s value to that of `dqn`, each of which `pick` makes of its seeds' steps."""
    return [pick(found[task, arm]) / pick(found[task, "dqn"]) for task in tasks]


def table(rows: list[dict]) -> None:
    """Prints the table, the best arm first."""
    found: dict = {}
    for row in rows:
        found.setdefault((row["task"], row["arm"]), []).append(float(row["solved_env_steps"] or row["env_steps"]))
    tasks = list(dict.fromkeys(row["task"] for row in rows))
    overall = lambda arm: geometric_mean(ratios(found, arm, tasks, statistics.median))
    arms = sorted({row["arm"] for row in rows} - {"dqn"}, key=overall)
    print("| arm | " + " | ".join([*GROUPS, "all", "losses", "largest ratio"]) + " |\n" + "|---" * 8 + "|")
    for arm in arms:
        groups = [cell(found, arm, [task for task in tasks if task.startswith(f"{group}/")]) for group in GROUPS]
        each = ratios(found, arm, tasks, statistics.median)
        losses = sum(ratio > LOSS for ratio in each)
        print(f"| `{arm}` | " + " | ".join([*groups, cell(found, arm, tasks), str(losses), f"{max(each):.2f}"]) + " |")


def main() -> None:
    if len(sys.argv) > 1:
        writer = csv.DictWriter(sys.stdout, ["task", "arm", "seed", *FIELDS], lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows_of(Path(sys.argv[1]), FIELDS))
        return
    with Path(__file__).with_suffix(".csv").open() as file:
        table(list(csv.DictReader(file)))


main()
