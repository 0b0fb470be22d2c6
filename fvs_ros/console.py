"""Standard output and error that never block their writer.

A stopped terminal (Ctrl-S), a stalled ssh or an unread pipe blocks every write, and with it a
control loop that logs a line. So each stream goes into a non-blocking pipe, which a thread
forwards; what does not fit is dropped.

A program that only prints results may block, but must not fail when its reader leaves, as ``head``
does.
"""

from __future__ import annotations

import contextlib
import io
import os
import sys
import threading
from collections.abc import Iterator
from typing import Any

#: Longest wait for the last output, s.
_LAST_OUTPUT_S = 0.5


class _Dropping(io.FileIO):
    """Writes what its descriptor accepts; drops the rest."""

    def __init__(self, fd: int, tty: bool) -> None:
        super().__init__(fd, "w", closefd=False)
        self._tty = tty

    def isatty(self) -> bool:
        return self._tty

    def write(self, data: Any, /) -> int:
        written = None
        with contextlib.suppress(OSError):
            written = super().write(data)
        return memoryview(data).nbytes if written is None else written


@contextlib.contextmanager
def _replaced(name: str, fd: int, tty: bool) -> Iterator[None]:
    """Make a stream of :mod:`sys` drop instead of raise, if it writes to this descriptor."""
    before = getattr(sys, name)
    try:
        before.flush()
        ours = before.fileno() == fd
    except (AttributeError, OSError, ValueError):  # closed from the start, or a test's own
        ours = False
    if not ours:
        yield
        return
    stream = io.TextIOWrapper(
        io.BufferedWriter(_Dropping(fd, tty)),
        encoding=before.encoding,
        errors="backslashreplace",
        line_buffering=True,
    )
    setattr(sys, name, stream)
    try:
        yield
    finally:
        stream.flush()
        setattr(sys, name, before)


@contextlib.contextmanager
def reader_may_leave() -> Iterator[None]:
    """Drop what is printed after the reader left: a program piped into ``head`` ends as usual.

    It still waits for a slow reader. Also a decorator of a program's ``main``.
    """
    with _replaced("stdout", 1, os.isatty(1)), _replaced("stderr", 2, os.isatty(2)):
        yield


@contextlib.contextmanager
def never_blocking() -> Iterator[tuple[int, int]]:
    """Make writes to standard output and error return at once, of Python and of C alike.

    Writes that find the pipe full are dropped: 64 KiB may wait for a reader. ``isatty`` of the
    streams in :mod:`sys` and the colours of ROS's log stay as they were. Afterwards both lead
    to their original targets, or nowhere if those are still blocked after half a second. Yields
    descriptors of the original output and error, for a child process.
    """
    for fd in range(3):
        try:
            os.fstat(fd)
        except OSError:  # closed: nothing else may take its number
            os.open(os.devnull, os.O_RDWR)
    if os.isatty(2):
        os.environ.setdefault("RCUTILS_COLORIZED_OUTPUT", "1")
    with _piped("stdout", 1) as out, _piped("stderr", 2) as err:
        yield out, err


@contextlib.contextmanager
def _piped(name: str, fd: int) -> Iterator[int]:
    """Redirect a descriptor through a pipe; yields a descriptor of its original target."""
    original = os.dup(fd)
    source, sink = os.pipe()
    os.set_blocking(sink, False)
    os.dup2(sink, fd)
    os.close(sink)
    carrier = threading.Thread(target=_carry, args=(source, original), daemon=True)
    carrier.start()
    try:
        with _replaced(name, fd, os.isatty(original)):
            yield original
    finally:
        os.dup2(original, fd)  # the pipe is closed, and the thread ends once all has arrived
        carrier.join(_LAST_OUTPUT_S)
        if carrier.is_alive():
            # No later output, not even a traceback, may hold the end of the process.
            with open(os.devnull, "wb") as nowhere:
                os.dup2(nowhere.fileno(), fd)
        else:
            os.close(source)
            os.close(original)


def _carry(source: int, original: int) -> None:
    sink = io.BufferedWriter(_Dropping(original, tty=False))
    while chunk := os.read(source, 65536):
        sink.write(chunk)
        sink.flush()
