#!/usr/bin/env python3
"""Trestle's DQN against Stable-Baselines3's on maze30, interleaved; prints JSON, and a line to stderr. See README.md."""

import argparse
import json
import os
import platform
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
TARGET = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
# The peer has no Double target and always clips the gradient at 10; Trestle is given the same work.
EQUAL_WORK = ["--set", "learner.double=false", "--set", "learner.max_grad_norm=10"]
# More than any number of steps asked for can hold, so that the steps alone end the run.
EPISODES = 1_000_000


def log(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def peer_python(venv: Path) -> Path:
    """The interpreter of `venv`, which is made from the pinned requirements if it is absent."""
    python = venv / "bin/python"
    if not python.exists():
        log(f"making {venv} from requirements.txt; PyTorch is a large download")
        try:
            subprocess.run([sys.executable, "-m", "venv", venv], check=True, stdout=sys.stderr)
            pip = [python, "-m", "pip", "install", "--quiet", "-r", HERE / "requirements.txt"]
            subprocess.run(pip, check=True, stdout=sys.stderr)
        except BaseException:
            # A half-made one would be taken for complete the next time.
            shutil.rmtree(venv, ignore_errors=True)
            raise
    return python


def built_trestle() -> Path:
    log("building trestle in release")
    subprocess.run(["cargo", "build", "--release", "--bin", "trestle"], cwd=ROOT, check=True, stdout=sys.stderr)
    return TARGET.absolute() / "release/trestle"


def run(command: list, cpus: set[int]) -> tuple[str, float]:
    """Output of `command` on the CPUs `cpus`, and the CPU seconds of all its processes."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [str(word) for word in command],
        stdout=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: os.sched_setaffinity(0, cpus),
        env={**os.environ, "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"},
    )
    if done.returncode != 0:
        raise SystemExit(f"{command[0]} ended with {done.returncode}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return done.stdout, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def sb3(python: Path, steps: int, cpus: set[int]) -> dict:
    """One run of the peer. Only its training counts: not the imports, not the making of the model."""
    return json.loads(run([python, HERE / "sb3_maze30.py", "--env-steps", steps, "--seed", 1], cpus)[0])


def trestle_command(binary: Path, steps: int, out: Path) -> list:
    return [binary, "train", "maze30", "--algo", "dqn", "--env-steps", steps, "--episodes", EPISODES, *EQUAL_WORK,
            "--seed", 1, "--quiet", "--out", out]


def trestle(binary: Path, steps: int, cpus: set[int]) -> dict:
    """One run of Trestle. Its wall time counts from the first tick, its CPU time from the start of its processes."""
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch) / "run"
        _, cpu_s = run(trestle_command(binary, steps, out), cpus)
        result = json.loads((out / "result.json").read_text(encoding="utf-8"))
    if result["env_steps"] != steps or result["restarts"] != 0:
        raise SystemExit(f"trestle took {result['env_steps']} environment steps with {result['restarts']} restarts; "
                         f"expected: {steps} with 0")
    return {
        "steps_per_s": steps / result["wall_s"],
        "env_steps": steps,
        "grad_steps": result["grad_steps"],
        "wall_s": result["wall_s"],
        "cpu_s": cpu_s,
    }


def measured(measure) -> dict:
    """What `measure` returns, with the load average before it."""
    load = os.getloadavg()[0]
    return {**measure(), "load_average_before": round(load, 2)}


def cpu_model() -> str:
    for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.machine()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trestle", type=Path, help="this binary instead of building one")
    parser.add_argument("--venv", type=Path, default=TARGET / "peers-venv", help="the peer's venv, made if absent")
    parser.add_argument("--pairs", type=int, default=3, help="runs of each")
    parser.add_argument("--trestle-steps", type=int, default=500_000, help="environment steps of a Trestle run")
    parser.add_argument("--sb3-steps", type=int, default=60_000, help="environment steps of a peer run")
    parser.add_argument("--cpus", help="CPUs that both may use, for example 0,1; all if not given")
    args = parser.parse_args()
    if args.pairs < 1:
        parser.error(f"--pairs {args.pairs}; accepted: 1 or more")
    allowed = os.sched_getaffinity(0)
    try:
        cpus = {int(cpu) for cpu in args.cpus.split(",")} if args.cpus else allowed
    except ValueError:
        parser.error(f"--cpus {args.cpus}; accepted: numbers with commas between them")
    if not cpus <= allowed:
        parser.error(f"--cpus {args.cpus}; accepted: some of {sorted(allowed)}")

    python = peer_python(args.venv.absolute())
    binary = args.trestle.absolute() if args.trestle else built_trestle()
    runs = []
    for pair in range(args.pairs):
        a = measured(lambda: sb3(python, args.sb3_steps, cpus))
        b = measured(lambda: trestle(binary, args.trestle_steps, cpus))
        runs.append({
            "sb3": a,
            "trestle": b,
            "ratio": b["steps_per_s"] / a["steps_per_s"],
            "cpu_ratio": (a["cpu_s"] / a["env_steps"]) / (b["cpu_s"] / b["env_steps"]),
        })
        log(f"pair {pair + 1} of {args.pairs}: sb3 {a['steps_per_s']:.0f}/s, trestle {b['steps_per_s']:.0f}/s, "
            f"ratio {runs[-1]['ratio']:.1f}")

    def median(of) -> float:
        return statistics.median(of(r) for r in runs)

    report = {
        "median_ratio": median(lambda r: r["ratio"]),
        "median_cpu_ratio": median(lambda r: r["cpu_ratio"]),
        "median_sb3_steps_per_s": median(lambda r: r["sb3"]["steps_per_s"]),
        "median_trestle_steps_per_s": median(lambda r: r["trestle"]["steps_per_s"]),
        "date": time.strftime("%Y-%m-%d"),
        "cpu_model": cpu_model(),
        "cpus": sorted(cpus),
        "kernel": platform.release(),
        "versions": {
            "trestle": run([binary, "--version"], cpus)[0].strip(),
            **runs[0]["sb3"]["versions"],
        },
        "trestle_command": " ".join(map(str, trestle_command(Path("trestle"), args.trestle_steps, Path("DIR")))),
        "runs": runs,
    }
    print(json.dumps(report, indent=2))
    loads = [r[side]["load_average_before"] for r in runs for side in ("sb3", "trestle")]
    log(f"maze30, DQN: Trestle {report['median_trestle_steps_per_s']:.0f} steps/s, Stable-Baselines3 "
        f"{report['median_sb3_steps_per_s']:.0f} steps/s; median ratio of {args.pairs} pairs "
        f"{report['median_ratio']:.1f} (by CPU time {report['median_cpu_ratio']:.1f}); "
        f"CPUs {sorted(cpus)}, load average {min(loads)} to {max(loads)}")


if __name__ == "__main__":
    main()
