"""An arm of seven joints, collected, trained and servoed by the launcher, as a user would."""

import json
from itertools import count

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from harness import Statuses
from recordings import relative_error
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String

from fvs_estimator_node.files import load_data_set, load_model
from fvs_ros import ros, topics
from fvs_ros.kinds.pose import Pose
from fvs_sim_node.simulation import SimConfig, Simulation

#: Fewer exchanges and images for a simulated second than a UR's.
COMMON = (
    *("robot:=iiwa", "tf_prefix:=left_", "feature:=pose", "command_interface:=position"),
    *("joint_state_rate_hz:=50", "image_rate_hz:=25.0"),
)


def launch(harness, scenario, *parameters, options=()):
    arguments = (word for value in (*COMMON, *parameters) for word in ("-p", value))
    process = harness.start("fvs_tools.launcher", scenario, *arguments, *options)
    assert harness.wait(process, 120.0) == 0, harness.output(process)
    return harness.output(process)


def test_an_arm_is_learned_and_servoed_by_its_name_with_positions(ros_test):
    replay = pytest.importorskip("fvs_lab.replay")
    data_path, model = (ros_test.folder / name for name in ("data.npz", "model.npz"))
    parameters = f"output_path:={data_path}", "duration_s:=10.0"
    launch(ros_test, "collect_minute", *parameters, options=("--train", str(model)))
    data = load_data_set(data_path)
    assert 8.0 < data.stamps_s[-1] - data.stamps_s[0] < 14.0
    assert np.abs(data.joints_rad[-1] - data.joints_rad[0]).max() < 0.1

    sampled_rad = data.joints_rad[::50]
    with Simulation(SimConfig(robot="iiwa", feature="pose", rendered=False)) as simulation:
        true = simulation.true_chain(Pose()).jacobian(sampled_rad)
    assert np.median(relative_error(load_model(model).chain.jacobian(sampled_rad), true)) < 0.02

    commands = ros_test.collect(Float64MultiArray, topics.POSITION_COMMANDS.name, ros.QOS_EVERY)
    statuses = ros_test.collect(DiagnosticStatus, topics.CONTROLLER_STATUS.name, ros.QOS_EVERY)
    short = "targets:=2", "target_s:=3.0", "use_sim_time:=true", "simulated_time:=true"
    parameters = *short, f"model_path:={model}", "output_dir:=out"
    options = "--scheme", "best", "--record", "bag", "-p", "images:=false"
    output = launch(ros_test, "demo", *parameters, options=options)
    assert "to 5 mm" in output
    assert {len(message.data) for message in commands} == {7}
    # The arm is stopped before the figure is drawn, and so not held meanwhile.
    states = [ros.from_status(status)["state"] for status in statuses]
    drawing = states[-states[::-1].index("SERVOING") :]
    assert drawing[0] == "READY", drawing
    assert "HOLDING" not in drawing[:-1], drawing
    results = json.loads((ros_test.folder / "out" / "results.json").read_text())
    assert len(results) == 2
    for result in results:
        assert 0.1 < result["start_distance_m"] < 0.5  # among the poses that the collector met
        assert result["settling_5mm_s"] < 2.0
        assert result["final_rms_m"] < 0.002
        assert result["peak_joint_speed_rad_s"] > 0.2
    # A replay judges as the demo did; the last target ends with the status of a stopped controller.
    records, names, _ = replay.read(ros_test.folder / "bag")
    assert len(names) == 7
    for record, result in zip(records, results, strict=True):
        assert record.score().start_distance_m == result["start_distance_m"]
    for name in ("settling_5mm_s", "settling_2mm_s", "final_rms_m"):
        assert getattr(records[0].score(), name) == results[0][name]
    # What is promised is the command's speed: the drive's own may overshoot it.
    steps = np.diff([message.data for message in commands], axis=0)
    assert np.abs(steps).max() <= 1.0 / 50.0 + 1e-9
    assert (ros_test.folder / "out" / "demo.png").stat().st_size > 20_000


def test_a_bad_description_holds_the_arm_and_a_good_one_gives_its_limits(ros_test):
    names = [f"joint_{number}" for number in range(1, 8)]
    joint = (
        "<joint name='{0}' type='revolute'><parent link='{1}'/><child link='{2}'/>"
        "<limit lower='-1' upper='{3}' velocity='0.5'/></joint>"
    )

    def urdf(upper=1.0, known=names):
        joints = "".join(joint.format(n, i, i + 1, upper) for i, n in enumerate(known))
        return String(data=f"<robot>{joints}</robot>")

    controller = ros_test.start_node("fvs_controller_node.node", joint_names=names)
    description = ros_test.publisher(String, topics.ROBOT_DESCRIPTION.name, ros.QOS_LATCHED)
    joints = ros_test.publisher(JointState, topics.JOINT_STATES.name)
    status = Statuses(ros_test, topics.CONTROLLER)
    stamps = count(1)

    def says(words):
        stamp_s = 0.01 * next(stamps)
        joints.publish(ros.to_joint_state(stamp_s, names, np.zeros(7), np.zeros(7)))
        return words in status.text()

    unknown, refused = "the joints' ranges are unknown", "robot_description is not usable"
    status.wait(lambda: says(unknown))
    for message, words, status_words in (  # what is no description of this arm blocks nothing
        (String(data="no xml"), "no XML", unknown),
        (urdf(known=["another"]), "it has none of the arm's joints", unknown),
        (urdf(known=names[:6]), "no moving joint joint_7", refused),
        (urdf(upper=-2.0), "has limits -1 to -2", refused),
    ):
        description.publish(message)
        status.wait(
            lambda status_words=status_words, words=words: (
                says(status_words) and words in status.text() + ros_test.output(controller)
            ),
            what=words,
        )
        assert status.value("state") in ("WAITING", "FAULT")
    description.publish(urdf())
    words = "joint_velocity_limits_rad_s are those of robot_description"
    status.wait(lambda: not says("robot_description") and words in ros_test.output(controller))
    assert not says(unknown)
