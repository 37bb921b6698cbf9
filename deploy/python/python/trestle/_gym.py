"""Makes Gymnasium environments, describes them, and looks whether they repeat their steps."""

from __future__ import annotations

import importlib
import itertools
import json
import math
import os
import platform
import sys
from collections.abc import Callable, Iterator
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from . import _trestle
from ._refused import Refused

Settings = dict[str, Any]

#: Steps of the episodes that are compared before a run, at most.
_COMPARED = 200
#: Bounds beyond this are as good as none.
_WIDE = 1e6
#: Longer side of a picture, pixels, at most.
_MAX_SIDE = 640
#: Inputs of a network, at most.
_MAX_INPUTS = 4096


def name_of(settings: Settings) -> str:
    """The environment's name for people."""
    return str(settings["id"] or settings["make"])


def _search(directory: str | None) -> None:
    """Modules are looked for in the ``directory`` where the run was started, and as with `python -m` in the working directory."""
    for path in ("", directory):
        if path is not None and path not in sys.path:
            sys.path.insert(0, path)


def _here() -> str | None:
    """The working directory, if it is still there."""
    try:
        return os.getcwd()
    except FileNotFoundError:
        return None


def _attribute(path: str, key: str) -> Any:
    module, _, name = path.partition(":")
    if not module or not name:
        raise Refused(f"{key} = {path}; accepted: module:name")
    try:
        found = importlib.import_module(module)
    except ModuleNotFoundError as error:
        raise Refused(f"{key} = {path}: {error}; accepted: a module that {sys.executable} finds") from error
    try:
        for part in name.split("."):
            found = getattr(found, part)
    except AttributeError as error:
        raise Refused(f"{key} = {path}: {error}; accepted: a name in {module}") from error
    return found


def make(settings: Settings, directory: str | None = None) -> gymnasium.Env[Any, Any]:
    """Make the environment of ``settings``, in its wrappers. Its modules may lie in ``directory``."""
    _search(directory)
    kwargs = dict(settings["kwargs"])
    env: gymnasium.Env[Any, Any]
    if settings["make"]:
        env = _attribute(settings["make"], "env.gym.make")(**kwargs)
    else:
        kwargs.setdefault("disable_env_checker", True)
        try:
            env = gymnasium.make(settings["id"], **kwargs)
        except gymnasium.error.Error as error:
            said = str(error)
            # Gymnasium leaves the version out where there is no version at all.
            name = settings["id"].rpartition(":")[2]
            if name not in said:
                said = f"no environment is registered as {name}: {said}"
            accepted = (
                "an id that Gymnasium has, package:Name-v0 for one that the package registers with gymnasium.register, "
                "or for a class or a function env.gym.make = module:name"
            )
            raise Refused(f"env.gym.id = {settings['id']}: {said.rstrip('.')}; accepted: {accepted}") from error
        except ModuleNotFoundError as error:
            raise Refused(f"env.gym.id = {settings['id']}: {error}") from error
    for wrapper in settings["wrappers"]:
        env = _attribute(wrapper, "env.gym.wrappers")(env)
    for method in ("reset", "step", "close", "action_space", "observation_space"):
        if not hasattr(env, method):
            raise Refused(
                f"{name_of(settings)} is {type(env).__name__} without `{method}`; accepted: an environment of Gymnasium's"
            )
    return env


def _shown(space: spaces.Space[Any]) -> str:
    text = repr(space)
    return text if len(text) < 300 else text[:300] + " ..."


