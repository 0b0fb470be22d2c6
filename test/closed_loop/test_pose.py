"""A tag's pose, servoed in lock step: every scheme, rendered images, and a camera that is moved."""

from dataclasses import replace

import numpy as np
from cases import each

from fvs_controller_node.reasons import Reason, State
from fvs_sim_node.config import SimConfig
from fvs_sim_node.simulation import Simulation
from fvs_tools.closed_loop import ClosedLoop
from fvs_tools.schemes import BEYOND, SCHEMES

START_RAD = np.array([0.1, -1.2, 1.5, -1.8, -1.4, -0.1])
GOAL_RAD = np.array([-0.2, -1.5, 1.75, -1.6, -1.75, 0.2])
#: What ``position_noise_m`` is like that of images.
EXACT = SimConfig(feature="pose", rendered=False, position_noise_m=3e-4)
SETTLED_M, SETTLED_RAD = 5e-3, np.radians(1.0)


def pose_at(loop, joints_rad):
    """The tag as the camera sees it at joints."""
    return loop.simulation.true_chain(loop.kind).position(joints_rad)


def loop_of(scheme, config=EXACT, **values):
    simulation = Simulation(config)
    simulation.reset(START_RAD, 1)
    loop = ClosedLoop.of_scheme(scheme, simulation, **values)
    loop.run(1.0)
    return loop


def servo(loop, target, seconds):
    """Ways, m, and angles, rad, tick by tick."""
    loop.set_target(target)
    parts = []
    for _ in range(round(seconds / loop.period_s)):
        loop.tick()
        parts.append(loop.kind.status_values(loop.kind.minus(loop.true_feature, target)))
    return np.array([[one["way_m"], one["angle_rad"]] for one in parts]).T


@each("scheme", [*SCHEMES, *BEYOND])
def test_every_scheme_settles_in_position_and_angle(scheme):
    loop = loop_of(scheme)
    way_m, angle_rad = servo(loop, pose_at(loop, GOAL_RAD), 3.0)
    assert way_m[0] > 0.1
    assert angle_rad[0] > np.radians(20.0)
    assert way_m[-125:].max() < SETTLED_M
    assert angle_rad[-125:].max() < SETTLED_RAD
    assert loop.loop.supervisor.last.reason is Reason.SETTLED


def test_rendered_images_bring_it_to_rest_within_a_millimetre_and_a_tenth_of_a_degree():
    loop = loop_of("best", SimConfig(feature="pose"))
    way_m, angle_rad = servo(loop, pose_at(loop, GOAL_RAD), 3.0)
    assert np.sqrt(np.mean(way_m[-125:] ** 2)) < 1e-3
    assert np.sqrt(np.mean(angle_rad[-125:] ** 2)) < np.radians(0.1)


def test_a_camera_that_is_turned_and_moved_costs_little_time():
    loop = loop_of("best")
    target = pose_at(loop, GOAL_RAD)
    undisturbed_s = loop.period_s * np.flatnonzero(servo(loop, target, 2.0)[0] > SETTLED_M)[-1]
    loop = loop_of("best")
    camera = loop.simulation.camera.turned(np.radians([8.0, -12.0, 13.0]))
    loop.simulation.configure(
        replace(EXACT, camera_pose=camera.moved(np.array([0.06, -0.05, 0.06])))
    )
    loop.run(0.3)
    way_m, angle_rad = servo(loop, pose_at(loop, GOAL_RAD), 2.0)
    late = (way_m > SETTLED_M) | (angle_rad > SETTLED_RAD)
    assert loop.period_s * np.flatnonzero(late)[-1] < 1.3 * undisturbed_s + 0.05


def test_a_frozen_image_holds_the_arm():
    loop = loop_of("best")
    frozen = loop.true_feature
    inputs = loop.loop

    def add_frozen(now_s, stamp_s, _seen_m):
        inputs.__class__.add_image(inputs, now_s, stamp_s, frozen)

    inputs.add_image = add_frozen
    servo(loop, pose_at(loop, GOAL_RAD), 1.5)
    assert loop.loop.supervisor.last.reason is Reason.IMAGE_NOT_FOLLOWING
    assert loop.loop.supervisor.last.state is State.HOLDING


def test_a_moving_target_is_followed():
    loop = loop_of("best")
    chain = loop.simulation.true_chain(loop.kind)
    errors_m = []
    for tick in range(500):
        along = 0.5 - 0.5 * np.cos(0.5 * tick * loop.period_s)
        target = chain.position(START_RAD + along * (GOAL_RAD - START_RAD))
        if tick % 4 == 0:
            loop.set_target(target)
        loop.tick()
        errors_m.append(np.linalg.norm(loop.kind.minus(loop.true_feature, target)))
    assert max(errors_m[125:]) < 5e-3
