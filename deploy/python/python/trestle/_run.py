"""Runs: trained from Python, and read back."""

from __future__ import annotations

import csv
import dataclasses
import json
import math
import os
import re
import signal
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from ._policy import Policy

#: Seconds between two looks at a run that is being trained.
_LOOK_S = 0.25
#: The exit status of a training that was interrupted.
_INTERRUPTED = 130
#: Characters of the end of what a failed training said.
_MAX_SAID = 8000


class TrainingError(RuntimeError):
    """A training that was refused or failed; the message is the program's own."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Result:
    """What a run came to. Counts are of all actors together; a value is None where it was never reached or is not known."""

    algo: str
    seed: int
    env: str
    episodes: int
    env_steps: int
    grad_steps: int
    #: Seconds from the first tick to the end of training.
    wall_s: float
    #: Finished training episodes when the run counted as solved.
    solved_episode: int | None
    #: Environment steps when the run counted as solved.
    solved_env_steps: int | None
    optimal_episode: int | None
    optimal_env_steps: int | None
    #: The greedy return that counts as the goal.
    threshold: float | None
    best_return: float | None
    final_return: float | None
    #: Equal for two lockstep runs of one configuration and seed.
    weights_sha256: str
    #: How often the run, or a process of it, was started again.
    restarts: int
    #: Everything in ``result.json``.
    everything: Mapping[str, Any] = dataclasses.field(repr=False)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Progress:
    """How far a training has come: its newest line of ``metrics.jsonl``."""

    #: The run's directory.
    path: Path
    #: The newest metrics by their names, such as ``rollout/ep_rew_mean``.
    metrics: Mapping[str, Any]


class Run:
    """A run's directory."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        """Open the run in the directory ``path``.

        Raises:
            FileNotFoundError: there is no run.
        """
        self.path = Path(path)
        if not (self.path / "config.toml").is_file():
            raise FileNotFoundError(f"{self.path} is no run: it has no config.toml")

    def __repr__(self) -> str:
        return f"Run({str(self.path)!r})"

    @property
    def config(self) -> dict[str, Any]:
        """Every setting of the run, resolved."""
        return tomllib.loads((self.path / "config.toml").read_text(encoding="utf-8"))

    @property
    def result(self) -> Result:
        """What the run came to.

        Raises:
            FileNotFoundError: it has not ended yet.
        """
        everything = json.loads((self.path / "result.json").read_text(encoding="utf-8"))
        names = [field.name for field in dataclasses.fields(Result) if field.name != "everything"]
        return Result(**{name: everything.get(name) for name in names}, everything=everything)

    def evals(self) -> Any:
        """Greedy evaluations, one a row: ``episode``, ``env_steps``, ``grad_steps``, ``wall_s`` (seconds), ``return``, ``length``
        (steps) and ``success`` (0 to 1; NaN where it is not defined).

        Returns:
            A pandas data frame where pandas is installed, or else a dict of numpy arrays ``[evaluations]`` by column.
        """
        with (self.path / "evals.csv").open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
            names = list(rows[0]) if rows else []
        return _frame({name: [_number(row[name]) for row in rows] for name in names})

    def metrics(self) -> Any:
        """Metrics of training, one a row, with the columns of ``metrics.jsonl``; NaN where a row has none.

        Returns:
            As :meth:`evals`.
        """
        rows = [json.loads(line) for line in _whole_lines(self.path / "metrics.jsonl")]
        names = dict.fromkeys(name for row in rows for name in row)
        return _frame({name: [_number(row.get(name)) for row in rows] for name in names})

    def policy(self, *, checkpoint: int | None = None) -> Policy:
        """The policy of a checkpoint, as :func:`load` gives it."""
        from ._policy import load

        return load(self.path, checkpoint=checkpoint)

    def resume(
        self,
        *,
        episodes: int | None = None,
        env_steps: int | None = None,
        callback: Callable[[Progress], object] | None = None,
        quiet: bool = True,
    ) -> Run:
        """Go on with the run from its newest checkpoint, or prolong one that is finished by higher limits.

        Args:
            episodes: finished episodes at which the run ends; the run's own limit if None.
            env_steps: environment steps at which the run ends; the run's own limit if None.
            callback: as in :func:`train`.
            quiet: as in :func:`train`.

        Raises:
            TrainingError: it was refused or failed.
        """
        args = ["resume", str(self.path), *_limits(episodes, env_steps)]
        _carry_out(args, self.path, callback, quiet)
        return self


def train(
    config: str | os.PathLike[str],
    *,
    algo: str | None = None,
    seed: int | None = None,
    episodes: int | None = None,
    env_steps: int | None = None,
    actors: int | None = None,
    mode: str | None = None,
    overrides: Mapping[str, Any] | None = None,
    out: str | os.PathLike[str] | None = None,
    resume: bool = False,
    overwrite: bool = False,
    callback: Callable[[Progress], object] | None = None,
    quiet: bool = True,
) -> Run:
    """Train an agent in processes of its own, and wait for the end.

    Args:
        config: a preset, a TOML file, or ``gym:ID`` for an environment of Gymnasium's.
        algo: the algorithm, such as ``"trestle"``, which is recommended, or ``"dqn"``; that of the configuration if None.
        seed: seed of every random stream, 0 to 2^63 - 1.
        episodes: finished episodes at which the run ends.
        env_steps: environment steps of all actors at which the run ends; whichever limit comes first.
        actors: actor processes, 1 to 64.
        mode: ``"lockstep"``, ``"free"`` or ``"reference"``.
        overrides: values by dotted keys, such as ``{"mentor.demo": "states.csv", "learner.hidden": [128, 128]}``.
        out: the run's directory; ``runs/CONFIG[-ALGO]-seedN`` if None.
        resume: go on from the newest complete checkpoint in the directory.
        overwrite: replace the directory if it holds a run.
        callback: called about four times a second with the :class:`Progress`. Returning False makes the run save and end.
        quiet: do not print progress.

    Returns:
        The run. One that ended early, by ``callback``, can be resumed.

    Raises:
        TrainingError: it was refused or failed. The message names the setting, the value and the accepted values.
        KeyboardInterrupt: Ctrl-C; the run has been saved.
    """
    if not isinstance(config, (str, os.PathLike)):
        raise TypeError(
            f"config is {config!r} ({type(config).__name__}); accepted: a preset, a TOML file, or gym:ID; a class or a function of "
            'yours goes by its name, as in trestle.train("gym", overrides={"env.gym.make": "my_module:MyEnv"})'
        )
    name = os.fspath(config)
    if out is None:
        stem = Path(name).stem.replace(":", "-") if not name.startswith("gym:") else name.replace(":", "-").replace("/", "-")
        out = Path("runs") / "-".join(filter(None, [stem, algo, f"seed{(overrides or {}).get('run.seed', 0) if seed is None else seed}"]))
    path = Path(out)
    args = ["train", name, "--out", str(path), *_limits(episodes, env_steps)]
    for flag, value in (("--algo", algo), ("--seed", seed), ("--actors", actors), ("--mode", mode)):
        if value is not None:
            args += [flag, str(value)]
    for key, value in (overrides or {}).items():
        args += ["--set", f"{key}={_toml(value)}"]
    args += ["--resume"] * resume + ["--overwrite"] * overwrite
    _carry_out(args, path, callback, quiet)
    return Run(path)


def _limits(episodes: int | None, env_steps: int | None) -> list[str]:
    limits = (("--episodes", episodes), ("--env-steps", env_steps))
    return [word for flag, value in limits if value is not None for word in (flag, str(value))]


def _toml(value: Any) -> str:
    """``value`` as TOML, on one line."""
    match value:
        case bool():
            return "true" if value else "false"
        case str() | os.PathLike():
            # Escapes of JSON are escapes of TOML.
            return json.dumps(os.fspath(value))
        case int() | np.integer():
            return str(int(value))
        case float() | np.floating():
            return repr(float(value))
        case Mapping():
            return "{ " + ", ".join(f"{json.dumps(str(key))} = {_toml(each)}" for key, each in value.items()) + " }"
        case list() | tuple() | np.ndarray():
            return "[" + ", ".join(_toml(each) for each in value) + "]"
    raise TypeError(
        f"an override is {value!r}; accepted: booleans, numbers, texts, lists and dicts of them; a class or a function goes by its "
        'name, "module:name"'
    )


def _carry_out(args: list[str], path: Path, callback: Callable[[Progress], object] | None, quiet: bool) -> None:
    command = [sys.executable, "-m", "trestle", *args, *(["--quiet"] if quiet else [])]
    with tempfile.TemporaryFile() as said:
        # In a group of its own: Ctrl-C reaches this process alone, and is passed on once.
        process = subprocess.Popen(
            command,
            process_group=0,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL if quiet else None,
            stderr=said if quiet else None,
        )
        stopped = False
        try:
            while True:
                try:
                    status = process.wait(timeout=_LOOK_S)
                    break
                except subprocess.TimeoutExpired:
                    if callback is not None and not stopped:
                        stopped = _look(path, callback) is False
                        if stopped:
                            process.send_signal(signal.SIGINT)
        except BaseException:
            # Ctrl-C, or what the callback raised: the run is saved first.
            process.send_signal(signal.SIGINT)
            process.wait()
            raise
        if callback is not None and not stopped and status == 0:
            _look(path, callback)
        if status == 0 or (stopped and status == _INTERRUPTED):
            return
        said.seek(max(0, said.seek(0, os.SEEK_END) - _MAX_SAID))
        text = said.read().decode(errors="replace").strip()
        text = re.sub(r"^error: ", "", text.removeprefix("\n"), flags=re.MULTILINE)
        raise TrainingError(text or f"the training ended with status {status}")


def _look(path: Path, callback: Callable[[Progress], object]) -> object:
    try:
        lines = _whole_lines(path / "metrics.jsonl", last=True)
    except FileNotFoundError:
        return None
    if not lines:
        return None
    return callback(Progress(path=path, metrics=json.loads(lines[-1])))


def _whole_lines(path: Path, *, last: bool = False) -> list[str]:
    """The lines of a file that may just be growing; of its last 64 KiB only, if the ``last`` one is all that counts."""
    with path.open("rb") as file:
        if last:
            file.seek(max(0, file.seek(0, os.SEEK_END) - (1 << 16)))
            begun_within = file.tell() > 0
        else:
            begun_within = False
        text = file.read().decode()
    lines = text[: text.rfind("\n") + 1].splitlines()
    return lines[1:] if begun_within else lines


def _number(value: Any) -> Any:
    if value is None or value == "":
        return math.nan
    if isinstance(value, str):
        number = float(value)
        return int(value) if number.is_integer() and value.lstrip("-").isdigit() else number
    return value


def _frame(columns: dict[str, list[Any]]) -> Any:
    try:
        import pandas
    except ImportError:
        return {name: np.array(values) for name, values in columns.items()}
    return pandas.DataFrame(columns)
