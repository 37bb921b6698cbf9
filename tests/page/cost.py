"""Measures the cost of the live page: of a watched run, of opening, and of memory over time.

cost.py beside PROGRAM [PAIRS]      runs with five open pages and without, in turn: weights, time, CPU time
cost.py opens PROGRAM [STEPS]       time until the page of a run of STEPS steps is complete, with nothing of it cached
cost.py memory PROGRAM [SECONDS]    resident memory of `trestle watch` with 50 open pages of a live run and its folder

Needs nothing beyond Python. Pages are open as in a browser: a stream of events, and each new part of the timeline.
"""

import contextlib
import http.client
import json
import os
import pathlib
import shutil
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time

LIMIT_S = 60
# A run of some seconds.
TRAIN = ["train", "maze30", "--algo", "ha-diiqn", "--env-steps", "100000", "--episodes", "1000000", "--set",
         "run.stop_when_solved=false", "--quiet"]
PAGES = 5
MANY_PAGES = 50
SAMPLE_S = 10


class Page:
    """An open page of `below`: it takes states as they come, and the moments of the map that it has not seen."""

    def __init__(self, port, below):
        self.port, self.below = port, below
        self.seen = 1
        self.open = True
        self.thread = threading.Thread(target=self.follow, daemon=True)
        self.thread.start()

    def follow(self):
        while self.open:
            # A page whose server has not begun to listen, or has ended, tries again.
            with contextlib.suppress(OSError, http.client.HTTPException):
                connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=LIMIT_S)
                connection.request("GET", f"/events{self.below}")
                answer = connection.getresponse()
                while self.open and (line := answer.readline()):
                    if line.startswith(b"data:"):
                        self.take(json.loads(line[5:]))
                connection.close()
            time.sleep(0.2)

    def take(self, state):
        extent = state.get("timeline") or {}
        # An answer is bounded, so it may take several.
        while extent.get("lines", 0) > self.seen:
            moments = json.loads(get(self.port, f"/timeline/{self.seen}{self.below}"))["moments"]
            self.seen += len(moments)
            if not moments:
                break


def get(port, path):
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=LIMIT_S)
    connection.request("GET", path)
    answer = connection.getresponse().read()
    connection.close()
    return answer


@contextlib.contextmanager
def watching(program, folder):
    """A page of `folder`: its process and its port."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    server = subprocess.Popen([program, "watch", folder, "--port", str(port)], stdout=subprocess.PIPE, text=True)
    try:
        server.stdout.readline()
        yield server, port
    finally:
        server.kill()
        server.wait()


def cpu_s(pid):
    """Seconds of CPU time that a process has taken."""
    fields = pathlib.Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def resident_mib(pid):
    """Resident memory of a process: all of it, and its own without the program's file."""
    status = dict(line.split(":", 1) for line in pathlib.Path(f"/proc/{pid}/status").read_text().splitlines())
    return [int(status[key].split()[0]) / 1024 for key in ("VmRSS", "RssAnon")]


def machine():
    models = [line.split(":")[1].strip() for line in open("/proc/cpuinfo") if line.startswith("model name")]
    return f"{models[0] if models else 'unknown'}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}"


def train(program, out):
    """Trains into `out`: the result, and the CPU seconds of all of the run's processes."""
    process = subprocess.Popen([program, *TRAIN, "--out", out], stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        raise SystemExit(f"the training ended with status {process.returncode}")
    return json.loads((out / "result.json").read_text()), usage.ru_utime + usage.ru_stime


def beside(program, pairs="10"):
    rows = []
    with tempfile.TemporaryDirectory() as place:
        place = pathlib.Path(place)
        for pair in range(int(pairs)):
            # Which of the two comes first changes, so that neither has the quieter machine.
            for watched in (False, True) if pair % 2 == 0 else (True, False):
                out = place / "runs" / f"{pair}-{watched}"
                with contextlib.ExitStack() as stack:
                    pages, server = [], None
                    if watched:
                        server, port = stack.enter_context(watching(program, place / "runs"))
                        pages = [Page(port, f"/{out.name}") for _ in range(PAGES)]
                    result, cpu = train(program, out)
                    serving = cpu_s(server.pid) if server else 0.0
                    for page in pages:
                        page.open = False
                rows.append((watched, result["wall_s"], cpu, serving, result["weights_sha256"]))
                print(f"  {'watched' if watched else 'alone  '}  {rows[-1][1]:7.2f} s  {cpu:7.2f} s of CPU  page {serving:5.2f} s of CPU", flush=True)
    if len({row[4] for row in rows}) != 1:
        raise SystemExit("the weights differ")
    print(f"{len(rows)} runs, all with the weights {rows[0][4][:12]}; {machine()}")
    for name, column in (("time", 1), ("CPU time of the run", 2)):
        alone, watched = ([row[column] for row in rows if row[0] is which] for which in (False, True))
        ratios = [b / a for a, b in zip(alone, watched, strict=True)]
        least = min(watched) / min(alone)
        print(f"{name}: watched over alone, median of pairs {statistics.median(ratios):.4f} ({min(ratios):.3f} to {max(ratios):.3f}), least over least {least:.4f}")
    share = statistics.median(row[3] / row[1] for row in rows if row[0])
    print(f"the page's own process: {100 * share:.2f} % of a core")


def forget(folder):
    """Drops what the system has cached of the files in `folder`."""
    os.sync()
    for path in folder.rglob("*"):
        if path.is_file():
            with path.open("rb") as file:
                os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)