class _Parts:
    """The features of a space of observations, in their order."""

    def __init__(self, space: spaces.Space[Any], *, picked: bool) -> None:
        """``picked``: only some of the features count, so parts without any are passed over."""
        self._picked = picked
        self.names: list[str] = []
        self.bounds: list[tuple[float, float]] = []
        self.categories: list[int] = []
        self.integral: list[bool] = []
        #: Whether one byte holds all values of the feature.
        self.bytes: list[bool] = []
        #: Place of the first feature, and shape, of each array.
        self.arrays: list[tuple[int, list[int]]] = []
        self.layout = self._add(space, "")
        if len(self.names) > _trestle.MAX_FEATURES:
            raise Refused(f"the observation space has {len(self.names)} features; accepted: 1 to {_trestle.MAX_FEATURES}")

    def _feature(self, name: str, low: float, high: float, *, category: bool = False, integral: bool, byte: bool) -> None:
        if category:
            self.categories.append(len(self.names))
        self.names.append(name)
        self.bounds.append((low, high))
        self.integral.append(integral)
        self.bytes.append(byte)

    def _array(self, name: str, space: spaces.Space[Any], low: Any, high: Any, category: bool) -> dict[str, Any]:
        shape = list(space.shape or ())
        if math.prod(shape) > _trestle.MAX_FEATURES:
            raise Refused(
                f"an observation of the shape {tuple(shape)} has {math.prod(shape)} features; accepted: up to "
                f"{_trestle.MAX_FEATURES}"
            )
        assert space.dtype is not None
        integral = not np.issubdtype(space.dtype, np.floating)
        lows = np.broadcast_to(np.asarray(low, dtype=np.float64), shape)
        highs = np.broadcast_to(np.asarray(high, dtype=np.float64), shape)
        self.arrays.append((len(self.names), shape))
        small = space.dtype in (np.uint8, np.bool_) or isinstance(space, spaces.MultiBinary)
        for index in np.ndindex(*shape):
            at = ",".join(map(str, index))
            # One value is no choice.
            choice = category and bool(highs[index] > lows[index])
            self._feature(
                f"{name}[{at}]" if name else at or "0",
                float(lows[index]),
                float(highs[index]),
                category=choice,
                integral=integral,
                byte=small or bool(category and lows[index] >= 0 and highs[index] <= 255),
            )
        return {"kind": "box", "shape": shape, "dtype": str(space.dtype)}

    def _add(self, space: spaces.Space[Any], name: str) -> dict[str, Any]:
        def below(part: object) -> str:
            return f"{name}.{part}" if name else str(part)

        match space:
            case spaces.Box():
                if space.dtype is None or not (np.issubdtype(space.dtype, np.number) or np.issubdtype(space.dtype, np.bool_)):
                    raise Refused(f"an observation of {_shown(space)}; accepted: numbers")
                return self._array(name, space, space.low, space.high, False)
            case spaces.Discrete():
                n, start = int(space.n), int(space.start)
                if n > _MAX_INPUTS:
                    raise Refused(
                        f"an observation of {_shown(space)} has {n} values, each an input of the network; accepted: up to {_MAX_INPUTS}"
                    )
                self._feature(name or "state", 0.0, float(n - 1), category=n > 1, integral=True, byte=n <= 256)
                return {"kind": "discrete", "n": n, "start": start}
            case spaces.MultiBinary():
                return self._array(name, space, 0, 1, True)
            case spaces.MultiDiscrete():
                first = np.asarray(getattr(space, "start", np.zeros_like(space.nvec)))
                return self._array(name, space, first, first + space.nvec - 1, True)
            case spaces.Tuple():
                made = [self._add(part, below(i)) for i, part in enumerate(space.spaces)]
                return _unless_empty({"kind": "tuple", "spaces": made})
            case spaces.Dict():
                parts = [(str(key), part) for key, part in space.spaces.items()]
                made = [self._add(part, below(key)) for key, part in parts]
                return _unless_empty({"kind": "dict", "keys": [key for key, _ in parts], "spaces": made})
        if name and self._picked:
            return {"kind": "none"}
        raise Refused(
            f"an observation of {_shown(space)}; accepted: Box, Discrete, MultiBinary, MultiDiscrete, and Tuple and Dict of them, "
            "and other parts of a Tuple or Dict where env.gym.features picks none of them"
        )


def _unless_empty(layout: dict[str, Any]) -> dict[str, Any]:
    """``layout`` of several parts, or that of nothing where no part has a feature."""
    return layout if any(part["kind"] != "none" for part in layout["spaces"]) else {"kind": "none"}


