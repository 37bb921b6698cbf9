"""Drawing batches of 32 from a replay of 10^6 transitions with cpprb; prints JSON. Beside it: `trestle-bench replay`.

cpprb gives numpy arrays of both states, actions, rewards and ends; Trestle's figure has the encoding of both states for the network in
it. States have 4 numbers of four bytes, or MinAtar's 400 of one byte. Times are medians of CPU time.
"""

from importlib.metadata import version

import cpprb
import numpy as np

from step_common import arguments, medians, print_report

STORED, BATCH, CHUNK = 1_000_000, 32, 10_000
STATES = {"f32": (4, np.float32), "u8": (400, np.uint8)}


def full(dim: int, dtype: type) -> cpprb.ReplayBuffer:
    """A full replay of one long episode, whose states are stored once, as Trestle stores them."""
    layout = {"obs": {"shape": dim, "dtype": dtype}, "act": {"dtype": np.uint32}, "rew": {}, "next_obs": {"shape": dim, "dtype": dtype},
              "done": {}}
    replay = cpprb.ReplayBuffer(STORED, layout)
    rng = np.random.default_rng(1)
    for _ in range(STORED // CHUNK):
        states = rng.integers(0, 2, (CHUNK + 1, dim)).astype(dtype)
        replay.add(obs=states[:-1], act=rng.integers(0, 4, CHUNK), rew=np.ones(CHUNK), next_obs=states[1:], done=np.zeros(CHUNK))
    return replay


def main() -> None:
    args = arguments(__doc__)
    cases = {}
    for element, (dim, dtype) in STATES.items():
        replay = full(dim, dtype)
        cases[element, dim] = lambda replay=replay: replay.sample(BATCH)
    found = medians(cases, args.quick)
    rows = [{"op": "sample", "dim": dim, "element": element, "stored": STORED, "batch": BATCH, "ns": round(us * 1e3 / BATCH, 1)}
            for (element, dim), us in found.items()]
    print_report("sampling", {"cpprb": version("cpprb")}, rows)


if __name__ == "__main__":
    main()
