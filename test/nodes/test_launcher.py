"""The launcher with real nodes: the whole loop, its end, and its refusals."""

import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import programs_in_turn
import pytest
from geometry_msgs.msg import PointStamped
from harness import children, ros_arguments
from sensor_msgs.msg import Image
from std_msgs.msg import Float64MultiArray

from fvs_ros import ros, topics
from fvs_ros.kinds.ball import Ball
from fvs_ros.paths import program
from fvs_tools.scenario import NODE_TABLE

MODULE, SERVO = "fvs_tools.launcher", "fvs_tools.servo_node"
RECORD = ("--record", "bag", "-p", "images:=false")
EXECUTABLES = dict(
    re.findall(
        r'"(fvs_\w+)=([\w.]+):main"',
        (Path(__file__).resolve().parents[2] / "setup.py").read_text(encoding="utf-8"),
    )
)


def alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_ctrl_c_in_motion_ends_all_with_zeros_last_also_in_the_recording(ros_test):
    bag_reader = pytest.importorskip("fvs_tools.bag_reader")
    commands = ros_test.collect(Float64MultiArray, topics.COMMANDS.name)
    target = ros_test.node.create_publisher(PointStamped, Ball.topics.target.name, ros.QOS_LATCHED)
    truths = ros_test.collect(PointStamped, "fvs_sim_node/true_ball_position")
    process = ros_test.start(MODULE, "servo", *RECORD)
    ros_test.spin_until(lambda: bool(truths), 30.0, "the simulator")
    ball = truths[-1].point
    point = np.array([ball.x - 0.1, ball.y - 0.1, ball.z - 0.2])
    target.publish(ros.to_feature(1.0, "camera_color_optical_frame", Ball(), point))
    ros_test.spin_until(
        lambda: commands and max(np.abs(commands[-1].data)) > 0.3, 20.0, "the arm to move"
    )
    nodes = children(process.pid)
    assert len(nodes) == 4
    assert ros_test.stop(process, signal.SIGINT) == 0, ros_test.output(process)
    ros_test.spin_for(0.2)
    assert not np.any([m.data for m in commands[-3:]])
    assert not any(alive(pid) for pid in nodes)
    with bag_reader.open_bag(ros_test.folder / "bag") as bag:
        of_arm = [each for each in bag.connections if each.topic == f"/{topics.COMMANDS.name}"]
        recorded = np.array([message.data for _, _, message in bag.decoded(of_arm)])
    assert np.abs(recorded).max() > 0.3
    assert not recorded[-3:].any()


def test_nothing_in_the_current_folder_is_run_and_a_killed_launcher_leaves_nothing(
    ros_test, monkeypatch
):
    here, temporary = ros_test.folder / "here", ros_test.folder / "temporary"
    here.mkdir()
    temporary.mkdir()
    monkeypatch.setenv("TMPDIR", str(temporary))
    for name in ("yaml", "numpy", "runpy", "signal", "multiprocessing", "pickle", "fvs_ros"):
        (here / f"{name}.py").write_text("import os; open('run', 'a').write(__file__)")
    if sys.version_info < (3, 11):  # where Python itself starts others with the folder on the path
        for name in ("multiprocessing", "pickle", "runpy", "signal"):
            (here / f"{name}.py").unlink()
    truths = ros_test.collect(PointStamped, "fvs_sim_node/true_ball_position")
    # For a look at the images the simulator starts a process.
    ros_test.node.create_subscription(Image, topics.COLOR_IMAGE.name, lambda _: None, 1)
    process = subprocess.Popen(
        [*program(MODULE), "servo"], cwd=here, env=ros_test.environment, stdout=subprocess.DEVNULL
    )
    try:
        nodes = []

        def renders():
            nodes[:] = children(process.pid)
            return bool(truths) and any(map(children, nodes))

        ros_test.spin_until(renders, 30.0, "the simulator, and a process of its own")
    finally:
        process.kill()
        process.wait()
    assert not (here / "run").exists()
    ros_test.spin_until(lambda: not any(map(alive, nodes)), what="the nodes to end with it")
    assert list(temporary.iterdir()) == []


def imports(pid):
    return "numpy" in Path(f"/proc/{pid}/maps").read_text()


@pytest.mark.parametrize("moment", [imports, children])
def test_a_signal_at_any_moment_of_the_start_ends_all(ros_test, moment):
    process = ros_test.start(MODULE, "servo")
    ros_test.spin_until(lambda: moment(process.pid), what="the moment")
    nodes = children(process.pid)
    assert ros_test.stop(process, signal.SIGINT) == 0, ros_test.output(process)
    assert not any(alive(pid) for pid in nodes)
    assert "Traceback" not in ros_test.output(process)


