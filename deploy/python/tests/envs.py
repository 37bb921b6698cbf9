"""Environments of the tests: small, of every space, and badly behaved."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces


class Line(gymnasium.Env[Any, Any]):
    """A walk on a line: 8 steps at most, the reward is the place."""

    def __init__(self, n: int = 5, start: int = 0) -> None:
        self.observation_space: Any = spaces.Box(-n, n, (1,), np.float32)
        self.action_space: Any = spaces.Discrete(2, start=start)
        self.start, self.n = start, n

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        self.at, self.steps = int(self.np_random.integers(-1, 2)), 0
        return self.observe(), {}

    def observe(self) -> Any:
        return np.array([self.at], dtype=np.float32)

    def step(self, action: Any) -> Any:
        self.at += 1 if action == 1 + self.start else -1
        self.steps += 1
        return self.observe(), float(self.at), abs(self.at) >= self.n, self.steps >= 8, {}


def line(n: int = 5) -> Line:
    """For ``env.gym.make``."""
    return Line(n)


class Told(Line):
    """It tells at an episode's end whether it has succeeded: to the left, where returns are low."""

    def step(self, action: Any) -> Any:
        obs, reward, terminated, truncated, info = super().step(action)
        return obs, reward, terminated, truncated, {"is_success": np.bool_(self.at < 0)} if truncated or terminated else info


class Named(Line):
    """Its actions have names, and it can fail in several ways."""

    def __init__(self, fault: str = "none", names: Any = ("back", "forth")) -> None:
        super().__init__()
        self.actions, self.fault = names, fault
        if fault == "making":
            raise RuntimeError("no motor")

    def step(self, action: Any) -> Any:
        match self.fault:
            case "step":
                raise RuntimeError("a wheel came off")
            case "four":
                return super().step(action)[:4]
            case "reward":
                return *super().step(action)[:1], None, False, False, {}
        return super().step(action)


class Blind(Line):
    """Takes a mode of rendering, and has none."""

    def __init__(self, render_mode: str | None = None) -> None:
        super().__init__()


class Spaces(Line):
    """Observes and acts in spaces that are given by name."""

    def __init__(self, observation: str = "box", action: str = "discrete") -> None:
        super().__init__()
        self.observation_space = {
            "box": spaces.Box(-1, 1, (2, 3), np.float64),
            "bytes": spaces.Box(0, 255, (2, 2), np.uint8),
            "bools": spaces.Box(0, 1, (3,), np.bool_),
            "grid": spaces.Box(0, 255, (5, 6, 2), np.uint8),
            "planes": spaces.Box(0, 255, (2, 5, 6), np.uint8),
            "flat": spaces.Box(0, 1, (5, 6), np.float32),
            "unbounded": spaces.Box(-np.inf, np.inf, (2,), np.float32),
            "discrete": spaces.Discrete(4, start=-1),
            "binary": spaces.MultiBinary(3),
            "multi": spaces.MultiDiscrete([3, 4]),
            "tuple": spaces.Tuple((spaces.Discrete(3), spaces.Box(-1, 1, (2,), np.float32))),
            "dict": spaces.Dict({"b": spaces.Discrete(3), "a": spaces.Box(-1, 1, (2,), np.float32)}),
            "text": spaces.Text(5),
            "talk": spaces.Dict({"said": spaces.Text(5), "at": spaces.Box(-1, 1, (2,), np.float32)}),
            "letter": spaces.Dict(
                {
                    "at": spaces.Box(-1, 1, (2,), np.float32),
                    "post": spaces.Dict({"said": spaces.Text(5), "more": spaces.Tuple((spaces.Text(5),))}),
                }
            ),
            "huge": spaces.Box(-1, 1, (100, 100), np.float32),
        }[observation]
        self.action_space = {
            "discrete": spaces.Discrete(3, start=2),
            "multi": spaces.MultiDiscrete([2, 3]),
            "binary": spaces.MultiBinary(2),
            "box": spaces.Box(-2, 2, (2,), np.float32),
            "million": spaces.Discrete(10**6),
            "tuple": spaces.Tuple((spaces.Discrete(2), spaces.Discrete(2))),
        }[action]

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        gymnasium.Env.reset(self, seed=seed)
        self.observation_space.seed(seed)
        self.steps = 0
        return self.observation_space.sample(), {}

    def step(self, action: Any) -> Any:
        assert self.action_space.contains(np.asarray(action, self.action_space.dtype) if self.action_space.shape else action)
        self.steps += 1
        return self.observation_space.sample(), 1.0, False, self.steps >= 8, {}


class Faulty(Line):
    """Does ``fault`` at the step after ``after`` others of the process; not in the process that looks at it before a run."""

    taken = 0

    def __init__(self, fault: str, after: int = 300) -> None:
        super().__init__()
        self.fault, self.after = fault, after
        self.probed = "gym-probe" in sys.argv
        if fault == "import" and not self.probed:
            time.sleep(float(after))

    def step(self, action: Any) -> Any:
        Faulty.taken += 1
        answer = super().step(action)
        if self.probed or Faulty.taken <= self.after:
            return answer
        obs, reward, terminated, truncated, info = answer
        match self.fault:
            case "raise":
                raise RuntimeError("the wheels came off")
            case "segfault":
                os.kill(os.getpid(), signal.SIGSEGV)
            case "endless":
                while True:
                    pass
            case "nan":
                obs = np.array([np.nan], dtype=np.float32)
            case "nan-reward":
                reward = float("nan")
            case "shape":
                obs = np.zeros(3, dtype=np.float32)
            case "type":
                obs = "here"
            case "four":
                return obs, reward, terminated, info
            case "exit":
                os._exit(0)
            case "interrupt":
                raise KeyboardInterrupt
            case "flood":
                for stream in (sys.stdout, sys.stderr):
                    print("x" * 5000, file=stream)
            case "fork":
                if os.fork() == 0:
                    # The copy comes back into the program.
                    return answer
            case "threads":
                if Faulty.taken == self.after + 1:
                    threading.Thread(target=time.sleep, args=(600,)).start()
                    subprocess.Popen(["sleep", "617"])
        return obs, reward, terminated, truncated, info


class Moody(Line):
    """Another environment in every process."""

    def observe(self) -> Any:
        return np.array([self.at + time.monotonic() % 0.1], dtype=np.float32)


class Half(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Halves the rewards."""

    def step(self, action: Any) -> Any:
        obs, reward, terminated, truncated, info = self.env.step(action)
        return obs, reward / 2, terminated, truncated, info
