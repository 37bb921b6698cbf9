#!/usr/bin/env python3
"""Runs over several hosts on a bad network, while processes are killed: each must end as the same run on one host.

    deploy/relay/tests/matrix.py                       a few rows and the hosts that are refused, some minutes
    deploy/relay/tests/matrix.py long                  every network, mode and fault, over three hosts
    deploy/relay/tests/matrix.py two                   the same over two hosts
    deploy/relay/tests/matrix.py random SEED [COUNT]   faults, networks and moments that SEED draws, 100 unless COUNT is given
    deploy/relay/tests/matrix.py NET MODE FAULT
    deploy/relay/tests/matrix.py refused               who is not let in

    --jobs N          rows at once
    --results FILE    a row that passes is added to this CSV, and a row that is in it is passed over

Needs root, iproute2, /dev/net/tun, target/debug/trestle (or TRESTLE) and deploy/relay/target/debug/trestle-relay (or
TRESTLE_RELAY). The hosts are namespaces of this machine, see network.py. Ends with status 77 where these cannot be had.
"""

import argparse
import csv
import ctypes
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

import hosts as at
from hosts import TOP, TRESTLE, Hosts, end, kill, until
from refused import refused

NETWORKS = {
    "none": {},
    "20ms": {"delay": 0.010},
    "100ms": {"delay": 0.050},
    "loss": {"delay": 0.002, "loss": 0.02},
    "reorder": {"delay": 0.005, "overtake": 0.1},
    "1mbit": {"delay": 0.005, "rate": 1e6},
    "cut5": {},
    "cut60": {},
}
CUTS = {"cut5": 5, "cut60": 60}
# In free mode steps take a millisecond: that is what it is for, and the run must outlive what is done to it.
SLOW = ["--set", "env.hazard.kind=slow", "--set", "env.hazard.after=1"]
MODES = {"lockstep": [], "lag": ["--set", "run.lag=1"], "free": ["--mode", "free", *SLOW]}
FAULTS = ["none", "relay", "host", "learner"]
SHORT = [
    ("none", "lockstep", "none"),
    ("20ms", "lockstep", "relay"),
    ("loss", "lag", "none"),
    ("reorder", "lockstep", "host"),
    ("cut5", "free", "none"),
    ("none", "free", "learner"),
]
# What `random` draws from: processes of the head, of host b, host b or the head as a whole, and the network.
RANDOM_NETWORKS = ["none", "20ms", "100ms", "loss", "reorder", "1mbit"]
HEADS = ["learner", "mentor-server", "relay", "carrier", "actor"]
RANDOM_FAULTS = [*HEADS, "b's relay", "b's carrier", "b's actor", "host", "head", "b stopped", "cut", "cut", "cut"]
# After these host b is lost, at the latest when it has been silent for too long, and comes back.
AWAY = ["host", "b's relay", "b's carrier", "b stopped", "cut"]
COLUMNS = ["command", "number", "network", "mode", "fault", "moment", "for_s", "seconds", "restarts", "bytes"]


class Row:
    """What is done to one run, after its first checkpoint and `moment` of its steps, a share, and for `lasts` seconds."""

    def __init__(self, command, number, net, mode, fault, moment=0.0, lasts=0.0, silence=20):
        self.command, self.number = command, number
        self.net, self.mode, self.fault = net, mode, fault
        self.moment, self.lasts, self.silence = moment, lasts, silence
        self.cut = CUTS.get(net, 0)

    def key(self):
        return (self.command, str(self.number), self.net, self.mode, self.fault)

    def name(self):
        return "-".join([*self.key()[:2], self.net, self.mode, self.fault.replace("'s", "").replace(" ", "-")])

    def steps(self):
        """Environment steps of the run."""
        return 3000 if self.mode != "free" else 20_000

    def others(self):
        """The actors of each host beside the head; three in all with the head's."""
        return {"b": 2} if self.command == "two" else {"b": 1, "c": 1}

    def endless(self):
        """Whether the run goes on until the hosts are back, and is stopped then: in free mode it does not wait for them."""
        return self.mode == "free" and (self.cut > 0 or self.fault in AWAY)

    def training(self, more):
        args = ["train", "maze-small", "--algo", "ha-diiqn", "--seed", "11", "--episodes", "1000000000"]
        every = ["--set", "checkpoint.every_env_steps=500"]
        steps = 1_000_000_000 if self.endless() else self.steps()
        return [*args, "--env-steps", str(steps), *MODES[self.mode], *every, *more]


