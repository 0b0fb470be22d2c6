"""Image points by a camera of which nothing is known: learned from a minute of motion, servoed."""

import json
import time
from collections import deque
from dataclasses import replace

import drawn_balls
import drawn_tags
import numpy as np
import pytest
import ur5_dh
from chain_robot import ForeignArm
from drawn_balls import VGA
from geometry_msgs.msg import Point32, PolygonStamped
from harness import Statuses
from recordings import Recording, ur5_chain
from sensor_msgs.msg import Image
from std_srvs.srv import Trigger

from fvs_controller_node.config import default_values
from fvs_controller_node.loop import ServoLoop
from fvs_estimator_node.files import (
    DataSet,
    FileError,
    load_data_set,
    load_model,
    save_data_set,
    save_model,
)
from fvs_estimator_node.loop import EstimationLoop
from fvs_estimator_node.rbf import RbfEstimator
from fvs_estimator_node.registry import create_estimator
from fvs_estimator_node.training import TrainingOptions, train
from fvs_ros import ros, topics
from fvs_ros.camera import CAMERA_FRAME, Intrinsics
from fvs_ros.joints import UR_JOINT_NAMES
from fvs_ros.kinds import KindConfig
from fvs_ros.kinds.points import Points
from fvs_ros.params import ParameterError

KIND = Points(4)
CAMERA = Intrinsics(640, 480, 600.0, 600.0, 320.0, 240.0)
NOISE_PX, DT_S, IMAGE_TICKS, LATE_TICKS = 0.2, 0.008, 4, 5
#: Points of a thing about the tool's point, m, at the first joints; in no plane: the tilt of a flat
#: one that faces the camera hardly shows.
CORNERS_M = 0.1 * np.array(
    [[-1.0, -1.0, 0.0], [1.0, -1.0, 1.0], [1.0, 1.0, -1.0], [-1.0, 1.0, 0.5]]
)


def arm():
    """A UR5 that carries the thing."""
    chain = ur5_chain(origin_m=np.array([0.15, 0.0, 1.6]))
    return replace(chain, feature_m=np.append(chain.feature_m, CORNERS_M))


ARM = arm()


def seen(joints):
    """The points at joints, (..., n): px, (..., m)."""
    plate = ARM.position(joints)
    corners = plate[..., None, :3] + plate[..., 3:].reshape(*plate.shape[:-1], -1, 3)
    return CAMERA.project(corners).reshape(*plate.shape[:-1], -1)


def measured(joints, rng):
    z = seen(joints)
    return z + NOISE_PX * rng.normal(size=z.shape)


@pytest.fixture(scope="module")
def data():
    stamps_s = np.arange(1800) / 30.0
    joints = Recording().joints(stamps_s)
    z = measured(joints, np.random.default_rng(1))
    return DataSet(stamps_s, joints, z, np.zeros(len(z)), UR_JOINT_NAMES, feature=KIND.name)


@pytest.fixture(scope="module")
def trained(data):
    return train(data, TrainingOptions("ridge"))


def goals(rng):
    return ur5_dh.HOME_RAD + rng.uniform(-0.2, 0.2, (3, 6))


def test_networks_of_a_minute_bring_the_points_to_their_targets_to_a_pixel(trained):
    rng = np.random.default_rng(2)
    servo = ServoLoop(default_values(feature=KIND.name, point_count=4, autostart=True))
    estimation = EstimationLoop(RbfEstimator(trained.model, kind=KIND))
    joints, waiting, tick = ur5_dh.HOME_RAD.copy(), deque(), 0
    for target in seen(goals(rng)):
        set_at = tick + 20
        for tick in range(tick + 1, tick + round(6.0 / DT_S)):  # noqa: B020
            now_s = 10.0 + DT_S * tick
            if tick == set_at:
                assert servo.add_target(target, CAMERA_FRAME)[0]
            if tick % IMAGE_TICKS == 0:
                waiting.append((tick + LATE_TICKS, now_s, measured(joints, rng)))
            if waiting and waiting[0][0] == tick:
                _, stamp_s, z = waiting.popleft()
                estimation.add_image(stamp_s, z)
                servo.add_image(now_s, stamp_s, z)
            estimation.add_joints(now_s, joints)
            if not estimation.problem:
                servo.add_jacobian(now_s, estimation.jacobian(joints))
            servo.add_joints(now_s, now_s, joints)
            command = servo.tick(now_s, DT_S)
            if servo.sliding_variable is not None:
                estimation.add_sliding_variable(now_s, servo.sliding_variable)
            joints = joints + DT_S * command.velocity_rad_s
        assert " px off" in command.text
        np.testing.assert_allclose(seen(joints), target, atol=1.0)


