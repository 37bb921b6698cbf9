"""One junction of SUMO's whose lights a body switches by phases of its own."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from multiprocessing.connection import Connection, Pipe
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import sumo  # the package eclipse-sumo

# sumo-rl looks for both when it is imported.
os.environ.setdefault("SUMO_HOME", sumo.SUMO_HOME)
os.environ.setdefault("LIBSUMO_AS_TRACI", "1")

from sumo_rl import SumoEnvironment  # noqa: E402
from sumo_rl.environment.observations import ObservationFunction  # noqa: E402

#: Vehicles an hour from each arm to each other one, by the side that they come from.
_FLOWS = {"top": 260, "bottom": 260, "left": 160, "right": 160}


class Lanes(ObservationFunction):
    """How full each lane is and how much of it stands, 0 to 1: the same features for every body, whatever its phases are."""

    def __call__(self) -> Any:
        """The state now."""
        signal = self.ts
        return np.array(signal.get_lanes_density() + signal.get_lanes_queue(), dtype=np.float32)

    def observation_space(self) -> gymnasium.spaces.Box:
        """Its space."""
        n = 2 * len(self.ts.lanes)
        return gymnasium.spaces.Box(np.zeros(n, dtype=np.float32), np.ones(n, dtype=np.float32))


def make(phases: str = "opposites", seconds: int = 400) -> gymnasium.Env[Any, Any]:
    """A junction of two roads, for ``seconds``, in a process of its own.

    ``phases = "opposites"`` gives green to opposite arms at once, ``"incoming"`` to one arm alone. An action is the next phase, for
    five seconds; the reward is the number of standing vehicles, times -0.1.
    """
    return Apart(phases, seconds)


class Apart(gymnasium.Env[Any, Any]):
    """A junction in a process of its own: libsumo has one simulation a process, and an actor trains in one and evaluates in another."""

    def __init__(self, phases: str, seconds: int) -> None:
        """Starts the process. It ends when this side of the line is closed, whatever closes it."""
        self.line, theirs = Pipe()
        command = [sys.executable, __file__, str(theirs.fileno()), phases, str(seconds)]
        self.process = subprocess.Popen(command, pass_fds=[theirs.fileno()])
        theirs.close()
        self.observation_space, self.action_space = self._answer()

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """Begin an episode."""
        super().reset(seed=seed)
        return self._ask("reset", {"seed": seed})

    def step(self, action: Any) -> Any:
        """Choose the next phase."""
        return self._ask("step", {"action": int(action)})

    def close(self) -> None:
        """End the process."""
        self.line.close()
        self.process.wait()

    def _ask(self, method: str, arguments: dict[str, Any]) -> Any:
        self.line.send((method, arguments))
        return self._answer()

    def _answer(self) -> Any:
        answer = self.line.recv()
        if isinstance(answer, Exception):
            raise answer
        return answer


def _serve(line: Connection, phases: str, seconds: int) -> None:
    """Steps a junction for the process at the other end of ``line``, until that closes it."""
    with tempfile.TemporaryDirectory(prefix="junction-") as place:
        env = _junction(Path(place), phases, seconds)
        line.send((env.observation_space, env.action_space))
        while True:
            try:
                method, arguments = line.recv()
            except EOFError:
                break
            try:
                line.send(getattr(env, method)(**arguments))
            except Exception as error:  # noqa: BLE001  (the other side raises it)
                line.send(error)
        env.close()


def _junction(place: Path, phases: str, seconds: int) -> Any:
    """The environment, with its files in ``place``: a simulation reads them when it starts, which is with each episode."""
    net, routes = place / "junction.net.xml", place / "junction.rou.xml"
    command = [Path(sumo.SUMO_HOME, "bin", "netgenerate"), "--grid", "--grid.number=1", "--grid.attach-length=150"]
    command += ["--default.lanenumber=1", "--no-turnarounds", "--tls.set=A0", f"--tls.layout={phases}"]
    subprocess.run([*command, "-o", net], check=True, stdout=subprocess.DEVNULL)
    routes.write_text(_routes())
    return SumoEnvironment(
        net_file=str(net),
        route_file=str(routes),
        single_agent=True,
        num_seconds=seconds,
        delta_time=5,
        yellow_time=2,
        min_green=5,
        reward_fn=lambda signal: -0.1 * signal.get_total_queued(),
        observation_class=Lanes,
        add_system_info=False,
        add_per_agent_info=False,
        sumo_warnings=False,
    )


def _routes() -> str:
    arms = list(_FLOWS)
    flows = [
        f'<flow id="{a}-{b}" begin="0" end="100000" probability="{_FLOWS[a] / 3600 / 2:.5f}" from="{a}0A0" to="A0{b}0"/>'
        for a in arms
        for b in arms
        if a != b
    ]
    return "<routes>\n" + "\n".join(flows) + "\n</routes>\n"


if __name__ == "__main__":
    _serve(Connection(int(sys.argv[1])), sys.argv[2], int(sys.argv[3]))
