#!/usr/bin/env python3
"""Throughput of a run over several hosts beside the same run on one, its bytes, and how many actors a learner can feed from.

    deploy/relay/tests/throughput.py compare     one host, and one and two joined hosts, with four actors in all
    deploy/relay/tests/throughput.py actors      free mode with slow steps and more and more actors, beside the model
    deploy/relay/tests/throughput.py tables      the tables of what has been measured

    --results FILE    where what is measured is kept, deploy/relay/tests/throughput.csv unless given; it is not measured again
    --repeat N        how often each row is measured, 3 times unless given; tables have medians
    --share N         takes an Nth of the steps, to see whether it works: the figures say nothing

Needs what matrix.py needs; build both programs with --release, and name them by TRESTLE and TRESTLE_RELAY. The environments are
maze-small, whose step takes well below a microsecond, and the same with a millisecond for each step (`env.hazard.kind = slow`). The
algorithm is dqn, so that a learner has no mentor-server to wait for.
"""

import argparse
import csv
import json
import signal
import statistics
import struct
import sys
import tempfile
import time
from pathlib import Path

import hosts as at
from hosts import TRESTLE, Hosts, end

ACTORS = 4
ROLLOUT = 32
# Bytes of the header of a batch, and of a transition of maze-small: two states of two features, and three words.
BATCH_HEADER, TRANSITION = 88, 28
ENVIRONMENTS = {"maze": [], "1 ms": ["--set", "env.hazard.kind=slow", "--set", "env.hazard.after=1"]}
MODES = {"lockstep": [], "lag": ["--set", "run.lag=1"], "free": ["--mode", "free"]}
# Environment steps of a row.
STEPS = {("maze", "lockstep"): 60_000, ("maze", "lag"): 60_000, ("maze", "free"): 120_000}
SLOW_STEPS = 24_000
ROUND_TRIPS = [0.2, 20.0]
# Of `actors`: on the head and on each of two joined hosts.
POINTS = [(1, 0), (1, 1), (2, 3), (2, 7), (4, 14)]
COLUMNS = ["what", "env", "mode", "joined", "actors", "round_trip_ms", "repeat", "steps", "seconds", "waits", "remote_steps"]
COLUMNS += ["measured_ms", "frames_up", "frames_down", "packets_up", "packets_down", "weights_bytes", "load"]
NUMBERS = COLUMNS[3:]


def weights_bytes(out):
    """Bytes of the network's weights alone, as in the head of the file that holds the best ones."""
    with open(sorted((out / "checkpoints").glob("*/model.safetensors"))[-1], "rb") as file:
        (length,) = struct.unpack("<Q", file.read(8))
        tensors = json.loads(file.read(length))
    return max(tensor["data_offsets"][1] for name, tensor in tensors.items() if name != "__metadata__")


def waits(out):
    """The share of the time for which the learner waited for actors."""
    rows = [json.loads(line) for line in (out / "metrics.jsonl").read_text().splitlines()]
    found = [row["ipc/wait_actors_frac"] for row in rows if "ipc/wait_actors_frac" in row]
    return statistics.mean(found) if found else float("nan")


def measure(what, env, mode, here, joined, round_trip, repeat, place, share):
    """One run with `here` actors on the head, and as many on each joined host as `joined` says. A row."""
    total = here + sum(joined)
    steps = STEPS.get((env, mode), SLOW_STEPS if what == "compare" else 4000 * total) // share
    names = ["b", "c"][: len(joined)]
    out = place / "run"
    hosts = Hosts(place, place.parent / "cred", others=names, silence=30)
    hosts.net.delay = round_trip / 2e3
    words = ["train", "maze-small", "--algo", "dqn", "--seed", "3", "--episodes", "1000000000", "--env-steps", str(steps)]
    words += ["--quiet", "--set", "eval.every=1000000000", "--set", f"run.rollout={ROLLOUT}", "--out", str(out)]
    words += [*MODES[mode], *ENVIRONMENTS[env]]
    try:
        if joined:
            head = hosts.head([*words, "--actors", str(here)], sum(joined))
            others = [hosts.join(name, actors) for name, actors in zip(names, joined)]
        else:
            head, others = hosts.start("head", [TRESTLE, *words, "--actors", str(here)]), []
        if end(head) != 0 or any(end(other) != 0 for other in others):
            raise AssertionError(f"a host has failed; {hosts.text('head')[-2000:]}")
        came = at.result(out)
        if mode == "free":
            lines = [line.split(",") for line in (out / "actors.csv").read_text().splitlines()[1:]]
            remote = sum(int(line[3]) for line in lines if line[6])
        else:
            remote = steps * sum(joined) // total
        with open(out / "hosts.csv", newline="") if joined else open("/dev/null") as file:
            counts = list(csv.DictReader(file))
        trips = [float(row["round_trip_ms"]) for row in counts if row["round_trip_ms"]]
        own = hosts.net.address["head"]
        row = [what, env, mode, len(joined), total, round_trip, repeat, came["env_steps"], came["wall_s"], waits(out), remote]
        row += [statistics.mean(trips) if trips else 0, sum(int(row["bytes_received"]) for row in counts)]
        row += [sum(int(row["bytes_sent"]) for row in counts), hosts.net.bytes - hosts.net.sent[own], hosts.net.sent[own]]
        return [*row, weights_bytes(out), Path("/proc/loadavg").read_text().split()[0]]
    finally:
        hosts.close()


