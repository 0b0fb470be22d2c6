"""Signals: none that can be noted ends a program by itself."""

import signal
import subprocess
import sys
from pathlib import Path

from fvs_ros import stop

DOCS = Path(__file__).resolve().parents[2] / "docs" / "safety.md"
#: What cannot be noted, and what a crash raises again and again.
LETHAL = {"SIGKILL", "SIGSTOP", "SIGSEGV", "SIGBUS", "SIGFPE", "SIGILL"}
#: What ends no program, and what would suspend one, which is ignored.
HARMLESS = {"SIGCHLD", "SIGCONT", "SIGURG", "SIGWINCH", "SIGPIPE", "SIGXFSZ"}
HARMLESS |= {"SIGTSTP", "SIGTTIN", "SIGTTOU"}
#: Raises each of the given signals in a process of its own, and tells how it ended.
CODE = """
import os, signal, sys
from fvs_ros import stop
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # nohup ignores it
for number in map(int, sys.argv[1:]):
    child = os.fork()
    if not child:
        stop.listen()
        signal.raise_signal(number)
        print(number, stop.RECEIVED, flush=True)
        os._exit(0)
    assert os.waitpid(child, 0)[1] == 0, number
"""


def test_a_signal_that_would_end_a_program_is_noted_or_named_in_the_docs():
    docs, numbers = DOCS.read_text(encoding="utf-8"), []
    for number in map(int, sorted(signal.valid_signals())):
        if stop.name_of(number) not in LETHAL:
            numbers.append(number)
        else:
            assert stop.name_of(number) in docs
    done = subprocess.run(
        [sys.executable, "-S", "-c", CODE, *map(str, numbers)],
        capture_output=True,
        text=True,
        check=False,
    )
    noted = [f"{n} {[] if stop.name_of(n) in HARMLESS else [n]}" for n in numbers]
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == noted
