"""Signals that would end a program, noted from its first moment on.

A program calls :func:`listen` before its slow imports. From then on a signal ends nothing by
itself: it is noted in :data:`RECEIVED`, and the program's loop looks there. So the last zero
command can always be sent, and a signal during start-up is a clean end, too.
"""

from __future__ import annotations

import signal

#: Exit codes of every program: done or stopped by a signal, an error, a wrong parameter or file.
EXIT_OK, EXIT_FAILURE, EXIT_BAD_INPUT = 0, 1, 2

#: Signals that have come so far.
RECEIVED: list[int] = []

#: What would suspend a program, with the arm moving at its last command.
_IGNORED = {signal.SIGTSTP, signal.SIGTTOU, signal.SIGTTIN}
#: What no program can note, what a crash would raise again and again, and what ends no program.
_LEFT = {
    *(signal.SIGKILL, signal.SIGSTOP),
    *(signal.SIGSEGV, signal.SIGBUS, signal.SIGFPE, signal.SIGILL),
    *(signal.SIGCHLD, signal.SIGCONT, signal.SIGURG, signal.SIGWINCH),
    *(signal.SIGPIPE, signal.SIGXFSZ),  # errors of the write, in Python
}


def listen() -> None:
    """Note every signal that would end the program, instead of dying from it.

    SIGHUP stays ignored where it is already, as under ``nohup``.
    """
    for number in signal.valid_signals() - _LEFT - _IGNORED:
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, lambda received, _frame: RECEIVED.append(received))
    for number in _IGNORED:
        signal.signal(number, signal.SIG_IGN)


def name_of(number: int) -> str:
    """Name of a signal, such as SIGTERM; most real-time signals have none."""
    return {member.value: member.name for member in signal.Signals}.get(number, f"signal {number}")
