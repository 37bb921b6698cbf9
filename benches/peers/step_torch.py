"""The gradient step of `trestle-bench step` in PyTorch, on one thread; prints JSON.

`eager` is what a user writes; `compiled` is the whole step as one graph under torch.compile, gradient and Adam
written out, left out where that does not work (it needs a C++ compiler). Times are medians of CPU time.
"""

import sys

import torch
from torch import nn
from torch.nn import functional

from step_common import BETA_1, BETA_2, EPSILON, GAMMA, LEARNING_RATE, REWARD, SIZES, arguments, medians, print_report


def network(inputs: int, width: int, outputs: int) -> nn.Module:
    return nn.Sequential(nn.Linear(inputs, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU(),
                         nn.Linear(width, outputs))


def samples(sizes, batch: int):
    torch.manual_seed(1)
    x, following = (torch.rand(batch, sizes[0]) * 2 - 1 for _ in range(2))
    return x, following, (torch.arange(batch) % sizes[2]).unsqueeze(1)


def eager_step(sizes, batch: int):
    online, target = network(*sizes), network(*sizes)
    adam = torch.optim.Adam(online.parameters(), lr=LEARNING_RATE)
    x, following, actions = samples(sizes, batch)

    def step():
        with torch.no_grad():
            wanted = REWARD + GAMMA * target(following).max(dim=1, keepdim=True).values
        loss = functional.huber_loss(online(x).gather(1, actions), wanted)
        adam.zero_grad()
        loss.backward()
        adam.step()

    return step


def compiled_step(sizes, batch: int):
    online, target = (list(p.detach() for p in network(*sizes).parameters()) for _ in range(2))
    mean, square = ([torch.zeros_like(p) for p in online] for _ in range(2))
    x, following, actions = samples(sizes, batch)
    count = torch.zeros(())

    def values(layers, x):
        first, first_bias, second, second_bias, last, last_bias = layers
        one = torch.relu(functional.linear(x, first, first_bias))
        two = torch.relu(functional.linear(one, second, second_bias))
        return one, two, functional.linear(two, last, last_bias)

    @torch.compile(fullgraph=True)
    def whole():
        wanted = REWARD + GAMMA * values(target, following)[2].max(dim=1, keepdim=True).values
        one, two, q = values(online, x)
        # The gradient is written out: differentiating within one graph does not work in every version.
        error = (q.gather(1, actions) - wanted).clamp(-1, 1) / batch
        to_last = torch.zeros_like(q).scatter(1, actions, error)
        to_second = (to_last @ online[4]) * (two > 0)
        to_first = (to_second @ online[2]) * (one > 0)
        grads = (to_first.T @ x, to_first.sum(0), to_second.T @ one, to_second.sum(0), to_last.T @ two,
                 to_last.sum(0))
        count.add_(1)
        size, root = LEARNING_RATE / (1 - BETA_1 ** count), torch.sqrt(1 - BETA_2 ** count)
        for p, m, v, g in zip(online, mean, square, grads):
            m.mul_(BETA_1).add_(g * (1 - BETA_1))
            v.mul_(BETA_2).add_(g * g * (1 - BETA_2))
            p.sub_(size * m / (torch.sqrt(v) / root + EPSILON))

    def step():
        with torch.no_grad():
            whole()

    return step


def main() -> None:
    args = arguments(__doc__)
    torch.set_num_threads(1)
    cases = {}
    for sizes, batch in SIZES:
        cases[sizes, batch, "eager"] = eager_step(sizes, batch)
        try:
            step = compiled_step(sizes, batch)
            step()
            cases[sizes, batch, "compiled"] = step
        except Exception as error:  # whatever the compiler lacks on this machine
            print(f"torch.compile does not work here: {type(error).__name__}: {error}", file=sys.stderr)
    found = medians(cases, args.quick)
    print_report("step_torch", {"torch": torch.__version__}, [
        {"inputs": sizes[0], "hidden": [sizes[1]] * 2, "batch": batch, "how": how, "us": round(us, 2)}
        for (sizes, batch, how), us in found.items()
    ])


if __name__ == "__main__":
    main()
