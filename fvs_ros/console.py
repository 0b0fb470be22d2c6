"""Standard output and error that never make their writer wait.

A terminal that is held (Ctrl-S), an ssh that stalls or a pipe that nobody reads blocks every
write, and with it the control loop that only wanted to log a line. So each of the two goes into
a pipe of our own that does not block; a thread carries it on. What does not fit is dropped.

A program that only tells what it found may wait; but a reader that leaves, as ``head`` does, is
no reason to fail.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import io
import os
import select
import sys
import threading
import time
from collections.abc import Iterator
from typing import Any

_STDOUT, _STDERR = 1, 2
_FIRST_FREE = 3
_CHUNK = 65536
#: How long the last words may take to arrive.
_LAST_WORDS_S = 0.5
_COLOURS = "RCUTILS_COLORIZED_OUTPUT"


class _Raw(io.RawIOBase):
    """Writes to a descriptor what it takes, and drops the rest."""

    def __init__(self, fd: int, tty: bool, waits: bool) -> None:
        self._fd = fd
        self._tty = tty
        self._waits = waits

    def writable(self) -> bool:
        return True

    def isatty(self) -> bool:
        return self._tty

    def fileno(self) -> int:
        return self._fd

    def write(self, data: Any, /) -> int:
        view = memoryview(data).cast("B")
        _write(self._fd, view, self._waits)
        return len(view)


def _write(fd: int, view: memoryview, waits: bool) -> None:
    """Write as much as the descriptor takes now, or all that a reader waits for."""
    while view:
        try:
            view = view[os.write(fd, view) :]
        except BlockingIOError:  # full; somebody else may have made a terminal so
            if not waits:
                return
            select.select([], [fd], [])
        except OSError:
            return


class _Channel:
    """One descriptor, led through a pipe while it is open.

    Attributes
    ----------
    original : int
        Another descriptor of where it led before.
    tty : bool
        Whether that is a terminal.
    """

    def __init__(self, fd: int) -> None:
        self._fd = fd
        self.original = _copy(fd)
        self.tty = os.isatty(self.original)
        source, sink = os.pipe()
        self._source = _above_standard(source)
        sink = _above_standard(sink)
        os.set_blocking(sink, False)
        os.dup2(sink, fd)
        os.close(sink)
        self._thread = threading.Thread(target=self._carry, name=f"console {fd}", daemon=True)
        self._thread.start()

    def _carry(self) -> None:
        while chunk := os.read(self._source, _CHUNK):
            _write(self.original, memoryview(chunk), waits=True)

    def restore(self) -> None:
        """Lead the descriptor back; the thread ends once all has arrived."""
        os.dup2(self.original, self._fd)

    def close(self, deadline_s: float) -> None:
        """Wait for the last words until ``deadline_s``; a blocked reader is given up then."""
        self._thread.join(max(0.0, deadline_s - time.monotonic()))
        if not self._thread.is_alive():
            os.close(self.original)
            os.close(self._source)
        elif not select.select([], [self.original], [], 0.0)[1]:
            # Nothing said from here on, a traceback even, may hold the end of the process.
            with open(os.devnull, "wb") as nowhere:
                os.dup2(nowhere.fileno(), self._fd)


def _copy(fd: int) -> int:
    """A second descriptor above the standard ones; one that is closed becomes ``/dev/null``."""
    try:
        return fcntl.fcntl(fd, fcntl.F_DUPFD_CLOEXEC, _FIRST_FREE)
    except OSError as error:
        if error.errno != errno.EBADF:
            raise
    nowhere = _above_standard(os.open(os.devnull, os.O_WRONLY))
    os.dup2(nowhere, fd)
    return nowhere


def _above_standard(fd: int) -> int:
    """The descriptor, moved if it took the place of a standard one that was closed."""
    if fd >= _FIRST_FREE:
        return fd
    moved = fcntl.fcntl(fd, fcntl.F_DUPFD_CLOEXEC, _FIRST_FREE)
    os.close(fd)
    return moved


def _stream(name: str, fd: int, tty: bool, waits: bool) -> io.TextIOWrapper | None:
    """A text stream that drops instead of raising; None if the present one leads elsewhere."""
    present = getattr(sys, name)
    if present is not None:
        try:
            if present.fileno() != fd:
                return None
        except (OSError, ValueError, AttributeError):
            return None
        with contextlib.suppress(OSError, ValueError):
            present.flush()
    return io.TextIOWrapper(
        _Raw(fd, tty, waits),  # type: ignore[arg-type]
        encoding=getattr(present, "encoding", None) or "utf-8",
        errors="backslashreplace",
        line_buffering=True,
    )


@contextlib.contextmanager
def reader_may_leave() -> Iterator[None]:
    """Let standard output and error be closed at their other end: what is said then is dropped.

    A program that was piped into ``head`` goes on and ends as it would, without a traceback. It
    still waits for a slow reader. Also a decorator of a program's ``main``.
    """
    before = sys.stdout, sys.stderr
    streams = (  # one that was closed before the start stays so: its descriptor may be another's
        sys.stdout and _stream("stdout", _STDOUT, os.isatty(_STDOUT), waits=True),
        sys.stderr and _stream("stderr", _STDERR, os.isatty(_STDERR), waits=True),
    )
    sys.stdout, sys.stderr = (s or b for s, b in zip(streams, before, strict=True))
    try:
        yield
    finally:
        for stream in streams:
            if stream is not None and not stream.closed:
                stream.flush()
        sys.stdout, sys.stderr = before


@contextlib.contextmanager
def never_blocking() -> Iterator[tuple[int, int]]:
    """Make writes to standard output and error return at once, of Python and of C alike.

    Writes that find the pipe full are dropped: 64 KiB may wait for a reader. ``isatty`` of the
    streams in :mod:`sys` and the colours of ROS's log stay as they were. Afterwards both lead
    where they led, or nowhere if that is still blocked after half a second.

    Yields
    ------
    tuple of int
        Descriptors of the original output and error, for a child process.
    """
    out, err = channels = (_Channel(_STDOUT), _Channel(_STDERR))
    before = sys.stdout, sys.stderr
    streams = (
        _stream("stdout", _STDOUT, out.tty, waits=False),
        _stream("stderr", _STDERR, err.tty, waits=False),
    )
    sys.stdout, sys.stderr = (s or b for s, b in zip(streams, before, strict=True))
    coloured = err.tty and _COLOURS not in os.environ
    if coloured:
        os.environ[_COLOURS] = "1"
    try:
        yield out.original, err.original
    finally:
        for stream in streams:
            if stream is not None and not stream.closed:
                stream.flush()
        sys.stdout, sys.stderr = before
        if coloured:
            os.environ.pop(_COLOURS, None)
        for channel in channels:
            channel.restore()
        deadline_s = time.monotonic() + _LAST_WORDS_S
        for channel in channels:
            channel.close(deadline_s)
