"""Signals: none that can be noted ends a program by itself."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from fvs_ros import stop

DOCS = Path(__file__).resolve().parents[2] / "docs" / "real_ur5.md"
#: What cannot be noted, and what a crash raises again and again.
LETHAL = {"SIGKILL", "SIGSTOP", "SIGSEGV", "SIGBUS", "SIGFPE", "SIGILL"}
#: What ends no program, and what would suspend one, which is ignored.
HARMLESS = {"SIGCHLD", "SIGCONT", "SIGURG", "SIGWINCH", "SIGPIPE", "SIGXFSZ"}
HARMLESS |= {"SIGTSTP", "SIGTTIN", "SIGTTOU"}
CODE = """
import signal, sys
from fvs_ros import stop
stop.listen()
signal.raise_signal(int(sys.argv[1]))
print(stop.RECEIVED)
"""


@pytest.mark.parametrize("number", map(int, sorted(signal.valid_signals())))
def test_a_signal_that_would_end_a_program_is_noted_or_named_in_the_docs(number):
    name = stop.name_of(number)
    if name in LETHAL:
        assert name in DOCS.read_text(encoding="utf-8")
        return
    done = subprocess.run(
        [sys.executable, "-S", "-c", CODE, str(number)], capture_output=True, text=True, check=False
    )
    noted = [] if name in HARMLESS else [number]
    assert (done.returncode, done.stdout.strip()) == (0, str(noted)), done.stderr
