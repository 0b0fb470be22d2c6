"""Collector, trainer, estimator and controller beside a driver and a detector that are not ours."""

import numpy as np
from geometry_msgs.msg import PoseStamped
from harness import Statuses
from std_srvs.srv import Trigger
from unseen_robot import FRAME, UnseenRobot

from fvs_ros import ros, topics

SEED, COLLECT_S = 4, 15.0


def test_a_robot_never_seen_before_is_learned_and_servoed_over_its_topics_alone(ros_test):
    """Seven joints, and a tag's pose by anybody's PoseStamped."""
    robot = UnseenRobot(SEED)
    served = robot.kind
    ros_test.start("unseen_robot", str(SEED), "60")
    data, model = ros_test.folder / "data.npz", ros_test.folder / "model.npz"
    given = {"feature": "pose", "joint_names": robot.names}
    collector = ros_test.start_node(
        "fvs_estimator_node.collector_node", output_path=data, duration_s=COLLECT_S, **given
    )
    assert ros_test.wait(collector, COLLECT_S + 40.0) == 0, ros_test.output(collector)
    trainer = ros_test.start("fvs_tools.train", str(data), "-o", str(model), "--method", "poe")
    assert ros_test.wait(trainer, 60.0) == 0, ros_test.output(trainer)

    truth = ros_test.collect(PoseStamped, "truth")
    said = Statuses(ros_test, topics.CONTROLLER)
    ros_test.start_node("fvs_estimator_node.node", model_path=model, method="poe", **given)
    ros_test.start_node("fvs_controller_node.node", law="minimum_time", **given)
    publisher = ros_test.publisher(PoseStamped, served.topics.target.name, ros.QOS_LATCHED)

    for target in robot.draw_targets(np.random.default_rng(SEED), count=2):
        publisher.publish(ros.to_feature(0.0, FRAME, served, target))
        said.wait(lambda: said.value("state") in ("READY", "SERVOING"), what="READY")
        if said.value("state") == "READY":
            assert ros_test.call(Trigger, "fvs_controller_node/start").success
        wanted = f"{target[0]:.5g}"
        said.wait(
            lambda w=wanted: said.value("reason") == "SETTLED" and said.value("target_x_m") == w
        )
        truth.clear()

        def there(target=target):
            last = [ros.from_feature(one, served, FRAME, "truth") for one in truth[-20:]]
            off = [np.linalg.norm(served.minus(one, target)) for one in last]
            return len(off) == 20 and max(off) < 0.005 and np.linalg.norm(off) < 0.003 * 20**0.5

        said.wait(there, what="the tag on its target for a while")
