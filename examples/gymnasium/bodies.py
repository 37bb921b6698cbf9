"""The same tasks with other bodies."""

from __future__ import annotations

from typing import Any

import gymnasium


def cart_pole(force: float = 10.0) -> gymnasium.Env[Any, Any]:
    """A pole on a cart that is pushed with ``force`` newtons; Gymnasium's has 10."""
    env = gymnasium.make("CartPole-v1")
    env.unwrapped.force_mag = force  # type: ignore[attr-defined]
    return env


def mountain_car(force: float = 0.001, steps: int = 200) -> gymnasium.Env[Any, Any]:
    """A car in a valley whose engine accelerates it by ``force`` a step; Gymnasium's has 0.001 and 200 steps."""
    env = gymnasium.make("MountainCar-v0", max_episode_steps=steps)
    env.unwrapped.force = force  # type: ignore[attr-defined]
    return env