def test_a_camera_on_the_arm_is_refused():
    with pytest.raises(ParameterError, match="points are seen by a camera in the room"):
        ServoLoop(default_values(feature="points", camera_mount="arm"))


def test_a_file_tells_how_many_points_and_keeps_the_chain(data, trained, tmp_path):
    save_data_set(tmp_path / "d.npz", data)
    save_model(tmp_path / "m.npz", trained)
    three, four = (KindConfig(feature="points", points=Points(k)) for k in (3, 4))
    assert load_data_set(tmp_path / "d.npz").kind == KIND
    with pytest.raises(FileError, match=r"points \(8 numbers\).*expected points \(6 numbers\)"):
        load_model(tmp_path / "m.npz", expected=three)
    loaded = load_model(tmp_path / "m.npz", expected=four)
    joints = ur5_dh.HOME_RAD
    kept = loaded.chain.jacobian(joints), trained.chain.jacobian(joints)
    np.testing.assert_allclose(*kept, atol=1e-9)
    of_chain = create_estimator("poe", load=lambda: loaded, kind=KIND).jacobian(joints)
    step = 1e-5 * np.eye(6)
    slopes = np.stack([seen(joints + one) - seen(joints - one) for one in step], axis=-1) / 2e-5
    np.testing.assert_allclose(of_chain / KIND.unit[:, None], slopes, atol=0.003 * slopes.max())
    with pytest.raises(ValueError, match="does not turn with the camera"):
        create_estimator("rbf_left", load=lambda: trained, kind=KIND)
    with pytest.raises(ValueError, match="even count"):
        replace(data, z=data.z[:, 1:])


def test_a_message_is_read_as_it_was_written_and_refused_if_it_has_other_points(trained):
    z = seen(ur5_dh.HOME_RAD)
    message = ros.to_feature(1.0, CAMERA_FRAME, KIND, z)
    np.testing.assert_allclose(KIND.read(message), z, atol=1e-3)
    back = ros.from_chain(ros.to_chain(trained.chain), 6, KIND)
    np.testing.assert_allclose(back.position(ur5_dh.HOME_RAD), z, atol=1.0)
    with pytest.raises(ValueError, match="has 4 points, expected 3"):
        Points(3).read(message)
    message.polygon.points[2].y = float("nan")
    with pytest.raises(ValueError, match="not finite"):
        KIND.read(message)


class Robot(ForeignArm):
    """An arm and a tracker that are not ours; an image every second step."""

    def __init__(self, harness):
        super().__init__(harness, ur5_dh.HOME_RAD)
        self.rng = np.random.default_rng(4)
        self.images = harness.node.create_publisher(PolygonStamped, "image_points", 10)

    def step(self, now_s):
        self.move(now_s, UR_JOINT_NAMES)
        if self.steps % 2:
            self.images.publish(polygon(measured(self.joints, self.rng), now_s))


def polygon(z, stamp_s=0.0):
    message = PolygonStamped()
    message.header.frame_id, message.header.stamp = CAMERA_FRAME, ros.to_stamp(stamp_s)
    message.polygon.points = [Point32(x=u, y=v) for u, v in z.reshape(-1, 2).tolist()]
    return message


@pytest.mark.parametrize("points", [1, 4])
def test_the_detector_publishes_points_of_a_camera_without_calibration(ros_test, points):
    middle_m, facing = np.array([0.05, 0.02, 0.5]), np.diag([1.0, -1.0, -1.0])
    rgb, expected = drawn_balls.draw([(middle_m, drawn_balls.RADIUS_M)])[0], VGA.project(middle_m)
    if points == 4:
        rgb, expected = (
            drawn_tags.draw([(0, facing, middle_m)]),
            drawn_tags.corners_px(facing, middle_m),
        )
    ros_test.start_node("fvs_detector_node.node", feature="points", point_count=points)
    status = Statuses(ros_test, topics.DETECTOR)
    images = ros_test.publisher(Image, "image_raw" if points == 1 else topics.COLOR_IMAGE.name)
    messages = ros_test.collect(PolygonStamped, "image_points")
    ros_test.node.create_timer(
        0.05, lambda: images.publish(ros.to_image(time.time(), CAMERA_FRAME, rgb, "rgb8"))
    )
    status.wait_for("TRACKING", "the pattern is seen, image_points is published")
    ros_test.spin_until(lambda: messages, what="points")
    z = Points(points).read(messages[-1]).reshape(-1, 2)
    np.testing.assert_allclose(z, np.reshape(expected, (-1, 2)), atol=0.5)


