"""Sends what is in the files of runs to a tracker of experiments: the work of ``trestle sync``.

Files are only read. Each run is one of the tracker's, and how far it has been sent is kept there, so that a second ``sync`` goes on.
"""

from __future__ import annotations

import csv
import hashlib
import json
import math
import os
import signal
import sys
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NoReturn

from ._refused import Refused
from ._trackers import Cursor, Described, Point, Sink, Tracker, tracker

#: Seconds between two looks at runs that are being trained.
_LOOK_S = 2.0
#: Seconds without a change after which a run is taken to be over, and nothing more is waited for.
_QUIET_S = 60.0
#: Levels of directories in which runs are looked for, and runs of them, at most.
_MAX_DEPTH = 4
_MAX_RUNS = 10_000
#: Longest line of a record that is read, bytes.
_MAX_LINE = 1 << 16
#: Points that are sent at once.
_BATCH = 500
_INTERRUPTED = 130


class _Interrupted(Exception):
    """Ctrl-C, or another request to end."""


def sync(order_json: str) -> int:
    """Carry out the order of the command line, ``{dir, to, project, once, quiet}``, and return the exit status."""
    order = json.loads(order_json)

    def end(number: int, frame: object) -> NoReturn:
        raise _Interrupted

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, end)
    try:
        with tracker(order["to"], order["project"], quiet=order["quiet"]) as to:
            _Sync(Path(order["dir"]), to, quiet=order["quiet"]).follow(once=order["once"])
    except _Interrupted:
        print("interrupted; the same command goes on", file=sys.stderr)
        return _INTERRUPTED
    except Refused as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except Exception as error:  # noqa: BLE001 - the trackers raise whatever they like.
        print(f"error: {order['to']}: {type(error).__name__}: {error}", file=sys.stderr)
        return 1
    return 0


class _Sync:
    """The runs in a directory, and how far each has been sent."""

    def __init__(self, root: Path, to: Tracker, *, quiet: bool) -> None:
        self._root, self._to, self._quiet = root, to, quiet
        self._runs: dict[Path, _Followed] = {}

    def follow(self, *, once: bool) -> None:
        quiet_since = time.monotonic()
        try:
            while True:
                moved = self._look(last=once)
                if once:
                    return
                if moved:
                    quiet_since = time.monotonic()
                if not any(run.live for run in self._runs.values()):
                    if all(run.over for run in self._runs.values()) and not self._to_come():
                        return
                    if time.monotonic() - quiet_since > _QUIET_S:
                        return
                time.sleep(_LOOK_S)
        finally:
            for run in self._runs.values():
                run.close()
            if not self._quiet:
                done = sum(run.over for run in self._runs.values())
                print(f"{len(self._runs)} runs, {done} of them complete: {self._to.where()}")

    def _look(self, *, last: bool) -> bool:
        """Send what is new; with ``last`` also close what is not over. Returns whether there was anything."""
        locked = _locked()
        moved = False
        for path in _runs(self._root):
            run = self._runs.get(path)
            if run is None:
                run = self._runs[path] = _Followed(path, self._root, self._to)
                moved = True
            moved |= run.look(locked)
            if run.over or (last and not run.live):
                run.close()
        return moved

    def _to_come(self) -> bool:
        """Whether the directory is of a sweep that has further runs."""
        try:
            manifest = json.loads((self._root / "sweep.json").read_text(encoding="utf-8"))
            return len(manifest["arms"]) * len(manifest["seeds"]) > len(self._runs)
        except (OSError, ValueError, KeyError, TypeError):
            return False


def _runs(root: Path) -> Iterator[Path]:
    """The directories of runs in ``root``, in order. Links are not followed."""
    waiting, found = [(root, 0)], 0
    while waiting and found < _MAX_RUNS:
        path, depth = waiting.pop(0)
        if (path / "config.toml").is_file() and ((path / "plan.bin").is_file() or (path / "logs").is_dir() or (path / "result.json").is_file()):
            found += 1
            yield path
            continue
        if depth < _MAX_DEPTH:
            try:
                entries = sorted(os.scandir(path), key=lambda entry: entry.name)
            except OSError:
                continue
            waiting += [(Path(e.path), depth + 1) for e in entries if e.is_dir(follow_symlinks=False) and not e.name.startswith(".")]


def _locked() -> set[int]:
    """The inodes on which a process of this machine holds a lock, as a run's supervisor does on its directory."""
    try:
        lines = Path("/proc/locks").read_text(encoding="utf-8").splitlines()
    except OSError:
        return set()
    words = [line.split() for line in lines if "FLOCK" in line]
    return {int(line[5].rsplit(":", 1)[1]) for line in words if len(line) > 5 and line[1] == "FLOCK"}


