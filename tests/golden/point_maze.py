"""Golden steps of the Point Maze, computed by Gymnasium-Robotics on MuJoCo: writes point_maze_steps.csv and
point_maze_rollouts.csv beside this file.

Run as `python point_maze.py` with `pip install gymnasium-robotics==1.4.2 mujoco==4.0.0`; the committed files were written
with Python 3.11.7, gymnasium 1.4.0 and numpy 2.4.6 on x86-64 Linux.

Steps: random states, two in three of them touching a wall, and the state after one step with a random control.
Rollouts: 300 steps from the map's start, the control drawn anew every 10 steps; one line for 10 steps, with the control
and the state after them.

MuJoCo adds up the margins of two geoms from version 3.5.0 on and takes the larger one before. The model gives both
0.002, so walls push from 0.004 on here; with 0.001 each they push from 0.002 on, as in the versions that D4RL and
Gymnasium-Robotics were written for. Both are recorded.
"""

import csv
import pathlib
import warnings

import gymnasium
import gymnasium_robotics
import numpy as np

HERE = pathlib.Path(__file__).parent
MAPS = HERE.parents[1] / "actor" / "maps"
WALL = 0.5
RADIUS = 0.1
STEPS = 40


def maze(name):
    """The environment on one of our maps, and its cells in metres: walls, free ones, the start."""
    lines = (MAPS / f"{name}.txt").read_text().split()
    env = gymnasium.make("PointMaze_UMaze-v3", maze_map=[[int(c == "#") for c in line] for line in lines])
    env.reset(seed=0)
    point = env.unwrapped.point_env
    cells = {letter: [] for letter in "#.SG"}
    for row, line in enumerate(lines):
        for column, letter in enumerate(line):
            cells[letter].append((column + 0.5 - len(line) / 2, len(lines) / 2 - row - 0.5))
    return point, np.array(cells["#"]), np.array(cells["."] + cells["S"] + cells["G"]), cells["S"][0]


def clearance(position, walls):
    """Distance between the ball and the nearest wall."""
    nearest = np.clip(position, walls - WALL, walls + WALL)
    return np.linalg.norm(position - nearest, axis=1).min() - RADIUS


def set_margin(point, margin):
    point.model.geom_margin[:] = margin / 2


def step(point, state, control):
    point.set_state(np.array(state[:2]), np.array(state[2:]))
    return point.step(np.array(control))[0]


def main():
    warnings.simplefilter("ignore")
    gymnasium.register_envs(gymnasium_robotics)
    rng = np.random.default_rng(1)
    steps, rollouts = [], []
    for name in ("umaze", "medium", "large"):
        point, walls, free, start = maze(name)
        for margin in (0.002, 0.004):
            set_margin(point, margin)
            for case in range(STEPS):
                touching = case % 3 != 0
                while True:
                    position = free[rng.integers(len(free))] + rng.uniform(-0.5, 0.5, 2)
                    if -0.01 < clearance(position, walls) < (margin if touching else 1):
                        break
                velocity, control = rng.uniform(-6, 6, 2), rng.uniform(-1, 1, 2)
                after = step(point, [*position, *velocity], control)
                steps.append([name, margin, *position, *velocity, *control, *after])
            state = np.array([*start, 0, 0])
            for _ in range(30):
                control = rng.choice([-1, -0.5, 0.5, 1], 2)
                for _ in range(10):
                    state = step(point, state, control)
                rollouts.append([name, margin, *control, *state])
    names = "x y vx vy"
    write("steps", f"map margin {names} ux uy x2 y2 vx2 vy2", steps)
    write("rollouts", f"map margin ux uy {names}", rollouts)


def write(name, header, rows):
    with (HERE / f"point_maze_{name}.csv").open("w", newline="") as file:
        lines = csv.writer(file, lineterminator="\n")
        lines.writerow(header.split())
        lines.writerows([[v if isinstance(v, str) else repr(float(v)) for v in row] for row in rows])


main()
