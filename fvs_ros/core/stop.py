"""SIGINT and SIGTERM, noted from a program's first moment on.

A program calls :func:`listen` before its slow imports. From then on a signal ends nothing by
itself: it is noted in :data:`RECEIVED`, and the program's loop looks there. So the last zero
command can always be sent, and a signal during start-up is a clean end, too.
"""

from __future__ import annotations

import signal

#: Signals that have come so far.
RECEIVED: list[int] = []


def listen() -> None:
    """Note SIGINT and SIGTERM instead of dying from them."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda received, _frame: RECEIVED.append(received))
