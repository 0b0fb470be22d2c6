"""Teach and repeat with a real controller: tool and object come from somebody else's tracker."""

import json
import signal

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from harness import PlayedRobot, Statuses
from std_srvs.srv import Trigger

from fvs_ros import ros
from fvs_ros.kinds.kind import MOUNTS
from fvs_ros.kinds.pose import Pose

NAME = "fvs_controller_node"


class Kitchen(Statuses):
    """A controller, a played robot, and an object."""

    def __init__(self, harness, path, kind=None, seen=True):
        super().__init__(harness, NAME, ros.QOS_EVERY)
        self.robot = PlayedRobot(harness, kind)
        feature = self.robot.kind.name
        harness.start_node("fvs_controller_node.node", references_path=path, feature=feature)
        self.robot.meet_controller()
        if seen:
            self.robot.show_object()
            name = self.robot.kind.topics.object.name
            self.wait(lambda: self.value(f"{name}_age_s") not in ("", "inf"), what="the object")
        harness.spin_for(0.5)  # for a mean

    def call(self, service):
        return self.harness.call(Trigger, f"{NAME}/{service}")

    def run(self, *arguments):
        process = self.harness.start("fvs_tools.client_node", *arguments)
        return self.harness.wait(process, 40.0), self.harness.output(process)

    def off_m(self, taught):
        return np.linalg.norm(self.robot.kind.minus(self.robot.from_object(), taught))


def test_what_is_taught_is_found_again_where_the_object_is(ros_test, tmp_path):
    path, name = tmp_path / "references.yaml", Pose.topics.object.name
    kitchen = Kitchen(ros_test, path, Pose())
    taught = kitchen.robot.from_object()
    answer = kitchen.call("teach")
    assert "grasp in the frame object" in answer.message
    assert "frame: object" in path.read_text()

    kitchen.robot.move_object(-0.06, 0.04, 0.05, 0.02, -0.03, 0.05)
    assert kitchen.call("go_to_reference").success
    started = []
    kitchen.wait(lambda: started.append(kitchen.call("start")) or started[-1].success, what="READY")
    kitchen.wait(lambda: kitchen.reason() == "SETTLED", what="SETTLED")
    assert kitchen.off_m(taught) < 0.005

    kitchen.harness.set_parameters(NAME, object_may_be_hidden_s=1.0)
    kitchen.harness.spin_for(0.1)  # so that an image of it tells that it stands
    kitchen.robot.silent.add(name)
    kitchen.wait(lambda: "where the object stood counts" in kitchen.text(), what="a remark")
    kitchen.wait(lambda: kitchen.reason() == "STALE", what="a hold")
    assert f"{name} is" in kitchen.text()
    assert f"not taught: {name} is" in kitchen.call("teach").message
    kitchen.robot.silent.clear()
    kitchen.wait(lambda: kitchen.reason() == "SETTLED", what="SETTLED")

    assert kitchen.harness.set_parameters(NAME, reference="place")[0].successful
    answer = kitchen.call("go_to_reference")
    assert not answer.success
    assert "unknown reference 'place'; known are grasp" in answer.message
    kitchen.wait(lambda: kitchen.reason() == "SETTLED", what="the old target, which stays")
    kitchen.harness.publisher(PoseStamped, name)
    kitchen.wait(lambda: f"{name} has 2 publishers" in kitchen.text(), what="a remark")


def test_without_an_object_an_absolute_target_is_taught(ros_test, tmp_path):
    kitchen = Kitchen(ros_test, tmp_path / "references.yaml", seen=False)
    answer = kitchen.call("teach")
    assert answer.success, answer.message
    assert f"in the frame {PlayedRobot.FRAME}" in answer.message


