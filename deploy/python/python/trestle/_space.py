"""Observations of a space as flat rows of features, one or a batch."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

Layout = dict[str, Any]


def rows(layout: Layout, obs: Any) -> tuple[NDArray[np.float32], bool]:
    """``obs`` as ``[rows][features]``, and whether it is a batch.

    Raises:
        ValueError: it has another shape than the space's, or the space's with a dimension for the batch before it.
    """
    match layout["kind"]:
        case "box":
            array = np.asarray(obs, dtype=np.float32)
            return _array(array, tuple(layout["shape"]))
        case "discrete":
            array = np.asarray(obs, dtype=np.float32)
            flat, batch = _array(array, ())
            return flat - np.float32(layout["start"]), batch
        case "tuple":
            parts = list(obs)
        case _:
            parts = [obs[key] for key in layout["keys"]]
    if len(parts) != len(layout["spaces"]):
        raise ValueError(f"an observation of {len(parts)} parts; accepted: {len(layout['spaces'])}")
    # At least one part has features: otherwise the whole would be nothing.
    made = [rows(space, part) for space, part in zip(layout["spaces"], parts) if space["kind"] != "none"]
    if len({(len(flat), batch) for flat, batch in made}) != 1:
        raise ValueError("the parts of an observation are batches of different lengths; accepted: of one length")
    return np.concatenate([flat for flat, _ in made], axis=1), made[0][1]


def _array(array: NDArray[np.float32], shape: tuple[int, ...]) -> tuple[NDArray[np.float32], bool]:
    if array.shape == shape:
        return array.reshape(1, -1), False
    if array.shape[1:] == shape and array.ndim == len(shape) + 1:
        return array.reshape(len(array), math.prod(shape)), True
    raise ValueError(f"an observation of the shape {array.shape}; accepted: {shape}, or {('n', *shape)} for a batch")
