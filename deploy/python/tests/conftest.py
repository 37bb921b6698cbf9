"""What the tests share."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

#: Settings of a run that takes a moment.
SMALL = {
    "learner.hidden": "[16]",
    "learner.warmup": "100",
    "learner.batch": "16",
    "learner.replay": "2000",
    "eval.every": "20",
    "eval.episodes": "2",
    "env.gym.warmup_steps": "50",
    # On a busy machine no process is taken for dead.
    "supervise.silence_s": "120",
}

Trestle = Callable[..., "subprocess.CompletedProcess[str]"]


@pytest.fixture
def trestle(tmp_path: Path) -> Trestle:
    """Carries out a command line of the program in an empty directory with the tests' environments."""
    (tmp_path / "envs.py").write_text((Path(__file__).parent / "envs.py").read_text())

    def run(*args: Any, ok: bool = True, timeout: float = 600) -> subprocess.CompletedProcess[str]:
        done = subprocess.run(
            [sys.executable, "-m", "trestle", *map(str, args)],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=timeout,
        )
        assert (done.returncode == 0) is ok, f"{args}: {done.returncode}\n{done.stdout}\n{done.stderr}"
        return done

    return run


def sets(settings: dict[str, Any]) -> list[str]:
    """``--set`` for each of ``settings``, those of a small run among them."""
    return [word for key, value in (SMALL | settings).items() for word in ("--set", f"{key}={value}")]