def drawn(seed, number):
    """Row `number` of the faults that `seed` draws: the same wherever and whenever it is asked for."""
    draw = random.Random(f"{seed}/{number}")
    net, mode = draw.choice(RANDOM_NETWORKS), draw.choice(list(MODES))
    fault = draw.choice(RANDOM_FAULTS)
    lasts = round(draw.uniform(0.2, 9), 1) if fault in ("cut", "b stopped") else 0.0
    return Row(f"random {seed}", number, net, mode, fault, round(draw.uniform(0.1, 0.6), 2), lasts, silence=5)


class Play:
    """One run over two or three hosts, and what is done to it."""

    def __init__(self, row, place, cred):
        self.row, self.place, self.out = row, place, place / "run"
        seed = row.number if row.command.startswith("random") else 1
        self.hosts = Hosts(place, cred, others=tuple(row.others()), silence=row.silence, seed=seed)
        for key, value in NETWORKS[row.net].items():
            setattr(self.hosts.net, key, value)
        own = ["--actors", "1", "--out", str(self.out)]
        self.head = self.hosts.head(row.training(own), 2)
        self.joined = {name: self.hosts.join(name, actors) for name, actors in row.others().items()}

    def cut(self, lasts):
        """Cuts the network. The run does not end meanwhile."""
        self.hosts.net.cut = True
        time.sleep(lasts)
        if self.head.poll() is not None:
            raise AssertionError("the run ended while the network was cut")
        self.hosts.net.cut = False

    def strike(self):
        """Does what the row says."""
        fault, b = self.row.fault, self.joined["b"]
        struck = True
        if fault in HEADS:
            struck = kill(self.head, fault)
        elif fault.startswith("b's "):
            struck = kill(b, fault.removeprefix("b's "))
        elif fault == "host":
            # As a whole: nobody there says farewell.
            os.killpg(b.pid, signal.SIGKILL)
            b.wait()
            self.joined["b"] = self.hosts.join("b", self.row.others()["b"])
        elif fault == "head":
            os.killpg(self.head.pid, signal.SIGKILL)
            self.head.wait()
            if not (self.out / "result.json").exists():
                self.head = self.hosts.head(["resume", str(self.out)], 2)
        elif fault == "b stopped":
            every = [pid for pid, _ in at.descendants(b.pid)]
            self.signal(every, signal.SIGSTOP)
            time.sleep(self.row.lasts)
            self.signal(every, signal.SIGCONT)
        elif fault == "cut":
            self.cut(self.row.lasts)
        if not struck:
            raise AssertionError(f"{fault} ended before it was killed")

    def stop_when_back(self):
        """Waits until all hosts take part again, or still do, and interrupts the run."""
        time.sleep(self.row.silence + 3)
        until("all hosts", lambda: at.joined(self.out) == sum(self.row.others().values()), self.head)
        time.sleep(1)
        self.signal(at.of_role(self.head, "train"), signal.SIGINT)

    @staticmethod
    def signal(pids, what):
        for pid in pids:
            try:
                os.kill(pid, what)
            except ProcessLookupError:
                pass

    def run(self):
        until("a checkpoint", lambda: list((self.out / "checkpoints").glob("*/COMPLETE")), self.head)
        if self.row.cut:
            self.cut(self.row.cut)
        moment = self.row.moment * self.row.steps()
        until(f"{moment:.0f} steps", lambda: at.steps_so_far(self.out) >= moment, self.head)
        self.strike()
        if self.row.endless():
            self.stop_when_back()
        if end(self.head, self.joined.values()) != (130 if self.row.endless() else 0):
            raise AssertionError("the run failed")
        # A host that hears nothing of the end gives up in time.
        for name, process in self.joined.items():
            status = end(process)
            if status != 0 or self.hosts.left(name):
                raise AssertionError(f"host {name} ended with {status} and left {self.hosts.left(name)}")
        if self.hosts.left("head"):
            raise AssertionError(f"the head left {self.hosts.left('head')}")
        if left := [path for path in self.out.iterdir() if path.name.endswith(".tmp")]:
            raise AssertionError(f"{left} are left in the run's directory")