def _picked(picks: list[int | str], names: list[str], key: str, *, parts: bool) -> list[int]:
    """The places of ``picks`` among ``names``; all of them if there are none."""
    if not picks:
        return list(range(len(names)))
    places: list[int] = []
    for pick in picks:
        if isinstance(pick, int) and 0 <= pick < len(names):
            found = [pick]
        else:
            found = [i for i, name in enumerate(names) if name == str(pick)]
            if parts and not found:
                found = [i for i, name in enumerate(names) if name.startswith((f"{pick}.", f"{pick}["))]
        if not found:
            shown = ", ".join(names[:30]) + (", ..." if len(names) > 30 else "")
            raise Refused(f"{key} = {pick}; accepted: 0 to {len(names) - 1}, or a name: {shown}")
        places += found
    if len(set(places)) < len(places):
        raise Refused(f"{key} = {picks}; accepted: each only once")
    return places


def flattening(
    space: spaces.Space[Any], features: list[int | str] | None
) -> tuple[list[str], list[int], Callable[[Any], list[float]]]:
    """Names of all features of ``space``, the places of those that are picked, and what makes features of an observation."""
    parts = _Parts(space, picked=bool(features))
    places = _picked(features or [], parts.names, "features", parts=True)
    return parts.names, places, _trestle.Flattener(json.dumps(parts.layout))


def _too_many(n: int, space: spaces.Space[Any]) -> Refused:
    return Refused(
        f"an action space of {_shown(space)} has {n} actions; accepted: 2 to {_trestle.MAX_ACTIONS}, or fewer by env.gym.bins"
    )


def _actions(env: gymnasium.Env[Any, Any], settings: Settings) -> dict[str, Any]:
    """Every action that the agent has."""
    space: Any = env.action_space
    bins = settings["bins"]
    if bins and not isinstance(space, spaces.Box):
        raise Refused(f"env.gym.bins = {bins}; accepted for {_shown(space)}: none, as its actions are not continuous")
    dtype, shape = "int", []
    match space:
        case spaces.Discrete():
            n, start = int(space.n), int(space.start)
            if n > _trestle.MAX_ACTIONS and not settings["actions"]:
                raise _too_many(n, space)
            values: list[Any] = list(range(start, start + min(n, 1_000_000)))
            names = _meanings(env, values)
        case spaces.MultiDiscrete() | spaces.MultiBinary():
            dtype, shape = str(space.dtype), list(space.shape)
            if isinstance(space, spaces.MultiBinary):
                sides = [2] * math.prod(shape)
                starts = [0] * len(sides)
            else:
                sides = [int(n) for n in space.nvec.flatten()]
                starts = [int(n) for n in np.asarray(getattr(space, "start", np.zeros_like(space.nvec))).flatten()]
            values, names = _enumerated([range(a, a + n) for a, n in zip(starts, sides)], space)
        case spaces.Box():
            dtype, shape = str(space.dtype), list(space.shape)
            dims = math.prod(shape)
            if len(bins) not in (1, dims) or not bins:
                raise Refused(
                    f"env.gym.bins = {bins}; accepted for {_shown(space)}: one number for all its {dims} dimensions, or {dims}"
                )
            low, high = space.low.flatten().astype(float), space.high.flatten().astype(float)
            if not (np.isfinite(low).all() and np.isfinite(high).all()):
                raise Refused(f"an action space of {_shown(space)}; accepted: finite bounds, between which env.gym.bins divides")
            each = bins * dims if len(bins) == 1 else bins
            axes = [[float(x) for x in np.linspace(a, b, n)] for a, b, n in zip(low, high, each)]
            values, names = _enumerated(axes, space)
        case _:
            raise Refused(
                f"an action space of {_shown(space)}; accepted: Discrete, MultiDiscrete, MultiBinary, or Box with env.gym.bins"
            )
    places = _picked(settings["actions"], names, "env.gym.actions", parts=False)
    if not 2 <= len(places) <= _trestle.MAX_ACTIONS:
        raise _too_many(len(places), space)
    return {
        "names": [names[i] for i in places],
        "dtype": dtype,
        "values": [values[i] for i in places],
        "shape": shape,
    }


