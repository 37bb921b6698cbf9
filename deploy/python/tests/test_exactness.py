"""Runs repeat bit by bit: with several actors, after a kill, and when they go on later."""

from __future__ import annotations

import importlib.util
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from conftest import Trestle, sets

#: Environments, what they need, and their settings.
ENVIRONMENTS: list[tuple[str, str, dict[str, str]]] = [
    ("gym:CartPole-v1", "gymnasium", {}),
    ("gym:MountainCar-v0", "gymnasium", {}),
    ("gym:Acrobot-v1", "gymnasium", {}),
    ("gym:FrozenLake-v1", "gymnasium", {}),
    ("gym:Taxi-v4", "gymnasium", {}),
    ("gym:minigrid:MiniGrid-Dynamic-Obstacles-5x5-v0", "minigrid", {"env.gym.features": "['direction', 'image']"}),
    (
        "gym",
        "gymnasium",
        {
            "env.gym.make": "envs:Spaces",
            "env.gym.kwargs": "{observation='grid'}",
            "learner.conv": "[{channels=5,kernel=3},{channels=4,kernel=2,stride=2}]",
        },
    ),
    # Sticky actions would not repeat: MinAtar's first one depends on the episode before, whatever the seed is.
    ("gym", "minatar", {"env.gym.make": "minatar.gym:BaseEnv", "env.gym.kwargs": "{game='breakout', sticky_action_prob=0.0}"}),
]


def sha(run: Path) -> str:
    """The hash of the run's last weights."""
    return str(json.loads((run / "result.json").read_text())["weights_sha256"])


@pytest.mark.parametrize(("config", "package", "own"), ENVIRONMENTS)
def test_runs_repeat_and_go_on_exactly(trestle: Trestle, tmp_path: Path, config: str, package: str, own: dict[str, str]) -> None:
    if importlib.util.find_spec(package) is None:
        pytest.skip(f"{package} is not installed")
    settings = sets({"env.step_limit": 120, "checkpoint.every_env_steps": 500, "eval.every": 5} | own)
    three = ["--algo", "dqn", "--actors", "3", *settings]
    trestle("train", config, "--env-steps", 2496, "--out", "whole", *three)
    trestle("train", config, "--env-steps", 960, "--out", "parts", *three)
    trestle("resume", "parts", "--env-steps", 2496)
    trestle("train", config, "--env-steps", 2496, "--out", "one", "--mode", "reference", *three)
    assert sha(tmp_path / "whole") == sha(tmp_path / "parts") == sha(tmp_path / "one")


@pytest.mark.parametrize(("config", "package", "own"), ENVIRONMENTS)
def test_a_killed_actor_changes_nothing(trestle: Trestle, tmp_path: Path, config: str, package: str, own: dict[str, str]) -> None:
    if importlib.util.find_spec(package) is None:
        pytest.skip(f"{package} is not installed")
    settings = sets({"env.step_limit": 120, "checkpoint.every_env_steps": 480, "eval.every": 5} | own)
    args = ["train", config, "--algo", "dqn", "--actors", "3", "--env-steps", "4992", *settings]
    trestle(*args, "--out", "whole")
    command = [sys.executable, "-m", "trestle", *args, "--out", "killed"]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as training:
        actor = "\x00".join(["actor", "--index", "1", "--run", "killed"])
        checkpoints = tmp_path / "killed/checkpoints"
        while training.poll() is None and not list(checkpoints.glob("*/COMPLETE")):
            time.sleep(0.01)
        victims = [
            int(process.name)
            for process in Path("/proc").iterdir()
            if process.name.isdigit() and actor in _command(process) and _parent(process) == training.pid
        ]
        assert len(victims) == 1
        os.kill(victims[0], signal.SIGKILL)
        assert training.wait(300) == 0
    assert json.loads((tmp_path / "killed/result.json").read_text())["restarts"] == 1
    assert sha(tmp_path / "killed") == sha(tmp_path / "whole")


def _command(process: Path) -> str:
    try:
        return (process / "cmdline").read_text()
    except OSError:
        return ""


def _parent(process: Path) -> int:
    try:
        return int((process / "stat").read_text().rpartition(")")[2].split()[1])
    except OSError:
        return 0


def test_an_environment_that_does_not_repeat_runs_if_it_may(trestle: Trestle, tmp_path: Path) -> None:
    settings = sets({"env.gym.make": "envs:Moody", "env.gym.nondeterministic": "true"})
    done = trestle("train", "gym", "--algo", "dqn", "--env-steps", 640, "--out", "run", *settings)
    assert "warning: envs:Moody is not deterministic" in done.stderr
    trestle("resume", "run", "--env-steps", 1280)
