"""Standard output and error that never wait, in processes of their own."""

import subprocess
import sys

OPEN = """
import os, sys, time
from fvs_ros import console
"""


def run(body):
    command = [sys.executable, "-c", OPEN + body]
    return subprocess.run(command, check=False, timeout=20, capture_output=True, text=True)


def test_what_is_said_arrives_in_order():
    done = run("""
with console.never_blocking():
    for number in range(3000):
        print(number)
        os.write(1, b"and\\n")
    print("no newline", end="")
    print("as usual", file=sys.stderr)
print(" after")
""")
    lines = [line for number in range(3000) for line in (str(number), "and")]
    assert done.stdout.splitlines() == [*lines, "no newline after"]
    assert (done.returncode, done.stderr) == (0, "as usual\n")


def test_a_crash_is_still_told_and_the_descriptors_are_as_before():
    done = run("""
def state():
    return [os.fstat(fd).st_ino for fd in (1, 2)], sys.stdout, sys.stderr, os.listdir("/dev/fd")
before = state()
with console.never_blocking():
    assert os.fstat(1).st_ino != before[0][0]
assert state() == before
with console.never_blocking():
    raise KeyError("the crash")
""")
    assert done.returncode == 1
    assert done.stderr.endswith("KeyError: 'the crash'\n")
