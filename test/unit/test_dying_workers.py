"""A worker that dies, or a test that is stuck, fails the run and is named; nothing hangs."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

_ROOT = Path(__file__).resolve().parents[2]
_STUCK = """
import os, pytest, subprocess
@pytest.mark.timeout(0.5)
def test_stuck(): subprocess.run(["sleep", "100"])
"""
_KILLED = """
def test_killed(): os.kill(os.getpid(), 9)
def test_after(): pass
"""


def test_a_run_whose_worker_dies_ends_and_fails(tmp_path):
    pytest.importorskip("xdist")
    (tmp_path / "nodes").mkdir()
    (tmp_path / "nodes" / "test_it.py").write_text(_STUCK + _KILLED)
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTEST_")}
    command = [sys.executable, "-m", "pytest", "-c", str(_ROOT / "setup.cfg"), "--rootdir=."]
    command += ["-p", "conftest", "-p", "no:cacheprovider", "-o", "faulthandler_timeout=3"]
    run = subprocess.run(
        [*command, "-n", "1", "nodes"],
        cwd=tmp_path,
        env={**environment, "PYTHONPATH": f"{_ROOT}:{_ROOT / 'test'}"},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert run.returncode == 1, run.stdout + run.stderr
    for words in ("test_stuck - Failed: Timeout", "test_killed - worker 'gw0' crashed"):
        assert words in run.stdout, run.stdout
