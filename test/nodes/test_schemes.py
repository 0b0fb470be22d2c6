"""Another scheme of the paper, and one more estimator, in the whole loop over DDS.

The paper's own is what the demo runs: test_launcher.py. Those beyond it: test_beyond_topics.py.
"""

import json
import subprocess
import sys

import pytest

MODULE = "fvs_tools.launcher"
SHORT = ["-p", "use_sim_time:=true", "-p", "simulated_time:=true", "-p", "targets:=1"]


def test_any_estimator_serves_any_law_whether_named_by_the_scheme_or_alone(ros_test):
    arguments = ["--scheme", "ukf+mpc", "-p", "method:=lkf"]
    folder = ros_test.folder / "result"
    process = ros_test.start(
        MODULE, "demo", *SHORT, "-p", "target_s:=3.0", "-p", f"output_dir:={folder}", *arguments
    )
    assert ros_test.wait(process, 90.0) == 0, ros_test.output(process)
    (result,) = json.loads((folder / "results.json").read_text())
    assert result["settling_5mm_s"] < 2.5, result
    assert result["final_rms_m"] < 0.003, result
    assert result["peak_joint_speed_rad_s"] < 1.1, result


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["demo", "--scheme", "rbf+mpc"], "unknown scheme 'rbf+mpc'; did you mean ukf+mpc?"),
        (["collect", "--scheme", "proposed"], "needs fvs_estimator_node and fvs_controller_node"),
    ],
)
def test_a_scheme_that_does_not_fit_starts_nothing(arguments, words):
    done = subprocess.run(
        [sys.executable, "-m", MODULE, *arguments], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert words in done.stderr
