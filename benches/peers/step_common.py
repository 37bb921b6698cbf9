"""What the peers' gradient steps have in common: sizes, timing, output."""

import argparse
import json
import os
import platform
import statistics
import time
from pathlib import Path

# Input, width of both hidden layers, outputs; rows of a batch.
SIZES = (((8, 64, 4), 32), ((8, 128, 4), 64), ((8, 256, 4), 128), ((2, 128, 4), 32))
# MinAtar's network: height, width, channels of the input; channels and kernel of the convolution; width of the hidden layer,
# outputs; rows of a batch.
GRID, CONV, DENSE, CONV_BATCH = (10, 10, 4), (16, 3), (128, 6), 32
GAMMA, REWARD = 0.99, -0.04
LEARNING_RATE, BETA_1, BETA_2, EPSILON = 1e-3, 0.9, 0.999, 1e-8
SAMPLES, SAMPLE_S = 31, 0.02


def arguments(description: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--quick", action="store_true", help="a few samples, to see whether it works")
    return parser.parse_args()


def medians(cases: dict, quick: bool) -> dict:
    """Microseconds of CPU time of a call of each case; the cases take turns."""
    calls = {}
    for name, case in cases.items():
        n, taken = 1, 0.0
        while taken < SAMPLE_S:
            # The first calls compile.
            n *= 2
            taken = sample(case, n)
        calls[name] = n
    samples = {name: [] for name in calls}
    for _ in range(3 if quick else SAMPLES):
        for name, n in calls.items():
            samples[name].append(sample(cases[name], n) / n * 1e6)
    return {name: statistics.median(values) for name, values in samples.items()}


def sample(case, n: int) -> float:
    """Seconds of CPU time of `n` calls, of all threads."""
    start = time.process_time()
    for _ in range(n):
        case()
    return time.process_time() - start


def cpu_model() -> str:
    for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.machine()


def row(sizes, batch: int, how: str, us: float) -> dict:
    """A row of the report; `sizes` is None for the network with a convolution."""
    if sizes is None:
        height, width, channels = GRID
        return {"inputs": height * width * channels, "conv": f"{CONV[0]} of {CONV[1]} x {CONV[1]}", "hidden": [DENSE[0]],
                "batch": batch, "how": how, "us": round(us, 2)}
    return {"inputs": sizes[0], "conv": "-", "hidden": [sizes[1]] * 2, "batch": batch, "how": how, "us": round(us, 2)}


def print_report(name: str, versions: dict, rows: list) -> None:
    print(json.dumps({
        "name": name,
        "machine": {"cpu": cpu_model(), "cores": len(os.sched_getaffinity(0)), "kernel": platform.release(),
                    "load_average": round(os.getloadavg()[0], 2)},
        "versions": {"python": platform.python_version(), **versions},
        "rows": rows,
    }))