def test_the_program_teaches_and_goes_there(ros_test, tmp_path):
    kitchen = Kitchen(ros_test, tmp_path / "references.yaml")
    taught = kitchen.robot.from_object()

    code, words = kitchen.run("teach", "grasp")
    assert code == 0, words
    kitchen.robot.move_object(0.05, -0.04, 0.05)
    code, words = kitchen.run("go", "grasp")
    assert code == 0, words
    assert "grasp: reached, " in words
    assert words.count("to go") <= 3  # one a second
    there_m = kitchen.robot.z
    assert kitchen.off_m(taught) < 0.005
    kitchen.robot.move_object(0.0, 0.1, 0.0)
    kitchen.harness.spin_for(0.5)
    assert np.linalg.norm(kitchen.robot.z - there_m) < 0.002, "it follows the object"

    code, words = kitchen.run("go", "grasp", "place")
    assert code == 1
    assert "unknown reference 'place'" in words
    kitchen.wait(lambda: kitchen.reason() == "READY", what="a stop")
    assert kitchen.run("follow", "grasp")[0] == 0
    code, words = kitchen.run("target", "0", "1")
    assert code == 1
    assert words.endswith("x y z, got 2\n"), "it sends nothing, not even a stop"
    assert kitchen.reason() != "READY"
    assert kitchen.run("stop")[0] == 0
    kitchen.wait(lambda: kitchen.reason() == "READY", what="READY")


def test_the_program_goes_to_a_target_and_says_why_not(ros_test, tmp_path):
    kitchen = Kitchen(ros_test, tmp_path / "references.yaml", seen=False)
    for target in ("-5e-2", "0.12", "1.43"), ("-0.05", "0.123", "1.43"):
        code, words = kitchen.run("target", *target)
        assert code == 0, words
        assert "\nreached, 0." in words
        assert np.linalg.norm(kitchen.robot.z - np.array(target, dtype=float)) < 0.002
    kitchen.wait(lambda: kitchen.reason() == "READY", what="rest")
    code, words = kitchen.run("target", "0", "0", "9")
    assert code == 1
    assert "z = 9.000 m is not in [0.1, 3]" in words.partition("not reached: ")[2]
    assert kitchen.reason() == "READY"


@pytest.mark.parametrize(
    ("command", "number"),
    [
        (("fvs_tools.client_node", "go", "grasp"), signal.SIGINT),
        (("fvs_tools.client_node", "target", "0.1", "0.2", "1.5"), signal.SIGTERM),
        (("servo_script",), signal.SIGTERM),
        (("servo_script",), signal.SIGHUP),
    ],
)
def test_a_signal_stops_the_arm(ros_test, tmp_path, command, number):
    kitchen = Kitchen(ros_test, tmp_path / "references.yaml")
    assert kitchen.call("teach").success
    kitchen.harness.set_parameters(NAME, settled_error_m=1e-5)  # never reached
    kitchen.robot.move_object(0.05, -0.04, 0.05)
    process = kitchen.harness.start(*command)
    kitchen.wait(lambda: kitchen.reason() == "SERVOING", what="SERVOING")
    assert kitchen.harness.stop(process, number) != 0
    words = kitchen.harness.output(process)
    assert "Traceback" not in words or "servo_script" in command, words
    kitchen.wait(lambda: kitchen.reason() == "READY", what="a stop")


@pytest.mark.parametrize("mount", MOUNTS)
def test_the_scenario_teaches_and_comes_again_where_the_object_has_jumped_to(ros_test, mount):
    few = (
        f"camera_mount:={mount}",
        "targets:=1",
        "target_s:=2.5",
        "image_rate_hz:=15.0",
        "object_tag_layout:=single",
    )
    arguments = (word for value in (*few, "output_dir:=out") for word in ("-p", value))
    process = ros_test.start("fvs_tools.launcher", "teach", *arguments)
    assert ros_test.wait(process, 120.0) == 0, ros_test.output(process)
    (result,) = json.loads((ros_test.folder / "out" / "results.json").read_text())
    assert result["start_distance_m"] > 0.02
    assert result["final_rms_m"] < 0.003