def opens(program, steps="1000000"):
    with tempfile.TemporaryDirectory() as place:
        out = pathlib.Path(place) / "run"
        subprocess.run([program, "train", "maze-small", "--algo", "ha-diiqn", "--env-steps", steps, "--episodes", "100000000",
                        "--set", "run.stop_when_solved=false", "--set", "learner.hidden=[16]", "--quiet", "--out", out], check=True, stdout=subprocess.DEVNULL)
        taken = []
        for _ in range(5):
            forget(out)
            with watching(program, out) as (_, port):
                start = time.monotonic()
                for path in ("/", "/asset/page.js", "/asset/dom.js", "/asset/charts.js", "/asset/run.js", "/asset/folder.js", "/asset/map.js",
                             "/asset/uPlot.js", "/asset/uPlot.css", "/asset/page.css"):
                    get(port, path)
                page = Page(port, "")
                state = {}
                while state.get("read", 0) < 1:
                    state = json.loads(get(port, "/state"))
                while page.seen < state["timeline"]["lines"]:
                    time.sleep(0.005)
                taken.append(time.monotonic() - start)
                page.open = False
        sizes = {name: (out / name).stat().st_size >> 10 for name in ("metrics.jsonl", "evals.csv", "timeline.jsonl")}
        print(f"a run of {state['env_steps']:.0f} steps, {state['episodes']:.0f} episodes, {sizes} KiB; {machine()}")
        print(f"complete after {', '.join(f'{s:.2f}' for s in taken)} s")
        if min(taken) > 1:
            raise SystemExit("it takes more than a second")


def memory(program, seconds="3600"):
    with tempfile.TemporaryDirectory() as place, contextlib.ExitStack() as stack:
        runs = pathlib.Path(place) / "runs"
        run = runs / "live"
        trainer = subprocess.Popen(["nice", "-n", "19", program, "train", "maze30", "--algo", "ha-diiqn", "--quiet", "--out", run, "--env-steps",
                                    "100000000", "--episodes", "10000000", "--set", "run.stop_when_solved=false"], stdout=subprocess.DEVNULL)
        stack.callback(lambda: (trainer.terminate(), trainer.wait()))
        server, port = stack.enter_context(watching(program, runs))
        pages = [Page(port, "/live" if number % 5 else "") for number in range(MANY_PAGES)]
        stack.callback(lambda: [setattr(page, "open", False) for page in pages])
        start = time.monotonic()
        samples = []
        print("seconds,rss_mib,own_mib", flush=True)
        while (elapsed := time.monotonic() - start) < float(seconds):
            time.sleep(SAMPLE_S)
            samples.append(resident_mib(server.pid))
            print(f"{elapsed:.0f},{samples[-1][0]:.1f},{samples[-1][1]:.1f}", flush=True)
            if trainer.poll() is not None:
                raise SystemExit("the run has ended")
        state = json.loads(get(port, "/state/live"))
        # The first sixth is the start: tables fill up, and allocators take what they need.
        rest = samples[len(samples) // 6:]
        half = len(rest) // 2
        early, late = (statistics.median(own for _, own in part) for part in (rest[:half], rest[half:]))
        print(f"{MANY_PAGES} pages over {elapsed:.0f} s of a run that came to {state['env_steps']:.0f} steps; {machine()}")
        print(f"most {max(rss for rss, _ in samples):.1f} MiB, without the program's file {max(own for _, own in samples):.1f} MiB; "
              f"medians of the two halves after the start {early:.1f} and {late:.1f} MiB; CPU {100 * cpu_s(server.pid) / elapsed:.1f} % of a core")


if __name__ == "__main__":
    measures = {"beside": beside, "opens": opens, "memory": memory}
    if len(sys.argv) < 3 or sys.argv[1] not in measures:
        sys.exit(__doc__)
    measures[sys.argv[1]](shutil.which(sys.argv[2]) or sys.argv[2], *sys.argv[3:])
