"""Image points before webcams, servoed by chains or by Jacobians that err."""

from collections import deque
from dataclasses import replace
from itertools import cycle

import numpy as np
import pytest
from cases import each
from webcams import before_webcams

from fvs_controller_node.config import default_values
from fvs_controller_node.loop import ServoLoop
from fvs_controller_node.reasons import Reason
from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.kinds.points import Points
from fvs_ros.pixel_chain import PixelChains

DT_S, NOISE_PX, ERROR = 0.008, 0.3, 0.03
#: Of each camera: ticks from image to image, and how many an image is late.
EVERY, LATE = (4, 6), (5, 9)


class Loop:
    """An arm of some joints with some points, before some webcams, in lock step."""

    def __init__(self, joints, points, cameras, late_s=(0.0, 0.0), **values):
        self.rng = np.random.default_rng(2)
        self.webcams = before_webcams(self.rng, joints, points, len(cameras))
        self.webcams = tuple(
            replace(chain, webcam=replace(chain.webcam, late_s=late))
            for chain, late in zip(self.webcams, late_s, strict=False)
        )
        self.model, self.kind = PixelChains(self.webcams), Points(points, cameras=tuple(cameras))
        names = [f"joint_{i + 1}" for i in range(joints)]
        self.values = default_values(
            **{"feature": "points", "point_count": points, "cameras": list(cameras)},
            **{"autostart": True, "joint_names": names, **values},
        )
        self.servo, self.joints, self.tick = ServoLoop(self.values), np.zeros(joints), 0
        self.wrong = 1.0 + ERROR * self.rng.normal(size=(self.kind.size, joints))
        self.waiting, self.apart_s = [deque() for _ in cameras], [0.0, 0.0]

    def run(self, ticks, covered=(), measured=None):
        """Let time pass; returns the reasons that were given."""
        reasons = set()
        for _ in range(ticks):
            self.tick += 1
            now_s = 10.0 + DT_S * self.tick
            for i, (webcam, waiting) in enumerate(zip(self.webcams, self.waiting, strict=True)):
                if self.tick % EVERY[i] == 0 and i not in covered:
                    z = webcam.position(self.joints)
                    z = z + NOISE_PX * self.rng.normal(size=z.size)
                    waiting.append((self.tick + LATE[i], now_s, z))
                if waiting and waiting[0][0] <= self.tick:
                    _, stamp_s, z = waiting.popleft()
                    z = z if measured is None else measured(i, z)
                    self.servo.add_image(
                        now_s, stamp_s + webcam.webcam.late_s + self.apart_s[i], z, i
                    )
            if self.values["law"] == "minimum_time" or self.webcams[0].webcam.late_s:
                self.servo.add_chain(now_s, self.model)
            jacobian = self.wrong * self.kind.along(self.model, self.joints)[1]
            self.servo.add_jacobian(now_s, jacobian)
            self.servo.add_joints(now_s, now_s, self.joints)
            command = self.servo.tick(now_s, DT_S)
            reasons.add(command.reason)
            self.joints = self.joints + DT_S * command.velocity_rad_s
        return reasons

    def give(self, goal_rad):
        """Give the pictures at joints as target, camera by camera."""
        z = self.model.position(goal_rad)
        for camera, rows in enumerate(self.kind.rows):
            assert self.servo.add_target(z[rows], CAMERA_FRAME, camera=camera)[0]
        return z


@each("law", ["minimum_time", "ftsm", "proportional"])
def test_seven_joints_bring_four_points_to_a_target(law):
    """More pixels than joints, and more joints than a body has ways to move."""
    loop = Loop(7, 4, [""], law=law)
    loop.run(50)
    target = loop.give(loop.rng.uniform(-0.2, 0.2, 7))
    loop.run(650)
    np.testing.assert_allclose(loop.model.position(loop.joints), target, atol=1.0)


