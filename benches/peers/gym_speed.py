#!/usr/bin/env python3
"""What Gymnasium's environments cost in Trestle; prints JSON, and a line for each figure to stderr. See README.md.

Run it with a Python that has Trestle's package. Rounds take turns, and processor time is compared wherever that answers the
question: other work on the machine then matters less.
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
import time
from pathlib import Path
from typing import Any, Callable

import gymnasium

HERE = Path(__file__).resolve().parent
#: The same work for both: SB3's DQN has no double target and looks one step ahead.
EQUAL_WORK = {"learner.double": "false", "learner.n_step": "1", "learner.max_grad_norm": "10"}
#: No sign of life is missed on a machine with other work.
PATIENT = {"supervise.silence_s": "600", "supervise.stall_s": "600"}


class Sleeper(gymnasium.Env):
    """Sleeps for a millisecond in each step."""

    def __init__(self) -> None:
        self.observation_space = gymnasium.spaces.Box(-1, 1, (4,))
        self.action_space = gymnasium.spaces.Discrete(2)

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        self.steps = 0
        return self.observation_space.low, {}

    def step(self, action: Any) -> Any:
        time.sleep(1e-3)
        self.steps += 1
        return self.observation_space.low, 0.0, False, self.steps >= 100, {}


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


def trestle(*args: Any, settings: dict[str, str] | None = None) -> tuple[str, float]:
    sets = [word for key, value in (settings or {}).items() for word in ("--set", f"{key}={value}")]
    return run([sys.executable, "-m", "trestle", *args, *sets])


def train(out: Path, config: str, steps: int, settings: dict[str, str]) -> dict[str, float]:
    """A run of ``steps`` environment steps; its processor time is that of all its processes from their start."""
    _, cpu_s = trestle("train", config, "--algo", "dqn", "--env-steps", steps, "--seed", 1, "--quiet", "--out", out,
                       settings=PATIENT | {"checkpoint.every_env_steps": "0"} | settings)
    result = json.loads((out / "result.json").read_text(encoding="utf-8"))
    if result["env_steps"] < steps or result["restarts"] != 0:
        raise SystemExit(f"{result['env_steps']} environment steps with {result['restarts']} restarts; expected: {steps} with 0")
    return {"env_steps": result["env_steps"], "wall_s": result["wall_s"], "cpu_s": cpu_s}


def loop(scratch: Path, rounds: int) -> dict[str, Any]:
    """Processor time of a step of CartPole in `trestle eval`, with a network of one unit, beyond that in a bare loop."""
    out = scratch / "cart"
    train(out, "gym:CartPole-v1", 30_000, {"learner.hidden": "[1]"})
    found = []
    for _ in range(rounds):
        steps, times = [], []
        for episodes in (100, 3_100):
            said, cpu = trestle("eval", out, "--episodes", episodes, "--seed", 7, "--json")
            steps.append(episodes * json.loads(said)["mean_steps"])
            times.append(cpu)
        ours = (times[1] - times[0]) / (steps[1] - steps[0])
        found.append({"ours_us": 1e6 * ours, "bare_us": 1e6 * bare(100_000)})
        found[-1]["added_us"] = found[-1]["ours_us"] - found[-1]["bare_us"]
    middle = {key: statistics.median(each[key] for each in found) for key in found[0]}
    log("a step of CartPole: {ours_us:.2f} us in Trestle, {bare_us:.2f} us in a bare loop, {added_us:.2f} us more".format(**middle))
    return {**middle, "rounds": found}


def bare(steps: int) -> float:
    """Processor seconds of a step in a loop of Python, resets included, as they are in Trestle."""
    env = gymnasium.make("CartPole-v1", disable_env_checker=True)
    env.reset(seed=1)
    before = time.process_time()
    for i in range(steps):
        _, _, terminated, truncated, _ = env.step(i & 1)
        if terminated or truncated:
            env.reset(seed=i)
    return (time.process_time() - before) / steps


def beside_sb3(scratch: Path, rounds: int, python: Path, steps: int) -> dict[str, Any]:
    """CartPole with two layers of 128 units, a batch of 64 and a gradient step each step: environment steps a second."""
    found = []
    for i in range(rounds):
        peer = json.loads(run([python, HERE / "sb3_gym.py", "--env-steps", steps])[0])
        ours = train(scratch / f"sb3-{i}", "gym:CartPole-v1", steps, EQUAL_WORK)
        rate = {"sb3": steps / peer["wall_s"], "trestle": ours["env_steps"] / ours["wall_s"]}
        found.append({
            **{f"{key}_steps_per_s": value for key, value in rate.items()},
            "ratio": rate["trestle"] / rate["sb3"],
            "cpu_ratio": (peer["cpu_s"] / steps) / (ours["cpu_s"] / ours["env_steps"]),
        })
        versions = peer["versions"]
    middle = {key: statistics.median(each[key] for each in found) for key in found[0]}
    log("CartPole: Trestle {trestle_steps_per_s:.0f} steps/s, Stable-Baselines3 {sb3_steps_per_s:.0f} steps/s, ratio {ratio:.1f}, "
        "by processor time {cpu_ratio:.1f}".format(**middle))
    return {**middle, "rounds": found, "versions": versions}


def actors(scratch: Path, rounds: int) -> dict[str, Any]:
    """An environment that sleeps a millisecond in each step: 4 actors, collecting while the learner trains, beside one."""
    own = {"env.gym.make": "gym_speed:Sleeper", "learner.hidden": "[16]", "learner.train_every": "8", "eval.every": "1000000"}
    found = []
    for i in range(rounds):
        rates = []
        for n in (1, 4):
            made = train(scratch / f"actors-{i}-{n}", "gym", 3_200 * n, own | {"run.actors": str(n), "run.lag": "1"})
            rates.append(made["env_steps"] / made["wall_s"])
        found.append({"one_steps_per_s": rates[0], "four_steps_per_s": rates[1], "ratio": rates[1] / rates[0]})
    middle = {key: statistics.median(each[key] for each in found) for key in found[0]}
    log("1 ms a step: one actor {one_steps_per_s:.0f} steps/s, four {four_steps_per_s:.0f}, ratio {ratio:.2f}".format(**middle))
    return {**middle, "rounds": found}


def cpu_model() -> str:
    for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.machine()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--peer", type=Path, help="a Python with requirements.txt; without it there is no comparison with SB3")
    parser.add_argument("--peer-steps", type=int, default=20_000, help="environment steps of a run beside SB3")
    args = parser.parse_args()
    if args.rounds < 1:
        parser.error(f"--rounds {args.rounds}; accepted: 1 or more")
    if not args.peer_steps > 1_000:
        parser.error(f"--peer-steps {args.peer_steps}; accepted: above the warm-up, 1000")
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as scratch:
        here = Path(scratch)
        measures: dict[str, Callable[[], dict[str, Any]]] = {
            "loop": lambda: loop(here, args.rounds),
            "actors": lambda: actors(here, args.rounds),
        }
        if args.peer:
            measures["beside_sb3"] = lambda: beside_sb3(here, args.rounds, args.peer.absolute(), args.peer_steps)
        report = {name: measure() for name, measure in measures.items()}
    loads = [round(load, 2), round(os.getloadavg()[0], 2)]
    machine = {"cpu": cpu_model(), "cores": os.cpu_count(), "kernel": platform.release(), "load_average": loads}
    print(json.dumps({"machine": machine, "python": platform.python_version(), **report}, indent=2))
    log(f"{machine['cpu']}, {machine['cores']} cores, Linux {machine['kernel']}; load average before and after {loads}")


if __name__ == "__main__":
    main()