def play(row, place, cred, expected):
    """Plays a row. Its line for the CSV, or the reason why it has failed, as text."""
    place.mkdir()
    began, played = time.monotonic(), Play(row, place, cred)
    try:
        played.run()
        came = at.result(played.out)
        if row.mode != "free" and came["weights_sha256"] != expected[row.mode]:
            raise AssertionError(f"weights {came['weights_sha256']}; on one host {expected[row.mode]}")
        if row.mode == "free":
            counted, asked = at.counted(played.out), came["env_steps"] if row.endless() else row.steps()
            if (counted, came["env_steps"]) != (asked, asked):
                raise AssertionError(f"{counted} steps are counted, {came['env_steps']} were taken, {asked} are right")
        seconds = round(time.monotonic() - began, 1)
        return [*row.key(), row.moment, row.lasts or row.cut, seconds, came["restarts"], played.hosts.net.bytes]
    except AssertionError as error:
        return str(error)
    finally:
        played.hosts.close()


def passed(path):
    if not path or not Path(path).exists():
        return set()
    with open(path, newline="") as file:
        return {tuple(line[:5]) for line in list(csv.reader(file))[1:]}


def note(path, line):
    if path:
        new = not Path(path).exists()
        with open(path, "a", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerows([COLUMNS, line] if new else [line])


def on_one_host(rows, place):
    """The weights that the rows are to end with."""
    expected = {}
    for row in rows:
        if row.mode != "free" and row.mode not in expected:
            out = place / f"one-{row.mode}"
            words = [TRESTLE, *row.training(["--actors", "3", "--out", str(out), "--quiet"])]
            subprocess.run(words, check=True, stdout=subprocess.DEVNULL)
            expected[row.mode] = at.result(out)["weights_sha256"]
    return expected


def tell(row, line, files, results):
    """Says what has become of a row, and keeps the files of one that has failed."""
    number = row.number if row.command.startswith("random") else ""
    head = f"{number:>4} {row.net:8}{row.mode:10}{row.fault:14}"
    if isinstance(line, str):
        kept = TOP / "target/hosts" / row.name()
        shutil.rmtree(kept, ignore_errors=True)
        shutil.copytree(files, kept, symlinks=True)
        print(f"FAILED {head}{line}; its files are in {kept}", flush=True)
    else:
        note(results, line)
        seconds, restarts, sent = line[-3:]
        print(f"ok     {head}{seconds:6.1f} s, {restarts} restarts, {sent} bytes", flush=True)
    shutil.rmtree(files)


def leave(*_):
    """Asked to end: what is under way is put away."""
    sys.exit(1)


def begin_worker():
    """A worker ends with its parent, however that ends."""
    signal.signal(signal.SIGTERM, leave)
    ctypes.CDLL(None).prctl(1, signal.SIGTERM)


def play_all(rows, place, options):
    """Plays the rows that have not passed yet; how many did, and how many did not."""
    done = passed(options.results)
    rows = [row for row in rows if row.key() not in done]
    expected, good, bad = on_one_host(rows, place), 0, 0
    with ProcessPoolExecutor(options.jobs, initializer=begin_worker) as pool:
        try:
            playing = {pool.submit(play, row, place / row.name(), place / "cred", expected): row for row in rows}
            for each in as_completed(playing):
                row, line = playing[each], each.result()
                bad += isinstance(line, str)
                good += not isinstance(line, str)
                tell(row, line, place / row.name(), options.results)
        except BaseException:
            # Rows under way end, and no others begin.
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    print(f"{good} of {good + bad} rows ended as they should, {len(done)} had before")
    return good, bad


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="*")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--results")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, leave)
    if missing := at.missing():
        print(missing)
        return 77
    # Not below /tmp, of which each host has its own.
    with tempfile.TemporaryDirectory(prefix="trestle-hosts-", dir="/var/tmp") as place:
        place = Path(place)
        at.credentials(place / "cred", "10.77.0.1")
        match options.what:
            case ["refused"]:
                return 0 if refused(place) else 1
            case []:
                rows = [Row("matrix", nth, *which) for nth, which in enumerate(SHORT)]
            case ["long" | "two" as which]:
                every = [(net, mode, fault) for net in NETWORKS for mode in MODES for fault in FAULTS]
                command = "matrix" if which == "long" else "two"
                rows = [Row(command, nth, *row) for nth, row in enumerate(every)]
            case ["random", seed, *count]:
                rows = [drawn(seed, number) for number in range(int(count[0]) if count else 100)]
            case [net, mode, fault]:
                rows = [Row("matrix", 0, net, mode, fault)]
            case _:
                parser.print_usage()
                return 2
        _, bad = play_all(rows, place, options)
        if not options.what and not refused(place):
            bad += 1
        return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
