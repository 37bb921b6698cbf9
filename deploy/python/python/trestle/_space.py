"""Observations of a space as flat rows of features, one or a batch."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Layout = dict[str, Any]


def rows(layout: Layout, obs: Any) -> tuple[NDArray[np.float32], bool]:
    """``obs`` as ``[rows][features]``, and whether it is a batch.

    Raises:
        ValueError: it has another form than the space's, or the space's with a dimension for the batch before it.
    """
    try:
        return _rows(layout, obs)
    except _Other as error:
        whole = f"; an observation is {form(layout)}" if layout["kind"] in ("tuple", "dict") else ""
        raise ValueError(f"{error}{whole}") from None


class _Other(ValueError):
    """Another form than the space's."""


def form(layout: Layout) -> str:
    """The form of an observation in words."""
    match layout["kind"]:
        case "box":
            return f"an array of the shape {tuple(layout['shape'])}"
        case "discrete":
            return f"a whole number from {layout['start']} to {layout['start'] + layout['n'] - 1}"
        case "tuple":
            return f"a tuple of ({', '.join(form(space) for space in layout['spaces'])})"
        case "dict":
            parts = zip(layout["keys"], layout["spaces"])
            return "a dict of {" + ", ".join(f"{key!r}: {form(space)}" for key, space in parts) + "}"
        case _:
            return "anything"


def _rows(layout: Layout, obs: Any) -> tuple[NDArray[np.float32], bool]:
    match layout["kind"]:
        case "box":
            return _array(_numbers(obs), tuple(layout["shape"]))
        case "discrete":
            flat, batch = _array(_numbers(obs), ())
            return flat - np.float32(layout["start"]), batch
        case "tuple":
            if not isinstance(obs, (tuple, list)):
                raise _Other(f"an observation is {_shown(obs)}; accepted: a tuple of {len(layout['spaces'])}")
            parts = list(obs)
        case _:
            if not isinstance(obs, Mapping):
                raise _Other(f"an observation is {_shown(obs)}; accepted: a dict with the keys {', '.join(layout['keys'])}")
            if missing := [key for key in layout["keys"] if key not in obs]:
                raise _Other(f"an observation without {', '.join(missing)}; accepted: a dict with the keys {', '.join(layout['keys'])}")
            parts = [obs[key] for key in layout["keys"]]
    if len(parts) != len(layout["spaces"]):
        raise _Other(f"an observation of {len(parts)} parts; accepted: {len(layout['spaces'])}")
    # At least one part has features: otherwise the whole would be nothing.
    made = [_rows(space, part) for space, part in zip(layout["spaces"], parts) if space["kind"] != "none"]
    if len({(len(flat), batch) for flat, batch in made}) != 1:
        raise ValueError("the parts of an observation are batches of different lengths; accepted: of one length")
    return np.concatenate([flat for flat, _ in made], axis=1), made[0][1]


def _numbers(obs: Any) -> NDArray[np.float32]:
    try:
        return np.asarray(obs, dtype=np.float32)
    except (TypeError, ValueError):
        raise _Other(f"an observation is {_shown(obs)}; accepted: numbers") from None


def _shown(obs: Any) -> str:
    text = repr(obs)
    return f"{text if len(text) < 200 else text[:200] + ' ...'} ({type(obs).__name__})"


def _array(array: NDArray[np.float32], shape: tuple[int, ...]) -> tuple[NDArray[np.float32], bool]:
    if array.shape == shape:
        return array.reshape(1, -1), False
    if array.shape[1:] == shape and array.ndim == len(shape) + 1:
        return array.reshape(len(array), math.prod(shape)), True
    raise _Other(f"an observation of the shape {array.shape}; accepted: {shape}, or {('n', *shape)} for a batch")
