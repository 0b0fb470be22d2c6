"""How a process that only watches or computes ahead keeps out of the loop's way."""

from __future__ import annotations

import contextlib
import ctypes
import os
import platform
import struct
from pathlib import Path

#: Of a core that is wanted by the loop, too, next to nothing is left for the others.
LEAST = 19
#: Number of the system call ``sched_setattr``, which the C library has no word for.
_SCHED_SETATTR = {"x86_64": 314, "aarch64": 274}.get(platform.machine())
#: ``struct sched_attr``: size, policy, flags, nice, priority, and three times in ns, of which an
#: ordinary process has the first, its turn.
_ATTRIBUTES = struct.Struct("=IIQiIQQQ")
#: The longest turn that the kernel gives, s.
_LONG_TURN_S = 0.1


def step_back(niceness: int = LEAST, own_session: bool = False) -> None:
    """Let the loop go first wherever there are too few cores for all.

    Every thread of the process takes smaller shares and, where the kernel knows of them (Linux
    from 6.12 on), longer turns: a process with turns of the usual length that wakes up meanwhile
    does not wait for the end of a long one.

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
            _take_long_turns(int(thread), nice)
    if os.getsid(0) == os.getpid():
        with contextlib.suppress(OSError):  # not every kernel has it
            Path("/proc/self/autogroup").write_text(str(niceness), encoding="ascii")


def _take_long_turns(thread: int, niceness: int) -> None:
    if _SCHED_SETATTR is None:
        return
    turn_ns = round(1e9 * _LONG_TURN_S)
    words = _ATTRIBUTES.pack(_ATTRIBUTES.size, os.SCHED_OTHER, 0, niceness, 0, turn_ns, 0, 0)
    # Whether it is heard does not matter: without it, it is as it was before.
    ctypes.CDLL(None).syscall(_SCHED_SETATTR, thread, ctypes.c_char_p(words), 0)
