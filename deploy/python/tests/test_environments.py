"""Spaces, choices of features and actions, and refusals, by ``config check``; and a run in each kind of space."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import pytest

from conftest import Trestle, sets


def check(trestle: Trestle, id: str = "", *, ok: bool = True, **own: Any) -> str:
    """What ``config check`` says of an environment with the settings ``own``."""
    settings = {"run.algo": "dqn"} | {f"env.gym.{key}": value for key, value in own.items()}
    done = trestle("config", "check", f"gym:{id}" if id else "gym", *sets(settings), ok=ok)
    return done.stdout if ok else done.stderr


@pytest.mark.parametrize(
    ("observation", "features"),
    [
        ("box", 6),
        ("bytes", 4),
        ("bools", 3),
        ("unbounded", 2),
        ("discrete", 1),
        ("binary", 3),
        ("multi", 2),
        ("tuple", 3),
        ("dict", 3),
    ],
)
def test_observations_of_every_space_are_accepted(trestle: Trestle, observation: str, features: int) -> None:
    said = check(trestle, make="envs:Spaces", kwargs=f"{{observation='{observation}'}}")
    assert f"{features} features, actions 2 3 4" in said


def test_parts_that_nobody_observes_may_be_anything(trestle: Trestle) -> None:
    own = {"make": "envs:Spaces", "kwargs": "{observation='talk'}"}
    assert "accepted: Box, Discrete" in check(trestle, ok=False, **own)
    assert "2 features" in check(trestle, features="['at']", **own)
    assert "env.gym.features = said; accepted" in check(trestle, ok=False, features="['said']", **own)


@pytest.mark.parametrize(
    ("action", "own", "names"),
    [
        ("discrete", {}, "2 3 4"),
        ("discrete", {"actions": "[2, '2']"}, "4 2"),
        ("multi", {}, "0,0 0,1 0,2 1,0 1,1 1,2"),
        ("binary", {}, "0,0 0,1 1,0 1,1"),
        ("box", {"bins": "[2]"}, "-2,-2 -2,2 2,-2 2,2"),
        ("box", {"bins": "[3, 2]", "actions": "['0,2', '-2,2']"}, "0,2 -2,2"),
    ],
)
def test_actions_of_every_space_are_enumerated(trestle: Trestle, action: str, own: dict[str, str], names: str) -> None:
    assert f"actions {names}\n" in check(trestle, make="envs:Spaces", kwargs=f"{{action='{action}'}}", **own)


@pytest.mark.parametrize("names", ["['back', 'forth']", "['one']", "[1, 2]"])
def test_a_list_of_names_names_the_actions(trestle: Trestle, names: str) -> None:
    expected = "back forth" if "back" in names else "0 1"
    assert f"actions {expected}\n" in check(trestle, make="envs:Named", kwargs=f"{{names={names}}}")


@pytest.mark.parametrize(
    ("fault", "first"),
    [
        ("making", "error: envs:Named raised RuntimeError: no motor"),
        ("step", "error: envs:Named raised RuntimeError: a wheel came off"),
        ("four", "error: envs:Named: step returned tuple of 4; accepted: (observation, reward,"),
        ("reward", "error: envs:Named: a reward is None (NoneType); accepted: a number"),
    ],
)
def test_what_it_raises_before_the_run_is_told_first(trestle: Trestle, fault: str, first: str) -> None:
    said = check(trestle, ok=False, make="envs:Named", kwargs=f"{{fault='{fault}'}}").splitlines()
    assert said[0].startswith(first), said
    # Every call that is shown is whole.
    assert all(line.startswith(("  File ", "    ")) for line in said[1:] if line), said


@pytest.mark.parametrize(
    ("own", "words"),
    [
        ({"make": "envs:Spaces", "kwargs": "{observation='text'}"}, ["Text(", "accepted: Box, Discrete, MultiBinary"]),
        ({"make": "envs:Spaces", "kwargs": "{observation='huge'}"}, ["10000 features; accepted: up to 4096"]),
        ({"make": "envs:Spaces", "kwargs": "{action='million'}"}, ["Discrete(1000000)", "1000000 actions; accepted: 2 to 1024"]),
        ({"make": "envs:Spaces", "kwargs": "{action='tuple'}"}, ["accepted: Discrete, MultiDiscrete, MultiBinary, or Box"]),
        ({"make": "envs:Spaces", "kwargs": "{action='box'}"}, ["env.gym.bins = []; accepted for Box", "2 dimensions"]),
        ({"make": "envs:Spaces", "kwargs": "{action='box'}", "bins": "[40]"}, ["1600 actions; accepted: 2 to 1024"]),
        ({"make": "envs:Line", "bins": "[3]"}, ["env.gym.bins = [3]", "actions are not continuous"]),
        ({"make": "envs:Line", "actions": "[7]"}, ["env.gym.actions = 7; accepted: 0 to 1, or a name: 0, 1"]),
        ({"make": "envs:Line", "actions": "[1]"}, ["has 1 actions; accepted: 2 to 1024"]),
        ({"make": "envs:Line", "features": "['x']"}, ["env.gym.features = x; accepted: 0 to 0, or a name: 0"]),
        ({"make": "envs:Line", "scale": "[1.0, 2.0]"}, ["env.gym.scale has 2 numbers; accepted: 1"]),
        ({"make": "envs:Gone"}, ["env.gym.make = envs:Gone", "accepted: a name in envs"]),
        ({"make": "gone:Gone"}, ["env.gym.make = gone:Gone", "accepted: a module that"]),
        ({"make": "envs"}, ["env.gym.make = envs; accepted: module:name"]),
        ({"make": "envs:Line", "kwargs": "{speed=1}"}, ["envs:Line raised TypeError: ", "unexpected keyword argument 'speed'"]),
        (
            {"make": "envs:Moody"},
            ["envs:Moody is not deterministic: with the same seed and actions the observation after 0 steps differs"],
        ),
        (
            {"id": "No-Such-v0"},
            ["env.gym.id = No-Such-v0: no environment is registered as No-Such-v0", "accepted: an id that Gymnasium has"],
        ),
        ({"id": "envs:Line"}, ["env.gym.id = envs:Line", "for a class or a function env.gym.make = module:name"]),
        ({"make": "os:getcwd"}, ["os:getcwd is str without `reset`"]),
    ],
)
def test_what_cannot_be_used_is_refused(trestle: Trestle, own: dict[str, str], words: list[str]) -> None:
    said = check(trestle, ok=False, **own)
    assert said.startswith("error: ") and all(word in said for word in words), said


@pytest.mark.parametrize(
    ("own", "words"),
    [
        ({}, ["learner.conv has 1 convolutions", "none, as its observation is an array of the shape [1]"]),
        ({"env.gym.make": "envs:Spaces", "env.gym.kwargs": "{observation='tuple'}"}, ["none, as its observation is 3 separate features"]),
        ({"env.gym.make": "envs:Spaces", "env.gym.kwargs": "{observation='bytes'}"}, ["kernel 3", "2 x 2 grid: a kernel of 1 to 2"]),
        ({"learner.conv": "[{channels=4}]"}, ["learner.conv", "accepted: tables { channels, kernel, stride }"]),
        ({"learner.conv": "[{channels=4,kernel=65}]"}, ["learner.conv", "accepted: tables { channels, kernel, stride }"]),
    ],
)
def test_convolutions_need_a_grid(trestle: Trestle, own: dict[str, str], words: list[str]) -> None:
    settings = sets({"env.gym.make": "envs:Line", "learner.conv": "[{channels=4,kernel=3}]"} | own)
    said = trestle("train", "gym", "--algo", "dqn", "--env-steps", 100, "--out", "run", *settings, ok=False).stderr
    assert said.startswith("error: ") and all(word in said for word in words), said


def test_a_refused_run_leaves_nothing(trestle: Trestle, tmp_path: Path) -> None:
    trestle("train", "gym:No-Such-v0", "--algo", "dqn", "--out", "run", ok=False)
    assert not (tmp_path / "run").exists()


def test_everything_is_found_once_and_written_down(trestle: Trestle, tmp_path: Path) -> None:
    settings = {
        "env.gym.make": "envs:Spaces",
        "env.gym.kwargs": "{observation='dict', action='multi'}",
        "env.gym.wrappers": "['envs:Half']",
        "env.gym.features": "['a', 'b']",
    }
    trestle("train", "gym", "--algo", "dqn", "--env-steps", 600, "--out", "run", *sets(settings))
    config = tomllib.loads((tmp_path / "run/config.toml").read_text())
    found = json.loads(config["env"]["gym"]["found"])
    features = found["features"]
    assert features["names"] == ["a[0]", "a[1]", "b"]
    assert (features["places"], features["categories"]) == ([0, 1, 2], [2])
    assert features["range"] == [[-1.0, 1.0], [-1.0, 1.0], [0.0, 2.0]]
    assert found["actions"]["values"][4] == [1, 1]
    # 8 steps of 1/2 each.
    returns = (tmp_path / "run/evals.csv").read_text().splitlines()[-1].split(",")
    assert "4.0" in returns or "4" in returns


def test_what_nothing_says_is_warned_of(trestle: Trestle) -> None:
    said = check(trestle, make="envs:Line")
    assert "  step limit     10000 (env.step_limit)\n" in said
    assert "warning: nothing says which return of gym envs:Line counts as solved" in said and "eval.threshold says it" in said
    said = trestle("config", "check", "gym:CartPole-v1", "--algo", "dqn").stdout
    assert "warning" not in said


def test_an_environment_may_tell_which_episodes_succeed(trestle: Trestle, tmp_path: Path) -> None:
    said = check(trestle, make="envs:Told")
    assert "  success        the environment tells which episodes succeed\n" in said and "warning" not in said
    # DQN learns to go to the right, and the environment counts the left as success.
    trestle("train", "gym", "--algo", "dqn", "--env-steps", 2000, "--out", "run", *sets({"env.gym.make": "envs:Told"}))
    last = (tmp_path / "run/evals.csv").read_text().splitlines()
    assert last[0].split(",")[4:] == ["return", "length", "success"]
    assert float(last[-1].split(",")[4]) > 0.0 and float(last[-1].split(",")[6]) == 0.0
    trestle("resume", "run", "--env-steps", 2400)


def test_features_are_shown_by_number_and_name(trestle: Trestle) -> None:
    said = check(trestle, make="envs:Spaces", kwargs="{observation='dict'}")
    names = "0 a[0], 1 a[1], 2 b (of 3)"
    assert f"  features       {names}\n" in said
    said = check(trestle, make="envs:Spaces", kwargs="{observation='binary'}")
    assert "0 0 (of 2), 1 1 (of 2), 2 2 (of 2)" in said


def test_the_demonstration_scales_the_input_if_it_is_to(trestle: Trestle, tmp_path: Path) -> None:
    (tmp_path / "states.csv").write_text("trajectory,terminal,0\n0,0,0\n0,0,1\n0,1,2\n")
    settings = {"env.gym.make": "envs:Line", "env.gym.scale": "'demonstration'", "mentor.demo": "states.csv"}
    for algo in ["dqn", "ha-diiqn"]:
        trestle("train", "gym", "--algo", algo, "--env-steps", 640, "--out", algo, *sets(settings))
        config = tomllib.loads((tmp_path / algo / "config.toml").read_text())
        assert json.loads(config["env"]["gym"]["found"])["features"]["range"] == [[-1.0, 3.0]]
        trestle("resume", algo, "--env-steps", 960)
    said = check(trestle, ok=False, make="envs:Line", scale="'demonstrations'")
    assert "scale = demonstrations; accepted: a number above 0 for each feature, or demonstration" in said


def test_thresholds_come_from_the_registry(trestle: Trestle) -> None:
    said = trestle("config", "check", "gym:CartPole-v1", "--set", "run.algo=dqn").stdout
    assert "4 features, actions 0 1" in said and "threshold      475.00" in said
    said = trestle("config", "check", "gym:CartPole-v1", "--set", "run.algo=dqn", "--set", "eval.threshold=100.0").stdout
    assert "threshold      100.00" in said
