"""Standard output and error that never make their writer wait.

A terminal that is held (Ctrl-S), an ssh that stalls or a pipe that nobody reads blocks every
write, and with it the control loop that only wanted to log a line. So each of the two goes into
a pipe of our own that does not block; a thread carries it on. What does not fit is dropped.
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
    """Writes to a descriptor what fits, and drops the rest."""

    def __init__(self, fd: int, tty: bool) -> None:
        self._fd = fd
        self._tty = tty

    def writable(self) -> bool:
        return True

    def isatty(self) -> bool:
        return self._tty

    def fileno(self) -> int:
        return self._fd

    def write(self, data: Any, /) -> int:
        view = memoryview(data).cast("B")
        _write(self._fd, view)
        return len(view)


def _write(fd: int, view: memoryview) -> None:
    """Write as much as the descriptor takes."""
    with contextlib.suppress(OSError):
        while view:
            view = view[os.write(fd, view) :]


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
        reader_left = False
        while chunk := os.read(self._source, _CHUNK):
            view = memoryview(chunk)
            while view and not reader_left:
                try:
                    view = view[os.write(self.original, view) :]
                except BlockingIOError:  # somebody else made the terminal so
                    select.select([], [self.original], [])
                except OSError:
                    reader_left = True

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


def _stream(name: str, channel: _Channel, fd: int) -> io.TextIOWrapper | None:
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
        _Raw(fd, channel.tty),  # type: ignore[arg-type]
        encoding=getattr(present, "encoding", None) or "utf-8",
        errors="backslashreplace",
        line_buffering=True,
    )


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
    streams = _stream("stdout", out, _STDOUT), _stream("stderr", err, _STDERR)
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
