"""Two webcams of unknown lenses and anybody's trackers, seven joints, through the real nodes."""

import numpy as np
from chain_robot import ForeignArm
from harness import Statuses
from std_srvs.srv import Trigger
from webcams import before_webcams

from fvs_estimator_node.files import TrainedModel, range_of, save_model
from fvs_estimator_node.training import distil
from fvs_ros import ros, topics
from fvs_ros.kinds.points import Points
from fvs_ros.pixel_chain import PixelChains

CAMERAS, NAMES = ("left", "right"), tuple(f"joint_{i + 1}" for i in range(7))
KIND, NOISE_PX = Points(2, cameras=CAMERAS), 0.3
#: Joint states from image to image of each camera.
EVERY = 2, 3


class Robot(ForeignArm):
    """An arm and two trackers that are not ours."""

    def __init__(self, harness):
        super().__init__(harness, np.zeros(7))
        self.rng, self.covered = np.random.default_rng(2), set()
        self.webcams = before_webcams(self.rng, 7, 2, 2)
        points = ros.message_class(Points.topics.tool.type)
        names = [part.feature.name for part in KIND.parts]
        self.images = [harness.node.create_publisher(points, name, 10) for name in names]

    def step(self, now_s):
        self.move(now_s, NAMES)
        for camera, publisher in enumerate(self.images):
            if self.steps % EVERY[camera] == 0 and camera not in self.covered:
                z = self.webcams[camera].position(self.joints)
                z = z + NOISE_PX * self.rng.normal(size=z.size)
                part = KIND.parts[camera]
                publisher.publish(ros.to_feature(now_s, f"{CAMERAS[camera]}_cam", part, z))

    def seen(self, joints):
        return PixelChains(self.webcams).position(joints)


def model_of(robot, path):
    """Write a model of the true chains."""
    chain = PixelChains(robot.webcams)
    joints = robot.rng.uniform(-0.4, 0.4, (200, 7))
    trained = TrainedModel(
        distil(chain, np.array([[-0.4] * 7, [0.4] * 7]), 20, robot.rng),
        **range_of(joints, chain.position(joints), robot.rng),
        joint_names=NAMES,
        feature=KIND.name,
        cameras=CAMERAS,
        chain=chain,
    )
    save_model(path, trained)


def test_seven_joints_bring_points_of_two_trackers_to_their_targets(ros_test):
    robot, status = Robot(ros_test), Statuses(ros_test, topics.CONTROLLER)
    model_of(robot, ros_test.folder / "model.npz")
    own = {"feature": "points", "point_count": 2, "cameras": list(CAMERAS)}
    own["joint_names"] = list(NAMES)
    model = ros_test.folder / "model.npz"
    ros_test.start_node("fvs_estimator_node.node", model_path=model, method="poe", **own)
    ros_test.start_node("fvs_controller_node.node", law="minimum_time", **own)
    points = ros.message_class(Points.topics.target.type)
    targets = [
        ros_test.publisher(points, part.topics.target.name, ros.QOS_LATCHED) for part in KIND.parts
    ]

    def give(target, cameras=(0, 1)):
        for i in cameras:
            part = KIND.parts[i]
            targets[i].publish(ros.to_feature(0.0, "anything", part, target[KIND.rows[i]]))

    def start():
        servoing = status.value("state") == "SERVOING"
        return servoing or ros_test.call(Trigger, f"{topics.CONTROLLER}/start").success

    goal = robot.seen(robot.rng.uniform(-0.2, 0.2, 7))
    give(goal, [0])
    words = "no right/target_points yet"
    status.wait(lambda: status.reason() == "NO_TARGET" and words in status.text(), what="a target")
    give(goal, [1])
    status.wait(start, what="a start")

    def there(rows=slice(None)):
        off = np.abs(robot.seen(robot.joints) - goal)[rows].max()
        return status.reason() == "SETTLED" and off < 1.0

    status.wait(there, 60.0, what="all points on their targets to a pixel")
    robot.covered.add(1)
    goal = robot.seen(robot.rng.uniform(-0.2, 0.2, 7))
    status.wait(lambda: "right/image_points is" in status.text(), what="word of the covered camera")
    give(goal)
    status.wait(lambda: there(KIND.rows[0]), 60.0, what="the points of the camera that sees")
    robot.covered.clear()
    status.wait(there, 60.0, what="all points again")
