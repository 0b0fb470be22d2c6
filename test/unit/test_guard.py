"""Tests that are killed leave no process behind."""

import os
import subprocess
import sys
import time
from pathlib import Path

KILLED = """
import os, subprocess, guard
guard.watch()
lasting = ["sh", "-c", "trap '' HUP INT; sleep 600"]
print(subprocess.Popen(lasting, start_new_session=True, stdout=2).pid, flush=True)
os.kill(os.getpid(), 9)
"""


def runs(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_what_killed_tests_have_started_ends():
    tests = subprocess.run(
        [sys.executable, "-c", KILLED], stdout=subprocess.PIPE, text=True, check=False
    )
    assert tests.returncode == -9
    end_s = time.monotonic() + 10.0 * float(os.environ["FVS_TEST_SLOWNESS"])
    while runs(int(tests.stdout)) and time.monotonic() < end_s:
        time.sleep(0.05)
    assert not runs(int(tests.stdout))
