"""`trestle sync` with the offline modes of all three trackers."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from conftest import Trestle

#: What has been read back of a tracker's run: its name, its configuration, its last metrics, and numbers of rows by metric.
Sent = dict[str, Any]


def _records(log: bytes) -> Iterator[bytes]:
    """The records of a `.wandb` file, which is a log of LevelDB's: blocks of 32 KiB, and pieces of records with a head of 7 bytes."""
    at, record = 7, b""
    while at + 7 <= len(log):
        room = 32768 - at % 32768
        if room < 7:
            at += room
            continue
        length, kind = int.from_bytes(log[at + 4 : at + 6], "little"), log[at + 6]
        record += log[at + 7 : at + 7 + length]
        at += 7 + length
        # A whole record, or the last piece of one.
        if kind in (1, 4):
            yield record
            record = b""


def _wandb(project: str) -> list[Sent]:
    pytest.importorskip("wandb")
    from wandb.proto import wandb_internal_pb2 as pb

    runs: dict[str, Sent] = {}
    for path in sorted(Path("wandb").glob("offline-run-*/run-*.wandb")):
        sent = runs.setdefault(path.stem, {"metrics": {}, "rows": {}, "config": {}})
        for data in _records(path.read_bytes()):
            record = pb.Record()
            record.ParseFromString(data)
            if record.HasField("run"):
                sent["name"] = record.run.display_name
                sent["config"] |= {item.key: json.loads(item.value_json) for item in record.run.config.update}
            for item in [*record.history.item, *record.summary.update]:
                name = item.key or "/".join(item.nested_key)
                sent["metrics"][name] = json.loads(item.value_json)
            for item in record.history.item:
                name = item.key or "/".join(item.nested_key)
                sent["rows"][name] = sent["rows"].get(name, 0) + 1
    return list(runs.values())


def _trackio(project: str) -> list[Sent]:
    trackio = pytest.importorskip("trackio")
    runs = []
    for run in trackio.Api().runs(project):
        sent: Sent = {"name": run.name.rpartition("-")[0], "config": run.config, "metrics": {}, "rows": {}}
        for row in trackio.SQLiteStorage.get_logs(project, run.name, run_id=run.id):
            sent["metrics"] |= row
            for name in row:
                sent["rows"][name] = sent["rows"].get(name, 0) + 1
        runs.append(sent)
    return runs


def _mlflow(project: str) -> list[Sent]:
    mlflow = pytest.importorskip("mlflow")
    client = mlflow.MlflowClient()
    runs = []
    for run in client.search_runs([client.get_experiment_by_name(project).experiment_id]):
        rows = {name: len(client.get_metric_history(run.info.run_id, name)) for name in run.data.metrics}
        params = {name: value for name, value in run.data.params.items()}
        runs.append({"name": run.info.run_name, "config": {"run": {"seed": int(params["run.seed"])}}, "metrics": run.data.metrics, "rows": rows})
    return runs


TRACKERS: dict[str, Callable[[str], list[Sent]]] = {"wandb": _wandb, "trackio": _trackio, "mlflow": _mlflow}


