"""Schemes of the paper and beyond, and one more estimator, in the whole loop over DDS.

The paper's own is what the demo runs: test_launcher.py.
"""

import json
import subprocess
import sys

import pytest

from fvs_ros.core.schemes import BEYOND, SCHEMES

MODULE = "fvs_ros.apps.launcher"
SHORT = ["-p", "use_sim_time:=true", "-p", "simulated_time:=true", "-p", "targets:=1"]


def settles(ros_test, *arguments):
    """Run the demo with one target; fail with its output unless the ball settles."""
    folder = ros_test.folder / "result"
    process = ros_test.start(
        MODULE, "demo", *SHORT, "-p", "target_s:=3.0", "-p", f"output_dir:={folder}", *arguments
    )
    assert ros_test.wait(process, 90.0) == 0, ros_test.output(process)
    result = json.loads((folder / "results.json").read_text())
    assert len(result) == 1
    assert result[0]["settling_5mm_s"] < 2.5, result
    assert result[0]["final_rms_m"] < 0.003, result
    assert result[0]["peak_joint_speed_rad_s"] < 1.1, result


@pytest.mark.parametrize(
    "name",
    [name for name in (*SCHEMES, *BEYOND) if name not in ("proposed", "rbf+pid", "ukf+mfac")],
)
def test_a_scheme_settles(ros_test, name):
    settles(ros_test, "--scheme", name)


def test_any_estimator_serves_any_law(ros_test):
    settles(ros_test, "-p", "method:=lkf", "-p", "law:=proportional")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["demo", "--scheme", "rbf+mpc"], "unknown scheme 'rbf+mpc'; known are proposed, rbf+pid"),
        (["collect", "--scheme", "proposed"], "needs fvs_estimator_node and fvs_controller_node"),
    ],
)
def test_a_scheme_that_does_not_fit_starts_nothing(arguments, words):
    done = subprocess.run(
        [sys.executable, "-m", MODULE, *arguments], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert words in done.stderr
