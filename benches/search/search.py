#!/usr/bin/env python3
"""Runs arms x maps x seeds of the single-process loop, one line of CSV a run; what the file has already is not run
again. See README.md."""

import argparse
import csv
import json
import os
import shlex
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FIELDS = ["arm", "map", "seed", "settings", "solved_episode", "solved_env_steps", "episodes", "env_steps",
          "final_return", "threshold"]
# A run is solved with the first of this many consecutive evaluations within the tolerance.
CONSECUTIVE = 3


def seeds(text: str) -> list[int]:
    first, _, last = text.partition("..")
    return list(range(int(first), int(last or first) + 1))


def train(options, sets: list[str], out: str) -> list[str]:
    command = [*shlex.split(options.prefix), options.binary, "train", options.config, "--mode", "reference",
               "--quiet", "--overwrite", "--out", out, "--set", "checkpoint.every_env_steps=0"]
    for setting in sets:
        command += ["--set", setting]
    return command


def threshold(options, sets: list[str]) -> float:
    """The map's best return, as a run of one tick reports it."""
    with tempfile.TemporaryDirectory() as out:
        command = train(options, [*sets, "run.algo=dqn", "run.env_steps=1"], out + "/run")
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        return json.loads(Path(out, "run/result.json").read_text())["threshold"]


def solved(evals: Path, mark: float) -> bool:
    """Whether the evaluations so far have three in a row at or above `mark`."""
    try:
        lines = evals.read_text().splitlines()[1:]
    except FileNotFoundError:
        return False
    returns = [float(line.split(",")[4]) for line in lines if line.count(",") == 6]
    row = 0
    for value in returns:
        row = row + 1 if value >= mark - 1e-6 * max(1, abs(mark)) else 0
        if row == CONSECUTIVE:
            return True
    return False


def run(options, sets: list[str], mark: float) -> dict:
    """Trains until the run is solved or has reached its limits, and returns its result."""
    with tempfile.TemporaryDirectory() as out:
        path = Path(out, "run")
        # A group of its own: the interrupt must reach the program through whatever `--prefix` puts before it.
        child = subprocess.Popen(train(options, sets, str(path)), stdout=subprocess.DEVNULL, start_new_session=True)
        try:
            told = False
            while child.poll() is None:
                time.sleep(0.2)
                if not told and solved(path / "evals.csv", mark):
                    os.killpg(child.pid, signal.SIGINT)
                    told = True
        finally:
            if child.poll() is None:
                os.killpg(child.pid, signal.SIGKILL)
        if child.returncode not in (0, 130):
            raise SystemExit(f"a run failed with status {child.returncode}: {shlex.join(child.args)}")
        return json.loads((path / "result.json").read_text())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", required=True, type=Path, help="CSV file, created or continued")
    parser.add_argument("--binary", default=str(ROOT / "target/release/trestle"))
    parser.add_argument("--config", default="maze30", help="preset or file that the settings change")
    parser.add_argument("--maps", nargs="+", default=["maze30"])
    parser.add_argument("--seeds", default="1..3")
    parser.add_argument("--set", action="append", default=[], help="a setting of all arms")
    parser.add_argument("--arm", action="append", required=True, help="name: key=value key=value ...")
    parser.add_argument("--tolerance", type=float, default=0.5)
    parser.add_argument("--prefix", default="", help="words before every command, such as `nice -n 19`")
    options = parser.parse_args()
    done = set()
    if options.out.exists():
        with options.out.open(newline="") as file:
            done = {(r["arm"], r["map"], r["seed"], r["settings"]) for r in csv.DictReader(file)}
    else:
        options.out.parent.mkdir(parents=True, exist_ok=True)
        options.out.write_text(",".join(FIELDS) + "\n")
    marks = {}
    # Seed by seed, so that an interrupted search has compared all arms on the seeds that it reached.
    for seed in seeds(options.seeds):
        for map_ in options.maps:
            for arm in options.arm:
                name, _, own = arm.partition(":")
                sets = [*options.set, *own.split()]
                key = (name, map_, str(seed), " ".join(sets))
                if key in done:
                    continue
                place = f"env.map={map_}"
                if map_ not in marks:
                    marks[map_] = threshold(options, [*options.set, place])
                result = run(options, [*sets, place, f"run.seed={seed}"], marks[map_] - options.tolerance)
                row = dict(zip(FIELDS, [name, map_, seed, " ".join(sets)]))
                row |= {field: result[field] for field in FIELDS[4:]}
                with options.out.open("a", newline="") as file:
                    csv.DictWriter(file, FIELDS, lineterminator="\n").writerow(row)
                print(*row.values(), file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
