"""A camera on the arm keeps what it sees in view, also on ways that would leave it."""

from collections import deque
from dataclasses import replace

import numpy as np
import pytest
import ur5_dh
from cases import each
from lock_step import GOAL_RAD, START_RAD, feature_at, loop_from, run

from fvs_controller_node.config import default_values
from fvs_controller_node.loop import ServoLoop
from fvs_controller_node.reasons import State
from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.chain import SerialChain
from fvs_ros.kinds import KINDS
from fvs_ros.rotations import rotation_from_vector
from fvs_ros.view import ViewConfig

WIDE = {"view_half_angles_deg": [34.5, 21.0]}
VIEW = ViewConfig(**WIDE)
#: A view without ends.
ENDLESS = {
    "view_half_angles_deg": [89.0, 89.0],
    "view_distance_m": [0.0, 100.0],
    "view_tilt_deg": 90.0,
    "view_radius_m": 0.0,
}
ON_ARM = {
    "feature": "pose",
    "camera_mount": "arm",
    "law": "minimum_time",
    "autostart": True,
    **WIDE,
}
DT_S, LATENCY_S, LAG_S = 0.008, 0.06, 0.035


def camera_at(joints_rad):
    """The chain of a camera beside the flange, tilted."""
    *frames, (rotation, origin_m) = ur5_dh.frames(joints_rad)
    camera = rotation @ rotation_from_vector(np.array([0.1, -0.15, 0.4]))
    origin_m = origin_m + rotation @ np.array([0.05, 0.02, 0.04])
    axes = np.array([frame[:, 2] for frame, _ in frames]) @ camera
    points_m = (np.array([point for _, point in frames]) - origin_m) @ camera
    return SerialChain(axes, points_m, np.zeros(3), joints_rad, on_arm=True)


def drawn(name, number):
    """A chain that sees an object, and where the object is seen from other joints: in view."""
    kind, generator = KINDS[name](camera_mount="arm"), np.random.default_rng(number)
    while True:
        start_rad, goal_rad = (
            ur5_dh.HOME_RAD + generator.uniform(-1.0, 1.0, 6) * [0.6, 0.5, 0.5, 0.8, 0.8, 1.0]
            for _ in range(2)
        )
        ray = np.array([*generator.uniform(-0.5, 0.5, 2), 1.0])
        rotation = rotation_from_vector(generator.uniform(-0.9, 0.9, 3)) @ np.diag([1, -1, -1])
        seen = kind.of_body(generator.uniform(0.2, 0.9) * ray, rotation)
        chain = replace(camera_at(start_rad), feature_m=seen)
        target = kind.nearest(chain.position(goal_rad))
        if not VIEW.out_of_view(kind, seen) and not VIEW.out_of_view(kind, target):
            return kind, chain, target


def least_margin_m(number, turned_rad=0.15, **values):
    """Servo for 4 s behind a bracket that was turned; the smallest margin, texts, and the loop."""
    kind, chain, target = drawn("pose", number)
    generator = np.random.default_rng(number)
    axis = generator.standard_normal(3)
    known = chain.moved(rotation_from_vector(turned_rad * axis / np.linalg.norm(axis)), np.zeros(3))
    loop = ServoLoop(default_values(**{**ON_ARM, **values}))
    joints, drive, images = chain.reference_rad, np.zeros(6), deque()
    margins_m, texts = [], set()
    for tick in range(500):
        now_s = tick * DT_S
        z = kind.nearest(chain.position(joints))
        margins_m.append(VIEW.margins(kind, z)[0].min())
        if tick % 4 == 0:
            images.append((now_s, joints, z))
        loop.add_joints(now_s, now_s, joints)
        if images and images[0][0] + LATENCY_S <= now_s:
            stamp_s, then, z = images.popleft()
            loop.add_image(now_s, stamp_s, z)
            anchored = known.anchored(then, z)
            anchored = replace(anchored, feature_m=kind.nearest(anchored.feature_m))
        if now_s > LATENCY_S + DT_S:
            loop.add_chain(now_s, anchored)
            loop.add_jacobian(now_s, kind.moved_by(*anchored.motion(joints)))
        if tick == 30:
            loop.add_target(target, CAMERA_FRAME)
        command = loop.tick(now_s, DT_S)
        texts.add(command.text.partition("; ")[2])
        drive = drive + DT_S / LAG_S * (command.velocity_rad_s - drive)
        joints = joints + DT_S * drive
    return min(margins_m), texts, loop


@each("number", [19, 111])
def test_a_way_that_would_leave_the_view_is_bent(number):
    lost_m, _, _ = least_margin_m(number, **ENDLESS)
    kept_m, texts, loop = least_margin_m(number)
    assert lost_m < -0.05  # out of the picture, or seen too flat
    assert kept_m > -0.005
    assert any("slowed, the tag is at the bottom edge of the view" in text for text in texts)
    assert np.linalg.norm(loop.supervisor.goal.error_m) < 0.02
    assert loop.supervisor.last.state is State.SERVOING


def test_a_target_out_of_view_is_refused():
    loop = ServoLoop(default_values(**ON_ARM))
    kind, _, target = drawn("pose", 0)
    accepted, text = loop.add_target(kind.retract(target, np.eye(6)[0]), CAMERA_FRAME)
    assert not accepted
    assert "at the right edge of the view by" in text
    assert loop.add_target(target, CAMERA_FRAME)[0]


@each("law", ["minimum_time", "ftsm"])
def test_an_object_at_the_camera_itself_moves_no_arm(law):
    loop = ServoLoop(default_values(**ON_ARM | {"law": law}))
    kind, chain, target = drawn("pose", 0)
    at_camera = kind.of_body(np.zeros(3), np.eye(3))
    with pytest.raises(ValueError, match="is at the camera itself"):
        kind.checked(at_camera)
    assert loop.add_target(target, CAMERA_FRAME)[0]
    states = set()
    for tick in range(100):  # even if it came to there
        now_s = tick * DT_S
        loop.add_joints(now_s, now_s, chain.reference_rad)
        loop.add_image(now_s, now_s, at_camera)
        loop.add_chain(now_s, chain)
        loop.add_jacobian(now_s, kind.moved_by(at_camera, *chain.motion(chain.reference_rad)[1:]))
        command = loop.tick(now_s, DT_S)
        assert not command.velocity_rad_s.any()
        states.add(command.state)
    assert State.FAULT in states


def test_a_fixed_camera_has_no_such_view():
    narrow = {"view_half_angles_deg": [1.0, 1.0], "view_distance_m": [0.0, 0.1]}
    commands = []
    for values in ({}, narrow):
        loop = loop_from("best", START_RAD, **values)
        target = feature_at(loop.simulation, GOAL_RAD)
        loop.simulation.reset(START_RAD, 1)
        commands.append(run(loop, target, 0.5)[0])
    assert np.array_equal(*commands)
    assert commands[0].any()
