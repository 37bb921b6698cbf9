"""The program ``trestle``: every process of a run is this module with another subcommand."""

from __future__ import annotations

import os
import signal
import sys
from typing import NoReturn

from . import _trestle

#: The subcommands of Python's: the one that looks at an environment before a run, and the one that sends runs to a tracker.
_PROBE, _SENDER = "gym-probe", "tracker-sync"


def main() -> NoReturn:
    """Carry out the command line and end this process with the command's status."""
    # Python's own handler would only take notice of a signal between two bytecodes.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    os.register_at_fork(after_in_child=_trestle.forked)
    arguments = sys.argv[1:]
    if arguments[:1] == [_PROBE]:
        from ._probe import probe

        status = probe()
    elif arguments[:1] == [_SENDER]:
        from ._sync import sync

        status = sync(*arguments[1:])
    else:
        status = _trestle.main(["trestle", *arguments], [sys.executable, "-m", "trestle"])
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, ValueError):
            pass
    # Threads that an environment has left behind must not keep the process alive.
    os._exit(status)


if __name__ == "__main__":
    main()
