"""The trackers of experiments that runs are sent to. Each is an optional package, and is set up by its own environment variables."""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
import io
import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Protocol

from ._refused import Refused

#: Longest text of a parameter that MLflow takes, and parameters and metrics that it takes at once.
_MLFLOW_TEXT, _MLFLOW_PARAMS, _MLFLOW_METRICS = 500, 100, 1000


@dataclasses.dataclass
class Cursor:
    """How far a run has been sent: the last episode, and the environment steps of the last row of a second and evaluation."""

    episodes: int = -1
    steps: int = -1
    evals: int = -1

    @classmethod
    def of(cls, kept: Any) -> Cursor:
        """What :meth:`kept` gave; the beginning where it is anything else."""
        try:
            fields = json.loads(kept)
            return cls(**{field.name: int(fields[field.name]) for field in dataclasses.fields(cls)})
        except (ValueError, KeyError, TypeError):
            return cls()

    def kept(self) -> str:
        """The cursor as text."""
        return json.dumps(dataclasses.asdict(self))


@dataclasses.dataclass(frozen=True)
class Point:
    """Metrics at a number of environment steps."""

    steps: int
    metrics: dict[str, float]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Described:
    """A run as a tracker gets to know it."""

    #: The same whenever the run is sent, and another one for each run.
    id: str
    name: str
    #: The arm of a sweep, or the algorithm.
    arm: str
    config: dict[str, Any]
    about: dict[str, str]
    #: Seconds since 1970.
    begun: float


class Sink(Protocol):
    """A run of a tracker."""

    def send(self, points: list[Point], cursor: Cursor) -> None:
        """Take ``points``, after which the run has been sent as far as ``cursor``."""

    def summarise(self, result: dict[str, Any]) -> None:
        """Take what the run has come to."""

    def close(self, state: str) -> None:
        """Nothing more comes for now: the run has ``finished``, or has ``ended`` early, or is ``running``."""


class Tracker(Protocol):
    """A tracker and a project in it."""

    def open(self, run: Described) -> tuple[Sink, Cursor]:
        """The tracker's run for ``run``, a new one or the one that there is, and how far that has been sent."""

    def where(self) -> str:
        """Where to look at it."""


@contextlib.contextmanager
def tracker(name: str, project: str, *, quiet: bool) -> Iterator[Tracker]:
    """The tracker called ``name``.

    Raises:
        Refused: its package is not installed.
    """
    makers: dict[str, Callable[[Any, str, bool], Tracker]] = {"wandb": _Wandb, "trackio": _Trackio, "mlflow": _Mlflow}
    try:
        module = importlib.import_module(name)
    except ImportError as error:
        raise Refused(f"--to {name}: {error}; accepted: with its package: pip install 'trestle-rl[{name}]'") from error
    yield makers[name](module, project, quiet)