@each("law", ["minimum_time", "ftsm", "proportional"])
def test_two_webcams_bring_a_point_to_a_place_in_space(law):
    """Four numbers of a point, whose Jacobian has errors in a direction that no arm can move."""
    loop = Loop(6, 1, ["left", "right"], law=law)
    loop.run(50)
    goal_rad = loop.rng.uniform(-0.2, 0.2, 6)
    target = loop.give(goal_rad)
    reasons = loop.run(600)
    assert reasons <= {Reason.READY, Reason.SERVOING, Reason.SETTLED}
    np.testing.assert_allclose(loop.model.position(loop.joints), target, atol=1.0)
    place, wanted = (loop.webcams[0].chain.position(q) for q in (loop.joints, goal_rad))
    assert np.linalg.norm(place - wanted) < 3e-3


@each("law", ["minimum_time", "ftsm"])
def test_a_webcam_that_is_lost_leaves_the_task_with_the_other(law):
    loop = Loop(6, 1, ["left", "right"], law=law)
    loop.run(50)
    target = loop.give(loop.rng.uniform(-0.2, 0.2, 6))
    loop.run(30)
    errors_px = cycle([30.0, -30.0])  # of its last images
    left = loop.kind.rows[0]
    for _ in range(2):
        reasons = loop.run(500, covered=[1], measured=lambda i, z: z + (i and next(errors_px)))
        assert reasons <= {Reason.SERVOING, Reason.SETTLED}
        off_px = loop.model.position(loop.joints)[left] - target[left]
        assert np.abs(off_px).max() < 1.0
        target = loop.give(loop.rng.uniform(-0.2, 0.2, 6))
    inputs, now_s = loop.servo.supervisor.inputs, 10.0 + DT_S * loop.tick
    assert "right/image_points is" in inputs.hidden(now_s)
    assert not loop.servo.set_current_as_target(now_s)[0]
    loop.run(500)  # it sees again
    np.testing.assert_allclose(loop.model.position(loop.joints), target, atol=1.0)


@each("law", ["minimum_time", "ftsm"])
def test_webcams_that_stamp_late_by_what_the_chains_know_are_followed_in_step(law):
    loop = Loop(6, 1, ["left", "right"], late_s=(0.03, 0.08), law=law)
    loop.run(50)
    for _ in range(3):
        target = loop.give(loop.rng.uniform(-0.3, 0.3, 6))
        assert loop.run(400) <= {Reason.READY, Reason.SERVOING, Reason.SETTLED}
        np.testing.assert_allclose(loop.model.position(loop.joints), target, atol=1.0)


def test_a_webcam_with_another_clock_is_no_start_and_leaves_a_session_with_word_of_it():
    loop = Loop(6, 1, ["left", "right"])
    loop.apart_s[1] = -1.0
    loop.run(50)
    loop.give(loop.rng.uniform(-0.2, 0.2, 6))
    assert loop.run(50) == {Reason.NO_POSITION}
    assert "right/image_points is stamped 1.0" in loop.servo.supervisor.last.text
    loop.apart_s[1] = 0.0
    loop.run(50)
    loop.apart_s[1] = -1.0
    assert loop.run(100) <= {Reason.SERVOING, Reason.SETTLED}
    words = loop.servo.supervisor.inputs.hidden(10.0 + DT_S * loop.tick)
    assert "right/image_points is stamped 1.0" in words
    assert "the other cameras count" in words


def test_a_part_of_a_target_replaces_that_of_its_camera_alone():
    loop = Loop(6, 1, ["left", "right"])
    loop.run(50)
    (left, right), goal = loop.kind.rows, loop.servo.supervisor.goal
    one, other = (loop.model.position(np.full(6, at)) for at in (0.1, 0.2))
    assert loop.servo.add_target(one[left], CAMERA_FRAME, camera=0) == (True, "")
    assert goal.target is None
    assert goal.awaited == "right/target_points"
    for z, mine, camera in ((one, right, 1), (other, right, 1), (other, left, 0)):
        assert loop.servo.add_target(z[mine], CAMERA_FRAME, camera=camera)[0]
    np.testing.assert_array_equal(goal.target, other)
    assert loop.servo.set_current_as_target(10.0 + DT_S * loop.tick)[0]
    here = goal.target
    assert loop.servo.add_target(one[right], CAMERA_FRAME, camera=1)[0]
    np.testing.assert_array_equal(goal.target, np.append(here[left], one[right]))