def test_the_detector_publishes_the_points_of_all_simulated_webcams(ros_test):
    truths, points, cameras = {}, {}, ["front", "side"]
    for name in cameras:
        truths[name] = ros_test.collect(PolygonStamped, f"{name}/fvs_sim_node/true_image_points")
        points[name] = ros_test.collect(PolygonStamped, f"{name}/image_points")
    status = Statuses(ros_test, topics.DETECTOR)
    ros_test.start_node("fvs_detector_node.node", feature="points", cameras=cameras)
    status.wait_for("WAITING", "front: no colour images")
    slow = {"publish_ball_position": False, "full_frame_rate_hz": 5.0}
    ros_test.start_node("fvs_sim_node.node", feature="points", cameras=cameras, **slow)
    ros_test.spin_until(lambda: all(points.values()) and all(truths.values()), 60.0, "the points")
    for name in cameras:
        z, truth = (Points().read(each[name][-1]) for each in (points, truths))
        np.testing.assert_allclose(z, truth, atol=0.8)


def test_what_is_clicked_on_is_followed_by_the_detector_until_it_is_taken_back(ros_test):
    rng = np.random.default_rng(7)
    spots = np.kron(rng.integers(0, 256, (60, 80, 1)), np.ones((4, 4, 3))).astype(np.uint8)
    shift = [0]
    ros_test.start_node("fvs_detector_node.node", feature="points")
    status = Statuses(ros_test, topics.DETECTOR)
    images = ros_test.publisher(Image, topics.COLOR_IMAGE.name)
    messages = ros_test.collect(PolygonStamped, "image_points")

    def show():
        rgb = np.roll(spots, shift[0], axis=1)
        images.publish(ros.to_image(time.time(), "anything", rgb, "rgb8"))

    ros_test.node.create_timer(0.05, show)
    status.wait_for("LOST", "nothing in view has the ball's colour")
    for wrong in ([1.0], [1.0, 2.0, 3.0, 4.0]):
        refusal = ros_test.set_parameters(topics.DETECTOR, track_px=wrong)[0]
        assert "u and v of 1 points" in refusal.reason
    for px in ([161.0, 121.0], [161.0, 121.0], [40.0, 80.0]):  # anew each time
        shift[0] = 0
        assert ros_test.set_parameters(topics.DETECTOR, track_px=px)[0].successful
        messages.clear()
        ros_test.spin_until(lambda: len(messages) > 2, what="points of the first image")
        for shift[0] in (10, 30):
            expected = np.array(px) + [shift[0], 0.0]

            def there(expected=expected):
                return messages and np.allclose(Points().read(messages[-1]), expected, atol=0.3)

            ros_test.spin_until(there, what="the point")
    assert ros_test.set_parameters(topics.DETECTOR, track_px=[])[0].successful
    status.wait_for("LOST", "nothing in view has the ball's colour")


def test_the_demo_brings_the_ball_before_two_webcams_to_a_target(ros_test):
    few = "targets:=1", "target_s:=3.0", "image_rate_hz:=15.0", "output_dir:=out"
    webcam = "feature:=points", "simulated_time:=true", "use_sim_time:=true"
    arguments = (word for value in (*few, *webcam) for word in ("-p", value))
    process = ros_test.start("fvs_tools.launcher", "demo", *arguments)
    assert ros_test.wait(process, 120.0) == 0, ros_test.output(process)
    (result,) = json.loads((ros_test.folder / "out" / "results.json").read_text())
    assert len(result["target_m"]) == 4
    assert result["start_distance_m"] > 40.0 * KIND.pixel_m
    assert result["final_rms_m"] < 1.0 * KIND.pixel_m
    assert "argv" not in ros_test.output(process)
    assert "build time" not in ros_test.output(process)
    assert "1.0 px" in ros_test.output(process)


@pytest.mark.parametrize(("method", "law"), [("rbf", "ftsm"), ("poe", "minimum_time")])
def test_the_nodes_bring_points_of_anybodys_tracker_to_a_target(ros_test, trained, method, law):
    model = ros_test.folder / "model.npz"
    save_model(model, trained)
    robot, status = Robot(ros_test), Statuses(ros_test, topics.CONTROLLER)
    common = {"feature": "points", "point_count": 4}
    ros_test.start_node("fvs_estimator_node.node", model_path=model, method=method, **common)
    ros_test.start_node("fvs_controller_node.node", law=law, **common)
    targets = ros_test.publisher(PolygonStamped, "target_points", ros.QOS_LATCHED)

    def started():
        servoing = status.value("state") == "SERVOING"
        return servoing or ros_test.call(Trigger, f"{topics.CONTROLLER}/start").success

    for target in seen(goals(robot.rng)):
        targets.publish(polygon(target))
        status.wait(started, what="a start")

        def there(target=target):
            return status.reason() == "SETTLED" and np.abs(seen(robot.joints) - target).max() < 1.0

        status.wait(there, 60.0, what="the points on their target to a pixel")
        assert " px off" in status.text()
