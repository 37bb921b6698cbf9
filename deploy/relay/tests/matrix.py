#!/usr/bin/env python3
"""Runs over several hosts on a bad network, while processes are killed: each must end as the same run on one host.

    deploy/relay/tests/matrix.py            a few rows, some minutes
    deploy/relay/tests/matrix.py long       every network, mode and fault
    deploy/relay/tests/matrix.py NET MODE FAULT
    deploy/relay/tests/matrix.py refused    who is not let in

Needs root, iproute2, /dev/net/tun, target/debug/trestle (or TRESTLE) and deploy/relay/target/debug/trestle-relay (or
TRESTLE_RELAY). The hosts are namespaces of this machine, see network.py. Ends with status 77 where these cannot be had.
"""

import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from network import Network

TOP = Path(__file__).resolve().parents[3]
TRESTLE = os.environ.get("TRESTLE", str(TOP / "target/debug/trestle"))
RELAY = os.environ.get("TRESTLE_RELAY", str(TOP / "deploy/relay/target/debug/trestle-relay"))
PORT = 7447
LIMIT = 600
STEPS = {"lockstep": 3000, "lag": 3000, "free": 20000}

NETWORKS = {
    "none": {},
    "20ms": {"delay": 0.010},
    "100ms": {"delay": 0.050},
    "loss": {"delay": 0.002, "loss": 0.02},
    "reorder": {"delay": 0.005, "overtake": 0.1},
    "1mbit": {"delay": 0.005, "rate": 1e6},
    "cut5": {"for": 5},
    "cut60": {"for": 60},
}
MODES = {"lockstep": [], "lag": ["--set", "run.lag=1"], "free": ["--mode", "free"]}
FAULTS = ["none", "relay", "host", "learner"]
SHORT = [
    ("none", "lockstep", "none"),
    ("20ms", "lockstep", "relay"),
    ("loss", "lag", "none"),
    ("reorder", "lockstep", "host"),
    ("cut5", "free", "none"),
    ("none", "free", "learner"),
]


def training(mode, more):
    args = ["maze-small", "--algo", "ha-diiqn", "--seed", "11", "--episodes", "1000000000", "--env-steps", str(STEPS[mode])]
    return [TRESTLE, "train", *args, *MODES[mode], "--set", "checkpoint.every_env_steps=500", *more]


def result(out):
    return json.loads((Path(out) / "result.json").read_text())


def inside(out, role):
    """The ids, as this namespace has them, of the run's or the host's processes `role` with `out` among their arguments."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                words = (entry / "cmdline").read_bytes().split(b"\0")
            except OSError:
                continue
            if len(words) > 2 and words[1] == role.encode() and any(out.encode() in word for word in words):
                found.append(int(entry.name))
    return found


def until(what, condition, process):
    end = time.monotonic() + LIMIT
    while not condition():
        if time.monotonic() > end:
            raise AssertionError(f"waited {LIMIT} s for {what}")
        if process.poll() is not None:
            raise AssertionError(f"the run ended before {what}")
        time.sleep(0.05)


def end(process):
    try:
        return process.wait(LIMIT)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        raise AssertionError(f"not over after {LIMIT} s") from None


class Hosts:
    """A head and hosts b and c."""

    def __init__(self, place, seed=1):
        self.place, self.processes = Path(place), []
        self.net = Network(["head", "b", "c"], seed)
        self.url = f"tls/{self.net.address['head']}:{PORT}"
        credentials = ["hosts", "credentials", "--out", str(self.place / "cred"), "--name", self.net.address["head"]]
        if not (self.place / "cred").exists():
            subprocess.run([TRESTLE, *credentials], check=True, env={**os.environ, "TRESTLE_RELAY": RELAY}, stdout=subprocess.DEVNULL)

    def start(self, name, words):
        log = open(self.place / f"{name}.log", "ab")
        process = self.net.start(name, words, {"TRESTLE_RELAY": RELAY}, log)
        self.processes.append(process)
        return process

    def credentials(self, name):
        return ["--credentials", str(self.place / f"cred/{name}.pem")]

    def head(self, mode, out):
        listen = ["--actors", "1", "--remote-actors", "2", "--listen", f"tls/0.0.0.0:{PORT}", "--host-silence", "20"]
        return self.start("head", training(mode, [*listen, *self.credentials("head"), "--out", str(out)]))

    def join(self, name):
        silence = ["--host-silence", "20"]
        return self.start(name, [TRESTLE, "join", self.url, "--actors", "1", "--name", name, *silence, *self.credentials("join")])

    def close(self):
        for process in self.processes:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
        self.net.close()


def left(place, name):
    """The listing of a host's /dev/shm and /tmp at its end, beside the names of the two: it should be empty."""
    lines = (place / f"{name}.log").read_text(errors="replace").splitlines()
    at = max(i for i, line in enumerate(lines) if line == "/dev/shm:")
    return [line for line in lines[at:] if line and line not in ("/dev/shm:", "/tmp:")]


