"""Networks behind a camera that was turned: a 3x3 factor, learned within a short way."""

import numpy as np
import pytest
import ur5_dh
from recordings import relative_error, turn, ur5_chain

from fvs_estimator_node.base import MotionStep
from fvs_estimator_node.left_factor import (
    KINDS,
    LEFT_FACTOR_PARAMETERS,
    MATRIX,
    ROTATION,
    LeftFactorConfig,
    LeftFactorEstimator,
    left_factor_config,
)
from fvs_estimator_node.rbf import FrozenRbfEstimator
from fvs_estimator_node.rotations import rotation_angle_rad
from fvs_estimator_node.teaching import teach

BOX = ur5_dh.HOME_RAD + np.array([-1.0, 1.0])[:, None] * ur5_dh.BOX_M_RAD
TURNED = turn([0.2, -0.3, 1.0], np.radians(45.0))
PLACES = ur5_dh.uniform_in_box(np.random.default_rng(9), 100)


@pytest.fixture(scope="module")
def model():
    return teach(ur5_chain(), BOX, 60, np.random.default_rng(0))


def estimator_of(model, kind=ROTATION):
    return LeftFactorEstimator(model, LeftFactorConfig(kind=kind))


def travel(estimator, chain, way_m, rng, noise_m=0.001, along=None):
    """Let the ball go a way in the box, about 12 mm a step; noise on every position."""
    joints = ur5_dh.HOME_RAD.copy()
    direction = along if along is not None else rng.normal(size=6)
    ball = chain.position(joints)
    seen, gone_m, count = ball + noise_m * rng.normal(size=3), 0.0, 0
    while gone_m < way_m:
        count += 1
        if along is not None:
            direction = along if count // 10 % 2 else -along
        else:
            direction = direction + 0.5 * rng.normal(size=6) - (joints - ur5_dh.HOME_RAD)
        step = 0.02 * direction / np.abs(direction).max()
        before, joints = joints, joints + step
        new_ball = chain.position(joints)
        new_seen = new_ball + noise_m * rng.normal(size=3)
        estimator.update(
            MotionStep(count / 30.0, 1.0 / 30.0, before + 0.5 * step, step, new_seen - seen)
        )
        gone_m += np.linalg.norm(new_ball - ball)
        ball, seen = new_ball, new_seen


def error_of(estimator, chain):
    learned = np.array([estimator.jacobian(q) for q in PLACES])
    return float(np.median(relative_error(learned, chain.jacobian(PLACES))))


@pytest.mark.parametrize(("kind", "within"), [(ROTATION, 0.12), (MATRIX, 0.18)])
@pytest.mark.parametrize("seed", range(3))
def test_a_turned_camera_is_learned_in_a_third_of_a_metre(model, kind, within, seed):
    chain = ur5_chain().moved(TURNED, np.zeros(3))
    estimator = estimator_of(model, kind)
    frozen = error_of(FrozenRbfEstimator(model), chain)
    assert frozen > 0.5
    travel(estimator, chain, 0.3, np.random.default_rng(seed))
    assert error_of(estimator, chain) < within
    travel(estimator, chain, 1.0, np.random.default_rng(seed))
    assert error_of(estimator, chain) < 0.08
    assert estimator.status_values()["camera_turned_deg"] == pytest.approx(45.0, abs=5.0)


def test_a_matrix_learns_what_no_rotation_can(model):
    stretched = 1.3 * TURNED
    chain = ur5_chain()

    class Stretched:
        """A camera whose metres are not ours."""

        @staticmethod
        def position(joints):
            return chain.position(joints) @ stretched.T

        @staticmethod
        def jacobian(joints):
            return stretched @ chain.jacobian(joints)

    errors = {}
    for kind in KINDS:
        estimator = estimator_of(model, kind)
        travel(estimator, Stretched, 1.5, np.random.default_rng(0))
        errors[kind] = error_of(estimator, Stretched)
    assert errors[MATRIX] < 0.1 < errors[ROTATION]


