"""A network as a module of PyTorch."""

from __future__ import annotations

from typing import Any

import torch


class Encode(torch.nn.Module):
    """From features ``[rows][features]`` to the network's input ``[rows][inputs]``."""

    def __init__(self, low: list[float], high: list[float], sizes: list[int]) -> None:
        """``sizes``: the number of categories of each feature, 0 for one that is scaled."""
        super().__init__()
        self.sizes = sizes
        self.register_buffer("low", torch.tensor(low))
        self.register_buffer("width", torch.tensor(high) - torch.tensor(low))

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        scaled = 2.0 * (features - self.low) / self.width - 1.0
        parts = []
        for i, size in enumerate(self.sizes):
            if size == 0:
                parts.append(scaled[:, i : i + 1])
            else:
                category = (features[:, i] - self.low[i]).round().long().clamp(0, size - 1)
                parts.append(torch.nn.functional.one_hot(category, size).to(features.dtype))
        return torch.cat(parts, dim=1)


def module(encoding: dict[str, Any], layers: list[tuple[int, int, list[float], list[float]]]) -> torch.nn.Module:
    """The network of ``layers``, behind its ``encoding``."""
    (parts,) = encoding.values()
    low = parts["low"]
    high = parts.get("high", [value + 1.0 for value in low])
    stack: list[torch.nn.Module] = [Encode(low, high, parts.get("sizes", [0] * len(low)))]
    for inputs, outputs, weights, bias in layers:
        linear = torch.nn.Linear(inputs, outputs)
        with torch.no_grad():
            linear.weight.copy_(torch.tensor(weights).reshape(inputs, outputs).T)
            linear.bias.copy_(torch.tensor(bias))
        stack += [linear, torch.nn.ReLU()]
    return torch.nn.Sequential(*stack[:-1])
