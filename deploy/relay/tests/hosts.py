"""A head and other hosts of a run, which are namespaces of this machine (see network.py), and what is killed on them."""

import json
import os
import signal
import subprocess
import time
from pathlib import Path

from network import Network

TOP = Path(__file__).resolve().parents[3]
TRESTLE = os.environ.get("TRESTLE", str(TOP / "target/debug/trestle"))
RELAY = os.environ.get("TRESTLE_RELAY", str(TOP / "deploy/relay/target/debug/trestle-relay"))
PORT = 7447
# Seconds that anything may take.
LIMIT = 600
# Seconds for which a host asks for a run that does not answer.
WAIT = 120


def missing():
    """Why no hosts can be had here, if they cannot."""
    for path in TRESTLE, RELAY:
        if not Path(path).is_file():
            return f"{path} is not built"
    if os.geteuid() != 0 or not Path("/dev/net/tun").exists():
        return "no root, or no /dev/net/tun"
    return None


def credentials(place, name):
    """Makes credentials for a head that is called `name`, in `place`."""
    words = [TRESTLE, "hosts", "credentials", "--out", str(place), "--name", name]
    subprocess.run(words, check=True, env={**os.environ, "TRESTLE_RELAY": RELAY}, stdout=subprocess.DEVNULL)


def result(out):
    return json.loads((Path(out) / "result.json").read_text())


def counted(out):
    """The environment steps in a run's `actors.csv`."""
    return sum(int(line.split(",")[3]) for line in (Path(out) / "actors.csv").read_text().splitlines()[1:])


def steps_so_far(out):
    """The environment steps that a run has taken, as its newest row of metrics has them."""
    path = Path(out) / "metrics.jsonl"
    whole = path.read_bytes().rpartition(b"\n")[0] if path.exists() else b""
    return json.loads(whole.rpartition(b"\n")[2])["time/total_timesteps"] if whole else 0


def joined(out):
    """How many actors of other hosts a run has now that have heard of it: their hosts have acknowledged something."""
    path = Path(out) / "hosts.csv"
    rows = [line.split(",") for line in path.read_text().splitlines()[1:]] if path.exists() else []
    return sum(len(row[1].split()) for row in rows if row[2] == "joined" and row[3])


def until(what, condition, process):
    """Waits for `condition` while `process`, the head, is there."""
    end = time.monotonic() + LIMIT
    while not condition():
        if time.monotonic() > end:
            raise AssertionError(f"waited {LIMIT} s for {what}")
        if process.poll() is not None:
            raise AssertionError(f"the run ended before {what}")
        time.sleep(0.05)


def end(process, others=()):
    """The exit status of a host, once it has ended. None of the others may fail before."""
    over = time.monotonic() + LIMIT
    while process.poll() is None:
        if any(other.poll() not in (None, 0) for other in others):
            raise AssertionError("another host has failed")
        if time.monotonic() > over:
            os.killpg(process.pid, signal.SIGKILL)
            raise AssertionError(f"not over after {LIMIT} s")
        time.sleep(0.02)
    return process.returncode


def descendants(pid):
    """The processes that `pid` and its children have started, each with its command line."""
    parents, words = {}, {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                stat = (entry / "stat").read_text()
                words[int(entry.name)] = (entry / "cmdline").read_bytes().decode(errors="replace").split("\0")
            except OSError:
                continue
            parents[int(entry.name)] = int(stat.rpartition(")")[2].split()[1])
    found, looked = [], [pid]
    while looked:
        parent = looked.pop()
        children = [child for child, of in parents.items() if of == parent]
        found += children
        looked += children
    return [(pid, words[pid]) for pid in found if pid in words]


def of_role(process, role):
    """The ids of the processes `role` of the host `process`; `carrier` is trestle-relay."""
    found = descendants(process.pid)
    if role == "carrier":
        return [pid for pid, words in found if words[0] == RELAY]
    # As the program starts itself: the file that it is, and the role.
    return [pid for pid, words in found if words[1:2] == [role] and words[0] not in ("sh", RELAY)]


def kill(process, role):
    """Kills a process `role` of the host `process` as soon as there is one. False: the host has ended before."""
    end = time.monotonic() + LIMIT
    while process.poll() is None:
        for pid in of_role(process, role)[:1]:
            try:
                os.kill(pid, signal.SIGKILL)
                return True
            except ProcessLookupError:
                continue
        if time.monotonic() > end:
            raise AssertionError(f"there is no {role} to kill")
        time.sleep(0.02)
    return False


class Hosts:
    """A head and others, all of whose files are in `place`."""

    def __init__(self, place, cred, others=("b", "c"), silence=20, seed=1):
        self.place, self.cred, self.processes, self.silence = Path(place), Path(cred), [], silence
        self.net = Network(["head", *others], seed)
        self.url = f"tls/{self.net.address['head']}:{PORT}"

    def start(self, name, words, env=None):
        log = open(self.place / f"{name}.log", "ab")
        process = self.net.start(name, words, {"TRESTLE_RELAY": RELAY, **(env or {})}, log)
        self.processes.append(process)
        return process

    def credentials(self, name):
        return ["--credentials", str(self.cred / f"{name}.pem")]

    def head(self, words, remote, program=TRESTLE):
        """Starts `train` or `resume`, with the arguments `words`, as the head of `remote` other actors."""
        listen = ["--remote-actors", str(remote), "--listen", f"tls/0.0.0.0:{PORT}", "--host-silence", str(self.silence)]
        return self.start("head", [program, *words, *listen, *self.credentials("head")])

    def join(self, name, actors=1, program=TRESTLE, wait=WAIT):
        more = ["--host-silence", str(self.silence), "--wait", str(wait), *self.credentials("join")]
        return self.start(name, [program, "join", self.url, "--actors", str(actors), "--name", name, *more])

    def text(self, name):
        """All that a host has said."""
        path = self.place / f"{name}.log"
        return path.read_text(errors="replace") if path.exists() else ""

    def left(self, name):
        """The listing of a host's /dev/shm and /tmp at its end, beside the names of the two: it should be empty."""
        lines = self.text(name).splitlines()
        at = max((i for i, line in enumerate(lines) if line == "/dev/shm:"), default=len(lines))
        return [line for line in lines[at:] if line and line not in ("/dev/shm:", "/tmp:")]

    def close(self):
        for process in self.processes:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
        self.net.close()
