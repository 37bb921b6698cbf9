"""The hosts that a head does not let in, and the words of both sides."""

import json
import subprocess
import sys
from pathlib import Path

from hosts import PORT, RELAY, TRESTLE, Hosts, end, result, until

TRAINING = ["train", "maze-small", "--seed", "11", "--env-steps", "3000", "--actors", "1"]

# A port scanner: forty connections, every other one with random bytes.
SCAN = """
import os, socket
for nth in range(40):
    with socket.create_connection(("{head}", {port}), 5) as link:
        link.settimeout(0.2)
        try:
            link.sendall(os.urandom(1 + nth * 997) if nth % 2 else b"GET / HTTP/1.1\\r\\n\\r\\n")
            link.recv(100)
        except OSError:
            pass
"""


def another_build(place, build):
    """A copy of the program, which was built from the sources `build`, that says so of others."""
    program = Path(TRESTLE).read_bytes()
    if program.count(build.encode()) == 0:
        raise AssertionError(f"{TRESTLE} does not hold {build}")
    other = place / "trestle"
    other.write_bytes(program.replace(build.encode(), build[::-1].encode()))
    other.chmod(0o755)
    return other


def refused(place):
    """Whether all are refused that must not join, each with words on both sides, and those join that may."""
    place = Path(place)
    hosts, good = Hosts(place, place / "cred"), True

    def check(what, ok, text=""):
        nonlocal good
        good &= bool(ok)
        print(f"{'ok' if ok else 'FAILED':7}{what}{'' if ok else ': ' + text[-600:]}", flush=True)

    def log(name):
        path = place / f"refused/logs/{name}.log"
        return path.read_text(errors="replace") if path.exists() else ""

    try:
        other = place / "other"
        subprocess.run([RELAY, "credentials", str(other), hosts.net.address["head"]], check=True, stdout=subprocess.DEVNULL)
        head = hosts.head([*TRAINING, "--out", str(place / "refused")], 2)
        until("a head that listens", lambda: "waiting for other hosts" in hosts.text("head"), head)
        # What the host says, and what the head says of it, if it hears of it at all.
        for what, words, own, heads in (
            ("a host without credentials", [hosts.url], "needs --credentials", None),
            (
                "a host with another authority's",
                [hosts.url, "--credentials", str(other / "join.pem")],
                "invalid peer certificate",
                "DecryptError",
            ),
            (
                "a host that speaks plain TCP",
                [hosts.url.replace("tls/", "tcp/"), "--insecure"],
                "early eof",
                "InvalidContentType",
            ),
        ):
            (place / "b.log").unlink(missing_ok=True)
            seen = len(log("relay")), len(hosts.text("head"))
            status = end(hosts.start("b", [TRESTLE, "join", *words, "--actors", "1", "--wait", "5"]))
            text = hosts.text("b")
            check(what, status == 1 and own in text, text)
            if heads:
                check(f"{what}: says why at once", "trestle-relay says: " in text.partition("has not answered")[0], text)
                logged, said = log("relay")[seen[0] :], hosts.text("head")[seen[1] :]
                check(f"{what}: the head's log says so, too", "WARN" in logged and heads in logged, logged)
                check(f"{what}: the head says so, too, once", said.count(heads) == 1, said)
        (place / "b.log").unlink(missing_ok=True)
        build = json.loads((place / "refused/build.json").read_text())["sources"]
        status = end(hosts.join("b", program=str(another_build(place, build))))
        reason = f"its program was built from other sources ({build[::-1]}) than the run's ({build})"
        check("a host with another build", status == 1 and reason in hosts.text("b"), hosts.text("b"))
        check("a host with another build: the head says so, too", f"host b is refused: {reason}" in hosts.text("head"))
        status = end(hosts.start("c", [sys.executable, "-c", SCAN.format(head=hosts.net.address["head"], port=PORT)]))
        check("a port scanner does no harm", status == 0 and head.poll() is None)
        (place / "b.log").unlink(missing_ok=True)
        joined = [hosts.join(name) for name in ("b", "c")]
        check("the run goes on with those that may join", end(head) == 0, hosts.text("head"))
        check("these end with the run", [end(process) for process in joined] == [0, 0], hosts.text("b"))
        restarts = result(place / "refused")["restarts"]
        check("nothing was started again", restarts == 0, f"{restarts} restarts")
        texts = {name: hosts.text(name) for name in ("head", "b", "c")}
        texts |= {path.name: path.read_text(errors="replace") for path in (place / "refused/logs").iterdir()}
        panics = [name for name, text in texts.items() if "panicked" in text]
        check("no process has panicked", texts["relay.log"] and not panics, f"{panics}")
    finally:
        hosts.close()
    return good
