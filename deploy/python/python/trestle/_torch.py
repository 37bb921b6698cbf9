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


class Planes(torch.nn.Module):
    """From rows of numbers to ``[rows][channels][height][width]``."""

    def __init__(self, height: int, width: int, channels: int, channels_first: bool) -> None:
        super().__init__()
        self.shape = (channels, height, width) if channels_first else (height, width, channels)
        self.channels_first = channels_first

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        x = x.reshape(-1, *self.shape)
        return x if self.channels_first else x.permute(0, 3, 1, 2)


class Row(torch.nn.Module):
    """From ``[rows][channels][height][width]`` to rows of numbers in the order height, width, channel."""

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return x.permute(0, 2, 3, 1).flatten(1)


#: Height, width, channels, kernel, stride, and whether the channels come first.
Conv = tuple[int, int, int, int, int, bool]


def module(
    encoding: dict[str, Any], layers: list[tuple[int, int, list[float], list[float], Conv | None]]
) -> torch.nn.Module:
    """The network of ``layers``, behind its ``encoding``."""
    (parts,) = encoding.values()
    low = parts["low"]
    high = parts.get("high", [value + 1.0 for value in low])
    stack: list[torch.nn.Module] = [Encode(low, high, parts.get("sizes", [0] * len(low)))]
    planes = False
    for inputs, outputs, weights, bias, conv in layers:
        layer: torch.nn.Linear | torch.nn.Conv2d
        if conv is not None:
            height, width, channels, kernel, stride, channels_first = conv
            if not planes:
                stack.append(Planes(height, width, channels, channels_first))
            layer = torch.nn.Conv2d(channels, outputs, kernel, stride)
            weight = torch.tensor(weights).reshape(kernel, kernel, channels, outputs).permute(3, 2, 0, 1)
        else:
            if planes:
                stack.append(Row())
            layer = torch.nn.Linear(inputs, outputs)
            weight = torch.tensor(weights).reshape(inputs, outputs).T
        planes = conv is not None
        with torch.no_grad():
            layer.weight.copy_(weight)
            assert layer.bias is not None
            layer.bias.copy_(torch.tensor(bias))
        stack += [layer, torch.nn.ReLU()]
    return torch.nn.Sequential(*stack[:-1])
