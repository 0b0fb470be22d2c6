"""A camera on the arm: other objects, taught views, a bumped bracket, an object on a belt."""

from dataclasses import replace

import numpy as np
import pytest
from cases import each

from fvs_controller_node.reasons import Reason, State
from fvs_controller_node.relation import OBJECT_FRAME
from fvs_estimator_node.registry import create_estimator
from fvs_sim_node.config import SimConfig
from fvs_sim_node.simulation import Simulation
from fvs_tools.closed_loop import ClosedLoop
from fvs_tools.schemes import SCHEMES, Scheme

EXACT = SimConfig(camera_mount="arm", rendered=False, position_noise_m=2e-4)


def loop_on_arm(feature, law="minimum_time", method="poe", **values):
    """A loop with the chain that a faultless training finds, half a second after its start."""
    simulation = Simulation(replace(EXACT, feature=feature))

    class Trained:
        chain = simulation.true_chain()

    estimator = create_estimator(method, {}, lambda: Trained, simulation.kind)
    loop = ClosedLoop(simulation, estimator, {"law": law, **values})
    loop.run(0.5)
    return loop


def view_from(loop, seed=0):
    """What the camera shall see of the object: what it sees at joints near by, (m,)."""
    home = loop.simulation.world.home_rad
    joints = home + np.random.default_rng(seed).uniform(-0.1, 0.1, len(home))
    return loop.simulation.true_chain().position(joints)


def errors_m(loop, target, seconds):
    """Errors, tick by tick, m, (k, d)."""
    errors = []
    for _ in range(round(seconds / loop.period_s)):
        loop.tick()
        errors.append(loop.kind.minus(target, loop.true_feature))
    return np.array(errors)


def settling_s(loop, errors):
    out = np.flatnonzero(np.linalg.norm(errors, axis=1) > 0.005)
    return (out[-1] + 1) * loop.period_s


def put_object(loop, motion_m):
    """Move the object in the room by a motion as the camera sees it, m, (6,)."""
    simulation = loop.simulation
    pose = simulation.world.object_pose
    shift_m = simulation.camera.rotation @ motion_m
    simulation.world.object_pose = replace(pose, position_m=pose.position_m + shift_m)


@each("feature", ["ball", "pose"])
def test_it_reaches_views_of_an_object_that_was_put_elsewhere(feature):
    loop = loop_on_arm(feature)
    put_object(loop, np.array([0.04, -0.03, 0.05]))
    loop.run(0.5)
    target = view_from(loop)
    loop.set_target(target)
    errors = errors_m(loop, target, 2.0)
    assert settling_s(loop, errors) < 0.65  # near an edge of the view at first
    assert np.linalg.norm(errors[-60:].mean(axis=0)) < 2e-4
    assert loop.loop.supervisor.last.state is State.SERVOING


@each("feature", ["ball", "pose"])
def test_an_object_is_put_elsewhere_while_the_arm_rests_at_its_target(feature):
    for way_m in ([0.06, 0.0, 0.0], [0.0, -0.06, 0.0], [0.0, 0.0, 0.3]):
        loop = loop_on_arm(feature)
        target = loop.true_feature
        loop.set_target(target)
        loop.run(1.5)
        put_object(loop, np.array(way_m))
        errors = errors_m(loop, target, 3.0)
        assert np.linalg.norm(errors[-60:].mean(axis=0)) < 5e-4
        assert loop.loop.supervisor.last.state is State.SERVOING


def test_a_frozen_picture_is_no_object_that_is_followed_at_the_target():
    loop = loop_on_arm("pose", object_moves=True)
    target = loop.true_feature
    loop.set_target(target)
    belt_m_s = (0.0, 0.05, 0.0)
    loop.simulation.configure(replace(loop.simulation.config, object_velocity_m_s=belt_m_s))
    loop.run(1.0)
    loop.simulation.as_seen = lambda *_: target[:3]
    loop.simulation._blurred = lambda *_: target
    loop.run(1.0)
    assert loop.loop.supervisor.last.state is State.HOLDING


