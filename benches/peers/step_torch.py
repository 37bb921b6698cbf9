"""The gradient step of `trestle-bench step` in PyTorch, on one thread; prints JSON.

`eager` is what a user writes; `compiled` is the whole step as one graph under torch.compile, gradient and Adam
written out, left out where that does not work (it needs a C++ compiler). Times are medians of CPU time.
"""

import sys

import torch
from torch import nn
from torch.nn import functional

from step_common import (BETA_1, BETA_2, CONV, CONV_BATCH, DENSE, EPSILON, GAMMA, GRID, LEARNING_RATE, REWARD, SIZES, arguments,
                         medians, print_report, row)


def network(inputs: int, width: int, outputs: int) -> nn.Module:
    return nn.Sequential(nn.Linear(inputs, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU(),
                         nn.Linear(width, outputs))


def conv_network() -> nn.Module:
    """MinAtar's network, of inputs `[batch][channels][height][width]`."""
    (height, width, channels), (outputs, kernel), (hidden, actions) = GRID, CONV, DENSE
    places = (height - kernel + 1) * (width - kernel + 1)
    return nn.Sequential(nn.Conv2d(channels, outputs, kernel), nn.ReLU(), nn.Flatten(), nn.Linear(places * outputs, hidden),
                         nn.ReLU(), nn.Linear(hidden, actions))


def make(sizes) -> nn.Module:
    return conv_network() if sizes is None else network(*sizes)


def samples(sizes, batch: int):
    torch.manual_seed(1)
    (height, width, channels), actions = GRID, DENSE[1]
    shape, actions = ((batch, channels, height, width), actions) if sizes is None else ((batch, sizes[0]), sizes[2])
    x, following = (torch.rand(*shape) * 2 - 1 for _ in range(2))
    return x, following, (torch.arange(batch) % actions).unsqueeze(1)


def eager_step(sizes, batch: int):
    online, target = make(sizes), make(sizes)
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
    online, target = (list(p.detach() for p in make(sizes).parameters()) for _ in range(2))
    mean, square = ([torch.zeros_like(p) for p in online] for _ in range(2))
    x, following, actions = samples(sizes, batch)
    count = torch.zeros(())

    def values(layers, x):
        first, first_bias, second, second_bias, last, last_bias = layers
        if sizes is None:
            one = torch.relu(functional.conv2d(x, first, first_bias)).flatten(1)
        else:
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
        if sizes is None:
            planes = to_first.view(batch, CONV[0], GRID[0] - CONV[1] + 1, GRID[1] - CONV[1] + 1)
            of_first = torch.nn.grad.conv2d_weight(x, online[0].shape, planes), planes.sum((0, 2, 3))
        else:
            of_first = to_first.T @ x, to_first.sum(0)
        grads = (*of_first, to_second.T @ one, to_second.sum(0), to_last.T @ two,
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
    for sizes, batch in (*SIZES, (None, CONV_BATCH)):
        cases[sizes, batch, "eager"] = eager_step(sizes, batch)
        try:
            step = compiled_step(sizes, batch)
            step()
            cases[sizes, batch, "compiled"] = step
        except Exception as error:  # whatever the compiler lacks on this machine
            print(f"torch.compile does not work here: {type(error).__name__}: {error}", file=sys.stderr)
    found = medians(cases, args.quick)
    print_report("step_torch", {"torch": torch.__version__}, [
        row(sizes, batch, how, us)
        for (sizes, batch, how), us in found.items()
    ])


if __name__ == "__main__":
    main()