class _Lines:
    """The whole lines of a file that grows. One that is another, or shorter, is read anew."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._inode, self._offset = 0, 0

    def new(self) -> Iterator[bytes]:
        try:
            file = self._path.open("rb")
        except FileNotFoundError:
            return
        with file:
            stat = os.fstat(file.fileno())
            if stat.st_ino != self._inode or stat.st_size < self._offset:
                self._inode, self._offset = stat.st_ino, 0
            file.seek(self._offset)
            long = False
            while piece := file.readline(_MAX_LINE):
                if not piece.endswith(b"\n"):
                    if len(piece) < _MAX_LINE:
                        # Torn: it is read when it is whole.
                        return
                    long = True
                    continue
                self._offset = file.tell()
                if not long:
                    yield piece
                long = False


class _Followed:
    """One run, and how far it has been sent."""

    def __init__(self, path: Path, root: Path, to: Tracker) -> None:
        self.path = path
        self.live = self.over = False
        self._to = to
        self._sink: Sink | None = None
        self._cursor = Cursor()
        self._metrics, self._evals = _Lines(path / "metrics.jsonl"), _Lines(path / "evals.csv")
        self._eval_names: list[str] = []
        self._name = str(path.relative_to(root)) if path != root else path.resolve().name
        self._stamp: object = None

    def look(self, locked: set[int]) -> bool:
        """Send what is new. Returns whether there was anything."""
        directory = self.path.stat()
        files = [_mtime(self.path / name) for name in ("metrics.jsonl", "evals.csv", "result.json")]
        result = _result(self.path)
        self.over = result is not None and not result.get("interrupted")
        self.live = not self.over and (directory.st_ino in locked or time.time() - max(files) < _QUIET_S)
        stamp = (files, self.over)
        if stamp == self._stamp:
            return False
        self._stamp = stamp
        sink = self._open()
        points: list[Point] = []
        for point in self._points():
            points.append(point)
            if len(points) == _BATCH:
                sink.send(points, self._cursor)
                points = []
        sink.send(points, self._cursor)
        if self.over and result is not None:
            sink.summarise({f"result/{key}": value for key, value in result.items()})
        return True

    def _open(self) -> Sink:
        if self._sink is None:
            self._sink, sent = self._to.open(self._described())
            # What is read anew is passed over again.
            self._cursor = sent
        return self._sink

    def close(self) -> None:
        """Tell the tracker that nothing more comes for now."""
        if self._sink is not None:
            self._sink.close("finished" if self.over else "running" if self.live else "ended")
            self._sink = None

    def _points(self) -> Iterator[Point]:
        """What has not been sent, and :attr:`_cursor` after each."""
        cursor = self._cursor
        for line in self._metrics.new():
            try:
                row = json.loads(line)
                episodes, steps = int(row["time/episodes"]), int(row["time/total_timesteps"])
            except (ValueError, KeyError, TypeError):
                continue
            values = _numbers(row)
            if "rollout/ep_rew" in row:
                if episodes > cursor.episodes:
                    cursor.episodes = episodes
                    yield Point(steps, values)
            elif steps > cursor.steps:
                cursor.steps = steps
                yield Point(steps, values)
        for line in self._evals.new():
            cells = next(csv.reader([line.decode(errors="replace")]))
            if cells[:1] == ["episode"]:
                self._eval_names = cells
                continue
            row = _numbers(dict(zip(self._eval_names, map(_number, cells))))
            steps = int(row.get("env_steps", -1))
            if steps > cursor.evals:
                cursor.evals = steps
                named = {f"eval/{key}": row[key] for key in ("return", "length", "success") if key in row}
                yield Point(steps, named | {"time/total_timesteps": steps, "time/episodes": row.get("episode", 0)})

    def _described(self) -> Described:
        config = tomllib.loads((self.path / "config.toml").read_text(encoding="utf-8"))
        # What a run has found of its environment is long, and no setting.
        for table in config.get("env", {}).values():
            if isinstance(table, dict):
                table.pop("found", None)
        try:
            build = json.loads((self.path / "build.json").read_text(encoding="utf-8"))
            command = (self.path / "command.txt").read_text(encoding="utf-8").splitlines()[:1]
        except (OSError, ValueError):
            build, command = {}, []
        resolved = self.path.resolve()
        # The same directory, which --overwrite replaces by another one.
        identity = f"{resolved}\n{resolved.stat().st_ino}\n{command}"
        arm = resolved.parent.name if resolved.name.startswith("seed-") else str(config.get("run", {}).get("algo", ""))
        return Described(
            id=hashlib.sha256(identity.encode()).hexdigest()[:16],
            name=self._name,
            arm=arm,
            config=config,
            about={"version": str(build.get("version", "")), "commit": str(build.get("commit", "")), "command": "".join(command)},
            begun=(self.path / "config.toml").stat().st_mtime,
        )


def _mtime(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except OSError:
        return 0.0


def _result(path: Path) -> dict[str, Any] | None:
    try:
        found = json.loads((path / "result.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) else None


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def _numbers(row: dict[str, Any]) -> dict[str, float]:
    """The finite numbers of ``row``."""
    return {
        key: value
        for key, value in row.items()
        if isinstance(key, str) and isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
    }


__all__ = ["sync"]
