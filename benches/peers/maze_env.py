"""The 2D maze of actor/src/env/maze as a gymnasium environment, with the irregular action set.

Its rules are written a second time here on purpose: the peer must not depend on this project's code, and the two
implementations check each other (see check()).
"""

from collections import deque
from pathlib import Path

import gymnasium
import numpy as np

# (column, row) of N, NE, S, SW; rows count downwards.
IRREGULAR = ((0, -1), (1, -1), (0, 1), (-1, 1))
# (column, row) of N, E, S, W.
REGULAR = ((0, -1), (1, 0), (0, 1), (-1, 0))
GOAL_REWARD = 1.0
BLOCKED_REWARD = -0.75
REVISIT_REWARD = -0.25
MOVE_REWARD = -0.04
BLOCKED = -1


class Maze(gymnasium.Env):
    """A cell is a number, row by row. Everything a step needs is in tables, so that the environment's share of the
    peer's time is small."""

    def __init__(self, map_file: Path, step_limit: int, directions=IRREGULAR):
        rows = Path(map_file).read_text(encoding="utf-8").split()
        self.columns, self.rows = len(rows[0]), len(rows)
        letters = "".join(rows)
        self.start, self.goal = letters.index("S"), letters.index("G")
        self.free = [letter != "#" for letter in letters]
        self.next = [[self._advance(cell, d) for d in directions] for cell in range(len(letters))]
        # Column and row scaled to -1..1, one array a cell; nobody writes to them.
        self.observed = [
            np.array([2.0 * (c % self.columns) / (self.columns - 1) - 1.0,
                      2.0 * (c // self.columns) / (self.rows - 1) - 1.0], dtype=np.float32)
            for c in range(len(letters))
        ]
        self.step_limit = step_limit
        self.observation_space = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.action_space = gymnasium.spaces.Discrete(len(directions))

    def _is_free(self, column: int, row: int) -> bool:
        inside = 0 <= column < self.columns and 0 <= row < self.rows
        return inside and self.free[row * self.columns + column]

    def _advance(self, cell: int, direction) -> int:
        """Where a move leads. Walls and the edge block it, and so do, diagonally, two blocked cells beside it."""
        column, row = cell % self.columns, cell // self.columns
        dx, dy = direction
        beside = self._is_free(column + dx, row) or self._is_free(column, row + dy)
        if not self._is_free(column + dx, row + dy) or not beside:
            return BLOCKED
        return (row + dy) * self.columns + column + dx

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.at, self.steps, self.visited = self.start, 0, {self.start}
        return self.observed[self.at], {}

    def step(self, action):
        self.steps += 1
        cell = self.next[self.at][action]
        if cell == BLOCKED:
            reward = BLOCKED_REWARD
        else:
            self.at = cell
            if cell in self.visited:
                reward = REVISIT_REWARD
            else:
                self.visited.add(cell)
                reward = GOAL_REWARD if cell == self.goal else MOVE_REWARD
        terminated = self.at == self.goal
        truncated = not terminated and self.steps >= self.step_limit
        return self.observed[self.at], reward, terminated, truncated, {}


def shortest_actions(maze: Maze) -> list[int]:
    """Actions of a shortest path from start to goal, by breadth-first search."""
    came_from = {maze.start: None}
    queue = deque([maze.start])
    while queue and maze.goal not in came_from:
        cell = queue.popleft()
        for action, target in enumerate(maze.next[cell]):
            if target != BLOCKED and target not in came_from:
                came_from[target] = (cell, action)
                queue.append(target)
    actions, step = [], came_from[maze.goal]
    while step is not None:
        actions.append(step[1])
        step = came_from[step[0]]
    return actions[::-1]


def play(maze: Maze, actions) -> tuple[float, bool, bool]:
    """Return of one episode of `actions`, and whether its last step terminated or truncated it."""
    maze.reset()
    total, terminated, truncated = 0.0, False, False
    for action in actions:
        if terminated or truncated:
            raise SystemExit("maze check failed: the episode ended before its actions did")
        _, reward, terminated, truncated, _ = maze.step(action)
        total += reward
    return total, terminated, truncated


def check(map_file: Path, step_limit: int) -> None:
    """Refuses to measure another maze than maze30: its known figures must come out."""

    def expect(what: str, found, wanted) -> None:
        if found != wanted:
            raise SystemExit(f"maze check failed: {what} is {found}; expected: {wanted}")

    maze = Maze(map_file, step_limit)
    expect("number of free cells", sum(maze.free), 827)
    expect("shortest regular path", len(shortest_actions(Maze(map_file, step_limit, REGULAR))), 96)
    best = shortest_actions(maze)
    expect("shortest irregular path", len(best), 111)
    total, terminated, truncated = play(maze, best)
    expect("optimal return", round(total, 9), -3.4)
    expect("end of the optimal episode", (terminated, truncated), (True, False))
    # From the start: N is blocked, S enters a new cell, N goes back to the start, which counts as visited.
    expect("return of N, S, N", round(play(maze, [0, 2, 0])[0], 9), -1.04)
    # Always N stays blocked until the step limit.
    total, terminated, truncated = play(maze, [0] * step_limit)
    expect("return of blocked moves alone", total, BLOCKED_REWARD * step_limit)
    expect("end at the step limit", (terminated, truncated), (False, True))
    expect("scaled corners", [maze.observed[c].tolist() for c in (maze.start, maze.goal)], [[-1, -1], [1, 1]])
