"""What other people's code can do to a run, and what the user reads then."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest

from conftest import Trestle, sets

LIMITS = {"supervise.restarts": 1, "supervise.stall_s": 3, "checkpoint.every_env_steps": 1000}


def train(trestle: Trestle, fault: str, *, ok: bool, after: float = 300, limits: dict[str, int] = LIMITS) -> str:
    """What a run says in which ``fault`` happens."""
    settings = limits | {"env.gym.make": "envs:Faulty", "env.gym.kwargs": f"{{fault='{fault}', after={after}}}"}
    return trestle("train", "gym", "--algo", "dqn", "--env-steps", 2000, "--out", "run", *sets(settings), ok=ok).stderr


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("raise", ["line ", "in step", "step raised RuntimeError: the wheels came off"]),
        ("segfault", ["SIGSEGV"]),
        ("endless", ["did not get ahead for 3 s (supervise.stall_s)"]),
        ("nan", ["feature 0 of its state", "NaN"]),
        ("nan-reward", ["a reward", "NaN"]),
        ("shape", ["an observation has the shape [3]; accepted: [1], as in its space"]),
        ("type", ["an observation is 'here' (str); accepted: an array of shape [1]"]),
        ("four", ["what step returned", "accepted: (observation, reward, terminated, truncated, info)"]),
        ("exit", ["actor-0 ended with exit status: 0"]),
        ("interrupt", ["step raised KeyboardInterrupt"]),
    ],
)
def test_a_fault_ends_the_run_with_its_reason(trestle: Trestle, fault: str, words: list[str]) -> None:
    said = train(trestle, fault, ok=False)
    assert all(word in said for word in words), said


@pytest.mark.parametrize("fault", ["flood", "fork", "threads"])
def test_a_nuisance_changes_nothing(trestle: Trestle, tmp_path: Path, fault: str) -> None:
    train(trestle, "none", ok=True)
    expected = json.loads((tmp_path / "run/result.json").read_text())
    (tmp_path / "run").rename(tmp_path / "expected")
    train(trestle, fault, ok=True)
    found = json.loads((tmp_path / "run/result.json").read_text())
    assert (found["weights_sha256"], found["restarts"]) == (expected["weights_sha256"], 0)
    # What the environment has started ends with it.
    assert subprocess.run(["pgrep", "-f", "^sleep 617$"], check=False, stdout=subprocess.DEVNULL).returncode == 1


def test_an_import_may_take_its_time(trestle: Trestle) -> None:
    train(trestle, "import", ok=True, after=35, limits={"supervise.stall_s": 60})
