"""Looks at an environment before a run, in a process of its own: one question on standard input, one answer on standard output."""

from __future__ import annotations

import json
import os
import sys
import threading
import traceback
from typing import Any

from . import _trestle
from ._refused import Refused

#: Calls of a traceback that the answer shows, the last ones.
_MAX_CALLS = 3


def probe() -> int:
    """Answer the question on standard input; 0 if there was one."""
    question = sys.stdin.readline()
    if not question:
        return 2
    # What the environment prints is no answer.
    answer = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    threading.Thread(target=_leave_with_parent, daemon=True).start()
    json.dump(_answer(json.loads(question)), answer, allow_nan=False)
    answer.write("\n")
    answer.close()
    return 0


def _leave_with_parent() -> None:
    while os.read(0, 1):
        pass
    os._exit(1)


def _told(error: BaseException) -> str:
    """The exception, and then where it came from: the last calls, each whole."""
    said = "".join(traceback.format_exception_only(error)).strip()
    calls = traceback.format_tb(error.__traceback__)[-_MAX_CALLS:]
    return "\n".join([said, *(call.rstrip() for call in calls)])


def _answer(question: dict[str, Any]) -> dict[str, Any]:
    if (question["version"], question["build"]) != (_trestle.VERSION, _trestle.BUILD):
        return {"other": {"version": _trestle.VERSION, "build": _trestle.BUILD}}
    if question["settings"] is None:
        return {"same": {}}
    from . import _gym

    try:
        return {"found": _gym.find(question["settings"], seed=question["seed"], step_limit=question["step_limit"])}
    except Refused as error:
        return {"refused": str(error)}
    except Exception as error:
        return {"refused": f"{_gym.name_of(question['settings'])} raised {_told(error)}"}
