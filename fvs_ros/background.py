"""How a process that only watches or computes ahead keeps out of the loop's way."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

#: Of a core that is wanted by the loop, too, next to nothing is left for the others.
LEAST = 19


def step_back(niceness: int = LEAST, own_session: bool = False) -> None:
    """Let the loop go first wherever there are too few cores for all.

    Every thread of the process takes smaller shares.

    Parameters
    ----------
    niceness : int
        How far, 1 to 19.
    own_session : bool
        Leave the parent's session first. For a child without a terminal: the kernel may share the
        cores among sessions before it shares them among their processes (autogroup), and then a
        child that stays in the loop's session takes its turn as if it were the loop.
    """
    if own_session and os.getsid(0) != os.getpid():
        with contextlib.suppress(OSError):  # the leader of a process group may not
            os.setsid()
    for thread in os.listdir("/proc/self/task"):
        with contextlib.suppress(ProcessLookupError):  # it has just ended
            # One that was started further back stays there: it may not come forward.
            nice = max(niceness, os.getpriority(os.PRIO_PROCESS, int(thread)))
            os.setpriority(os.PRIO_PROCESS, int(thread), nice)
    if os.getsid(0) == os.getpid():
        with contextlib.suppress(OSError):  # not every kernel has it
            Path("/proc/self/autogroup").write_text(str(niceness), encoding="ascii")
