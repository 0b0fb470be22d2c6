"""Collector, trainer, estimator and controller beside a driver and a detector that are not ours."""

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped
from std_srvs.srv import Trigger
from unseen_robot import FRAME, UnseenRobot

from fvs_ros import ros, topics

SEED, COLLECT_S = 4, 14.0


@pytest.mark.timeout(200)
def test_a_robot_never_seen_before_is_learned_and_servoed_over_its_topics_alone(ros_test):
    ros_test.start("unseen_robot", str(SEED), "125")
    data, model = ros_test.folder / "data.npz", ros_test.folder / "model.npz"
    collector = ros_test.start_node(
        "fvs_estimator_node.collector_node", output_path=data, duration_s=COLLECT_S
    )
    assert ros_test.wait(collector, COLLECT_S + 40.0) == 0, ros_test.output(collector)
    trainer = ros_test.start("fvs_tools.train", str(data), "-o", str(model), "--method", "poe")
    assert ros_test.wait(trainer, 60.0) == 0, ros_test.output(trainer)

    truth = ros_test.collect(PointStamped, "true_ball")
    statuses = ros_test.collect(DiagnosticStatus, topics.CONTROLLER_STATUS.name)
    ros_test.start_node("fvs_estimator_node.node", model_path=model, method="poe")
    ros_test.start_node("fvs_controller_node.node")
    publisher = ros_test.publisher(PointStamped, topics.TARGET_POSITION.name, ros.QOS_LATCHED)

    def value(key):
        return ros.from_status(statuses[-1])[key] if statuses else ""

    for target in UnseenRobot(SEED).draw_targets(np.random.default_rng(SEED), count=2):
        publisher.publish(ros.to_point(0.0, FRAME, target))
        ros_test.spin_until(lambda: value("state") in ("READY", "SERVOING"), what="READY")
        if value("state") == "READY":
            assert ros_test.call(Trigger, "fvs_controller_node/start").success
        wanted = f"{target[0]:.5g}"
        ros_test.spin_until(
            lambda wanted=wanted: (value("target_x_m"), value("reason")) == (wanted, "SETTLED"),
            what="the target",
        )
        truth.clear()
        ros_test.spin_for(0.5)
        ball = np.array([[m.point.x, m.point.y, m.point.z] for m in truth])
        distance = np.linalg.norm(ball - target, axis=1)
        assert distance.max() < 0.005, statuses[-1].message
        assert np.sqrt(np.mean(distance**2)) < 0.003
