"""Trained policies."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from . import _gym, _trestle
from ._run import Run
from ._space import rows


def load(run: str | os.PathLike[str] | Run, *, checkpoint: int | None = None) -> Policy:
    """The policy of a run.

    Args:
        run: the run, or its directory.
        checkpoint: the checkpoint's tick; the newest complete one if None.

    Raises:
        ValueError: there is no such run or checkpoint.
    """
    path = run.path if isinstance(run, Run) else Path(run)
    return Policy(_trestle.Policy(path, checkpoint), Run(path).config)


class Policy:
    """The greedy policy of a checkpoint. :func:`load` makes one."""

    def __init__(self, network: _trestle.Policy, config: dict[str, Any]) -> None:
        self._network = network
        self._epsilon = float(config["exploration"]["epsilon_end"])
        self._random = np.random.default_rng(config["run"]["seed"])
        settings = json.loads(network.settings())
        found = settings.get("found") if network.env == "gym" else None
        self._settings: dict[str, Any] = settings
        self._found: dict[str, Any] | None = None
        threshold, tolerance = config["eval"].get("threshold"), float(config["eval"]["tolerance"])
        self._step_limit = int(config["env"]["step_limit"])
        if found is None:
            self._layout: dict[str, Any] = {"kind": "box", "shape": [network.features]}
            self._places = list(range(network.features))
            self._values: list[Any] = list(range(len(network.actions)))
        else:
            self._found = found = json.loads(found)
            threshold = found["threshold"] if threshold is None else threshold
            self._layout, self._places = found["space"], found["features"]["places"]
            actions = found["actions"]
            self._values = _gym._values(actions)
        # A sum of rewards may fall short by its rounding.
        self._least = None if threshold is None else threshold - tolerance - 1e-6 * max(1.0, abs(threshold))

    def __repr__(self) -> str:
        return f"Policy(checkpoint={self.checkpoint}, features={len(self._places)}, actions={self.actions})"

    @property
    def least_return(self) -> float | None:
        """The return from which on an episode succeeds in the policy's run; None where nothing says it."""
        return self._least

    @property
    def step_limit(self) -> int:
        """Steps after which its run cuts an episode off."""
        return self._step_limit

    def check_fits(self, env: gymnasium.Env[Any, Any]) -> None:
        """Refuse an environment with other observations or actions than those of the policy's run.

        Raises:
            ValueError: ``env`` has others.
        """
        if self._found is not None:
            _gym.check_fits(env, self._settings, self._found)

    @property
    def checkpoint(self) -> int:
        """The checkpoint's tick."""
        return self._network.tick

    @property
    def actions(self) -> list[str]:
        """Names of the actions, in the order of :meth:`q_values`."""
        return self._network.actions

    def features(self, obs: Any) -> tuple[NDArray[np.float32], bool]:
        """The features of ``obs`` that the agent sees, ``[rows][features]``, and whether ``obs`` is a batch.

        Raises:
            ValueError: ``obs`` is none of the environment's space.
        """
        flat, batch = rows(self._layout, obs)
        return np.ascontiguousarray(flat[:, self._places]), batch

    def q_values(self, obs: Any) -> NDArray[np.float32]:
        """The value of each action: ``[actions]``, or ``[rows][actions]`` for a batch.

        Args:
            obs: an observation as the environment gives it, or a batch: the same with a dimension before all others.

        Raises:
            ValueError: ``obs`` is none of the environment's space.
        """
        features, batch = self.features(obs)
        values = np.array(self._network.q_values(features), dtype=np.float32).reshape(len(features), -1)
        return values if batch else values[0]

    def predict(
        self,
        observation: Any,
        state: None = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Any, None]:
        """The action to take, with the signature of Stable-Baselines3's ``predict``.

        Args:
            observation: as in :meth:`q_values`.
            state: of no use; the policy has no memory.
            episode_start: of no use.
            deterministic: take the best action. Otherwise a random one with the probability ``exploration.epsilon_end``.

        Returns:
            The action as the environment takes it, or an array of them for a batch, and None.

        Raises:
            ValueError: ``observation`` is none of the environment's space.
        """
        values = self.q_values(observation)
        best = np.atleast_1d(values.argmax(axis=-1))
        if not deterministic:
            explores = self._random.random(len(best)) < self._epsilon
            best = np.where(explores, self._random.integers(len(self._values), size=len(best)), best)
        actions = [self._values[action] for action in best]
        return (np.array(actions) if values.ndim == 2 else np.copy(actions[0])[()]), None

    def to_torch(self) -> Any:
        """The network as a ``torch.nn.Module``, its input's encoding included: ``float32`` features ``[rows][features]`` to values
        ``[rows][actions]``.

        Raises:
            ImportError: torch is not installed.
        """
        from ._torch import module

        return module(json.loads(self._network.encoding()), self._network.layers())
