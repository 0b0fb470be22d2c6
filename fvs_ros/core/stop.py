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

_NOTED = (
    signal.SIGINT,
    signal.SIGTERM,
    signal.SIGHUP,  # the terminal was closed, or ssh was lost
    signal.SIGQUIT,
    signal.SIGUSR1,
    signal.SIGUSR2,
    signal.SIGALRM,
)
_IGNORED = (signal.SIGTSTP, signal.SIGTTOU, signal.SIGTTIN)


def listen() -> None:
    """Note the signals that ask for an end instead of dying from them.

    SIGHUP stays ignored where it is already, as under ``nohup``. Ctrl-Z and its like (SIGTSTP,
    SIGTTOU, SIGTTIN) are ignored: a suspended program leaves the arm moving at its last command.
    """
    for number in _NOTED:
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, lambda received, _frame: RECEIVED.append(received))
    for number in _IGNORED:
        signal.signal(number, signal.SIG_IGN)
