#!/usr/bin/env python3
"""The table of the corridors in docs/results.md, from a sweep that corridors.sh made: corridors.py OUT

The share of blocked steps is that of the mentor's steps that the observer has no action for (E and W), whose nearest action of
the observer's (NE for E, SW for W) leads into a wall. Ratios are those of medians; intervals hold 95 % (bootstrap, 2000 resamples).
A run that was not solved counts as later than all others.
"""

import csv
import json
import statistics
import sys
from pathlib import Path

from medians import ratio

ARMS = ["dqn", "diiqn", "gated", "matched", "confidence"]
# The nearest action of `irregular` to a step that it does not have, as (columns, rows); rows count downwards.
NEAREST = {(1, 0): (1, -1), (-1, 0): (-1, 1)}
# The file of each corridor among the sweep's maps.
MAPS = {
    "four": "corridors-four-12x11.txt.txt",
    "serpentine": "serpentine-2-6401-14x12.txt",
    "labyrinth": "corridors-2-6402-14x14.txt",
}


def blocked(name: str, out: Path) -> str:
    """How many of the mentor's steps the observer has no action for, and how many of these have a blocked nearest action."""
    corridor, mentor = name.split("-")
    walls = (out / "maps" / MAPS[corridor]).read_text(encoding="utf-8").split()
    recorded = Path(__file__).parent / "corridors" / f"{mentor}.csv"
    made = out / "demonstrations" / "corridors" / f"{name}.csv"
    with open(recorded if recorded.exists() else made, encoding="utf-8") as rows:
        cells = [(int(float(row["column"])), int(float(row["row"]))) for row in csv.DictReader(rows)]
    steps = [((x, y), NEAREST[to[0] - x, to[1] - y]) for (x, y), to in zip(cells, cells[1:]) if (to[0] - x, to[1] - y) in NEAREST]
    into = [(x + dx, y + dy) for (x, y), (dx, dy) in steps]
    free = [0 <= y < len(walls) and 0 <= x < len(walls[y]) and walls[y][x] != "#" for x, y in into]
    return f"{free.count(False)} of {len(free)}"


def main() -> None:
    out = Path(sys.argv[1])
    print("| corridor, mentor | blocked | " + " | ".join(f"`{arm}`" for arm in ARMS) + " | `matched` / `dqn` | `confidence` / `dqn`", end="")
    print(" | `matched` / `diiqn` | `confidence` / `diiqn` |\n|---|---|" + "---|" * (len(ARMS) + 4))
    for task in sorted((out / "corridors").iterdir()):
        episodes: dict[str, list[float]] = {}
        for arm in ARMS:
            results = [json.loads(file.read_text()) for file in sorted((task / arm).glob("seed-*/result.json"))]
            episodes[arm] = [result["solved_episode"] or float("inf") for result in results]
        cells = [task.name.replace("-", ", "), blocked(task.name, out)]
        cells += [f"{statistics.median(episodes[arm]):.0f}" for arm in ARMS]
        cells += [ratio(episodes[arm], episodes[base]) for base in ["dqn", "diiqn"] for arm in ["matched", "confidence"]]
        print("| " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
