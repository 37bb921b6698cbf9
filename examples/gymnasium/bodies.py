"""The same tasks with other bodies."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np


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


class DoorKey(gymnasium.Env[Any, Any]):
    """MiniGrid's DoorKey on one layout: fetch the key, open the door, reach the goal.

    The state is (column, row, direction, key in hand, door open). With ``strides`` the body goes a cell in any of four directions,
    takes a key and opens a door by going there. Without, it has MiniGrid's own actions: turn, go ahead, pick up, toggle.
    """

    def __init__(self, strides: bool = False, size: int = 6, layout: int = 1) -> None:
        """``layout`` is the seed of the walls, the key, the door and the start."""
        import minigrid  # noqa: F401  (registers its environments)

        self.grid = gymnasium.make(f"MiniGrid-DoorKey-{size}x{size}-v0", disable_env_checker=True)
        self.bare: Any = self.grid.unwrapped
        self.strides, self.layout = strides, layout
        last = size - 1
        self.observation_space = gymnasium.spaces.Box(
            np.zeros(5, dtype=np.float32), np.array([last, last, 3, 1, 1], dtype=np.float32)
        )
        self.action_space = gymnasium.spaces.Discrete(4 if strides else 5)

    def get_action_meanings(self) -> list[str]:
        """Names of the actions."""
        return ["east", "south", "west", "north"] if self.strides else ["left", "right", "forward", "pickup", "toggle"]

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode; all of them begin alike."""
        super().reset(seed=seed)
        self.grid.reset(seed=self.layout)
        return self._state(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Take an action; a step costs 0.02, the goal is worth 1."""
        kinds = self.bare.actions
        if self.strides:
            self.bare.agent_dir = int(action)
            ahead = self.bare.grid.get(*self.bare.front_pos)
            if ahead is not None and ahead.type == "key":
                self.grid.step(kinds.pickup)
            elif ahead is not None and ahead.type == "door" and not ahead.is_open:
                self.grid.step(kinds.toggle)
            done = self.grid.step(kinds.forward)
        else:
            done = self.grid.step([kinds.left, kinds.right, kinds.forward, kinds.pickup, kinds.toggle][int(action)])
        return self._state(), 1.0 if done[2] else -0.02, done[2], done[3], {}

    def _state(self) -> Any:
        door = any(cell is not None and cell.type == "door" and cell.is_open for cell in self.bare.grid.grid)
        column, row = self.bare.agent_pos
        key = self.bare.carrying is not None
        return np.array([column, row, self.bare.agent_dir, key, door], dtype=np.float32)