@pytest.mark.parametrize("kind", KINDS)
def test_a_camera_that_stands_still_is_hardly_turned_by_noise(model, kind):
    estimator = estimator_of(model, kind)
    before = error_of(estimator, ur5_chain())
    travel(estimator, ur5_chain(), 1.0, np.random.default_rng(0))
    assert error_of(estimator, ur5_chain()) < before + 0.04


@pytest.mark.parametrize("noise_m", [0.004, 0.006, 0.01])
@pytest.mark.parametrize("rests", [True, False])
def test_a_noisy_camera_is_no_camera_that_is_bumped(model, noise_m, rests):
    estimator, rng = estimator_of(model), np.random.default_rng(2)
    if rests:
        ball = ur5_chain().position(ur5_dh.HOME_RAD)
        for _ in range(100):
            estimator.observe(ur5_dh.HOME_RAD, ball + noise_m * rng.normal(size=3))
        assert estimator._watch.deviation_m == pytest.approx(2.0**0.5 * noise_m, rel=0.3)
    travel(estimator, ur5_chain(), 3.0, rng, noise_m)
    assert estimator.status_values()["camera_bumps"] == 0.0


def test_a_turned_camera_that_is_noisy_is_found_soon_and_kept_along_a_line(model):
    chain, home, noise_m = ur5_chain().moved(TURNED, np.zeros(3)), ur5_dh.HOME_RAD, 0.004
    soon, kept = [], []
    for seed in range(24):
        estimator, rng = estimator_of(model), np.random.default_rng(seed)
        for _ in range(60):
            estimator.observe(home, chain.position(home) + noise_m * rng.normal(size=3))
        travel(estimator, chain, 0.3, rng, noise_m)
        soon.append(error_of(estimator, chain))
        travel(estimator, chain, 1.2, rng, noise_m)
        travel(estimator, chain, 4.0, rng, noise_m, along=rng.normal(size=6))
        kept.append(error_of(estimator, chain))
    assert np.mean(soon) < 0.2
    assert np.mean(kept) < 0.18


@pytest.mark.parametrize("turned", [np.eye(3), TURNED])
def test_noise_feigns_no_turn_about_the_line_that_the_ball_goes_along(model, turned):
    """What the small motions to the side tell is less than their noise: nothing is believed."""
    off_deg = []
    for seed in range(10):
        rng, learner = np.random.default_rng(seed), estimator_of(model)
        if turned is TURNED:
            travel(learner, ur5_chain().moved(TURNED, np.zeros(3)), 3.0, rng)
            jump = MotionStep(0.0, 1.0 / 30.0, ur5_dh.HOME_RAD, np.full(6, 0.01), np.ones(3))
            learner.update(jump)  # a bump that turns nothing
        begun = learner.factor
        joints, last = ur5_dh.HOME_RAD, 0.001 * rng.normal(size=3)
        for k in range(12):
            j = FrozenRbfEstimator(model).jacobian(joints)
            aside = 0.002 * rng.normal(size=3)
            step = np.linalg.pinv(j) @ (np.array([0.03, 0.0, 0.0]) + aside)
            noise = 0.001 * rng.normal(size=3)
            seen = begun @ (j @ step) + noise - last
            learner.update(MotionStep(k / 30.0, 1.0 / 30.0, joints, step, seen))
            last = noise
        off_deg.append(np.degrees(rotation_angle_rad(learner.factor @ begun.T)))
    assert np.mean(off_deg) < 2.0


@pytest.mark.parametrize("kind", KINDS)
def test_a_long_way_along_one_line_forgets_nothing(model, kind):
    chain = ur5_chain().moved(TURNED, np.zeros(3))
    estimator, rng = estimator_of(model, kind), np.random.default_rng(0)
    travel(estimator, chain, 1.0, rng)
    travel(estimator, chain, 30.0, rng, along=np.eye(6)[0])
    assert error_of(estimator, chain) < 0.2
    assert np.isfinite(estimator.factor).all()


