"""Stepping back is for the whole process, and whoever cannot goes on as before."""

import json
import os
import subprocess
import sys

import pytest

_CHILD = """
import json, os, sys, threading
from fvs_ros.background import step_back
done = threading.Event()
thread = threading.Thread(target=done.wait)
thread.start()
step_back(7, own_session=sys.argv[1] == "own")
threads = os.listdir("/proc/self/task")
print(json.dumps({
    "nice": [os.getpriority(os.PRIO_PROCESS, int(thread)) for thread in threads],
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