def test_a_camera_whose_target_is_not_updated_shows_it_where_it_was():
    loop = Loop(6, 1, ["left", "right"])
    loop.run(50)
    (left, right), goal = loop.kind.rows, loop.servo.supervisor.goal
    start = loop.model.position(loop.joints)

    def give(z, camera):
        loop.servo.add_target(z, CAMERA_FRAME, 10.0 + DT_S * loop.tick, camera)

    for step in range(20):
        for camera, rows in enumerate((left, right)):
            give(start[rows] + step, camera)
        loop.run(4)
    for _ in range(40):
        give(start[left] + 20.0, 0)
        loop.run(4)
    np.testing.assert_allclose(goal.target[right], start[right] + 19.0, atol=0.5)
    np.testing.assert_allclose(goal.target[left], start[left] + 20.0, atol=0.5)
    reasons = set()
    for step in range(20):  # the other camera's parts are older
        give(start[left] + step, 0)
        loop.servo.add_target(start[right] + step, CAMERA_FRAME, 9.98 + DT_S * loop.tick, 1)
        reasons |= loop.run(4)
    np.testing.assert_allclose(goal.target[right], start[right] + 19.0, atol=3.0)
    assert reasons <= {Reason.SERVOING, Reason.SETTLED}


def test_a_target_beyond_the_picture_is_refused():
    loop = Loop(6, 1, ["left", "right"], picture_px=[640, 480])
    loop.run(50)
    loop.give(np.full(6, 0.1))
    accepted, why = loop.servo.add_target(np.array([5000.0, 240.0]), CAMERA_FRAME, camera=0)
    assert not accepted
    assert "left/target_points: (5000.0, 240.0) px is not in a picture of 640 x 480 px" in why
    loop = Loop(6, 1, ["left", "right"], picture_px=[640, 480])
    assert not loop.servo.add_target(np.array([5000.0, 240.0]), CAMERA_FRAME, camera=0)[0]
    assert loop.servo.supervisor.goal.awaited == "left/target_points and right/target_points"


def test_the_arm_rests_while_no_webcam_sees():
    loop = Loop(6, 1, ["left", "right"])
    assert loop.run(100, covered=[1]) == {Reason.MISSING}
    loop.run(50)
    loop.give(loop.rng.uniform(-0.2, 0.2, 6))
    loop.run(30)
    loop.run(40, covered=[0, 1])
    before = loop.joints
    assert loop.run(20, covered=[0, 1]) == {Reason.STALE}
    np.testing.assert_array_equal(loop.joints, before)


@pytest.mark.parametrize("camera", [0, 1])
def test_a_webcam_with_a_bad_or_a_frozen_picture_stops_the_arm(camera):
    loop = Loop(6, 1, ["left", "right"])
    loop.run(50)
    loop.give(loop.rng.uniform(-0.2, 0.2, 6))
    loop.run(10)
    nan = {"measured": lambda i, z: z + [np.nan, 0.0][i != camera]}
    assert Reason.BAD_INPUT in loop.run(9, **nan)
    assert loop.run(200, **nan) == {Reason.BAD_INPUT}
    loop = Loop(6, 1, ["left", "right"])
    loop.run(50)
    loop.give(np.full(6, 0.3))
    frozen = loop.webcams[camera].position(loop.joints)
    reasons = loop.run(200, measured=lambda i, z: frozen if i == camera else z)
    assert reasons & {Reason.IMAGE_NOT_FOLLOWING, Reason.PREDICTION_ERROR}


PICTURES = {
    "upside down": lambda z: [640.0, 480.0] - z,
    "mirrored": lambda z: [640.0, 0.0] + [-1.0, 1.0] * z,
    "points in another order": lambda z: z[::-1],
}


@each("picture", PICTURES)
def test_a_picture_that_is_not_as_in_training_stops_the_arm(picture):
    for joints, points in (7, 4), (6, 1):
        if points == 1 and "order" in picture:
            continue
        loop = Loop(joints, points, [""])

        def measured(_, z):
            return PICTURES[picture](z.reshape(-1, 2)).ravel()

        loop.run(50, measured=measured)
        loop.give(loop.rng.uniform(-0.25, 0.25, joints))
        loop.run(900, measured=measured)
        last = loop.servo.supervisor.last
        assert last.reason.needs_start or last.reason is Reason.NEAR_SINGULAR, last.text
        assert np.abs(loop.joints).max() < 1.0
