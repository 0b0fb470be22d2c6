"""Waits for the end of the tests, however they end, and ends what they have started and left.

``python guard.py MARK`` outlives the process that started it. Whatever then still has ``MARK`` in
its environment gets SIGTERM, and after a while SIGKILL.
"""

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

#: A node ends within this time, s.
_END_S = 5.0


def watch():
    """Have whatever this process starts from now on end with it."""
    os.environ["FVS_TEST_MARK"] = mark = f"{os.getpid()} {time.time()}"
    nowhere = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.DEVNULL)
    command = [sys.executable, "-S", __file__, mark]
    subprocess.Popen(command, start_new_session=True, env={}, **nowhere)


def marked(mark):
    """Processes whose environment holds a mark."""
    found = []
    for environment in Path("/proc").glob("[0-9]*/environ"):
        with contextlib.suppress(OSError):  # it has just ended, or is somebody else's
            if mark in environment.read_bytes() and int(environment.parent.name) != os.getpid():
                found.append(int(environment.parent.name))
    return found


def main():
    """Wait, then end what is left."""
    mark = sys.argv[1].encode()
    while os.getppid() == int(mark.split()[0]):
        time.sleep(0.2)
    end_s, number = time.monotonic() + _END_S, signal.SIGTERM
    while left := marked(mark):
        if time.monotonic() > end_s:
            number = signal.SIGKILL
        for process in left:
            with contextlib.suppress(ProcessLookupError):
                os.kill(process, number)
        time.sleep(0.2)


if __name__ == "__main__":
    main()