def test_a_recorder_that_gives_up_stops_nothing_and_a_node_that_dies_all(ros_test):
    pytest.importorskip("rosbags")
    process = ros_test.start(MODULE, "servo", *RECORD)
    truths = ros_test.collect(PointStamped, "fvs_sim_node/true_ball_position")
    ros_test.spin_until(lambda: len(truths) > 10, 30.0, "the simulator")
    shutil.rmtree(ros_test.folder / "bag")
    words = "fvs_recorder_node ended with exit code 1: the others go on"
    ros_test.spin_until(lambda: words in ros_test.output(process), 30.0, "the recorder's end")
    output = ros_test.output(process)
    assert "recording into bag has ended: No such file or directory" in output
    assert "Traceback" not in output
    truths.clear()
    ros_test.spin_until(lambda: len(truths) > 10, 30.0, "the simulator")
    nodes = children(process.pid)
    (estimator,) = (
        pid for pid in nodes if "fvs_estimator_node" in Path(f"/proc/{pid}/cmdline").read_text()
    )
    os.kill(estimator, signal.SIGKILL)
    assert ros_test.wait(process) == 1
    assert "fvs_estimator_node ended with signal SIGKILL" in ros_test.output(process)
    assert not any(alive(pid) for pid in nodes)


def test_every_executable_says_what_it_is_for():
    helps = programs_in_turn.run([(module, ["--help"]) for module in EXECUTABLES.values()])
    for name, (code, text) in zip(EXECUTABLES, helps, strict=True):
        assert code == 0, name
        assert f"\n\n{name}: " in f"\n\n{text}"
        assert "usage: " in text
        assert name not in NODE_TABLE or "\nparameters and their defaults:\n  " in text


#: Module, arguments, and words of the refusal.
REFUSED = [
    (MODULE, ["servo", "--shceme", "best"], "did you mean --scheme?"),
    (MODULE, ["servo", "--namespace", "a b"], "cannot start: "),
    (MODULE, ["servo", "-r", "a"], "cannot start: "),
    (MODULE, ["servo", "--train", "x.npz"], "servo starts no fvs_collector_node"),
    (MODULE, ["collect_minute", "--train", "/tmp"], "/tmp is a folder, expected the name of"),
    (
        MODULE,
        ["demo", "-p", "robot:=iiwa", "-p", "targets:=3"],
        "\n  fvs_launch collect_minute --train out/model.npz -p robot:=iiwa"
        "\n  fvs_launch demo -p robot:=iiwa -p targets:=3 -p model_path:=out/model.npz\n",
    ),
    (MODULE, ["demo", "-p", "robot:=scara", "-p", "feature:=pose"], "with fewer set task_axes"),
    (MODULE, ["ur5_real"], "\n  fvs_launch ur5_real_collect --train out/ur5_real/model.npz\n"),
    ("fvs_tools.demo_node", ros_arguments(output_dir="/proc/no"), "cannot be written"),
    ("fvs_tools.calibrate_node", ros_arguments(output_path="/proc/c.yaml"), "cannot be written"),
    ("fvs_tools.client_node", ["go", "grasp", "--timeout-s", "nan"], "must be above 0, got nan"),
    (SERVO, ["left", "right", "right"], "/right/fvs_controller_node, /right/fvs_est"),
    (SERVO, ["a", "b", "--ros-args", "-r", "__ns:=/lab"], "neither __ns nor __node may be"),
    (SERVO, ["--ros-args", "-p", "fvs_controller_node:method:=lkf"], "unknown parameter 'method'"),
    (SERVO, ["--ros-args", "-p", "methot:=poe"], "did you mean method"),
    ("fvs_sim_node.node", {"gui": True}, "gui needs a display"),
    (
        "fvs_detector_node.node",
        {"feature": "pose", "tag_dictionary": "4X4_50", "tag_id": 50},
        "tag 50 is not in 4X4_50: tag_id can be 0 to 49",
    ),
    ("fvs_estimator_node.node", {"model_path": "nowhere.npz"}, "model_path"),
    ("fvs_estimator_node.node", {"feature_frame": "other_frame"}, "other_frame"),
    ("fvs_controller_node.node", {"alpha_1": 1.0}, "'alpha_1'; did you mean alpha1?"),
    ("fvs_estimator_node.collector_node", {"output_path": "/proc/x.npz"}, "be written"),
    ("fvs_dashboard.dashboard_node", {"host": "203.0.113.1"}, "cannot be served at 203.0.113.1"),
    ("fvs_tools.demo_node", ["-p", "port:=9000"], "unknown argument '-p'"),
    ("fvs_tools.demo_node", ["--ros-args", "-p", "foo"], "cannot start:"),
]


def test_what_cannot_do_as_told_says_so_in_a_sentence_and_ends(ros_test):
    environment = {**ros_test.environment, "DISPLAY": "", "WAYLAND_DISPLAY": ""}
    commands = ros_test.collect(Float64MultiArray, topics.COMMANDS.name)
    ended = programs_in_turn.run(
        [
            (module, own if isinstance(own, list) else ros_arguments(**own))
            for module, own, _ in REFUSED
        ],
        env=environment,
    )
    for (_, _, words), (code, text) in zip(REFUSED, ended, strict=True):
        assert words in text
        assert code == 2, text
        assert "Traceback" not in text
    ros_test.spin_for(0.1)
    assert not any(np.any(m.data) for m in commands)
