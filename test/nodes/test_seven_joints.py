"""An arm of seven joints, collected, trained and servoed by the launcher, as a user would."""

import json
from itertools import count

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String

from fvs_estimator_node.files import load_model
from fvs_ros import ros, topics

ARM = ("-p", "robot:=iiwa")
POSITION = ("-p", "command_interface:=position")
#: Fewer exchanges for a simulated second than a UR's.
SLOW = ("-p", "joint_state_rate_hz:=50")


def test_an_arm_is_learned_and_servoed_by_its_name_with_positions(ros_test):
    data, model = (ros_test.folder / name for name in ("data.npz", "model.npz"))
    arm = [*ARM, *SLOW, *POSITION]
    collected = [*arm, "-p", f"output_path:={data}", "-p", "duration_s:=10.0"]
    process = ros_test.start("fvs_tools.launcher", "collect_minute", *collected)
    assert ros_test.wait(process, 120.0) == 0, ros_test.output(process)
    trainer = ros_test.start("fvs_tools.train", str(data), "-o", str(model), "--method", "poe")
    assert ros_test.wait(trainer, 60.0) == 0, ros_test.output(trainer)
    assert load_model(model).chain.prismatic.tolist() == [0.0] * 7
    assert "joints move the ball by lbr_iiwa_joint_1 " in ros_test.output(trainer)
    simulated = ["-p", "use_sim_time:=true", "-p", "simulated_time:=true"]
    short = ["-p", "targets:=1", "-p", "target_s:=3.0", "-p", f"model_path:={model}"]
    commands = ros_test.collect(Float64MultiArray, topics.POSITION_COMMANDS.name, ros.QOS_EVERY)
    demo = ros_test.start(
        "fvs_tools.launcher", "demo", "--scheme", "best", *arm, *simulated, *short
    )
    assert ros_test.wait(demo, 90.0) == 0, ros_test.output(demo)
    assert {len(message.data) for message in commands} == {7}
    results = json.loads((ros_test.folder / "out" / "demo" / "results.json").read_text())
    assert [one["final_rms_m"] < 0.002 for one in results] == [True]


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
    statuses = ros_test.collect(DiagnosticStatus, topics.CONTROLLER_STATUS.name)
    stamps = count(1)

    def says(words):
        stamp_s = 0.01 * next(stamps)
        joints.publish(ros.to_joint_state(stamp_s, names, np.zeros(7), np.zeros(7)))
        return bool(statuses) and words in statuses[-1].message

    ros_test.spin_until(lambda: says("the joints' ranges are unknown"), what="unknown ranges")
    for text, words in (  # what is no description of this arm blocks nothing
        (String(data="no xml"), "no XML"),
        (urdf(known=["another"]), "it has none of the arm's joints"),
    ):
        description.publish(text)
        ros_test.spin_until(
            lambda words=words: (
                "left out: " in ros_test.output(controller) and words in ros_test.output(controller)
            ),
            what=f"robot_description is left out: {words}",
        )
        assert not says("robot_description is not usable")
        assert says("the joints' ranges are unknown")
    for text, words in (
        (urdf(known=names[:6]), "no moving joint joint_7"),
        (urdf(upper=-2.0), "has limits -1 to -2"),
    ):
        description.publish(text)
        ros_test.spin_until(
            lambda words=words: says("robot_description is not usable") and says(words),
            what=f"robot_description is refused: {words}",
        )
        assert ros.from_status(statuses[-1])["state"] in ("WAITING", "FAULT")
    description.publish(urdf())
    ros_test.spin_until(
        lambda: (
            not says("robot_description")
            and "joint_velocity_limits_rad_s are those of robot_description"
            in ros_test.output(controller)
        ),
        what="a good description",
    )
    assert not says("ranges are unknown")
