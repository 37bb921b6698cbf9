#!/usr/bin/env python3
"""DQN on MinAtar's Breakout with MinAtar's network: environment steps a second beside Stable-Baselines3 and a loop like CleanRL's;
prints JSON, and a line to stderr. See README.md.

Run it with a Python that has Trestle's package, and MinAtar. Rounds take turns. The peers have one thread for their arithmetic,
and so has Trestle unless ``--threads`` says otherwise. Trestle runs twice: in lockstep, in which actor and learner take turns, and with
``run.lag = 1``, in which they work at the same time.
"""

import argparse
import json
import os
import platform
import resource
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from settings_minatar import TRESTLE
from step_common import cpu_model

HERE = Path(__file__).resolve().parent


def log(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def run(command: list[Any]) -> tuple[str, float]:
    """What ``command`` prints, and the processor seconds of all its processes."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "PYTHONPATH": str(HERE)}
    done = subprocess.run([str(word) for word in command], stdout=subprocess.PIPE, text=True, env=environment)
    if done.returncode != 0:
        raise SystemExit(f"{' '.join(map(str, command))} ended with {done.returncode}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return done.stdout, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def trestle(out: Path, steps: int, threads: int, lag: int) -> dict[str, float]:
    """A run of ``steps`` environment steps; its processor time is that of all its processes from their start."""
    settings = TRESTLE | {"learner.threads": str(threads), "run.lag": str(lag)}
    sets = [word for key, value in settings.items() for word in ("--set", f"{key}={value}")]
    _, cpu_s = run([sys.executable, "-m", "trestle", "train", "gym", "--algo", "dqn", "--env-steps", steps, "--seed", 1, "--quiet",
                    "--out", out, *sets])
    result = json.loads((out / "result.json").read_text(encoding="utf-8"))
    if result["restarts"] != 0:
        raise SystemExit(f"{result['restarts']} restarts; expected: 0")
    return {"env_steps": result["env_steps"], "wall_s": result["wall_s"], "cpu_s": cpu_s}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--peer", type=Path, required=True, help="a Python with requirements-minatar.txt")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--threads", type=int, default=1, help="threads of Trestle's gradient step")
    parser.add_argument("--steps", type=int, default=100_000, help="environment steps of a run of Trestle")
    parser.add_argument("--peer-steps", type=int, default=20_000, help="environment steps of a run of a peer")
    args = parser.parse_args()
    if args.rounds < 1:
        parser.error(f"--rounds {args.rounds}; accepted: 1 or more")
    found: list[dict[str, Any]] = []
    versions: dict[str, str] = {}
    loads = [os.getloadavg()[0]]
    with tempfile.TemporaryDirectory() as scratch:
        for at in range(args.rounds):
            line: dict[str, Any] = {}
            for how in ("sb3", "cleanrl"):
                peer = json.loads(run([args.peer, HERE / "loop_minatar.py", how, "--env-steps", args.peer_steps])[0])
                versions |= peer["versions"]
                line[how] = args.peer_steps / peer["wall_s"]
                line[f"{how}_cpu_us"] = 1e6 * peer["cpu_s"] / args.peer_steps
            for lag, name in enumerate(("trestle", "trestle_lag")):
                ours = trestle(Path(scratch) / f"{name}-{at}", args.steps, args.threads, lag)
                line[name] = ours["env_steps"] / ours["wall_s"]
                line[f"{name}_cpu_us"] = 1e6 * ours["cpu_s"] / ours["env_steps"]
            for how in ("cleanrl", "trestle", "trestle_lag"):
                line[f"{how}_ratio"] = line[how] / line["sb3"]
                line[f"{how}_cpu_ratio"] = line["sb3_cpu_us"] / line[f"{how}_cpu_us"]
            found.append(line)
            log(f"round {at + 1} of {args.rounds}: " + ", ".join(f"{key} {value:.1f}" for key, value in line.items()))
            loads.append(os.getloadavg()[0])
    middle = {key: statistics.median(line[key] for line in found) for key in found[0]}
    machine = {"cpu": cpu_model(), "cores": os.cpu_count(), "kernel": platform.release(), "load_average": round(max(loads), 2)}
    print(json.dumps({"name": "minatar", "machine": machine, "versions": versions, "threads": args.threads, **middle, "rounds": found}, indent=2))
    log("MinAtar Breakout, steps/s: Stable-Baselines3 {sb3:.0f}; CleanRL's loop {cleanrl:.0f}, ratio {cleanrl_ratio:.1f}; Trestle {trestle:.0f}, "
        "ratio {trestle_ratio:.1f} ({trestle_cpu_ratio:.1f} by processor time); with run.lag = 1 {trestle_lag:.0f}, ratio "
        "{trestle_lag_ratio:.1f}".format(**middle))


if __name__ == "__main__":
    main()
