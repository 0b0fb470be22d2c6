"""A turn of the camera is seen by the next few steps, and noise is not taken for one."""

import numpy as np
import pytest
from recordings import turn

from fvs_estimator_node.turn_watch import TurnWatch

AXIS = np.array([0.2, -0.3, 1.0]) / np.linalg.norm([0.2, -0.3, 1.0])
TURNED = turn(AXIS, np.radians(45.0))


def path(count, rng, step_m=0.012, across=None):
    """Positions of a ball that goes step by step along a smooth way, m; across an axis if told."""
    direction = rng.normal(size=3)
    steps = []
    for _ in range(count):
        direction += 0.3 * rng.normal(size=3)
        if across is not None:
            direction -= (direction @ across) * across
        steps.append(step_m * direction / np.linalg.norm(direction))
    return np.cumsum(steps, axis=0)


def tell(watch, balls_m, rotation, noise_m, rng, factor=None):
    """Let it watch; returns how often, and after how many steps first, a turn was seen."""
    seen = balls_m @ rotation.T + noise_m * rng.normal(size=balls_m.shape)
    found = [
        len(watch.add(np.eye(3) if factor is None else factor, predicted, step)) > 0
        for predicted, step in zip(np.diff(balls_m, axis=0), np.diff(seen, axis=0), strict=True)
    ]
    return sum(found), (found.index(True) + 1 if any(found) else None)


def rested(rng, noise_m):
    """A watch that has seen noise at rest."""
    watch = TurnWatch()
    for _ in range(150):
        watch.rest(2.0**0.5 * noise_m * rng.normal(size=3))
    return watch


@pytest.mark.parametrize("step_m", [0.012, 0.03, 0.06])
@pytest.mark.parametrize("noise_m", [0.0002, 0.001, 0.004, 0.006])
def test_noise_is_learned_and_never_taken_for_a_turn(noise_m, step_m):
    rng = np.random.default_rng(1)
    watch = rested(rng, noise_m)
    assert watch.deviation_m == pytest.approx(2.0**0.5 * noise_m, rel=0.3)
    assert tell(watch, path(2000, rng, step_m), np.eye(3), noise_m, rng)[0] == 0
    for _ in range(20):  # without a rest before
        assert tell(TurnWatch(), path(100, rng, step_m), np.eye(3), noise_m, rng)[0] == 0


def test_a_camera_that_is_calm_for_a_few_images_is_not_turned_by_the_noise_that_follows():
    for seed in range(40):
        rng, watch = np.random.default_rng(seed), TurnWatch()
        for _ in range(4):
            watch.rest(0.0001 * rng.normal(size=3))
        assert tell(watch, path(20, rng), np.eye(3), 0.002, rng)[0] == 0


@pytest.mark.parametrize("step_m", [0.03, 0.06])
@pytest.mark.parametrize("noise_m", [0.012, 0.02, 0.03])
def test_noise_beyond_all_bounds_is_no_turn_either(noise_m, step_m):
    rng = np.random.default_rng(1)
    for _ in range(20):
        assert tell(rested(rng, noise_m), path(100, rng, step_m), np.eye(3), noise_m, rng)[0] == 0
    watch = rested(rng, noise_m)
    assert watch.too_noisy
    assert watch.deviation_m == pytest.approx(0.014, rel=0.2)  # the bound


@pytest.mark.parametrize(("noise_m", "within"), [(0.0002, 3), (0.001, 6)])
@pytest.mark.parametrize("seed", range(5))
def test_a_turn_is_seen_by_the_next_few_steps_and_they_are_handed_out(noise_m, within, seed):
    rng = np.random.default_rng(seed)
    watch = rested(rng, noise_m)
    count, first = tell(watch, path(20, rng, across=AXIS), TURNED, noise_m, rng)
    assert count >= 1
    assert first <= within
    known = rested(rng, noise_m)
    assert tell(known, path(200, rng), TURNED, noise_m, rng, TURNED)[0] == 0


def test_a_small_turn_is_left_to_be_followed_however_well_it_is_seen():
    watch, turned = rested(np.random.default_rng(0), 0.0002), turn(AXIS, np.radians(8.0))
    for one in ([0.03, 0.0, 0.0], [0.02, 0.02, 0.0], [0.02, 0.01, 0.01], [0.0, 0.02, 0.02]):
        assert watch.add(np.eye(3), np.array(one), turned @ one) == []


def test_a_turn_is_seen_only_where_the_steps_are_longer_than_noise_may_feign_it():
    watch, turned = rested(np.random.default_rng(0), 0.001), turn(AXIS, np.radians(20.0))
    across = np.array([0.3, 0.2, 0.0]) / np.linalg.norm([0.3, 0.2, 0.0])
    seen = []
    for step_m in (0.012, 0.03):
        watch.clear()
        steps = [step_m * across] * 3
        seen.append([len(watch.add(np.eye(3), step, turned @ step)) for step in steps])
    assert seen == [[0, 0, 0], [0, 0, 3]]


def test_the_steps_since_the_turn_are_handed_out_as_they_were_told():
    watch = rested(np.random.default_rng(0), 0.001)
    told = [np.array(one) for one in ([0.03, 0.0, 0.0], [0.02, 0.02, 0.0], [0.02, 0.01, 0.01])]
    for one in told[:2]:
        assert watch.add(np.eye(3), one, TURNED @ one) == []
    steps = watch.add(np.eye(3), told[2], TURNED @ told[2])
    np.testing.assert_array_equal([step[0] for step in steps], told)
    np.testing.assert_array_equal([step[1] for step in steps], [TURNED @ one for one in told])
    assert watch.add(np.eye(3), told[0], TURNED @ told[0]) == []  # begun anew


@pytest.mark.parametrize("step_m", [0.012, 0.03, 0.06])
@pytest.mark.parametrize("outlier_m", [0.02, 0.03, 0.06])
def test_an_outlier_goes_out_and_back_and_is_no_turn(outlier_m, step_m):
    rng = np.random.default_rng(2)
    found = 0
    for _ in range(10):
        watch, balls = rested(rng, 0.001), path(300, rng, step_m)
        seen = balls + 0.001 * rng.normal(size=balls.shape)
        struck = seen[10::20]
        direction = rng.normal(size=struck.shape)
        struck += outlier_m * direction / np.linalg.norm(direction, axis=1, keepdims=True)
        steps = zip(np.diff(balls, axis=0), np.diff(seen, axis=0), strict=True)
        found += sum(len(watch.add(np.eye(3), *step)) > 0 for step in steps)
    assert found <= 1  # of 150 outliers


def test_after_clear_it_begins_anew():
    watch, step = rested(np.random.default_rng(0), 0.001), np.array([0.03, 0.0, 0.0])
    for _ in range(2):
        watch.add(np.eye(3), step, TURNED @ step)
    watch.clear()
    for _ in range(2):
        assert watch.add(np.eye(3), step, TURNED @ step) == []
    assert watch.add(np.eye(3), step, TURNED @ step) != []


def test_what_is_no_number_teaches_no_noise():
    watch = TurnWatch()
    before = watch.deviation_m
    watch.rest(np.full(3, np.nan))
    assert watch.deviation_m == before
