#!/usr/bin/env python3
"""Ratios to `diiqn` with honest inference on maze30: docs/results.md shows what this prints.

Every arm but `diiqn` has the same runs with `mentor.inference=similar` as with `any`. So their rows are those of maze30-runs.csv.
maze30-similar-runs.csv has the runs of `diiqn`, and some of the other arms, which are counted and compared. Intervals hold 95 %
(bootstrap, 2000 resamples).
"""

import csv
import statistics
from pathlib import Path

from medians import ratio

HERE = Path(__file__).parent


def times(file: str, column: str) -> dict[str, list[float]]:
    """Of each arm when its runs were solved; never is infinity."""
    found: dict[str, list[float]] = {}
    with open(HERE / file, encoding="utf-8") as rows:
        for row in csv.DictReader(rows):
            found.setdefault(row["arm"], []).append(float(row[column] or "inf"))
    return found


def same() -> str:
    """How many runs of the other arms were solved after the same steps under both rules."""
    steps = []
    for file in ["maze30-runs.csv", "maze30-similar-runs.csv"]:
        with open(HERE / file, encoding="utf-8") as rows:
            steps.append({(row["arm"], row["seed"]): row["solved_env_steps"] for row in csv.DictReader(rows)})
    both = [key for key in steps[1] if key[0] != "diiqn"]
    return f"{sum(steps[0][key] == steps[1][key] for key in both)} of {len(both)}"


def main() -> None:
    columns = ["solved_episode", "solved_env_steps"]
    arms = [times("maze30-runs.csv", column) for column in columns]
    honest = [times("maze30-similar-runs.csv", column)["diiqn"] for column in columns]
    print("| arm | runs | episodes | thousand steps | episodes / `diiqn` | steps / `diiqn` |\n|---|---|---|---|---|---|")
    for arm in ["diiqn", "dqn", "literal", "gated", "matched", "confidence", "guided"]:
        episodes, steps = honest if arm == "diiqn" else (arms[0][arm], arms[1][arm])
        ratios = ["1", "1"] if arm == "diiqn" else [ratio(episodes, honest[0]), ratio(steps, honest[1])]
        cells = [f"`{arm}`", len(steps), f"{statistics.median(episodes):.0f}", f"{statistics.median(steps) / 1e3:.0f}", *ratios]
        print("| " + " | ".join(map(str, cells)) + " |")
    print(f"\nRuns of other arms that are the same, to the step: {same()}")


if __name__ == "__main__":
    main()
