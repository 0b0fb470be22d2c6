"""The launcher with real nodes: the whole loop, its end, and its refusals."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from geometry_msgs.msg import PointStamped
from std_msgs.msg import Float64MultiArray

from fvs_ros.core import ros

MODULE = "fvs_ros.apps.launcher"


def children(process):
    """Processes that a process has started and that still run."""
    out = subprocess.run(
        ["ps", "--ppid", str(process.pid), "-o", "pid="],
        capture_output=True,
        text=True,
        check=False,
    )
    return [int(pid) for pid in out.stdout.split()]


def command_line(pid):
    return Path(f"/proc/{pid}/cmdline").read_text()


def alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_the_demo_settles_every_target(ros_test):
    simulated = ["-p", "use_sim_time:=true", "-p", "simulated_time:=true"]
    short = ["-p", "targets:=2", "-p", "target_s:=3.0", "-p", "fvs_demo_node:seed:=5"]
    process = ros_test.start(MODULE, "demo", *simulated, *short)
    assert ros_test.wait(process, 90.0) == 0, ros_test.output(process)
    folder = ros_test.folder / "out" / "demo"
    results = json.loads((folder / "results.json").read_text())
    assert len(results) == 2
    for result in results:
        assert 0.25 < result["start_distance_m"] < 0.35
        assert result["settling_5mm_s"] < 2.0
        assert result["final_rms_m"] < 0.0015
        assert result["peak_joint_speed_rad_s"] < 1.1
    assert (folder / "demo.png").stat().st_size > 20_000
    assert "to 5 mm" in ros_test.output(process)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_in_motion_ends_all_with_zeros_last(ros_test, number):
    commands = ros_test.collect(Float64MultiArray, ros.COMMANDS)
    target = ros_test.node.create_publisher(PointStamped, ros.TARGET_POSITION, ros.QOS_LATCHED)
    truths = ros_test.collect(PointStamped, "fvs_sim_node/true_ball_position")
    process = ros_test.start(MODULE, "servo")
    ros_test.spin_until(lambda: bool(truths), 30.0, "the simulator")
    ball = truths[-1].point
    point = np.array([ball.x - 0.1, ball.y - 0.1, ball.z - 0.2])
    target.publish(ros.to_point(1.0, "camera_color_optical_frame", point))
    ros_test.spin_until(
        lambda: commands and max(np.abs(commands[-1].data)) > 0.3, 20.0, "the arm to move"
    )
    nodes = children(process)
    assert len(nodes) == 3
    assert ros_test.stop(process, number) == 0, ros_test.output(process)
    ros_test.spin_for(0.2)
    assert not np.any([m.data for m in commands[-3:]])
    assert not any(alive(pid) for pid in nodes)


@pytest.mark.parametrize("delay_s", [0.15, 0.3, 0.5, 0.8, 1.2])
def test_a_signal_at_any_moment_of_the_start_ends_all(ros_test, delay_s):
    process = ros_test.start(MODULE, "servo")
    ros_test.spin_for(delay_s)
    nodes = children(process)
    assert ros_test.stop(process, signal.SIGINT) == 0, ros_test.output(process)
    assert not any(alive(pid) for pid in nodes)
    assert "Traceback" not in ros_test.output(process)


def test_a_node_that_dies_brings_all_down_and_is_named(ros_test):
    process = ros_test.start(MODULE, "servo")
    truths = ros_test.collect(PointStamped, "fvs_sim_node/true_ball_position")
    ros_test.spin_until(lambda: bool(truths), 30.0, "the simulator")
    nodes = children(process)
    estimator = next(pid for pid in nodes if "fvs_estimator_node" in command_line(pid))
    os.kill(estimator, signal.SIGKILL)
    assert ros_test.wait(process) == 1
    assert "fvs_estimator_node ended with signal SIGKILL" in ros_test.output(process)
    assert not any(alive(pid) for pid in nodes)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nowhere"], "no file nowhere.yaml"),
        (["servo", "-p", "law:=pid"], "law must be one of"),
        (["servo", "-p", "method:=psychic"], "method must be one of"),
        (["servo", "-p", "lawn:=ftsm"], "has a parameter lawn"),
        (["servo", "-p", "law:=["], "no YAML"),
        (["servo", "-p", "use_sim_time:=3"], "use_sim_time must be true or false"),
        (["servo", "--namespace", "a b"], "--namespace must be"),
    ],
)
def test_a_wrong_scenario_starts_nothing(tmp_path, arguments, words):
    done = subprocess.run(
        [sys.executable, "-m", MODULE, *arguments], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert words in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda path: None, "no file"),
        (lambda path: path.write_bytes(b"not a model"), "model"),
        (lambda path: np.savez(path, centres=np.zeros(3)), "model"),
    ],
)
def test_a_missing_or_foreign_model_is_one_clear_sentence(ros_test, make, words):
    path = ros_test.folder / "model.npz"
    make(path)
    process = ros_test.start_node("fvs_estimator_node.node", model_path=str(path))
    assert ros_test.wait(process) == 2
    output = ros_test.output(process)
    assert words in output
    assert "model.npz" in output
    assert "Traceback" not in output


def test_scenario_files_serve_ros_params_file_as_well(ros_test):
    path = ros_test.folder / "scenario.yaml"
    path.write_text(yaml.safe_dump({"fvs_sim_node": {"ros__parameters": {"tf_prefix": "ur_"}}}))
    from sensor_msgs.msg import JointState

    states = ros_test.collect(JointState, ros.JOINT_STATES)
    ros_test.start("fvs_sim_node.node", "--ros-args", "--params-file", str(path))
    ros_test.spin_until(lambda: bool(states))
    assert states[-1].name[0] == "ur_elbow_joint"


def test_a_namespace_moves_every_topic_and_the_parameters_still_apply(ros_test):
    from sensor_msgs.msg import JointState

    states = ros_test.collect(JointState, "left/joint_states")
    ros_test.start(MODULE, "servo", "--namespace", "left", "-p", "joint_state_order:=kinematic")
    ros_test.spin_until(lambda: bool(states), 30.0)
    assert states[-1].name[0] == "shoulder_pan_joint"
