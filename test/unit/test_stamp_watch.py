"""Images that are stamped too late or too early: told from a camera that was moved."""

import numpy as np
import pytest
from recordings import Recording, turn, ur5_chain

from fvs_estimator_node.camera_motion import CameraMotion
from fvs_estimator_node.poe import PoeEstimator
from fvs_estimator_node.rotations import rotation_angle_rad
from fvs_estimator_node.stamp_watch import StampWatch

PERIOD_S = 1.0 / 30.0


def gone(time_s, start_s):
    """Share of a way that takes 0.6 s, from a time on, s, shape (n, 1)."""
    share = np.clip((time_s - start_s) / 0.6, 0.0, 1.0)
    return (share * share * (3.0 - 2.0 * share))[:, None]


def journey(time_s):
    """A ball that rests, goes 0.4 m in 0.6 s, rests, and goes elsewhere, m, shape (n, 3)."""
    legs = ((0.7, [0.3, 0.2, -0.1]), (2.0, [-0.1, 0.3, 0.2]), (3.3, [-0.3, -0.2, 0.1]))
    ball = np.tile([0.0, 0.0, 1.4], (len(time_s), 1))
    for start_s, way_m in legs:
        ball += gone(time_s, start_s) * way_m
    return ball


def told(late_s, noise_m, rng, count=140, rotation=None):
    """Pairs of a camera that stamps late: where the model has the ball, is it seen, and when."""
    stamp_s = PERIOD_S * np.arange(count)
    seen = journey(stamp_s - late_s) @ (np.eye(3) if rotation is None else rotation).T
    return zip(journey(stamp_s), seen + noise_m * rng.normal(size=seen.shape), stamp_s, strict=True)


@pytest.mark.parametrize("late_s", [-0.3, -0.1, -0.06, 0.06, 0.1, 0.3])
@pytest.mark.parametrize("noise_m", [0.001, 0.004])
def test_wrong_stamps_do_not_turn_the_camera(late_s, noise_m):
    camera = CameraMotion()
    for model_m, seen_m, stamp_s in told(late_s, noise_m, np.random.default_rng(0)):
        camera.add(model_m, seen_m, stamp_s)
    assert camera.angle_rad < np.radians(2.0)
    assert camera.doubts.stamps.lag_s == pytest.approx(late_s, abs=0.02)
    assert ("too late" if late_s > 0.0 else "too early") in camera.doubts.stamps.remark
    assert bool(camera.doubts.stamps.problem) == (abs(late_s) > 0.08)


@pytest.mark.parametrize("noise_m", [0.001, 0.004, 0.012])
@pytest.mark.parametrize("degrees", [0.0, 45.0, 120.0])
def test_right_stamps_are_not_doubted_wherever_the_camera_stands(noise_m, degrees):
    rng = np.random.default_rng(1)
    camera = CameraMotion()
    for pair in told(0.0, noise_m, rng, rotation=turn([1.0, 2.0, 3.0], np.radians(degrees))):
        camera.add(*pair)
        assert camera.doubts.stamps.lag == 0.0
    assert camera.doubts.stamps.remark == camera.doubts.stamps.problem == ""


@pytest.mark.parametrize("struck", [10, 22, 30, 36, 45, 62])
def test_a_blow_is_no_lag_whenever_it_falls(struck):
    rng = np.random.default_rng(struck)
    rotation, shift = turn([0.2, 1.0, 0.3], np.radians(45.0)), np.array([0.1, 0.0, 0.0])
    camera = CameraMotion()
    for i, (model_m, seen_m, stamp_s) in enumerate(told(0.0, 0.001, rng)):
        camera.add(model_m, rotation @ seen_m + shift if i >= struck else seen_m, stamp_s)
        assert camera.doubts.stamps.lag == 0.0
    assert camera.doubts.bumps >= 1


def lags(way_m, change, noise_m, seed):
    """Every lag that is found while a ball goes along x, and what is seen of it is changed."""
    time_s, watch = PERIOD_S * np.arange(60), StampWatch()
    model = [0.0, 0.0, 1.4] + gone(time_s, 0.7) * [way_m, 0.0, 0.0]
    seen = change(time_s, model) + noise_m * np.random.default_rng(seed).normal(size=model.shape)
    found = set()
    for pair in zip(model, seen, time_s, strict=True):
        watch.add(*pair)
        found.add(watch.lag)
    return found


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    ("after_s", "way_m"),
    [(-0.4, [0.18, 0.09, 0.0]), (0.3, [-0.18, 0.09, 0.0])],
    ids=["ahead of the ball", "back behind the ball"],
)
def test_a_camera_that_is_carried_about_when_the_ball_starts_is_no_lag(after_s, way_m, seed):
    def carried(time_s, model):
        return model + gone(time_s, 0.7 + after_s) * way_m

    assert lags(0.2, carried, 0.0005, seed) == {0.0}


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("scale", [0.85, 0.9, 1.1])
def test_a_model_that_has_the_ball_go_too_far_or_not_far_enough_is_no_lag(scale, seed):
    assert lags(0.2, lambda _, model: scale * model, 0.0005, seed) == {0.0}


