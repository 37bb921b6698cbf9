"""Golden values of DQN gradient steps, computed by PyTorch: writes dqn_step.json beside this file.

Run as `python dqn_step.py`; the committed file was written with Python 3.11.7 and torch 2.2.2 (from PyPI, x86-64
Linux, on the CPU with one thread). The exact version should not matter: the test that reads the file allows for
differences in rounding.

For each case, 10 steps of DQN on a 2-16-16-4 network with a fixed target network, one batch of 8 transitions a
step. Parameters are flat in Trestle's order: for each layer the weights as [in][out] row-major, then the bias.
"""

import json
import pathlib

import torch

SIZES = [2, 16, 16, 4]
ROWS = 8
STEPS = 10
GAMMA = 0.99
LR = 1e-3
CASES = [
    {"name": "huber-plain", "loss": "huber", "double": False, "max_norm": None},
    {"name": "huber-double", "loss": "huber", "double": True, "max_norm": None},
    {"name": "squared-plain-clipped", "loss": "squared", "double": False, "max_norm": 0.5},
]


def network():
    layers = []
    for i, (inputs, outputs) in enumerate(zip(SIZES, SIZES[1:])):
        if i > 0:
            layers.append(torch.nn.ReLU())
        layers.append(torch.nn.Linear(inputs, outputs))
    return torch.nn.Sequential(*layers)


def numbers(tensor):
    """The tensor's numbers with the nine digits that identify an f32."""
    return [float(f"{x:.9g}") for x in tensor.detach().flatten().tolist()]


def flat(net):
    linear = [m for m in net if isinstance(m, torch.nn.Linear)]
    return numbers(torch.cat([part.flatten() for m in linear for part in (m.weight.t(), m.bias)]))


def batch():
    return {
        "obs": torch.rand(ROWS, SIZES[0]) * 2 - 1,
        "action": torch.randint(SIZES[-1], (ROWS,)),
        # Wide enough for errors on both sides of the Huber threshold.
        "reward": torch.randn(ROWS),
        "next_obs": torch.rand(ROWS, SIZES[0]) * 2 - 1,
        "terminal": torch.rand(ROWS) < 0.25,
    }


def run(case, initial, target, batches):
    online = network()
    online.load_state_dict(initial)
    adam = torch.optim.Adam(online.parameters(), lr=LR)
    losses, norms, after = [], [], {}
    for step, b in enumerate(batches, start=1):
        with torch.no_grad():
            next_q = target(b["next_obs"])
            chosen = (online(b["next_obs"]) if case["double"] else next_q).argmax(1, keepdim=True)
            bootstrap = next_q.gather(1, chosen).squeeze(1)
            y = b["reward"] + GAMMA * bootstrap * (~b["terminal"]).float()
        q = online(b["obs"]).gather(1, b["action"].unsqueeze(1)).squeeze(1)
        if case["loss"] == "huber":
            loss = torch.nn.functional.huber_loss(q, y, delta=1.0)
        else:
            loss = torch.nn.functional.mse_loss(q, y)
        adam.zero_grad()
        loss.backward()
        if case["max_norm"] is not None:
            norms.append(torch.nn.utils.clip_grad_norm_(online.parameters(), case["max_norm"]))
        adam.step()
        losses.append(loss)
        if step in (1, STEPS):
            after[step] = flat(online)
    return {
        **case,
        "losses": numbers(torch.stack(losses)),
        "norms": numbers(torch.stack(norms)) if norms else [],
        "params_after_1": after[1],
        "params_after_10": after[STEPS],
    }


def render(value, indent=0):
    """JSON with each list of plain values on one line: compact, and still readable in a diff."""
    pad = "\n" + " " * (indent + 1)
    end = "\n" + " " * indent
    if isinstance(value, dict):
        items = (f"{pad}{json.dumps(key)}: {render(item, indent + 1)}" for key, item in value.items())
        return "{" + ",".join(items) + end + "}"
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return "[" + ",".join(pad + render(item, indent + 1) for item in value) + end + "]"
    return json.dumps(value)


def main():
    torch.set_num_threads(1)
    torch.manual_seed(20240607)
    online, target = network(), network()
    batches = [batch() for _ in range(STEPS)]
    initial = {k: v.clone() for k, v in online.state_dict().items()}
    result = {
        "sizes": SIZES,
        "rows": ROWS,
        "gamma": GAMMA,
        "lr": LR,
        "online": flat(online),
        "target": flat(target),
        "batches": [
            {
                "obs": numbers(b["obs"]),
                "action": b["action"].tolist(),
                "reward": numbers(b["reward"]),
                "next_obs": numbers(b["next_obs"]),
                "terminal": b["terminal"].tolist(),
            }
            for b in batches
        ],
        "cases": [run(case, initial, target, batches) for case in CASES],
    }
    path = pathlib.Path(__file__).with_suffix(".json")
    path.write_text(render(result) + "\n")


if __name__ == "__main__":
    main()
