#!/usr/bin/env python3
"""Steps of the Point Maze: Gymnasium-Robotics against both back ends of Trestle, in turn, so that all see the same machine.

    benches/peers/point_maze.py --steps-binary target/release/examples/env_steps [--rounds 5]

Needs `pip install gymnasium-robotics==1.4.2 mujoco==4.0.0`, and the program by
`cargo build --release --workspace --example env_steps`. The back end mujoco is measured where libmujoco is found, which in
a virtual environment is the one that Gymnasium-Robotics uses. Prints JSON: the median time of a step in nanoseconds, and the
median of the rounds' ratios of Gymnasium-Robotics to each back end.

The peer is what `gymnasium.make` returns, wrappers for the order of calls and the step limit included, in the medium maze with
random diagonal actions; Trestle's side is the same task, with its rewards and its end at the goal.
"""

import argparse
import json
import statistics
import subprocess
import time
import warnings


def gymnasium_ns(steps):
    """The time of one step, nanoseconds."""
    import gymnasium
    import gymnasium_robotics
    import numpy as np

    gymnasium.register_envs(gymnasium_robotics)
    env = gymnasium.make("PointMaze_Medium-v3", max_episode_steps=4000)
    rng = np.random.default_rng(0)
    actions = rng.choice([-1.0, -0.5, 0.5, 1.0], (4096, 2))
    env.reset(seed=0)
    start = time.perf_counter()
    for i in range(steps):
        _, _, terminated, truncated, _ = env.step(actions[i % 4096])
        if terminated or truncated:
            env.reset()
    return (time.perf_counter() - start) * 1e9 / steps


def trestle_ns(program, backend, steps):
    out = subprocess.run([program, backend, str(steps)], capture_output=True, text=True)
    if out.returncode != 0:
        return None, out.stderr.strip()
    row = json.loads(out.stdout)
    return row["ns"], row["version"]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps-binary", required=True)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--steps", type=int, default=20_000, help="of Gymnasium-Robotics a round")
    args = parser.parse_args()
    warnings.simplefilter("ignore")
    peer, ours = [], {"builtin": [], "mujoco": []}
    notes = {}
    gymnasium_ns(1000)
    for _ in range(args.rounds):
        peer.append(gymnasium_ns(args.steps))
        for backend, factor in (("builtin", 50), ("mujoco", 5)):
            ns, notes[backend] = trestle_ns(args.steps_binary, backend, args.steps * factor)
            ours[backend].append(ns)
    rows = [{"name": "gymnasium-robotics", "ns": statistics.median(peer)}]
    for backend, times in ours.items():
        row = {"name": f"trestle {backend}", "note": notes[backend]}
        if None not in times:
            row["ns"] = statistics.median(times)
            row["ratio"] = statistics.median(p / t for p, t in zip(peer, times))
        rows.append(row)
    print(json.dumps({"rows": rows}, indent=2))


main()
