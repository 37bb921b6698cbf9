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


def breakout(sticky: float = 0.0) -> gymnasium.Env[Any, Any]:
    """MinAtar's Breakout with the actions stay, left and right; ``sticky`` is how likely the last action is repeated."""
    from minatar.gym import BaseEnv

    class Breakout(BaseEnv):  # type: ignore[misc]
        def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
            # MinAtar remembers the last action of the episode before, so that episodes would not repeat.
            self.game.last_action = 0
            answer: tuple[Any, dict[str, Any]] = super().reset(seed=seed, options=options)
            return answer

    env: gymnasium.Env[Any, Any] = Breakout("breakout", use_minimal_action_set=True, sticky_action_prob=sticky)
    return env


def reacher(gear: tuple[float, float] = (200.0, 200.0), effort: float = 0.1) -> gymnasium.Env[Any, Any]:
    """MuJoCo's arm of two links that reaches for a point; ``gear`` are the ratios of its two motors, Gymnasium's are 200.

    A motor at full power costs ``effort`` a step. Gymnasium's 1 is as much as being a metre away, which is five times the arm's reach.
    """
    env = gymnasium.make("Reacher-v5", reward_control_weight=effort)
    env.unwrapped.model.actuator_gear[:, 0] = gear  # type: ignore[attr-defined]
    return env


class DoorKey(gymnasium.Env[Any, Any]):
    """MiniGrid's DoorKey on one layout: fetch the key, open the door, reach the goal.

    The state is (column, row), direction, key in hand, door open; the last three are categories. With ``strides`` the body goes a
    cell in any of four directions, takes a key and opens a door by going there. Without, it has MiniGrid's own actions: turn, go
    ahead, pick up, toggle.
    """

    def __init__(self, strides: bool = False, size: int = 8, layout: int = 1, toll: float = 0.0) -> None:
        """``layout`` is the seed of the walls, the key, the door and the start; a step costs ``toll``."""
        import minigrid  # noqa: F401  (registers its environments)

        self.grid = gymnasium.make(f"MiniGrid-DoorKey-{size}x{size}-v0", disable_env_checker=True)
        self.bare: Any = self.grid.unwrapped
        self.strides, self.layout, self.toll = strides, layout, toll
        self.observation_space = gymnasium.spaces.Dict(
            place=gymnasium.spaces.Box(0, size - 1, (2,), np.float32),
            direction=gymnasium.spaces.Discrete(4),
            key=gymnasium.spaces.Discrete(2),
            door=gymnasium.spaces.Discrete(2),
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
        """Take an action; the goal is worth 1."""
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
        return self._state(), 1.0 if done[2] else -self.toll, done[2], done[3], {}

    def _state(self) -> Any:
        door = any(cell is not None and cell.type == "door" and cell.is_open for cell in self.bare.grid.grid)
        place = np.array(self.bare.agent_pos, dtype=np.float32)
        return {"place": place, "direction": int(self.bare.agent_dir), "key": int(self.bare.carrying is not None), "door": int(door)}
