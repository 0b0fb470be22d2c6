"""Images that are stamped too late or too early: told from a camera that was moved."""

import numpy as np
import pytest
from recordings import turn

from fvs_estimator_node.loop import StampWatch

PERIOD_S, IDENTITY = 1.0 / 30.0, np.eye(3)


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
    """Images of a camera that stamps late: when, where the ball is seen, and the model has it."""
    stamp_s = PERIOD_S * np.arange(count)
    seen = journey(stamp_s - late_s) @ (np.eye(3) if rotation is None else rotation).T
    return zip(stamp_s, seen + noise_m * rng.normal(size=seen.shape), journey(stamp_s), strict=True)


def lags_of(images, rotation=IDENTITY):
    """What the watch says of each image, s, where the rotation is known to the prediction."""
    watch = StampWatch()
    return [watch.add(at_s, seen, rotation @ model) for at_s, seen, model in images]


@pytest.mark.parametrize("late_s", [-0.3, -0.1, -0.06, 0.06, 0.1, 0.3])
@pytest.mark.parametrize("noise_m", [0.001, 0.004])
def test_wrong_stamps_are_found_and_so_is_by_how_much(late_s, noise_m):
    found = lags_of(told(late_s, noise_m, np.random.default_rng(0)))
    assert next(filter(None, found)) == pytest.approx(late_s, abs=0.025)


@pytest.mark.parametrize("noise_m", [0.001, 0.004, 0.012])
@pytest.mark.parametrize("degrees", [0.0, 45.0, 120.0])
def test_right_stamps_are_not_doubted_wherever_the_camera_stands(noise_m, degrees):
    rotation = turn([1.0, 2.0, 3.0], np.radians(degrees))
    images = told(0.0, noise_m, np.random.default_rng(1), rotation=rotation)
    assert not any(lags_of(images, rotation))


@pytest.mark.parametrize("struck", [10, 22, 30, 36, 45, 62])
def test_a_blow_is_no_lag_whenever_it_falls(struck):
    rotation, shift = turn([0.2, 1.0, 0.3], np.radians(45.0)), np.array([0.1, 0.0, 0.0])
    images = [
        (stamp_s, rotation @ seen_m + shift if i >= struck else seen_m, model_m)
        for i, (stamp_s, seen_m, model_m) in enumerate(
            told(0.0, 0.001, np.random.default_rng(struck))
        )
    ]
    assert not any(lags_of(images, rotation))


def changed(way_m, change, seed):
    """What is found while a ball goes along x, and what is seen of it is changed."""
    time_s, rng = PERIOD_S * np.arange(60), np.random.default_rng(seed)
    model = [0.0, 0.0, 1.4] + gone(time_s, 0.7) * [way_m, 0.0, 0.0]
    seen = change(time_s, model) + 0.0005 * rng.normal(size=model.shape)
    return lags_of(zip(time_s, seen, model, strict=True))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    ("after_s", "way_m"),
    [(-0.4, [0.18, 0.09, 0.0]), (0.3, [-0.18, 0.09, 0.0])],
    ids=["ahead of the ball", "back behind the ball"],
)
def test_a_camera_that_is_carried_about_when_the_ball_starts_is_no_lag(after_s, way_m, seed):
    def carried(time_s, model):
        return model + gone(time_s, 0.7 + after_s) * way_m

    assert not any(changed(0.2, carried, seed))