def _enumerated(axes: list[Any], space: spaces.Space[Any]) -> tuple[list[Any], list[str]]:
    n = math.prod(len(axis) for axis in axes)
    if n > _trestle.MAX_ACTIONS:
        raise _too_many(n, space)
    values = [list(value) for value in itertools.product(*axes)]
    return values, [",".join(f"{x:g}" for x in value) for value in values]


def _meanings(env: gymnasium.Env[Any, Any], values: list[int]) -> list[str]:
    """Names of discrete actions, where the environment has some, or else their numbers."""
    numbers = [str(value) for value in values]
    bare = env.unwrapped
    try:
        if callable(meanings := getattr(bare, "get_action_meanings", None)):
            names = [str(name) for name in meanings()]
        elif isinstance(actions := getattr(bare, "actions", ()), (list, tuple)):
            names = [name for name in actions if isinstance(name, str)]
        else:
            kinds = {int(kind): str(kind.name) for kind in actions}
            names = [kinds[value] for value in values]
    except Exception:
        # An attribute of this name that is something else.
        return numbers
    return names if len(names) == len(values) and len(set(names)) == len(names) else numbers


def check_fits(env: gymnasium.Env[Any, Any], settings: Settings, found: dict[str, Any]) -> None:
    """Refuse an ``env`` that has other observations or actions than a run with ``settings`` has ``found``."""
    layout = _Parts(env.observation_space, picked=bool(settings["features"])).layout
    if layout != found["space"]:
        raise Refused(f"the environment's observation space is {_shown(env.observation_space)}; accepted: that of the policy's run")
    own, expected = _actions(env, settings), found["actions"]
    if own != expected:
        shown = [", ".join(actions["names"][:30]) for actions in (own, expected)]
        raise Refused(f"the environment's actions are {shown[0]}; accepted: those of the policy, {shown[1]}")


def _values(actions: dict[str, Any]) -> list[Any]:
    """What the environment gets for each action."""
    if not actions["shape"]:
        return list(actions["values"])
    return [np.array(value, dtype=actions["dtype"]).reshape(actions["shape"]) for value in actions["values"]]


def make_found(settings_json: str, found_json: str) -> tuple[gymnasium.Env[Any, Any], list[Any]]:
    """The environment of a run that has found it before, and what it gets for each action."""
    settings, found = json.loads(settings_json), json.loads(found_json)
    env = make(settings, found.get("directory"))
    layout = _Parts(env.observation_space, picked=bool(settings["features"])).layout
    if layout != found["space"]:
        raise Refused(f"the observation space is {_shown(env.observation_space)}, but the run has found another one before")
    return env, _values(found["actions"])


