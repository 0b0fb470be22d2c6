"""Lowers the priority of processes that must not slow down the control loop."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

#: The lowest priority: beside the loop on one core, such a process gets almost nothing.
LEAST = 19


def step_back(niceness: int = LEAST, own_session: bool = False) -> None:
    """Lower the priority of every thread of this process.

    Parameters
    ----------
    niceness : int
        1 to 19; 19 is the lowest priority.
    own_session : bool
        Leave the parent's session first, for a child without a terminal. The kernel may share the
        cores among sessions first (autogroup); a child in the loop's session then competes as if
        it were the loop.
    """
    if own_session and os.getsid(0) != os.getpid():
        with contextlib.suppress(OSError):  # a process group leader may not
            os.setsid()
    for thread in os.listdir("/proc/self/task"):
        with contextlib.suppress(ProcessLookupError):  # it has just ended
            # A lower priority stays: raising it is not permitted.
            nice = max(niceness, os.getpriority(os.PRIO_PROCESS, int(thread)))
            os.setpriority(os.PRIO_PROCESS, int(thread), nice)
    if os.getsid(0) == os.getpid():
        with contextlib.suppress(OSError):  # not every kernel has it
            Path("/proc/self/autogroup").write_text(str(niceness), encoding="ascii")
