"""SIGINT and SIGTERM, noted from a program's first moment on.

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


def listen() -> None:
    """Note SIGINT and SIGTERM instead of dying from them."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda received, _frame: RECEIVED.append(received))
