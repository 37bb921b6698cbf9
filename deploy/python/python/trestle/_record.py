"""Demonstrations: the states that a policy visits."""

from __future__ import annotations

import csv
import os
import warnings
from pathlib import Path
from typing import Any, Protocol

import gymnasium

from . import _gym
from ._policy import Policy

#: Steps after which an episode is cut off that nothing else ends.
_STEP_LIMIT = 10_000


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
    """Write the states of greedy episodes that succeed as a demonstration, for ``mentor.demo``, as ``trestle demo record`` does.
    Actions and rewards are no part of it.

    Args:
        policy: what acts.
        env: the environment, or its id. It must have the observations and actions of the policy.
        episodes: episodes to play; episode i is reset with ``seed + i``.
        out: the CSV file to write.
        least_return: leave episodes with a lower return out. If None, those episodes are written that succeed by
            ``info["is_success"]`` of their last step. Where the environment does not tell, those are whose return counts as solved
            in the policy's run, or else by the environment's ``reward_threshold``; where there is neither, all are, with a warning.
            ``-math.inf`` writes all.
        features: the features to write, by their places or names; all if None. The observer's are those of its environment's
            space, picked by ``env.gym.features``.
        overwrite: replace the file if it exists.

    Returns:
        The number of episodes in the file.

    Raises:
        FileExistsError: the file exists.
        ValueError: no episode succeeds, a space cannot be used, or the policy acts in another one.
    """
    path = Path(out)
    if path.exists() and not overwrite:
        raise FileExistsError(f"{path} exists; accepted: another file, or overwrite=True")
    made = gymnasium.make(env) if isinstance(env, str) else env
    names, places, flatten = _gym.flattening(made.observation_space, features)
    _check_fits(policy, made)
    limit = policy.step_limit if isinstance(policy, Policy) else _STEP_LIMIT
    returns: list[float] = []
    told: list[Any] = []
    played: list[tuple[list[list[float]], bool]] = []
    for episode in range(episodes):
        obs, _ = made.reset(seed=seed + episode)
        states, total, over, terminated = [flatten(obs)], 0.0, False, False
        info: dict[str, Any] = {}
        while not over:
            action, _ = policy.predict(obs, deterministic=True)
            obs, reward, terminated, truncated, info = made.step(action)
            total += float(reward)
            states.append(flatten(obs))
            over = bool(terminated or truncated) or len(states) > limit
        returns.append(total)
        told.append(info.get("is_success"))
        played.append((states, bool(terminated)))
    if least_return is None and any(success is not None for success in told):
        succeeded = [bool(success) for success in told]
        fault = "succeeds by info['is_success']"
    else:
        least = _least(policy, made) if least_return is None else least_return
        succeeded = [least is None or total >= least for total in returns]
        fault = f"has a return of {least} or more" + (f", the best has {max(returns):.6g}" if returns else "")
    if isinstance(env, str):
        made.close()
    kept = [episode for episode, success in zip(played, succeeded) if success and len(episode[0]) > 1]
    if not kept:
        raise ValueError(
            f"none of {episodes} episodes {fault}; nothing is written; accepted: a policy that succeeds, or another least_return, such "
            "as -math.inf for all"
        )
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


def _check_fits(policy: Predicts, env: gymnasium.Env[Any, Any]) -> None:
    if isinstance(policy, Policy):
        policy.check_fits(env)
        return
    # A model of Stable-Baselines3 knows the space that it acts in.
    space = getattr(policy, "action_space", None)
    if space is not None and space != env.action_space:
        raise ValueError(f"the environment's actions are {env.action_space}; accepted: those of the policy, {space}")


def _least(policy: Predicts, env: gymnasium.Env[Any, Any]) -> float | None:
    """The return from which on an episode succeeds."""
    least = policy.least_return if isinstance(policy, Policy) else None
    if least is None:
        least = getattr(getattr(env, "spec", None), "reward_threshold", None)
    if least is None:
        warnings.warn(
            "nothing says which episodes succeed, so all are recorded; least_return says it, or eval.threshold of the policy's run",
            stacklevel=3,
        )
    return least
