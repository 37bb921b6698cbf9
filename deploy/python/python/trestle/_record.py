"""Demonstrations: the states that a policy visits."""

from __future__ import annotations

import csv
import os
from pathlib import Path
from typing import Any, Protocol

import gymnasium

from . import _gym


class Predicts(Protocol):
    """What acts: a :class:`Policy`, or anything with Stable-Baselines3's ``predict``."""

    def predict(self, observation: Any, /, *, deterministic: bool) -> tuple[Any, Any]:
        """The action to take."""
        ...


def record(
    policy: Predicts,
    env: gymnasium.Env[Any, Any] | str,
    *,
    episodes: int = 20,
    out: str | os.PathLike[str],
    seed: int = 0,
    least_return: float | None = None,
    features: list[int | str] | None = None,
    overwrite: bool = False,
) -> int:
    """Write the states of greedy episodes as a demonstration, for ``mentor.demo``. Actions and rewards are no part of it.

    Args:
        policy: what acts.
        env: the environment, or its id.
        episodes: episodes to play; episode i is reset with ``seed + i``.
        out: the CSV file to write.
        least_return: leave episodes with a lower return out.
        features: the features to write, by their places or names; all if None. The observer's are those of its environment's
            space, picked by ``env.gym.features``.
        overwrite: replace the file if it exists.

    Returns:
        The number of episodes in the file.

    Raises:
        FileExistsError: the file exists.
        ValueError: no episode is to be written, or a space cannot be used.
    """
    path = Path(out)
    if path.exists() and not overwrite:
        raise FileExistsError(f"{path} exists; accepted: another file, or overwrite=True")
    made = gymnasium.make(env) if isinstance(env, str) else env
    names, places, flatten = _gym.flattening(made.observation_space, features)
    kept: list[tuple[list[list[float]], bool]] = []
    for episode in range(episodes):
        obs, _ = made.reset(seed=seed + episode)
        states, total, over, terminated = [flatten(obs)], 0.0, False, False
        while not over:
            action, _ = policy.predict(obs, deterministic=True)
            obs, reward, terminated, truncated, _ = made.step(action)
            total += float(reward)
            over = bool(terminated or truncated)
            states.append(flatten(obs))
        if len(states) > 1 and (least_return is None or total >= least_return):
            kept.append((states, bool(terminated)))
    if isinstance(env, str):
        made.close()
    if not kept:
        raise ValueError(f"none of {episodes} episodes has a return of {least_return} or more; nothing is written")
    # Whole, or not at all.
    unfinished = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    with unfinished.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["trajectory", "terminal", *(names[place] for place in places)])
        for number, (states, terminated) in enumerate(kept):
            for i, state in enumerate(states):
                last = terminated and i == len(states) - 1
                writer.writerow([number, int(last), *(repr(state[place]) for place in places)])
    unfinished.replace(path)
    return len(kept)
