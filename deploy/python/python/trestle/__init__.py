"""Trestle: deep implicit imitation Q-learning for agents whose actions differ from their mentor's.

The package holds the whole program: ``trestle`` and ``python -m trestle`` are its command line. From Python,

* :func:`train` trains an agent and returns its :class:`Run`;
* :func:`load` gives the :class:`Policy` of a run's checkpoint;
* :func:`record` writes the states that a policy visits as a demonstration for ``mentor.demo``.
"""

from __future__ import annotations

from ._policy import Policy, load
from ._record import Predicts, record
from ._run import Progress, Result, Run, TrainingError, train
from ._trestle import VERSION as __version__

__all__ = [
    "Policy",
    "Predicts",
    "Progress",
    "Result",
    "Run",
    "TrainingError",
    "__version__",
    "load",
    "record",
    "train",
]