@pytest.mark.parametrize("kind", KINDS)
def test_a_bump_is_not_learned_from_but_noted(model, kind):
    estimator = estimator_of(model, kind)
    before = estimator.factor
    estimator.update(
        MotionStep(1.0, 0.03, ur5_dh.HOME_RAD, np.full(6, 0.01), np.array([0.1, 0.0, 0.0]))
    )
    np.testing.assert_array_equal(estimator.factor, before)
    assert estimator.status_values()["camera_bumps"] == 1.0
    chain = ur5_chain().moved(TURNED, np.zeros(3))
    travel(estimator, chain, 0.3, np.random.default_rng(1))
    assert error_of(estimator, chain) < 0.2


def test_a_blow_is_no_step_of_the_ball_however_noisy_the_camera_is(model):
    estimator, rng = estimator_of(model), np.random.default_rng(2)
    ball = ur5_chain().position(ur5_dh.HOME_RAD)
    for _ in range(60):
        estimator.observe(ur5_dh.HOME_RAD, ball + 0.004 * rng.normal(size=3))
    before = estimator.factor
    estimator.update(
        MotionStep(1.0, 0.03, ur5_dh.HOME_RAD, np.full(6, 0.01), np.array([0.1, 0.0, 0.0]))
    )
    np.testing.assert_array_equal(estimator.factor, before)
    assert estimator.status_values()["camera_bumps"] == 1.0


def unit(rng):
    direction = rng.normal(size=3)
    return direction / np.linalg.norm(direction)


@pytest.mark.parametrize("kind", KINDS)
def test_a_turn_that_hardly_moves_the_ball_in_view_is_seen_by_the_next_steps(model, kind):
    estimator, rng = estimator_of(model, kind), np.random.default_rng(3)
    chain = ur5_chain()
    travel(estimator, chain, 1.0, rng)  # much that speaks for a camera as it was
    assert estimator.status_values()["camera_bumps"] == 0.0
    home = chain.position(ur5_dh.HOME_RAD)
    turned = chain.moved(TURNED, home - TURNED @ home)  # about the ball
    travel(estimator, turned, 0.08, rng)
    assert estimator.status_values()["camera_bumps"] == 1.0
    assert error_of(estimator, turned) < 0.4


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_not_finite_or_too_little_teaches_nothing_and_reset_forgets(model, bad):
    estimator, home = estimator_of(model), ur5_dh.HOME_RAD
    motion, ball = np.full(6, 0.01), np.array([0.003, 0.0, 0.001])
    with np.errstate(all="ignore"):
        for joints, moved, seen in (
            (np.full(6, bad), motion, ball),
            (home, np.full(6, np.nan), ball),
            (home, motion, np.array([np.nan, 0.0, 0.0])),
            (home, 1e-5 * motion, ball),
        ):
            estimator.update(MotionStep(1.0, 0.03, joints, moved, seen))
    np.testing.assert_array_equal(estimator.factor, np.eye(3))
    values = estimator.status_values()
    assert (values["updates"], values["refused"]) == (0.0, 3.0)
    estimator.update(MotionStep(1.0, 0.03, home, motion, ball))
    assert estimator.status_values()["updates"] == 1.0
    estimator.reset()
    np.testing.assert_array_equal(estimator.factor, np.eye(3))
    np.testing.assert_allclose(
        estimator.jacobian(home), FrozenRbfEstimator(model).jacobian(home), atol=1e-12
    )
    assert estimator.status_values()["updates"] == 0.0


def test_every_declared_parameter_reaches_the_configuration():
    defaults = {p.name: p.default for p in LEFT_FACTOR_PARAMETERS}
    assert left_factor_config(defaults) == LeftFactorConfig()
    assert set(defaults) == {f"rbf_left.{name}" for name in LeftFactorConfig().__dict__}
    assert left_factor_config({"rbf_left.kind": MATRIX}).kind == MATRIX


@pytest.mark.parametrize(
    ("name", "value"),
    [("kind", "affine"), ("memory_m", 0.0), ("bump_m", np.nan), ("min_motion_rad", -1.0)],
)
def test_a_wrong_setting_is_refused_with_its_name(name, value):
    with pytest.raises(ValueError, match=f"{value}"):
        LeftFactorConfig(**{name: value})
