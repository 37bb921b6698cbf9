#!/usr/bin/env python3
"""What large replays cost: memory, checkpoints, and going on from them; prints JSON, and a table to stderr.

    benches/big_replays.py PROGRAM [--stored 100000 1000000 10000000] [--algo dqn ha-diiqn]

For each size a run of maze30 fills a replay of so many transitions, hardly learning meanwhile: one gradient step in 4096 steps. It takes
a checkpoint in its middle and one at its end, and then goes on for one more tick.

- memory: what all processes hold together, at most (PSS, looked at every 50 ms), over the number of stored transitions;
- checkpoint: how long the learner stood still for one, by its log, and how large the last one is;
- resume: from the start of `trestle resume` to the end of one more tick and its checkpoint. Reading, linking, the mentor-server's rebuild
  are in it. Beside it the processor time of all processes, which other work on the machine changes less.
"""

import argparse
import json
import os
import platform
import re
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

#: One tick.
ROLLOUT = 4096
SETTINGS = {
    "run.rollout": str(ROLLOUT),
    "learner.train_every": str(ROLLOUT),
    "learner.warmup": "1000",
    "eval.every": "100000000",
    "checkpoint.keep": "1",
    "supervise.silence_s": "600",
    "supervise.stall_s": "600",
}


def held(root: int) -> int:
    """Bytes that a process and its children hold; of what several share each counts its part."""
    total, ids = 0, [root]
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
            except OSError:
                continue
            if parent == root:
                ids.append(int(entry.name))
    for process in ids:
        try:
            rollup = Path(f"/proc/{process}/smaps_rollup").read_text()
        except OSError:
            continue
        if found := re.search(r"^Pss:\s+(\d+) kB", rollup, re.MULTILINE):
            total += 1024 * int(found[1])
    return total


def cpu_s() -> float:
    """Processor seconds of all children that have ended, and of theirs."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def run(command: list[Any]) -> tuple[float, float, int]:
    """Seconds and processor seconds that ``command`` takes, and the most bytes that its processes held."""
    start, cpu, most = time.perf_counter(), cpu_s(), 0
    with subprocess.Popen([str(word) for word in command], stdout=subprocess.DEVNULL) as training:
        while training.poll() is None:
            most = max(most, held(training.pid))
            time.sleep(0.05)
    if training.returncode != 0:
        raise SystemExit(f"{' '.join(map(str, command))} ended with {training.returncode}")
    return time.perf_counter() - start, cpu_s() - cpu, most


def stalls(out: Path) -> list[float]:
    """Seconds that the learner stood still for each checkpoint."""
    text = "".join(path.read_text(errors="replace") for path in sorted((out / "logs").rglob("*")) if path.is_file())
    return [int(found) / 1e6 for found in re.findall(r"stall_us[\"=: ]+(\d+)", text)]


def size(directory: Path) -> int:
    return sum(path.stat().st_size for path in directory.rglob("*") if path.is_file())


def measure(program: Path, algo: str, stored: int) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch) / "run"
        steps = -(-stored // ROLLOUT) * ROLLOUT
        settings = SETTINGS | {"learner.replay": str(stored), "checkpoint.every_env_steps": str(steps // 2)}
        sets = [word for key, value in settings.items() for word in ("--set", f"{key}={value}")]
        seconds, cpu, most = run([program, "train", "maze30", "--algo", algo, "--seed", 1, "--env-steps", steps, "--episodes", 10**9,
                             "--quiet", "--out", out, *sets])
        taken = stalls(out)
        newest = max((path for path in (out / "checkpoints").iterdir() if path.name.isdigit()), key=lambda path: path.name)
        on_disk = size(newest)
        resumed, resumed_cpu, most_again = run([program, "resume", out, "--env-steps", steps + ROLLOUT, "--quiet"])
        return {
            "algo": algo,
            "stored": stored,
            "train_s": round(seconds, 2),
            "train_cpu_s": round(cpu, 2),
            "peak_mb": round(most / 1e6, 1),
            "checkpoint_s": round(max(taken), 3) if taken else None,
            "checkpoint_mb": round(on_disk / 1e6, 1),
            "resume_s": round(resumed, 2),
            "resume_cpu_s": round(resumed_cpu, 2),
            "resume_peak_mb": round(most_again / 1e6, 1),
        }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", type=Path)
    parser.add_argument("--stored", type=int, nargs="+", default=[100_000, 1_000_000, 10_000_000])
    parser.add_argument("--algo", nargs="+", default=["dqn", "ha-diiqn"])
    args = parser.parse_args()
    loads, rows = [os.getloadavg()[0]], []
    for stored in args.stored:
        for algo in args.algo:
            rows.append(measure(args.program.absolute(), algo, stored))
            loads.append(os.getloadavg()[0])
            print(" ".join(f"{key}={value}" for key, value in rows[-1].items()), file=sys.stderr, flush=True)
    machine = {"cores": os.cpu_count(), "kernel": platform.release(), "load_average": [round(load, 2) for load in loads]}
    print(json.dumps({"name": "big_replays", "machine": machine, "rows": rows}, indent=2))


if __name__ == "__main__":
    main()
