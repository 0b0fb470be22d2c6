"""Stepping back is for the whole process, and whoever cannot goes on as before."""

import json
import os
import platform
import subprocess
import sys

import pytest

_CHILD = """
import json, os, re, sys, threading
from pathlib import Path
from fvs_ros.background import step_back
done = threading.Event()
thread = threading.Thread(target=done.wait)
thread.start()
step_back(7, own_session=sys.argv[1] == "own")
def turn_ns(thread):
    told = Path(f"/proc/self/task/{thread}/sched")
    found = told.exists() and re.search(r"se.slice +: *(\\d+)", told.read_text())
    return int(found[1]) if found else None
threads = os.listdir("/proc/self/task")
print(json.dumps({
    "nice": [os.getpriority(os.PRIO_PROCESS, int(thread)) for thread in threads],
    "turns_ns": [turn_ns(thread) for thread in threads],
    "own": os.getsid(0) == os.getpid(),
}))
done.set()
"""


@pytest.mark.parametrize("session", ["own", "parent's"])
def test_every_thread_steps_back_and_the_session_is_left_if_told(session):
    done = subprocess.run(
        [sys.executable, "-c", _CHILD, session], capture_output=True, text=True, check=True
    )
    found = json.loads(done.stdout)
    nice = max(7, os.getpriority(os.PRIO_PROCESS, 0))  # nobody comes forward
    assert found["nice"] == [nice, nice]
    assert found["own"] == (session == "own")
    version = tuple(int(part) for part in platform.release().split(".")[:2])
    if version >= (6, 12) and None not in found["turns_ns"]:
        assert found["turns_ns"] == [100_000_000] * 2
