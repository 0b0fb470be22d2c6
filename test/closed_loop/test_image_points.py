"""Image points before a webcam, servoed by a chain or by Jacobians that err."""

from collections import deque

import numpy as np
from cases import each

from fvs_controller_node.config import default_values
from fvs_controller_node.loop import ServoLoop
from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.chain import SerialChain
from fvs_ros.kinds.points import Points
from fvs_ros.pixel_chain import PixelChain, Webcam

DT_S, IMAGE_TICKS, LATE_TICKS, NOISE_PX, ERROR = 0.008, 4, 5, 0.3, 0.03
WAYS_M = 0.1 * np.array([[1.0, 0.0, 0.5], [0.0, 1.0, -0.5], [-1.0, 0.6, 0.3]])


@each("law", ["minimum_time", "ftsm", "proportional"])
def test_seven_joints_bring_four_points_to_a_target(law):
    """More pixels than joints, and more joints than a body has ways to move."""
    rng = np.random.default_rng(2)
    first = np.array([0.1, -0.1, 1.5])
    axes, near = rng.normal(size=(2, 7, 3))
    chain = SerialChain(axes, first + 0.3 * near, np.append(first, WAYS_M), np.zeros(7))
    model, kind = PixelChain(chain, Webcam(600.0, (320.0, 240.0), -0.2)), Points(4)
    names = [f"joint_{i + 1}" for i in range(7)]
    values = default_values(
        feature="points", point_count=4, law=law, autostart=True, joint_names=names
    )
    servo, joints, waiting = ServoLoop(values), np.zeros(7), deque()
    target, wrong = model.position(rng.uniform(-0.2, 0.2, 7)), 1.0 + ERROR * rng.normal(size=(8, 7))
    for tick in range(1, 700):
        now_s = 10.0 + DT_S * tick
        if tick == 50:
            assert servo.add_target(target, CAMERA_FRAME)[0]
        if tick % IMAGE_TICKS == 0:
            z = model.position(joints) + NOISE_PX * rng.normal(size=8)
            waiting.append((tick + LATE_TICKS, now_s, z))
        if waiting and waiting[0][0] == tick:
            servo.add_image(now_s, *waiting.popleft()[1:])
        if law == "minimum_time":
            servo.add_chain(now_s, model)
        servo.add_jacobian(now_s, wrong * kind.along(model, joints)[1])
        servo.add_joints(now_s, now_s, joints)
        joints = joints + DT_S * servo.tick(now_s, DT_S).velocity_rad_s
    np.testing.assert_allclose(model.position(joints), target, atol=1.0)