def row(net, mode, fault, place, expected):
    hosts = Hosts(place)
    out = Path(place) / f"{net}-{mode}-{fault}"
    for name in "head", "b", "c":
        (Path(place) / f"{name}.log").unlink(missing_ok=True)
    began = time.monotonic()
    try:
        how = dict(NETWORKS[net])
        cut = how.pop("for", 0)
        for key, value in how.items():
            setattr(hosts.net, key, value)
        head, joined = hosts.head(mode, out), {name: hosts.join(name) for name in ("b", "c")}
        until("a checkpoint", lambda: list((out / "checkpoints").glob("*/COMPLETE")), head)
        if cut:
            hosts.net.cut = True
            time.sleep(cut)
            hosts.net.cut = False
        if fault == "relay":
            os.kill(inside(str(out), "relay")[0], signal.SIGKILL)
        elif fault == "learner":
            os.kill(inside(str(out), "learner")[0], signal.SIGKILL)
        elif fault == "host":
            # As a whole: nobody there says farewell.
            os.killpg(joined["b"].pid, signal.SIGKILL)
            joined["b"].wait()
            joined["b"] = hosts.join("b")
        if end(head) != 0:
            raise AssertionError("the run failed")
        # A host that hears nothing of the end gives up in time.
        for name, process in joined.items():
            status = end(process)
            if status != 0 or left(Path(place), name):
                raise AssertionError(f"host {name} ended with {status} and left {left(Path(place), name)}")
        if left(Path(place), "head"):
            raise AssertionError(f"the head left {left(Path(place), 'head')}")
        came = result(out)
        if mode == "free":
            rows = [line.split(",") for line in (out / "actors.csv").read_text().splitlines()[1:]]
            counted = sum(int(line[3]) for line in rows)
            if counted != came["env_steps"] or came["env_steps"] != STEPS["free"]:
                raise AssertionError(f"{counted} steps are counted, {came['env_steps']} were taken")
        elif came["weights_sha256"] != expected[mode]:
            raise AssertionError(f"weights {came['weights_sha256']}; on one host {expected[mode]}")
        seconds, bytes_ = time.monotonic() - began, hosts.net.bytes
        print(f"ok      {net:8}{mode:10}{fault:8}{seconds:6.1f} s, {came['restarts']} restarts, {bytes_} bytes", flush=True)
        return True
    except AssertionError as error:
        print(f"FAILED  {net:8}{mode:10}{fault:8}{error}; logs in {place}", flush=True)
        return False
    finally:
        hosts.close()


def refused(place):
    """The hosts that are not let in, and the words of both sides."""
    hosts, good = Hosts(place), True

    def check(what, ok, text=""):
        nonlocal good
        good &= bool(ok)
        print(f"{'ok' if ok else 'FAILED':8}{what}{'' if ok else ': ' + text[-600:]}", flush=True)

    try:
        other = Path(place) / "other"
        subprocess.run([RELAY, "credentials", str(other), hosts.net.address["head"]], check=True, stdout=subprocess.DEVNULL)
        head = hosts.head("lockstep", Path(place) / "refused")
        log = Path(place) / "head.log"
        until("a head that listens", lambda: log.exists() and b"waiting for other hosts" in log.read_bytes(), head)
        for what, words in {
            "a host without credentials": [hosts.url],
            "a host with another authority's": [hosts.url, "--credentials", str(other / "join.pem")],
            "a host that speaks plain TCP": [hosts.url.replace("tls/", "tcp/"), "--insecure"],
        }.items():
            (Path(place) / "b.log").unlink(missing_ok=True)
            status = end(hosts.start("b", [TRESTLE, "join", *words, "--actors", "1", "--wait", "5"]))
            text = (Path(place) / "b.log").read_text()
            check(what, status == 1 and ("credentials" in text or "answer" in text), text)
            # A refusal is said on both sides.
            if status == 1 and "answer" in text:
                relay = (Path(place) / "refused/logs/relay.log").read_text(errors="replace")
                check(f"{what}: the head says so, too", "WARN" in relay and "zenoh" in relay, relay)
        # A port scanner.
        scan = f"""
import os, socket
for nth in range(40):
    with socket.create_connection(("{hosts.net.address['head']}", {PORT}), 5) as link:
        link.settimeout(0.2)
        try:
            link.sendall(os.urandom(1 + nth * 997) if nth % 2 else b"GET / HTTP/1.1\\r\\n\\r\\n")
            link.recv(100)
        except OSError:
            pass
"""
        status = end(hosts.start("c", [sys.executable, "-c", scan]))
        check("a port scanner does no harm", status == 0 and head.poll() is None)
        joined = [hosts.join(name) for name in ("b", "c")]
        check("the run goes on with those that may join", end(head) == 0, log.read_text())
        for process in joined:
            end(process)
    finally:
        hosts.close()
    return good


def main(args):
    for path in TRESTLE, RELAY:
        if not Path(path).is_file():
            print(f"{path} is not built")
            return 77
    if os.geteuid() != 0 or not Path("/dev/net/tun").exists():
        print("no root, or no /dev/net/tun")
        return 77
    # Not below /tmp, of which each host has its own.
    with tempfile.TemporaryDirectory(prefix="trestle-hosts-", dir="/var/tmp") as place:
        if args == ["refused"]:
            return 0 if refused(place) else 1
        if len(args) == 3:
            rows = [tuple(args)]
        elif args == ["long"]:
            rows = [(net, mode, fault) for net in NETWORKS for mode in MODES for fault in FAULTS]
        elif not args:
            rows = SHORT
        else:
            print(__doc__)
            return 2
        expected = {}
        for mode in sorted({mode for _, mode, _ in rows} - {"free"}):
            out = f"{place}/one-{mode}"
            subprocess.run(training(mode, ["--actors", "3", "--out", out, "--quiet"]), check=True, stdout=subprocess.DEVNULL)
            expected[mode] = result(out)["weights_sha256"]
        good = [row(*which, place, expected) for which in rows]
        if not args:
            good.append(refused(place))
        print(f"{sum(good)} of {len(good)} rows ended as they should")
        if not all(good):
            subprocess.run(f"mkdir -p target/hosts && cp -r {place} target/hosts/", shell=True, cwd=TOP, check=False)
            print("what is left of them is in target/hosts")
        return 0 if all(good) else 1


if __name__ == "__main__":
    try:
        sys.exit(main(sys.argv[1:]))
    except socket.error as error:
        print(error)
        sys.exit(1)
