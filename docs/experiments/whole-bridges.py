#!/usr/bin/env python3
"""The tables of docs/experiments.md about whole bridges, one pair for each group of tasks.

    docs/experiments/whole-bridges.py            the tables, from whole-bridges.csv
    docs/experiments/whole-bridges.py OUT        rows for whole-bridges.csv, from the runs of whole-bridges.sh in OUT

A run that was not solved counts with the steps that it took, its budget.
"""

import csv
import statistics
import sys
from pathlib import Path

from tables import geometric_mean, rows_of, with_interval

FIELDS = ["episodes", "env_steps", "solved_episode", "solved_env_steps"]
ARMS = ["dqn", "ha-diiqn", "end", "guided", "whole"]
RATIOS = [("end", "ha-diiqn"), ("whole", "guided"), ("ha-diiqn", "dqn"), ("guided", "dqn"), ("whole", "dqn")]


def steps(rows: list[dict]) -> dict[str, dict[str, dict[int, float]]]:
    """Thousand steps until solved, by task, arm and seed."""
    found: dict = {}
    for row in rows:
        value = float(row["solved_env_steps"] or row["env_steps"]) / 1000
        found.setdefault(row["task"], {}).setdefault(row["arm"], {})[int(row["seed"])] = value
    return found


def ratio(found: dict, arm: str, base: str) -> str:
    """The geometric mean over tasks of the ratios of medians, each over the seeds that both arms have, with its 95 % interval
    (percentile bootstrap of the seeds of each task, from a fixed seed), and on how many tasks `arm` has the smaller median."""
    pairs = []
    for arms in found.values():
        common = sorted(arms.get(arm, {}).keys() & arms.get(base, {}).keys())
        if common:
            pairs.append(([arms[arm][seed] for seed in common], [arms[base][seed] for seed in common]))
    ratios = lambda pick: [pick(times) / pick(others) for times, others in pairs]
    smaller = sum(ratio < 1 for ratio in ratios(statistics.median))
    return f"{with_interval(lambda pick: geometric_mean(ratios(pick)))} | {smaller} of {len(pairs)}"


def tables(rows: list[dict]) -> None:
    """Prints the tables of one group of tasks."""
    found = steps(rows)
    present = [arm for arm in ARMS if any(arm in arms for arms in found.values())]
    print("| task | " + " | ".join(f"`{arm}`" for arm in present) + " |\n" + "|---" * (len(present) + 1) + "|")
    for task, arms in found.items():
        cells = []
        for arm in present:
            of = [row for row in rows if (row["task"], row["arm"]) == (task, arm)]
            solved = sum(row["solved_env_steps"] != "" for row in of)
            share = "" if solved == len(of) else f", {solved} of {len(of)}"
            cells.append(f"{statistics.median(arms[arm].values()):.1f}{share}")
        print(f"| {task.split('/')[1]} | " + " | ".join(cells) + " |")
    print("\n| ratio of medians | geometric mean | tasks with a smaller median |\n|---|---|---|")
    for arm, base in RATIOS:
        if arm in present and base in present:
            print(f"| `{arm}` / `{base}` | {ratio(found, arm, base)} |")
    print()


def main() -> None:
    if len(sys.argv) > 1:
        writer = csv.DictWriter(sys.stdout, ["task", "arm", "seed", *FIELDS], lineterminator="\n")
        writer.writerows(rows_of(Path(sys.argv[1]), FIELDS))
        return
    with Path(__file__).with_suffix(".csv").open() as file:
        rows = list(csv.DictReader(file))
    for group in dict.fromkeys(row["task"].split("/")[0] for row in rows):
        tables([row for row in rows if row["task"].startswith(f"{group}/")])


main()
