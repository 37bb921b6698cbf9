"""Golden values of gradient steps with convolutions, computed by PyTorch: writes conv_step.json beside this file.

Run as `python conv_step.py`; the committed file was written with Python 3.11.2 and torch 1.13.1 (Debian's python3-torch, x86-64
Linux, on the CPU with one thread). The exact version should not matter: the test that reads the file allows for differences in
rounding.

For each case, 10 steps of DQN's loss with given targets, one batch of 6 inputs a step. Parameters are flat in Trestle's order: for
each layer the weights as [in][out] row-major, where a convolution's inputs are [row][column][channel], then the bias.
"""

import json
import pathlib

import torch
from dqn_step import numbers, render

ROWS = 6
STEPS = 10
LR = 1e-3
CASES = [
    {"name": "channels-last", "grid": [6, 5, 3], "channels_first": False, "conv": [[5, 3, 1]], "dense": [9, 4]},
    {"name": "two-with-strides", "grid": [9, 8, 2], "channels_first": False, "conv": [[4, 3, 2], [7, 2, 1]], "dense": [8, 3]},
    {"name": "channels-first", "grid": [5, 7, 2], "channels_first": True, "conv": [[6, 2, 2]], "dense": [18]},
]


class Network(torch.nn.Module):
    def __init__(self, case):
        super().__init__()
        self.grid, self.channels_first = case["grid"], case["channels_first"]
        height, width, channels = case["grid"]
        self.convs, self.dense = torch.nn.ModuleList(), torch.nn.ModuleList()
        for outputs, kernel, stride in case["conv"]:
            self.convs.append(torch.nn.Conv2d(channels, outputs, kernel, stride))
            height, width, channels = (height - kernel) // stride + 1, (width - kernel) // stride + 1, outputs
        inputs = height * width * channels
        for outputs in case["dense"]:
            self.dense.append(torch.nn.Linear(inputs, outputs))
            inputs = outputs

    def forward(self, x):
        height, width, channels = self.grid
        if self.channels_first:
            x = x.reshape(-1, channels, height, width)
        else:
            x = x.reshape(-1, height, width, channels).permute(0, 3, 1, 2)
        for conv in self.convs:
            x = torch.relu(conv(x))
        x = x.permute(0, 2, 3, 1).flatten(1)
        for layer in self.dense[:-1]:
            x = torch.relu(layer(x))
        return self.dense[-1](x)

    def flat(self):
        parts = [part.flatten() for conv in self.convs for part in (conv.weight.permute(2, 3, 1, 0), conv.bias)]
        parts += [part.flatten() for layer in self.dense for part in (layer.weight.t(), layer.bias)]
        return numbers(torch.cat(parts))


def run(case):
    network = Network(case)
    adam = torch.optim.Adam(network.parameters(), lr=LR)
    height, width, channels = case["grid"]
    result = {**case, "params": network.flat(), "batches": []}
    losses = []
    for step in range(1, STEPS + 1):
        # Bytes, as they come from a replay, scaled to [-1, 1].
        x = torch.randint(256, (ROWS, height * width * channels))
        action, target = torch.randint(case["dense"][-1], (ROWS,)), torch.randn(ROWS)
        q = network(2.0 * x / 255.0 - 1.0).gather(1, action.unsqueeze(1)).squeeze(1)
        loss = torch.nn.functional.huber_loss(q, target, delta=1.0)
        adam.zero_grad()
        loss.backward()
        if step == 1:
            result["q"] = numbers(q)
        adam.step()
        losses.append(loss)
        if step in (1, STEPS):
            result[f"params_after_{step}"] = network.flat()
        result["batches"].append({"x": x.flatten().tolist(), "action": action.tolist(), "target": numbers(target)})
    result["losses"] = numbers(torch.stack(losses))
    return result


def main():
    torch.set_num_threads(1)
    torch.manual_seed(20261130)
    result = {"rows": ROWS, "lr": LR, "cases": [run(case) for case in CASES]}
    path = pathlib.Path(__file__).with_suffix(".json")
    path.write_text(render(result) + "\n")


if __name__ == "__main__":
    main()