def rows(what):
    """What is to be measured: environment, mode, actors here and on each joined host, round trip."""
    if what == "actors":
        for round_trip in ROUND_TRIPS:
            for here, away in POINTS:
                yield "1 ms", "free", here, [away, away] if away else [], round_trip
        # The learner at its limit: nothing but its own work holds it up.
        yield "maze", "free", ACTORS, [], 0.0
        return
    for env in ENVIRONMENTS:
        for mode in MODES:
            yield env, mode, ACTORS, [], 0.0
            for round_trip in ROUND_TRIPS:
                for joined in [2], [1, 1]:
                    yield env, mode, 2, joined, round_trip


def read(path):
    if not path.exists():
        return []
    with open(path, newline="") as file:
        return [{key: float(value) if key in NUMBERS else value for key, value in row.items()} for row in csv.DictReader(file)]


def medians(found):
    """One row for each thing that was measured, with the medians over the repetitions, in their order."""
    groups = {}
    for row in found:
        groups.setdefault(tuple(row[key] for key in COLUMNS[:6]), []).append(row)
    for group in groups.values():
        yield {**group[0], **{key: statistics.median(row[key] for row in group) for key in COLUMNS[7:]}}


def rate(row):
    return row["steps"] / row["seconds"]


def tables(found):
    """Prints what the documentation quotes."""
    every = list(medians(found))
    compared = [row for row in every if row["what"] == "compare"]
    alone = {(row["env"], row["mode"]): rate(row) for row in compared if not row["joined"]}
    if compared:
        print("| step | mode | hosts | round trip | steps/s | of one host |\n|---|---|---|---|---|---|")
    for row in compared:
        name = "one" if not row["joined"] else f"head and {row['joined']:.0f}"
        trip = f"{row['round_trip_ms']:g} ms" if row["joined"] else ""
        beside = rate(row) / alone.get((row["env"], row["mode"]), float("nan"))
        print(f"| {row['env']} | {row['mode']} | {name} | {trip} | {rate(row):,.0f} | {beside:.2f} |")
    over = [row for row in compared if row["joined"]]
    own = TRANSITION + BATCH_HEADER / ROLLOUT
    if over:
        print("\n| step | mode | joined | round trip | bytes a transition, frames | times a batch's own | packets | a version's, frames |")
        print("|---|---|---|---|---|---|---|---|")
    for row in over:
        frames, packets = row["frames_up"] / row["remote_steps"], row["packets_up"] / row["remote_steps"]
        version = "" if row["mode"] == "free" else f"{row['frames_down'] * ACTORS * ROLLOUT / row['steps'] / row['joined']:,.0f}"
        head = f"| {row['env']} | {row['mode']} | {row['joined']:.0f} | {row['round_trip_ms']:g} ms"
        print(f"{head} | {frames:.1f} | {frames / own:.2f} | {packets:.1f} ({packets / own:.2f}) | {version} |")
    if over:
        print(f"\nThe weights alone have {over[0]['weights_bytes']:,.0f} bytes, and a transition with its share of the header {own:.2f}.")
    points = [row for row in every if row["what"] == "actors"]
    if points:
        model(points)


def model(points):
    """How many actors one learner can feed from: as many as bring what it takes in."""
    slow, busy = [row for row in points if row["env"] == "1 ms"], [row for row in points if row["env"] == "maze"]
    one = next((rate(row) for row in slow if row["actors"] == 1), None)
    if not one or not busy:
        return
    most = rate(busy[0]) / (1 - busy[0]["waits"])
    print(f"\nAn actor alone brings {one:,.0f} steps/s, and a learner that never waits takes {most:,.0f}: {most / one:.0f} actors.\n")
    print("| actors | round trip | steps/s | model | the learner waits |\n|---|---|---|---|---|")
    for row in slow:
        expected = min(row["actors"] * one, most)
        share = f"{100 * row['waits']:.0f}%"
        print(f"| {row['actors']:.0f} | {row['round_trip_ms']:g} ms | {rate(row):,.0f} | {expected:,.0f} | {share} |")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["compare", "actors", "tables"])
    parser.add_argument("--results", type=Path, default=Path(__file__).parent / "throughput.csv")
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--share", type=int, default=1)
    options = parser.parse_args()
    if options.what == "tables":
        tables(read(options.results))
        return 0
    if missing := at.missing():
        print(missing)
        return 77
    # Asked to end: hosts are put away.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    done = {tuple(row[key] for key in COLUMNS[:7]) for row in read(options.results)}
    with tempfile.TemporaryDirectory(prefix="trestle-hosts-", dir="/var/tmp") as place:
        place = Path(place)
        at.credentials(place / "cred", "10.77.0.1")
        for repeat in range(options.repeat):
            for nth, (env, mode, here, joined, round_trip) in enumerate(rows(options.what)):
                total = here + sum(joined)
                if (options.what, env, mode, len(joined), total, round_trip, repeat) in done:
                    continue
                own = place / f"{repeat}-{nth}"
                own.mkdir()
                began = time.monotonic()
                row = measure(options.what, env, mode, here, joined, round_trip, repeat, own, options.share)
                new = not options.results.exists()
                with open(options.results, "a", newline="") as file:
                    csv.writer(file, lineterminator="\n").writerows([COLUMNS, row] if new else [row])
                took, fast = time.monotonic() - began, row[7] / row[8]
                print(f"{env:5} {mode:9} {len(joined)} joined, {total} actors, {round_trip} ms: {fast:.0f} steps/s in {took:.0f} s", flush=True)
    tables(read(options.results))
    return 0


if __name__ == "__main__":
    sys.exit(main())