def frame(env: gymnasium.Env[Any, Any]) -> tuple[int, int, bytes] | None:
    """Width, height and pixels of what ``env`` looks like now, smaller where it is large; None where it does not render so."""
    if getattr(env, "render_mode", None) != "rgb_array":
        return None
    picture = np.asarray(env.render())
    if picture.ndim != 3 or picture.shape[2] not in (3, 4) or picture.dtype != np.uint8:
        raise Refused(f"render returned {picture.dtype} of the shape {picture.shape}; accepted: uint8 of (height, width, 3)")
    picture = picture[:, :, :3]
    shrink = -(-max(picture.shape[:2]) // _MAX_SIDE)
    if shrink > 1:
        height, width = (side // shrink for side in picture.shape[:2])
        blocks = picture[: height * shrink, : width * shrink].reshape(height, shrink, width, shrink, 3)
        picture = blocks.mean(axis=(1, 3)).round().astype(np.uint8)
    return picture.shape[1], picture.shape[0], picture.tobytes()


def _episode(
    env: gymnasium.Env[Any, Any], flat: Callable[[Any], list[float]], values: list[Any], seed: int, steps: int, name: str
) -> Iterator[tuple[list[float], float, bool, bool | None]]:
    """Features, rewards, ends and successes of an episode with random actions that depend on ``seed`` alone.

    Success is None where the environment does not tell. ``name`` is for messages.
    """
    choice = np.random.Generator(np.random.PCG64(seed))
    obs, _ = _pair(env.reset(seed=seed), name)
    yield flat(obs), 0.0, False, None
    for _ in range(steps):
        action = values[choice.integers(len(values))]
        answer = env.step(action.copy() if isinstance(action, np.ndarray) else action)
        if not isinstance(answer, tuple) or len(answer) != 5:
            raise Refused(
                f"{name}: step returned {type(answer).__name__}"
                + (f" of {len(answer)}" if isinstance(answer, tuple) else "")
                + "; accepted: (observation, reward, terminated, truncated, info)"
            )
        obs, reward, terminated, truncated, info = answer
        try:
            reward = float(reward)
        except (TypeError, ValueError) as error:
            raise Refused(f"{name}: a reward is {reward!r} ({type(reward).__name__}); accepted: a number") from error
        over = bool(terminated) or bool(truncated)
        success = info.get("is_success") if isinstance(info, dict) else None
        yield flat(obs), reward, over, None if success is None else bool(success)
        if over:
            return


def _pair(answer: Any, name: str) -> tuple[Any, Any]:
    if not isinstance(answer, tuple) or len(answer) != 2:
        raise Refused(f"{name}: reset returned {type(answer).__name__}; accepted: (observation, info)")
    return answer


def _difference(first: list[Any], second: list[Any], when: str) -> str | None:
    for step, (one, other) in enumerate(zip(first, second)):
        if one != other:
            names = ["observation", "reward", "end of the episode", "success"]
            what = next(name for name, a, b in zip(names, one, other) if a != b)
            return f"with the same seed and actions the {what} after {step} steps differs {when}"
    return f"with the same seed and actions the episode's length differs {when}" if len(first) != len(second) else None


def find(settings: Settings, *, seed: int, step_limit: int) -> dict[str, Any]:
    """Everything about the environment that a run has to know before it starts."""
    name = name_of(settings)
    env = make(settings)
    parts = _Parts(env.observation_space, picked=bool(settings["features"]))
    actions = _actions(env, settings)
    values = _values(actions)
    flatten = _trestle.Flattener(json.dumps(parts.layout))

    def flat(obs: Any) -> list[float]:
        try:
            features: list[float] = flatten(obs)
        except ValueError as error:
            raise Refused(f"{name}: {error}") from error
        for place, value in enumerate(features):
            if not math.isfinite(value):
                raise Refused(f"{name}: the feature {parts.names[place]} is {value}; accepted: finite numbers")
        return features

    places = _picked(settings["features"], parts.names, "env.gym.features", parts=True)
    if not places:
        raise Refused(
            f"an observation of {_shown(env.observation_space)} has no features; accepted: 1 to {_trestle.MAX_FEATURES}"
        )
    # By the name of the demonstration, whose states are not here: the program puts their range in the place of this one.
    scale = [] if isinstance(settings["scale"], str) else settings["scale"]
    if scale and len(scale) != len(places):
        raise Refused(f"env.gym.scale has {len(scale)} numbers; accepted: {len(places)}, one for each feature")

    # Seeds that all environments take.
    seed = seed % 2**31
    compared = min(_COMPARED, step_limit)
    first = list(_episode(env, flat, values, seed, compared, name))
    list(_episode(env, flat, values, (seed + 1) % 2**31, 10, name))
    difference = _difference(first, list(_episode(env, flat, values, seed, compared, name)), "from one episode to the other")
    seen, told = _warm_up(env, flat, values, seed, settings["warmup_steps"], step_limit, name)
    spec = getattr(env, "spec", None)
    threshold = getattr(spec, "reward_threshold", None)
    env.close()
    if difference is None:
        again = make(settings)
        difference = _difference(first, list(_episode(again, flat, values, seed, compared, name)), "from one instance to the other")
        again.close()

    bounds, ranges, steps, warnings = _scales(parts, places, scale, seen)
    categories = [i for i, place in enumerate(places) if place in set(parts.categories)]
    inputs = len(places) + sum(int(ranges[i][1] - ranges[i][0]) for i in categories)
    if inputs > _MAX_INPUTS:
        raise Refused(
            f"the observation gives the network {inputs} inputs; accepted: up to {_MAX_INPUTS}, or fewer by env.gym.features"
        )
    return {
        "version": _trestle.VERSION,
        "build": _trestle.BUILD,
        "executable": sys.executable,
        "python": platform.python_version(),
        "gymnasium": gymnasium.__version__,
        "name": name,
        "directory": _here(),
        "space": parts.layout,
        "features": {
            "names": [parts.names[i] for i in places],
            "places": places,
            "bounds": bounds,
            "range": ranges,
            "step": steps,
            "categories": categories,
            "integral": all(parts.integral[i] for i in places),
            "element": "u8" if all(parts.bytes[i] for i in places) else "f32",
            "shape": next((s for first, s in parts.arrays if places == list(range(first, first + math.prod(s)))), []),
        },
        "actions": actions,
        "threshold": None if threshold is None else float(threshold),
        "success": told or _tells(first),
        "difference": difference,
        "warnings": warnings,
    }


def _warm_up(
    env: gymnasium.Env[Any, Any],
    flat: Callable[[Any], list[float]],
    values: list[Any],
    seed: int,
    steps: int,
    step_limit: int,
    name: str,
) -> tuple[list[np.ndarray[Any, Any]], bool]:
    """States of random steps, ``[steps + 1][features]`` an episode, of ``steps`` steps together; and whether success was told."""
    episodes: list[np.ndarray[Any, Any]] = []
    told = False
    while steps > 0:
        seed = (seed + 1) % 2**31
        episode = list(_episode(env, flat, values, seed, min(steps, step_limit), name))
        episodes.append(np.array([features for features, *_ in episode]))
        told |= _tells(episode)
        # An episode may be over before its first step; a warm-up of such episodes ends all the same.
        steps -= max(len(episode) - 1, 1)
    return episodes, told


def _tells(episode: list[tuple[list[float], float, bool, bool | None]]) -> bool:
    """Whether the environment tells success, in ``info["is_success"]``."""
    return any(success is not None for *_, success in episode)


def _scales(
    parts: _Parts, places: list[int], scale: list[float], seen: list[np.ndarray[Any, Any]]
) -> tuple[list[Any], list[Any], list[float], list[str]]:
    """Bounds, the range that the network's input is scaled by, and how far a step goes, for each feature; and warnings."""
    states = np.concatenate(seen)
    changes = np.concatenate([np.diff(episode, axis=0) for episode in seen])
    bounds: list[Any] = []
    ranges: list[Any] = []
    steps: list[float] = []
    still: list[str] = []
    for i, place in enumerate(places):
        low, high = parts.bounds[place]
        bounds.append([low if math.isfinite(low) else None, high if math.isfinite(high) else None])
        least, most = float(states[:, place].min()), float(states[:, place].max())
        category = place in parts.categories
        if scale and not category:
            span = [-float(scale[i]), float(scale[i])]
        elif abs(low) < _WIDE and abs(high) < _WIDE:
            span = [low, high]
        else:
            middle, width = (least + most) / 2, most - least
            span = [middle - width, middle + width]
            if width == 0.0:
                still.append(parts.names[place])
        if not span[0] < span[1]:
            span = [span[0] - 1.0, span[1] + 1.0]
        ranges.append([_single(span[0]), _single(span[1])])
        moved = float(np.sqrt(np.mean(changes[:, place] ** 2))) if len(changes) else 0.0
        steps.append(1.0 if category else moved if moved > 0.0 else (span[1] - span[0]) / 100)
    warnings = []
    if still:
        shown = ", ".join(still[:8]) + (", ..." if len(still) > 8 else "")
        warnings.append(
            f"features without bounds that never changed in the warm-up: {shown}; env.gym.scale or a longer env.gym.warmup_steps would scale them"
        )
    return bounds, ranges, steps, warnings


def _single(value: float) -> float:
    return float(np.float32(value))
