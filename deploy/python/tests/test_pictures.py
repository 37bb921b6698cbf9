"""`trestle eval --picture` where the environment draws itself."""

from __future__ import annotations

import re
from pathlib import Path

from conftest import Trestle, sets


def test_an_episode_becomes_a_film_and_a_strip(trestle: Trestle, tmp_path: Path) -> None:
    settings = sets({"run.algo": "dqn", "env.gym.kwargs": "{is_slippery=false}"})
    trestle("train", "gym:FrozenLake-v1", *settings, "--env-steps", "600", "--out", "run", "--quiet")
    plain = trestle("eval", "run", "--json").stdout
    for name, begins in (("a.gif", b"GIF89a"), ("b.png", b"\x89PNG"), ("c.svg", b"<svg")):
        assert trestle("eval", "run", "--json", "--picture", name).stdout == plain
        assert (tmp_path / name).read_bytes().startswith(begins)
    svg = (tmp_path / "c.svg").read_text()
    steps = [int(number) for number in re.findall(r">step (\d+)</text>", svg)]
    assert steps[0] == 0 and steps == sorted(steps) and svg.count("<image") == len(steps)
    # The same episode is the same film.
    trestle("eval", "run", "--picture", "d.gif")
    assert (tmp_path / "d.gif").read_bytes() == (tmp_path / "a.gif").read_bytes()


def test_what_does_not_draw_itself_is_refused(trestle: Trestle, tmp_path: Path) -> None:
    trestle("train", "gym", *sets({"run.algo": "dqn", "env.gym.make": "envs:Blind"}), "--env-steps", "300", "--out", "run", "--quiet")
    said = trestle("eval", "run", "--picture", "a.gif", ok=False).stderr
    assert "has neither a map nor pictures; accepted" in said and not (tmp_path / "a.gif").exists()
