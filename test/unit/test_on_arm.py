"""A chain that ends in the camera: another object, one that moves, and a bumped bracket."""

from dataclasses import replace

import numpy as np
import pytest
import ur5_dh
from cases import each
from recordings import image, rotation_about, ur5_chain

from fvs_estimator_node.files import DataSet
from fvs_estimator_node.registry import create_estimator
from fvs_estimator_node.training import TrainingError, TrainingOptions, learned, train
from fvs_ros.kinds.ball import Ball
from fvs_ros.kinds.pose import Pose
from fvs_ros.rotations import rotation_angle_rad

KINDS = [Ball(camera_mount="arm"), Pose(camera_mount="arm")]
NOISE_M = 2e-4
TURNED, SHIFT_M = rotation_about([0.3, 0.1, 1.0], np.radians(10.0)), np.array([0.01, -0.015, 0.008])


def room(kind):
    """What a UR5 sees in the room that has its camera where it usually has its ball."""
    arm = ur5_chain()
    z = kind.of_body(np.array([0.05, 0.02, 0.35]), rotation_about([1.0, 0.2, 0.0], 2.8))
    at_camera = replace(arm, on_arm=True).moved(np.eye(3), -arm.position(ur5_dh.HOME_RAD)[:3])
    return replace(at_camera, feature_m=np.zeros_like(z)).anchored(ur5_dh.HOME_RAD, z)


def wander(seed, count=90, half_rad=0.2):
    """Joints on a smooth path about home, rad, (count, 6), from there on."""
    rng = np.random.default_rng(seed)
    phases, rates = rng.uniform(0.0, 6.0, 6), rng.uniform(0.5, 2.0, 6)
    times_s = np.arange(count)[:, None] / 30.0
    return ur5_dh.HOME_RAD + half_rad * (np.sin(phases + rates * times_s) - np.sin(phases))


def watch(estimator, chain, joints, rng, first_s=0.0, velocity_m_s=0.0):
    kind = estimator.kind
    for index, joints_rad in enumerate(joints):
        stamp_s = first_s + index / 30.0
        carried = chain.feature_m.copy()
        carried[:3] += stamp_s * velocity_m_s
        z = replace(chain, feature_m=carried).position(joints_rad)
        z = kind.retract(z, NOISE_M * rng.normal(size=kind.size))
        estimator.observe(image(joints_rad, z, stamp_s), NOISE_M)
    return z


def jacobian_error(estimator, chain, joints_rad, z):
    truth = estimator.kind.moved_by(z, *chain.motion(joints_rad)[1:])
    error = estimator.jacobian(joints_rad, z) - truth
    return np.linalg.norm(error) / np.linalg.norm(truth)


def made(kind, chain):
    class Trained:
        pass

    Trained.chain = chain
    return create_estimator("poe", {}, lambda: Trained, kind)


@each("kind", KINDS)
def test_what_is_learned_before_one_object_holds_before_another(kind):
    rng, chain = np.random.default_rng(0), room(kind)
    joints = wander(1, 600, 0.12)
    z = chain.position(joints) + 0.0
    z = np.array(
        [kind.retract(row, NOISE_M * rng.normal(size=kind.size)) for row in chain.position(joints)]
    )
    data = DataSet(
        np.arange(600) / 15.0, joints, z, np.zeros(600), feature=kind.name, camera_mount="arm"
    )
    model = train(data, TrainingOptions("poe"))
    assert model.camera_mount == "arm"
    truth = learned(chain, joints)
    for got, most in ((learned(model.chain, joints), 0.003), (model.model.jacobian(joints), 0.01)):
        error = np.linalg.norm(got - truth, axis=(1, 2)) / np.linalg.norm(truth, axis=(1, 2))
        assert np.median(error) < most
    # Chain and networks serve what is elsewhere.
    there = kind.retract(z[0], np.array([0.1, -0.05, 0.1, 0.02, 0.1, -0.05])[: kind.size])
    networks = create_estimator("rbf", {}, lambda: model, kind)
    for estimator in (made(kind, model.chain), networks):
        assert jacobian_error(estimator, chain, joints[0], there) < 0.01
    with pytest.raises(TrainingError, match="train with the method poe"):
        train(data, TrainingOptions("ridge"))
    with pytest.raises(ValueError, match="use another method than rbf_left"):
        create_estimator("rbf_left", {}, lambda: model, kind)


@each("kind", KINDS)
def test_a_bumped_bracket_is_found_and_a_moved_object_is_none(kind):
    rng, chain, joints = np.random.default_rng(2), room(kind), wander(3, 240)
    estimator = made(kind, chain)
    watch(estimator, chain, joints[:60], rng)
    elsewhere = kind.retract(chain.feature_m, np.full(kind.size, 0.04))
    moved = replace(chain, feature_m=elsewhere)
    z = watch(estimator, moved, joints[60:120], rng, 2.0)
    assert estimator.bumps == 0
    assert jacobian_error(estimator, moved, joints[119], z) < 0.01
    bumped = moved.moved(TURNED, SHIFT_M)
    z = watch(estimator, bumped, joints[120:240], rng, 4.0)
    assert estimator.bumps == 1
    assert jacobian_error(estimator, bumped, joints[239], z) < 0.01
    found = np.radians(estimator.status_values()["camera_turned_deg"])
    assert abs(found - rotation_angle_rad(TURNED)) < np.radians(1.0)
    np.testing.assert_allclose(estimator.chain.position(joints[239]), z, atol=1e-9)


@each("kind", KINDS)
def test_an_object_on_a_belt_is_not_taken_for_a_bumped_bracket(kind):
    rng, chain, joints = np.random.default_rng(4), room(kind), wander(5, 210)
    estimator, belt_m_s = made(kind, chain), np.array([0.05, -0.05, 0.02])
    z = watch(estimator, chain, joints[:150], rng, velocity_m_s=belt_m_s)
    assert estimator.bumps == 0
    assert jacobian_error(estimator, chain, joints[149], z) < 0.01
    bumped = chain.moved(TURNED, SHIFT_M)
    z = watch(estimator, bumped, joints[150:], rng, 5.0, TURNED @ belt_m_s)
    assert estimator.bumps == 1
    assert jacobian_error(estimator, bumped, joints[-1], z) < 0.01


@each("kind", KINDS)
def test_stamps_of_two_clocks_in_turns_leave_the_jacobian_right(kind):
    rng, chain, joints = np.random.default_rng(0), room(kind), wander(7, 120)
    estimator = made(kind, chain)
    elsewhere = replace(chain, feature_m=kind.retract(chain.feature_m, np.full(kind.size, 0.3)))
    for first in range(0, 120, 2):
        watch(estimator, chain, joints[first : first + 2], rng, first / 30.0, 0.3)
        z = watch(estimator, elsewhere, joints[:1], rng, 1.79e9 + first / 30.0)
        assert jacobian_error(estimator, elsewhere, joints[0], z) < 0.05