@pytest.fixture(params=list(TRACKERS))
def tracker(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A tracker that keeps everything in the test's directory."""
    name: str = request.param
    pytest.importorskip(name)
    monkeypatch.chdir(tmp_path)
    for variable, value in {
        "WANDB_MODE": "offline",
        "WANDB_SILENT": "true",
        "TRACKIO_DIR": str(tmp_path / "trackio"),
        "MLFLOW_TRACKING_URI": f"sqlite:///{tmp_path}/mlflow.db",
    }.items():
        monkeypatch.setenv(variable, value)
    return name


def _read(tracker: str) -> list[Sent]:
    """In a process of its own: trackers read their variables once."""
    script = f"import json, test_sync; print('READ' + json.dumps(test_sync.TRACKERS[{tracker!r}]('trestle'), default=str))"
    path = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run([sys.executable, "-c", script], env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    found: list[Sent] = json.loads(done.stdout.split("READ", 1)[1])
    return sorted(found, key=lambda run: run["name"])


def _rows(run: Path, *keys: str) -> int:
    rows = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    return sum(all(key in row for key in keys) for row in rows)


def test_a_sweep_is_sent_once_and_goes_on(tracker: str, trestle: Trestle, tmp_path: Path) -> None:
    trestle("sweep", "maze-small", "--algos", "dqn,ha-diiqn", "--seeds", "3", "--env-steps", "2000", "--out", "s", "--quiet")
    torn = tmp_path / "s/dqn/seed-3/metrics.jsonl"
    torn.write_bytes(torn.read_bytes() + b"x" * 200_000 + b'\n[]\n{"time/episodes": "<script>"}\n{"time/epi')
    (tmp_path / "s/out").symlink_to("/")
    said = trestle("sync", "s", "--to", tracker)
    assert "2 runs, 2 of them complete" in said.stdout
    first = _read(tracker)
    assert [run["name"] for run in first] == ["dqn/seed-3", "ha-diiqn/seed-3"]
    for sent, name in zip(first, ["dqn/seed-3", "ha-diiqn/seed-3"], strict=True):
        run = tmp_path / "s" / name
        result = json.loads((run / "result.json").read_text())
        if name.startswith("dqn"):
            run.joinpath("metrics.jsonl").write_bytes(run.joinpath("metrics.jsonl").read_bytes().split(b"x" * 9)[0])
        assert sent["config"]["run"]["seed"] == 3
        assert sent["metrics"]["result/env_steps"] == 2000
        assert sent["metrics"]["eval/return"] == pytest.approx(result["final_return"])
        assert sent["rows"]["rollout/ep_rew"] == _rows(run, "rollout/ep_rew")
        assert sent["rows"]["eval/return"] == len((run / "evals.csv").read_text().splitlines()) - 1
    # The same again adds nothing, and longer runs only what is new.
    trestle("sync", "s", "--to", tracker, "--quiet")
    assert [run["rows"]["rollout/ep_rew"] for run in _read(tracker)] == [run["rows"]["rollout/ep_rew"] for run in first]
    trestle("sweep", "--resume", "--out", "s", "--env-steps", "3000", "--quiet")
    trestle("sync", "s", "--to", tracker, "--quiet")
    for sent in _read(tracker):
        run = tmp_path / "s" / sent["name"]
        assert sent["metrics"]["result/env_steps"] == 3000
        assert sent["rows"]["rollout/ep_rew"] == _rows(run, "rollout/ep_rew")


def test_a_live_run_is_followed_to_its_end(tracker: str, trestle: Trestle, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "trestle"]
    limits = ["--env-steps", "100000000", "--episodes", "100000000", "--set", "run.stop_when_solved=false"]
    with subprocess.Popen([*command, "train", "maze-small", "--algo", "dqn", "--quiet", "--out", "run", *limits]) as training:
        while not (tmp_path / "run/evals.csv").exists() and training.poll() is None:
            time.sleep(0.05)
        # Without --once it would follow for as long as the run goes on.
        with subprocess.Popen([*command, "sync", "run", "--to", tracker], stdout=subprocess.PIPE, text=True) as following:
            while following.poll() is None and not (_sent(tracker, tmp_path)):
                time.sleep(0.2)
            training.send_signal(signal.SIGTERM)
            training.wait()
            (tmp_path / "run/result.json").write_text((tmp_path / "run/result.json").read_text().replace('"interrupted": true', '"interrupted": false'))
            said, _ = following.communicate(timeout=120)
    assert following.returncode == 0 and "1 runs, 1 of them complete" in said
    (sent,) = _read(tracker)
    assert sent["metrics"]["result/env_steps"] == json.loads((tmp_path / "run/result.json").read_text())["env_steps"]
    assert sent["rows"]["rollout/ep_rew"] == _rows(tmp_path / "run", "rollout/ep_rew")


def _sent(tracker: str, place: Path) -> bool:
    """Whether the tracker has something of a run."""
    names = {"wandb": "wandb/offline-run-*/files/trestle-sent.json", "trackio": "trackio/trestle.db", "mlflow": "mlflow.db"}
    return any(place.glob(names[tracker]))


def test_a_tracker_that_is_not_there_is_named(trestle: Trestle, tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    for name in TRACKERS:
        (tmp_path / f"{name}.py").write_text("raise ImportError('not here')\n")
        said = trestle("sync", "run", "--to", name, ok=False).stderr
        assert f"pip install 'trestle-rl[{name}]'" in said