def test_stamps_that_were_mended_are_no_longer_doubted():
    rng = np.random.default_rng(0)
    camera = CameraMotion()
    for late_s in (0.06, 0.0):
        for pair in told(late_s, 0.001, rng):
            camera.add(*pair)
        assert bool(camera.doubts.stamps.lag) == bool(late_s)


@pytest.mark.parametrize(
    ("late_s", "words"), [(0.1, "by about 0.10 s, as"), (0.4, "by about 0.40 s or more, as")]
)
def test_only_what_is_beyond_all_lags_is_said_to_be_so_much_or_more(late_s, words):
    watch = StampWatch()
    for pair in told(late_s, 0.0005, np.random.default_rng(0)):
        watch.add(*pair)
    assert words in watch.remark


@pytest.mark.parametrize("late_s", [-0.15, 0.1])
@pytest.mark.parametrize("seed", range(3))
def test_wrong_stamps_of_a_camera_that_was_turned_before_are_found_and_turn_it_no_further(
    late_s, seed
):
    rng, camera = np.random.default_rng(seed), CameraMotion()
    rotation = turn([0.2, 1.0, 0.3], np.radians(45.0))
    angle = 0.15 * np.arange(-99.0, 1.0)
    helix = 0.1 * np.column_stack([np.cos(angle) - 1.0, np.sin(angle), 0.3 * angle])
    for model_m in helix + [0.0, 0.0, 1.4]:
        camera.add(model_m, rotation @ model_m + 0.001 * rng.normal(size=3))
    for pair in told(late_s, 0.001, rng, 60, rotation):
        camera.add(*pair)
        if camera.doubts.stamps.lag:
            assert rotation_angle_rad(rotation.T @ camera.rotation) < np.radians(1.0)
    assert camera.doubts.stamps.lag_s == pytest.approx(late_s, abs=0.02)


def test_a_bump_soon_after_wrong_stamps_were_found_is_taken_for_no_more_than_it_is():
    off, bump = [], turn([0.0, 1.0, 0.2], np.radians(3.0))
    for seed in range(8):
        camera, since_found = CameraMotion(), 0
        off.append(0.0)
        for model_m, seen_m, stamp_s in told(0.1, 0.001, np.random.default_rng(seed), 70):
            bumped = since_found > 4
            camera.add(model_m, bump @ seen_m + [0.05, 0.0, 0.0] if bumped else seen_m, stamp_s)
            since_found += bool(camera.doubts.stamps.lag)
            if since_found > 7:
                off[-1] = max(off[-1], rotation_angle_rad(bump.T @ camera.rotation))
    assert 0.0 < np.median(off) < np.radians(5.0)


def test_without_stamps_it_is_said_without_a_number():
    watch = StampWatch()
    for model_m, seen_m, _ in told(0.1, 0.001, np.random.default_rng(0)):
        watch.add(model_m, seen_m)
    assert watch.lag == pytest.approx(3.0, abs=0.5)
    assert watch.lag_s == 0.0
    assert "too late, as" in watch.remark
    assert watch.problem == ""


def test_the_estimator_says_so_until_it_is_reset():
    chain = ur5_chain()
    estimator = PoeEstimator(chain)
    recording = Recording()
    time_s = PERIOD_S * np.arange(120)
    going_s = np.maximum(time_s - 0.7, 0.0)
    joints = recording.joints(1.5 * going_s)
    balls = chain.position(recording.joints(1.5 * np.maximum(going_s - 0.1, 0.0)))
    for one, ball, stamp_s in zip(joints, balls, time_s, strict=True):
        estimator.observe(one, ball, stamp_s)
    assert "stamps are too late by about 0.10 s" in estimator.problem
    assert estimator.status_values()["images_late_s"] == pytest.approx(0.1, abs=0.02)
    estimator.reset()
    assert estimator.problem == estimator.remark == ""
