"""Data sets as users have them, written by Minari and h5py: makes the files in demonstrations/ beside this file.

Run as `python demonstrations.py`; the committed files were written with Python 3.11.7, minari 0.5.4, gymnasium 1.4.0,
h5py 3.16.0 and pyarrow 26.0.1 (`pip install "minari[hdf5,arrow]" pillow`, from PyPI). The tests compare what Trestle imports
with what is said here of the episodes, so no number in the files is looked up anywhere else.

A walker goes through the grid of maze-small along the moves in EPISODES. Observations are a dictionary:

- `cell`: (column, row) as float32, two features;
- `observation`: (column / 10, row / 10, dx, dy, 7, 8) as float64, of which a point maze would use the first four.
"""

import os
import pathlib
import shutil
import tempfile

import gymnasium as gym
import h5py
import minari
import numpy as np
from gymnasium.spaces import Box, Dict, Discrete
from minari.data_collector import EpisodeBuffer

HERE = pathlib.Path(__file__).parent
OUT = HERE / "demonstrations"
MOVES = {"N": (0, -1), "E": (1, 0), "S": (0, 1), "W": (-1, 0)}
SPACE = Dict({"cell": Box(0, 11, (2,), np.float32), "observation": Box(-9, 9, (6,), np.float64)})


def maze():
    """The map as lists, its start and its goal."""
    lines = (HERE / "../../actor/maps/maze-small.txt").read_text().split()
    find = lambda c: next((x, y) for y, line in enumerate(lines) for x, d in enumerate(line) if d == c)
    return lines, find("S"), find("G")


def shortest():
    """Moves of a shortest path from the start to the goal."""
    lines, start, goal = maze()
    reached, edge = {start: ""}, [start]
    for x, y in edge:
        for name, (dx, dy) in MOVES.items():
            to = (x + dx, y + dy)
            inside = 0 <= to[1] < len(lines) and 0 <= to[0] < len(lines[0])
            if inside and lines[to[1]][to[0]] != "#" and to not in reached:
                reached[to] = reached[x, y] + name
                edge.append(to)
    return reached[goal]


# Moves of each episode, and whether it ended in a terminal state: the whole way, and a walk that was broken off.
WAY = shortest()
EPISODES = [(WAY, True), (WAY[: len(WAY) // 2], False)]


def walk(moves):
    """Cells and full observations of a walk: len(moves) + 1 of each."""
    _, start, _ = maze()
    cells, speeds = [start], [(0, 0)]
    for name in moves:
        speeds.append(MOVES[name])
        cells.append((cells[-1][0] + MOVES[name][0], cells[-1][1] + MOVES[name][1]))
    cells = np.array(cells, np.float32)
    rest = np.tile([7.0, 8.0], (len(cells), 1))
    return cells, np.hstack([cells.astype(np.float64) / 10, np.array(speeds, np.float64), rest])


def buffers(shift):
    """The episodes; `shift` changes their actions and rewards and nothing else."""
    for i, (moves, terminal) in enumerate(EPISODES):
        cells, full = walk(moves)
        n = len(moves)
        yield EpisodeBuffer(
            id=i,
            seed=i,
            observations={"cell": cells, "observation": full},
            actions=np.array([("NESW".index(m) + shift) % 4 for m in moves]),
            rewards=[-0.04 - shift] * n,
            terminations=[terminal and j == n - 1 for j in range(n)],
            truncations=[not terminal and j == n - 1 for j in range(n)],
            infos={},
        )


def write_minari(name, data_format, shift=0):
    """A data set made by Minari, moved to OUT/name."""
    minari.create_dataset_from_buffers(
        dataset_id="trestle/maze-v0",
        buffer=list(buffers(shift)),
        observation_space=SPACE,
        action_space=Discrete(4),
        data_format=data_format,
    )
    shutil.move(pathlib.Path(os.environ["MINARI_DATASETS_PATH"]) / "trestle/maze-v0/data", OUT / name)
    shutil.rmtree(os.environ["MINARI_DATASETS_PATH"] + "/trestle")


def write_d4rl(name, timeouts=True, successors=False, shift=0, compress=False):
    """A flat file as D4RL has them: the observation before each action, and no last one."""
    flat = {"observations": [], "next_observations": [], "actions": [], "rewards": [], "terminals": [], "timeouts": []}
    for moves, terminal in EPISODES:
        cells, _ = walk(moves)
        flat["observations"].append(cells[:-1])
        flat["next_observations"].append(cells[1:])
        n = len(moves)
        flat["actions"].append(np.full((n, 2), 0.5 + shift, np.float32))
        flat["rewards"].append(np.full(n, -0.04 - shift, np.float32))
        ends = np.arange(n) == n - 1
        flat["terminals"].append(ends & terminal)
        flat["timeouts"].append(ends & (not terminal))
    extra = {"compression": "gzip", "chunks": True}
    with h5py.File(OUT / name, "w") as file:
        for key, parts in flat.items():
            if (key == "timeouts" and not timeouts) or (key == "next_observations" and not successors):
                continue
            chunked = compress and key == "observations"
            file.create_dataset(key, data=np.concatenate(parts), **(extra if chunked else {}))
        states = np.concatenate(flat["observations"])
        file.create_dataset("infos/qpos", data=states + np.float32(0.5))


def main():
    shutil.rmtree(OUT, ignore_errors=True)
    OUT.mkdir()
    with tempfile.TemporaryDirectory() as scratch:
        os.environ["MINARI_DATASETS_PATH"] = scratch
        for data_format in ["hdf5", "arrow"]:
            write_minari(f"minari-{data_format}", data_format)
            write_minari(f"minari-{data_format}-other-actions", data_format, shift=1)
    write_d4rl("d4rl.hdf5")
    write_d4rl("d4rl-gzip-other-actions.hdf5", shift=1, compress=True)
    write_d4rl("d4rl-no-timeouts.hdf5", timeouts=False)
    write_d4rl("d4rl-successors.hdf5", successors=True)
    cells = [walk(moves)[0] for moves, _ in EPISODES]
    np.save(OUT / "one.npy", cells[0])
    np.save(OUT / "two.npy", np.stack([cells[0], cells[0][::-1]]).astype(">f8"))


if __name__ == "__main__":
    main()