def _flat(table: dict[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in table.items():
        name = f"{above}.{key}" if above else key
        if isinstance(value, dict):
            yield from _flat(value, name)
        else:
            yield name, value


class _Wandb:
    """Weights & Biases: ``WANDB_MODE=offline`` keeps everything in ``wandb/`` until ``wandb sync``."""

    def __init__(self, wandb: Any, project: str, quiet: bool) -> None:
        self._wandb, self._project, self._quiet = wandb, project, quiet
        self._where: str = project

    def open(self, run: Described) -> tuple[Sink, Cursor]:
        made = self._wandb.init(
            project=self._project,
            id=run.id,
            resume="allow",
            reinit="create_new",
            name=run.name,
            group=run.arm,
            job_type="trestle",
            config=run.config | {"trestle": run.about},
            settings=self._wandb.Settings(silent=self._quiet, console="off", disable_git=True, x_disable_stats=True, save_code=False),
        )
        made.define_metric("time/total_timesteps")
        made.define_metric("*", step_metric="time/total_timesteps")
        self._where = f"in {made.settings.wandb_dir}; `wandb sync` uploads it" if made.offline else made.url
        sink = _WandbSink(made)
        return sink, sink.sent()

    def where(self) -> str:
        return self._where


class _WandbSink:
    #: The cursor's key in the summary of a run, and its file in the directory of one that is offline.
    _KEY, _FILE = "trestle/sent", "trestle-sent.json"

    def __init__(self, run: Any) -> None:
        self._run = run

    def sent(self) -> Cursor:
        if not self._run.offline:
            return Cursor.of(self._run.summary.get(self._KEY))
        # Each start of an offline run has a directory of its own.
        others = Path(self._run.settings.wandb_dir).glob(f"offline-run-*-{self._run.id}/files/{self._FILE}")
        kept = [Cursor.of(path.read_text(encoding="utf-8")) for path in others]
        return max(kept, key=lambda cursor: (cursor.episodes, cursor.steps), default=Cursor())

    def send(self, points: list[Point], cursor: Cursor) -> None:
        for point in points:
            self._run.log(point.metrics | {"time/total_timesteps": point.steps})
        self._run.summary[self._KEY] = cursor.kept()
        if self._run.offline:
            (Path(self._run.dir) / self._FILE).write_text(cursor.kept(), encoding="utf-8")

    def summarise(self, result: dict[str, Any]) -> None:
        self._run.summary.update(result)

    def close(self, state: str) -> None:
        self._run.finish(exit_code=1 if state == "ended" else 0)


class _Trackio:
    """Trackio: everything is in its directory on this machine, unless ``TRACKIO_SPACE_ID`` or ``TRACKIO_SERVER_URL`` names another
    place."""

    def __init__(self, trackio: Any, project: str, quiet: bool) -> None:
        self.trackio, self.project, self._quiet = trackio, project, quiet

    def open(self, run: Described) -> tuple[Sink, Cursor]:
        sink = _TrackioSink(self, run)
        return sink, sink.sent()

    def where(self) -> str:
        return f"`trackio show --project {self.project}` shows them"

    @contextlib.contextmanager
    def run(self, described: Described) -> Iterator[Any]:
        """A run of Trackio's, which has one at a time."""
        said = io.StringIO()
        with contextlib.redirect_stdout(said):
            run = self.trackio.init(
                project=self.project,
                name=f"{described.name}-{described.id[:6]}",
                group=described.arm,
                resume="allow",
                config=described.config | {"trestle": described.about},
                embed=False,
                auto_log_gpu=False,
                auto_log_cpu=False,
            )
            try:
                yield run
            finally:
                self.trackio.finish()


class _TrackioSink:
    def __init__(self, to: _Trackio, run: Described) -> None:
        self._to, self._run = to, run

    def sent(self) -> Cursor:
        """From what is there on this machine."""
        cursor = Cursor()
        storage = self._to.trackio.SQLiteStorage
        if not storage.get_project_db_path(self._to.project).exists():
            return cursor
        for row in storage.get_logs(self._to.project, f"{self._run.name}-{self._run.id[:6]}"):
            steps = int(row.get("step") or 0)
            if "eval/return" in row:
                cursor.evals = max(cursor.evals, steps)
            elif "rollout/ep_rew" in row:
                cursor.episodes = max(cursor.episodes, int(row["time/episodes"]))
            elif "time/total_timesteps" in row:
                cursor.steps = max(cursor.steps, steps)
        return cursor

    def send(self, points: list[Point], cursor: Cursor) -> None:
        if points:
            with self._to.run(self._run) as run:
                for point in points:
                    run.log(point.metrics, step=point.steps)

    def summarise(self, result: dict[str, Any]) -> None:
        numbers = {key: value for key, value in result.items() if isinstance(value, (int, float)) and not isinstance(value, bool)}
        with self._to.run(self._run) as run:
            run.log(numbers, step=int(result.get("result/env_steps", 0)))

    def close(self, state: str) -> None:
        pass


class _Mlflow:
    """MLflow: ``MLFLOW_TRACKING_URI`` names the server or directory."""

    def __init__(self, mlflow: Any, project: str, quiet: bool) -> None:
        self._client = mlflow.MlflowClient()
        self._uri = mlflow.get_tracking_uri()
        self._entities = importlib.import_module("mlflow.entities")
        found = self._client.get_experiment_by_name(project)
        self._experiment = found.experiment_id if found else self._client.create_experiment(project)

    def open(self, run: Described) -> tuple[Sink, Cursor]:
        known = self._client.search_runs([self._experiment], filter_string=f"tags.`trestle.id` = '{run.id}'", max_results=1)
        if known:
            id = known[0].info.run_id
            self._client.update_run(id, status="RUNNING")
            return _MlflowSink(self._client, self._entities, id, run), Cursor.of(known[0].data.tags.get("trestle.sent"))
        tags = {"trestle.id": run.id, "trestle.arm": run.arm} | {f"trestle.{key}": text for key, text in run.about.items() if text}
        made = self._client.create_run(self._experiment, start_time=int(1000 * run.begun), tags=tags, run_name=run.name)
        params = [self._entities.Param(key, str(value)[:_MLFLOW_TEXT]) for key, value in _flat(run.config)]
        for at in range(0, len(params), _MLFLOW_PARAMS):
            self._client.log_batch(made.info.run_id, params=params[at : at + _MLFLOW_PARAMS])
        return _MlflowSink(self._client, self._entities, made.info.run_id, run), Cursor()

    def where(self) -> str:
        return self._uri if self._uri.startswith("http") else f"{self._uri}; `mlflow ui --backend-store-uri {self._uri}` shows them"


class _MlflowSink:
    def __init__(self, client: Any, entities: Any, id: str, run: Described) -> None:
        self._client, self._entities, self._id, self._run = client, entities, id, run

    def send(self, points: list[Point], cursor: Cursor) -> None:
        metrics = []
        for point in points:
            # When it was: runs say how many seconds they have trained.
            at = int(1000 * (self._run.begun + point.metrics.get("time/time_elapsed", 0.0)))
            metrics += [self._entities.Metric(key, value, at, point.steps) for key, value in point.metrics.items()]
        for at in range(0, len(metrics), _MLFLOW_METRICS):
            self._client.log_batch(self._id, metrics=metrics[at : at + _MLFLOW_METRICS])
        self._client.set_tag(self._id, "trestle.sent", cursor.kept())

    def summarise(self, result: dict[str, Any]) -> None:
        numbers = {key: value for key, value in result.items() if isinstance(value, (int, float)) and not isinstance(value, bool)}
        now, steps = int(1000 * time.time()), int(result.get("result/env_steps", 0))
        self._client.log_batch(self._id, metrics=[self._entities.Metric(key, value, now, steps) for key, value in numbers.items()])
        self._client.set_tag(self._id, "trestle.weights_sha256", str(result.get("result/weights_sha256")))

    def close(self, state: str) -> None:
        status = {"finished": "FINISHED", "ended": "KILLED"}.get(state)
        if status is not None:
            self._client.set_terminated(self._id, status)
