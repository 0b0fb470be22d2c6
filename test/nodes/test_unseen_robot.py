"""Collector, trainer, estimator and controller beside a driver and a detector that are not ours."""

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped, PoseStamped
from std_srvs.srv import Trigger
from unseen_robot import FRAME, UnseenRobot

from fvs_ros import ros, topics
from fvs_ros.kinds import KINDS

SEED, COLLECT_S = 4, 10.0


@pytest.mark.parametrize("feature", tuple(KINDS))
def test_a_robot_never_seen_before_is_learned_and_servoed_over_its_topics_alone(ros_test, feature):
    """Of a ball six joints, of a tag's pose seven, by anybody's PoseStamped."""
    robot = UnseenRobot(SEED, feature == "pose")
    served = robot.kind
    ros_test.start("unseen_robot", str(SEED), "60", feature)
    data, model = ros_test.folder / "data.npz", ros_test.folder / "model.npz"
    given = {"feature": feature, "joint_names": robot.names}
    collector = ros_test.start_node(
        "fvs_estimator_node.collector_node", output_path=data, duration_s=COLLECT_S, **given
    )
    assert ros_test.wait(collector, COLLECT_S + 40.0) == 0, ros_test.output(collector)
    trainer = ros_test.start("fvs_tools.train", str(data), "-o", str(model), "--method", "poe")
    assert ros_test.wait(trainer, 60.0) == 0, ros_test.output(trainer)

    kind = PoseStamped if feature == "pose" else PointStamped
    truth = ros_test.collect(kind, "truth")
    statuses = ros_test.collect(DiagnosticStatus, topics.CONTROLLER_STATUS.name)
    ros_test.start_node("fvs_estimator_node.node", model_path=model, method="poe", **given)
    ros_test.start_node("fvs_controller_node.node", law="minimum_time", **given)
    publisher = ros_test.publisher(kind, served.topics.target.name, ros.QOS_LATCHED)

    def value(key):
        return ros.from_status(statuses[-1])[key] if statuses else ""

    for target in robot.draw_targets(np.random.default_rng(SEED), count=2):
        publisher.publish(ros.to_feature(0.0, FRAME, served, target))
        ros_test.spin_until(lambda: value("state") in ("READY", "SERVOING"), what="READY")
        if value("state") == "READY":
            assert ros_test.call(Trigger, "fvs_controller_node/start").success
        wanted = f"{target[0]:.5g}"
        ros_test.spin_until(
            lambda wanted=wanted: (value("target_x_m"), value("reason")) == (wanted, "SETTLED"),
            what="the target",
        )
        ros_test.spin_for(0.5)  # what a busy computer held back of the way is heard
        truth.clear()
        ros_test.spin_until(lambda: len(truth) > 20, what="where the ball is")
        errors = [
            served.minus(ros.from_feature(one, served, FRAME, "truth"), target) for one in truth
        ]
        distance = np.linalg.norm(errors, axis=1)
        assert distance.max() < 0.005, statuses[-1].message
        assert np.sqrt(np.mean(distance**2)) < 0.003
