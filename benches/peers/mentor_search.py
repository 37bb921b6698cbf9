#!/usr/bin/env python3
"""Similarity queries and nearest mentor transitions by scikit-learn's KDTree and BallTree and by faiss's Flat index, beside
the figures of `trestle-bench mentor --json`.

The world is that of benches/src/walk.rs: a box of cells with about one mentor state a cell, states up to 0.2 beside
the middle of their cell, features with standard deviation 1. *similar* asks for all mentor states with KL <= 0.1, a radius
of sqrt(0.2). *infer* asks for the one mentor transition nearest to an observer's: a weaker question than Trestle's, which
is for every mentor transition nearer than its own error so far, and which none of these can be asked.

One thread. CPU time of this process, the median of --repeats samples; peers are asked one query at a time and in batches of
4096, where the cost of a call from Python is spread. One line of CSV a measurement; with --json a table of ratios, too, and
with --pictures a picture of each cost against size.
"""

import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[variable] = "1"

import argparse
import csv
import json
import statistics
import sys
import time
from pathlib import Path

import faiss
import numpy as np
from sklearn.neighbors import BallTree, KDTree

DIMS, MENTOR = (2, 4), (100, 10_000, 100_000)
JITTER, E_TH, TURN = 0.2, 0.1, 3
RADIUS = float(np.sqrt(2 * E_TH))
QUERIES, SINGLE = 4096, 256
FIELDS = ["op", "dim", "mentor", "peer", "single_us", "batch_us"]


def side(dim: int, mentor: int) -> int:
    return int(np.ceil(mentor ** (1 / dim)))