@pytest.mark.parametrize(
    "scheme",
    [
        *SCHEMES.values(),
        *(Scheme(method, method, "proportional", "") for method in ("frozen", "lkf", "rls")),
    ],
    ids=lambda scheme: scheme.name,
)
def test_the_networks_of_a_chain_serve_every_scheme_of_the_paper(scheme):
    loop = ClosedLoop.of_scheme(scheme, Simulation(replace(EXACT, feature="pose")))
    put_object(loop, np.array([0.04, -0.03, 0.05]))
    loop.run(0.5)
    target = view_from(loop)
    loop.set_target(target)
    assert np.linalg.norm(errors_m(loop, target, 3.0)[-1]) < 1e-3


def test_a_taught_view_is_reached_again_after_the_object_moved():
    loop = loop_on_arm("pose")
    loop.run(1.0)
    taught = loop.loop.teach(loop.simulation.time_s)
    assert taught.frame == OBJECT_FRAME  # the camera's pose as seen from the object
    there = loop.kind.inverse(loop.true_feature)
    assert np.linalg.norm(loop.kind.minus(taught.z, there)) < 1e-3
    put_object(loop, np.array([-0.03, 0.04, 0.03]))
    loop.run(0.5)
    accepted, _ = loop.loop.go_to(taught)
    assert accepted
    loop.run(2.0)
    off_m = loop.kind.minus(loop.kind.inverse(loop.true_feature), taught.z)
    assert np.linalg.norm(off_m) < 1e-3


@each("feature", ["ball", "pose"])
def test_a_bracket_that_is_bumped_in_motion_costs_little(feature):
    times_s = []
    for turned_deg in (0.0, 10.0):
        loop = loop_on_arm(feature)
        target = view_from(loop, 3)
        loop.set_target(target)
        loop.run(0.1)
        turn = (turned_deg, 0.0, 0.0)
        loop.simulation.configure(replace(loop.simulation.config, camera_rotation_deg=turn))
        times_s.append(settling_s(loop, errors_m(loop, target, 3.0)))
    assert times_s[1] < 0.5 + 1.5 * times_s[0]


@each("feature", ["ball", "pose"])
def test_an_object_on_a_belt_is_followed_if_it_may_move(feature):
    for moves in (True, False):
        loop = loop_on_arm(feature, object_moves=moves)
        target = loop.true_feature
        loop.set_target(target)
        belt_m_s = (0.0, 0.1, 0.0)
        loop.simulation.configure(replace(loop.simulation.config, object_velocity_m_s=belt_m_s))
        errors = errors_m(loop, target, 2.0)
        behind_m = np.linalg.norm(errors[-125:], axis=1).max()
        assert (behind_m < 1.5e-3) == moves


@each("feature", ["ball", "pose"])
def test_an_image_that_stands_is_no_object_that_is_followed(feature):
    loop = loop_on_arm(feature, object_moves=True)
    loop.set_target(view_from(loop, 3))
    loop.run(0.15)
    simulation, rng, kind = loop.simulation, np.random.default_rng(0), loop.kind
    stands, advance, joints_rad = loop.true_feature, simulation.advance, simulation.joints_rad

    def frozen():
        out = advance()
        noisy = [kind.retract(stands, 2e-4 * rng.normal(size=kind.size)) for _ in out.observations]
        images = zip(out.observations, noisy, strict=True)
        return replace(out, observations=[replace(image, z=z) for image, z in images])

    simulation.advance = frozen
    for _ in range(round(3.0 / loop.period_s)):
        loop.tick()
    last = loop.loop.supervisor.last
    assert last.reason in (Reason.STALLED, Reason.OSCILLATING)
    assert not last.velocity_rad_s.any()
    assert np.abs(simulation.joints_rad - joints_rad).max() < 0.65  # before swings are counted


@each("speed_m_s", [0.2, 0.3])
def test_an_arm_that_catches_up_with_an_object_is_not_stalled(speed_m_s):
    loop = loop_on_arm("ball", object_moves=True)
    loop.set_target(loop.true_feature)
    simulation = loop.simulation
    belt_m_s = (0.0, speed_m_s, 0.0)
    simulation.configure(replace(simulation.config, object_velocity_m_s=belt_m_s))
    loop.run(1.2)
    assert loop.loop.supervisor.last.state is State.SERVOING
