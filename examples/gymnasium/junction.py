"""One junction of SUMO's whose lights a body switches by phases of its own."""

from __future__ import annotations

import os
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import sumo  # the package eclipse-sumo

# sumo-rl looks for it when it is imported.
os.environ.setdefault("SUMO_HOME", sumo.SUMO_HOME)

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
    """A junction of two roads, for ``seconds``.

    ``phases = "opposites"`` gives green to opposite arms at once, ``"incoming"`` to one arm alone. An action is the next phase, for
    five seconds; the reward is the number of standing vehicles, times -0.1.
    """
    # The simulation reads its files when it starts, which it does anew with each episode.
    place = tempfile.TemporaryDirectory(prefix="junction-")
    net, routes = Path(place.name, "junction.net.xml"), Path(place.name, "junction.rou.xml")
    command = [Path(sumo.SUMO_HOME, "bin", "netgenerate"), "--grid", "--grid.number=1", "--grid.attach-length=150"]
    command += ["--default.lanenumber=1", "--no-turnarounds", "--tls.set=A0", f"--tls.layout={phases}"]
    subprocess.run([*command, "-o", net], check=True, stdout=subprocess.DEVNULL)
    routes.write_text(_routes())
    env: Any = SumoEnvironment(
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
    env.place = place
    return env  # type: ignore[no-any-return]


def _routes() -> str:
    arms = list(_FLOWS)
    flows = [
        f'<flow id="{a}-{b}" begin="0" end="100000" probability="{_FLOWS[a] / 3600 / 2:.5f}" from="{a}0A0" to="A0{b}0"/>'
        for a in arms
        for b in arms
        if a != b
    ]
    return "<routes>\n" + "\n".join(flows) + "\n</routes>\n"