def mentor_path(dim: int, mentor: int, rng: np.random.Generator) -> np.ndarray:
    """States of a mentor that goes straight on, and turns once in TURN steps or at the box's sides."""
    length, cell = side(dim, mentor), rng.integers(0, side(dim, mentor), dim)
    states, action = [cell.copy()], 0
    for _ in range(mentor):
        if rng.integers(TURN) == 0:
            action = rng.integers(2 * dim)
        while not 0 <= cell[action // 2] + (1 if action % 2 else -1) < length:
            action = rng.integers(2 * dim)
        cell[action // 2] += 1 if action % 2 else -1
        states.append(cell.copy())
    return jitter(np.array(states), rng)


def jitter(cells: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return (cells + rng.uniform(-JITTER, JITTER, cells.shape)).astype(np.float32)


def observer(dim: int, mentor: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Both states of transitions anywhere in the box."""
    cells = rng.integers(0, side(dim, mentor), (QUERIES, dim))
    after = cells.copy()
    after[np.arange(QUERIES), rng.integers(0, dim, QUERIES)] += 1
    return jitter(cells, rng), jitter(np.minimum(after, side(dim, mentor) - 1), rng)


def peers(points: np.ndarray, nearest: bool) -> dict:
    """A function of a block of queries for each peer, on the index over `points`."""
    found = {}
    for name, tree in (("KDTree", KDTree(points)), ("BallTree", BallTree(points))):
        if nearest:
            found[name] = lambda block, tree=tree: tree.query(block, k=1)
        else:
            found[name] = lambda block, tree=tree: tree.query_radius(block, RADIUS)
    flat = faiss.IndexFlatL2(points.shape[1])
    flat.add(points)
    found["faiss Flat"] = (lambda b: flat.search(b, 1)) if nearest else (lambda b: flat.range_search(b, RADIUS**2))
    return found


def microseconds(ask, queries: np.ndarray, block: int, repeats: int) -> float:
    """CPU time a query, the median of samples of all `queries` in blocks."""
    samples = []
    for _ in range(repeats):
        start = time.process_time()
        for at in range(0, len(queries), block):
            ask(queries[at : at + block])
        samples.append((time.process_time() - start) / len(queries) * 1e6)
    return statistics.median(samples)


def measure(repeats: int):
    for dim in DIMS:
        for mentor in MENTOR:
            rng = np.random.default_rng(1)
            states = mentor_path(dim, mentor, rng)
            before, after = observer(dim, mentor, rng)
            for op, points, queries in (
                ("similar", states, before),
                ("infer", np.hstack([states[:-1], states[1:]]), np.hstack([before, after])),
            ):
                for peer, ask in peers(points, op == "infer").items():
                    single = microseconds(ask, queries[:SINGLE], 1, repeats)
                    batch = microseconds(ask, queries, QUERIES, repeats)
                    yield dict(zip(FIELDS, [op, dim, mentor, peer, f"{single:.3f}", f"{batch:.3f}"]))


def figure(x: float) -> str:
    """Three significant digits, without an exponent."""
    return f"{x:,.0f}" if x >= 100 else f"{x:.3g}"


def table(rows: list[dict], trestle: list[dict]) -> None:
    """Prints how many times Trestle's time each peer takes, single and in batches."""
    names = list(dict.fromkeys(row["peer"] for row in rows))
    print("| | d | mentor | Trestle, us | " + " | ".join(names) + " |\n|---|---|---|---|" + "---|" * len(names))
    for own in (row for row in trestle if row["op"] in ("similar", "infer")):
        key = (own["op"], own["dim"], own["mentor"])
        us, cells = own["ns"] / 1000, []
        for name in names:
            row = next(r for r in rows if (r["op"], r["dim"], r["mentor"], r["peer"]) == (*key, name))
            cells.append("{} ({})".format(*(figure(float(row[k]) / us) for k in ("batch_us", "single_us"))))
        print(f"| {key[0]} | {key[1]} | {key[2]} | {us:.3f} | " + " | ".join(cells) + " |")


def picture(axes, title: str, xlabel: str, curves: list[tuple[str, list, list]]) -> None:
    """Cost against size, both logarithmic. Colours of Okabe and Ito (2008); dashes tell the lines apart as well."""
    colours = ("#0072b2", "#e69f00", "#009e73", "#d55e00", "#cc79a7", "#56b4e9", "#000000", "#999999")
    dashes = ("-", "--", ":", "-.")
    for at, (name, sizes, us) in enumerate(curves):
        axes.plot(sizes, us, dashes[at % 4], color=colours[at % 8], marker="o", markersize=4, linewidth=2, label=name)
    axes.set(title=title, xlabel=xlabel, xscale="log", yscale="log")
    axes.grid(color="#dddddd")


def pictures(rows: list[dict], trestle: list[dict], directory: Path) -> None:
    """mentor-search.png: both questions by mentor transitions; mentor-bridges.png: bridges by stored ones."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    def ours(op: str, key: str, **where) -> tuple[list, list]:
        found = [row for row in trestle if row["op"] == op and row.get(key) and all(row[k] == v for k, v in where.items())]
        return found, [row[key] / 1000 for row in found]

    figure, panels = pyplot.subplots(2, 2, figsize=(11, 8), layout="constrained")
    for across, op in enumerate(("similar", "infer")):
        for down, dim in enumerate(DIMS):
            curves = []
            for name, key in (("Trestle", "ns"), ("scan of all", "naive_ns")):
                found, us = ours(op, key, dim=dim)
                curves.append((name, [row["mentor"] for row in found], us))
            for peer in dict.fromkeys(row["peer"] for row in rows):
                found = [row for row in rows if (row["op"], row["dim"], row["peer"]) == (op, dim, peer)]
                curves.append((f"{peer}, batches", [row["mentor"] for row in found], [float(row["batch_us"]) for row in found]))
            picture(panels[down][across], f"{op}, {dim} features", "mentor transitions", curves)
            panels[down][across].set_ylabel("us a query")
            panels[down][across].legend(fontsize="small", frameon=False)
    figure.savefig(directory / "mentor-search.png", dpi=100)
    figure, panels = pyplot.subplots(1, 2, figsize=(11, 4.5), layout="constrained", sharey=True)
    for panel, states in zip(panels, ("cells", "anywhere")):
        curves = []
        for dim in DIMS:
            for mentor in MENTOR:
                found, us = ours("bridge", "ns", dim=dim, mentor=mentor, states=states)
                curves.append((f"{dim} features, mentor of {mentor:,}", [row["stored"] for row in found], us))
        picture(panel, f"bridge search, states {states}", "stored transitions", curves)
    panels[0].set_ylabel("us a stored transition")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
    figure.savefig(directory / "mentor-bridges.png", dpi=100)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, help="what `trestle-bench mentor --json` printed")
    parser.add_argument("--pictures", type=Path, help="a directory for pictures; needs --json")
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    faiss.omp_set_num_threads(1)
    rows, writer = [], csv.DictWriter(sys.stderr, FIELDS, lineterminator="\n")
    writer.writeheader()
    for row in measure(options.repeats):
        writer.writerow(row)
        rows.append(row)
    if options.json:
        text = json.loads(options.json.read_text())
        trestle = text["rows"] if isinstance(text, dict) else text
        table(rows, trestle)
        if options.pictures:
            options.pictures.mkdir(parents=True, exist_ok=True)
            pictures(rows, trestle, options.pictures)


if __name__ == "__main__":
    main()
