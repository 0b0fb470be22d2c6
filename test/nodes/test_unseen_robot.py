"""Collector, trainer, estimator and controller beside a driver and a detector that are not ours."""

import os
import sys
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped
from std_srvs.srv import Trigger

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from unseen_robot import FRAME, UnseenRobot

from fvs_ros import ros, topics

TESTS = str(Path(__file__).resolve().parents[1])
#: A fifth of what the collector does by default.
COLLECT_S, SETTLE_S, REST_S = 24.0, 3.0, 1.0


@pytest.mark.timeout(200)
def test_a_robot_never_seen_before_is_learned_and_servoed_over_its_topics_alone(
    ros_test, monkeypatch
):
    seed = 4
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([TESTS, os.environ["PYTHONPATH"]]))
    ros_test.start("unseen_robot", str(seed), "125")
    data, model = ros_test.folder / "data.npz", ros_test.folder / "model.npz"
    collector = ros_test.start_node(
        "fvs_estimator_node.collector_node", output_path=str(data), duration_s=COLLECT_S
    )
    assert ros_test.wait(collector, COLLECT_S + 40.0) == 0, ros_test.output(collector)
    trainer = ros_test.start("fvs_tools.train", str(data), "-o", str(model), "--method", "ridge")
    assert ros_test.wait(trainer, 60.0) == 0, ros_test.output(trainer)

    truth = ros_test.collect(PointStamped, "true_ball")
    statuses = ros_test.collect(DiagnosticStatus, "fvs_controller_node/status")
    ros_test.start_node("fvs_estimator_node.node", model_path=str(model))
    ros_test.start_node("fvs_controller_node.node")
    publisher = ros_test.publisher(PointStamped, topics.TARGET_POSITION.name, ros.QOS_LATCHED)
    for target in UnseenRobot(seed).draw_targets(np.random.default_rng(seed), count=2):
        publisher.publish(ros.to_point(0.0, FRAME, target))
        ros_test.spin_until(
            lambda: statuses and ros.from_status(statuses[-1])["state"] in ("READY", "SERVOING"),
            what="READY",
        )
        assert ros_test.call(Trigger, "fvs_controller_node/start").success
        ros_test.spin_for(SETTLE_S)
        truth.clear()
        ros_test.spin_for(REST_S)
        ball = np.array([[m.point.x, m.point.y, m.point.z] for m in truth])
        distance = np.linalg.norm(ball - target, axis=1)
        assert distance.max() < 0.005, statuses[-1].message
        assert np.sqrt(np.mean(distance**2)) < 0.003
