"""How much of an image is believed: the filter that learns the noise."""

from __future__ import annotations

import numpy as np
import pytest

from fvs_controller_node.predictor import BallPredictor
from fvs_ros import fusion as fusion_module
from fvs_ros.fusion import Fusion
from fvs_ros.tracker import Image, Tracker


def follow(fusion, images, motions):
    """Estimates along images (n, 3) m with predicted motions (n, 3) m in between."""
    estimate, found = images[0].copy(), []
    fusion.restart()
    for image, motion in zip(images[1:], motions[1:], strict=True):
        estimate = estimate + motion
        correction = fusion.correct(image - estimate, motion)
        if correction is not None:
            estimate = estimate + correction
        found.append(estimate.copy())
    return np.array(found)


class FixedShare:
    """Believes a fixed share of each image: what the filter must not be worse than."""

    def __init__(self, gain):
        self.gain = gain

    def restart(self):
        pass

    def correct(self, innovation_m, motion_m):
        return self.gain * innovation_m


@pytest.mark.parametrize("sigma_m", [2e-4, 1e-3, 4e-3])
def test_at_rest_it_learns_the_noise_and_averages_it_away(sigma_m):
    rng = np.random.default_rng(1)
    truth = np.array([0.1, -0.2, 1.3])
    images = truth + sigma_m * rng.normal(size=(400, 3))
    fusion = Fusion()
    estimates = follow(fusion, images, np.zeros((400, 3)))
    assert fusion.noise_m == pytest.approx(sigma_m, rel=0.25)
    error = np.sqrt(np.mean((estimates[60:] - truth) ** 2))
    assert error < 0.2 * sigma_m
    fixed = follow(FixedShare(0.3), images, np.zeros((400, 3)))
    assert error < 0.5 * np.sqrt(np.mean((fixed[60:] - truth) ** 2))


@pytest.mark.parametrize("sigma_m", [2e-4, 1e-3, 4e-3])
def test_a_second_of_images_tells_the_noise(sigma_m):
    learned_m = []
    for seed in range(10):
        fusion = Fusion()
        images = sigma_m * np.random.default_rng(seed).normal(size=(30, 3))
        follow(fusion, images, np.zeros((30, 3)))
        learned_m.append(fusion.noise_m)
    assert 0.78 * sigma_m < np.median(learned_m) < 2.5 * sigma_m


def test_noise_that_throws_the_arm_about_is_learned_all_the_same():
    learned_m = []
    for seed in range(5):
        rng, fusion = np.random.default_rng(seed), Fusion()
        motions = 0.01 * rng.normal(size=(150, 3))
        follow(fusion, np.cumsum(motions, axis=0) + 0.02 * rng.normal(size=(150, 3)), motions)
        learned_m.append(fusion.noise_m)
    assert np.median(learned_m) > 0.008


@pytest.mark.parametrize("sigma_m", [2e-4, 1e-3, 4e-3])
def test_after_a_long_rest_it_states_the_deviation_that_it_has(sigma_m):
    rng = np.random.default_rng(6)
    images = sigma_m * rng.normal(size=(4000, 3))
    fusion = Fusion()
    estimates = follow(fusion, images, np.zeros((4000, 3)))
    rms = np.sqrt(np.mean(estimates[1000:] ** 2))
    assert fusion.deviation_m == pytest.approx(rms, rel=0.35)
    least = fusion_module._LEAST_GAIN
    assert rms == pytest.approx(sigma_m * np.sqrt(least / (2.0 - least)), rel=0.15)


def moving(wrong, sigma_m, rng, n=300):
    """Positions on a wide circle, images of them, and motions predicted with a relative error."""
    angle = np.linspace(0.0, 6.0, n)
    truth = 0.5 * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    motions = np.diff(truth, axis=0, prepend=truth[:1]) @ (
        np.eye(3) + wrong * rng.normal(size=(3, 3))
    )
    return truth, truth + sigma_m * rng.normal(size=(n, 3)), motions


def test_in_motion_it_learns_how_wrong_the_prediction_is():
    rng = np.random.default_rng(2)
    fusions = {}
    for wrong in (0.0, 0.3):
        _, images, motions = moving(wrong, 5e-4, rng)
        fusions[wrong] = Fusion()
        follow(fusions[wrong], images, motions)
    assert fusions[0.0].wrong_share < 0.1
    assert fusions[0.3].wrong_share > 2.0 * fusions[0.0].wrong_share


GAINS = (0.1, 0.3, 0.6, 1.0)


def rms_m(fusion, truth, images, motions, first=0):
    return np.sqrt(np.mean((follow(fusion, images, motions) - truth[1:])[first:] ** 2))


@pytest.mark.parametrize("sigma_m", [2e-4, 1e-3, 4e-3])
@pytest.mark.parametrize("wrong", [0.0, 0.05, 0.3])
def test_in_motion_it_is_no_worse_than_the_best_fixed_share(wrong, sigma_m):
    rng = np.random.default_rng(3)
    paths = moving(wrong, sigma_m, rng)
    best = min(rms_m(FixedShare(gain), *paths, first=100) for gain in GAINS)
    # That a prediction is exact, nobody knows after a hundred images.
    assert rms_m(Fusion(), *paths, first=100) < (1.3 if wrong else 1.8) * best


def slow(wrong, speed_m, rng, n=240):
    """A straight line of so many m an image, after a quick one that was predicted rightly."""
    steps = np.concatenate([np.full(120, 0.01), np.full(n, speed_m)])
    truth = np.outer(np.cumsum(steps), [0.6, 0.8, 0.0])
    motions = np.diff(truth, axis=0, prepend=truth[:1])
    motions[120:] *= 1.0 + wrong
    return truth, truth + 1e-3 * rng.normal(size=truth.shape), motions


@pytest.mark.parametrize("speed_m", [0.0007, 0.0017, 0.0033])
@pytest.mark.parametrize("wrong", [0.1, 0.3])
def test_a_slow_ball_is_followed_though_the_prediction_was_right_before(wrong, speed_m):
    paths = slow(wrong, speed_m, np.random.default_rng(9))
    best = min(rms_m(FixedShare(gain), *paths, first=120) for gain in GAINS)
    fusion = Fusion()
    assert rms_m(fusion, *paths, first=120) < 1.3 * best
    assert fusion.noise_m == pytest.approx(1e-3, rel=0.25)


@pytest.mark.parametrize("drift_m", [0.0003, 0.003, 0.012])
def test_a_camera_that_is_carried_is_no_noise_and_the_estimate_is_soon_right(drift_m):
    rng = np.random.default_rng(10)
    way = np.concatenate([np.zeros(100), np.cumsum(np.full(60, drift_m)), np.zeros(20)])
    way[160:] = way[159]
    truth = np.outer(way, [0.6, 0.0, 0.8])
    images = truth + 1e-3 * rng.normal(size=truth.shape)
    fusion = Fusion()
    predictor = BallPredictor()
    predictor.tracker.fusion = fusion
    errors = []
    for k, (image, true) in enumerate(zip(images, truth, strict=True)):
        for part in range(4):
            predictor.add_joints((k + part / 4.0) / 30.0, np.zeros(6), np.zeros((3, 6)))
        predictor.add_ball(k / 30.0, image)
        errors.append(np.linalg.norm(predictor.predict() - true))
    assert fusion.noise_m == pytest.approx(1e-3, rel=0.4)
    # Six images' way at most while it is carried, and the noise; soon after, noise alone.
    assert max(errors[100:160]) < 6.0 * drift_m + 5e-3
    assert max(errors[166:]) < 2.5e-3


def test_two_wrong_positions_agree_only_where_they_say_the_same():
    fusion, still = Fusion(), np.zeros(3)
    there = np.array([0.05, 0.0, 0.0])
    assert fusion.agree(there, there + 0.003, still)
    assert not fusion.agree(there, -there, still)
    assert not fusion.agree(there, np.array([0.0, 0.05, 0.0]), still)
    assert not fusion.agree(0.2 * there, 0.5 * there, still)
    # Nearer to each other than noise, or the motion in between, may bring them; but not alike.
    assert not fusion.agree(np.array([0.009, 0.0, 0.0]), np.array([0.006, 0.006, 0.0]), still)
    assert not fusion.agree(there, -there, 1.2 * there)


def test_one_wrong_position_within_the_gate_teaches_little():
    fusion = Fusion()
    follow(fusion, 1e-3 * np.random.default_rng(11).normal(size=(300, 3)), np.zeros((300, 3)))
    before = fusion.noise_m
    fusion.correct(np.array([0.0, 0.009, 0.0]), np.zeros(3))
    assert fusion.noise_m < 1.15 * before


def test_one_wrong_position_within_the_gate_moves_the_estimate_little_however_far_it_is_off():
    rest = 1e-3 * np.random.default_rng(12).normal(size=(300, 3))
    for off_m in np.linspace(0.001, 0.02, 20):
        for direction in np.vstack([np.eye(3), np.ones(3) / 3.0**0.5]):
            fusion = Fusion()
            follow(fusion, rest, np.zeros((300, 3)))
            correction = fusion.correct(off_m * direction, np.zeros(3))
            assert correction is None or np.linalg.norm(correction) < 1.5e-3


@pytest.mark.parametrize("off_m", [0.02, 0.05, 0.2])
@pytest.mark.parametrize("period", [2, 3, 5])
def test_an_image_that_flickers_between_two_things_is_no_noise(period, off_m):
    images = 1e-3 * np.random.default_rng(13).normal(size=(400, 3))
    images[100:][::period] += [off_m, 0.0, 0.0]
    fusion, predictor_errors = Fusion(), []
    predictor = BallPredictor()
    predictor.tracker.fusion = fusion
    for k, image in enumerate(images):
        for part in range(4):
            predictor.add_joints((k + part / 4.0) / 30.0, np.zeros(6), np.zeros((3, 6)))
        predictor.add_ball(k / 30.0, image)
        predictor_errors.append(np.linalg.norm(predictor.predict()))
    assert np.median(predictor_errors[100:]) < 5e-4
    assert fusion.noise_m < 2e-3


@pytest.mark.parametrize("seed", range(3))
def test_however_wild_the_images_were_none_is_believed_that_is_far_off(seed):
    rng = np.random.default_rng(seed)
    fusion = Fusion()
    for noise_m, count in ((0.3, 300), (0.001, 20)):
        motions = 0.004 * rng.normal(size=(count, 3))
        images = np.cumsum(motions, axis=0) + noise_m * rng.normal(size=(count, 3))
        follow(fusion, images, motions)
    assert fusion.correct(np.array([0.3, 0.0, 0.0]), np.zeros(3)) is None


def test_a_wrong_prediction_of_a_jerky_motion_is_no_noise():
    learned_m = []
    for seed in range(5):
        rng, fusion = np.random.default_rng(seed), Fusion()
        follow(fusion, 1e-3 * rng.normal(size=(100, 3)), np.zeros((100, 3)))
        motions = 0.01 * rng.normal(size=(300, 3))
        images = np.cumsum(motions, axis=0) + 1e-3 * rng.normal(size=(300, 3))
        follow(fusion, images, 0.7 * motions)
        learned_m.append(fusion.noise_m)
    assert np.mean(learned_m) == pytest.approx(1e-3, rel=0.2)


def test_images_without_a_position_in_between_do_not_spoil_what_is_known_of_the_noise():
    learned_m = []
    for seed in range(10):
        rng, fusion = np.random.default_rng(seed), Fusion()
        way = np.outer(np.arange(400), [0.003, 0.0, 0.0])
        images = way + 1e-3 * rng.normal(size=way.shape)
        images[100 + np.flatnonzero(np.arange(300) % 15 < 10)] = np.nan
        follow(fusion, images, np.tile([0.0015, 0.0, 0.0], (400, 1)))
        learned_m.append(fusion.noise_m)
    assert np.mean(learned_m) == pytest.approx(1e-3, rel=0.1)


def test_wrong_images_now_and_then_teach_little():
    rng = np.random.default_rng(14)
    images = 1e-3 * rng.normal(size=(2000, 3))
    wrong = rng.random(2000) < 0.1
    images[wrong] += 0.05 * rng.normal(size=(int(wrong.sum()), 3))
    fusion = Fusion()
    estimates = follow(fusion, images, np.zeros((2000, 3)))
    assert np.median(np.linalg.norm(estimates, axis=1)) < 5e-4
    assert fusion.noise_m < 2e-3


@pytest.mark.parametrize("off_m", [0.003, 0.004, 0.008, 0.012])
def test_some_in_a_row_that_say_the_same_are_followed(off_m):
    fusion = Fusion()
    follow(fusion, 1e-3 * np.random.default_rng(12).normal(size=(300, 3)), np.zeros((300, 3)))
    estimate, there = np.zeros(3), np.array([0.0, off_m, 0.0])
    for _ in range(6):
        estimate = estimate + fusion.correct(there - estimate, np.zeros(3))
    assert np.linalg.norm(estimate - there) < 0.25 * off_m


def test_after_a_doubt_it_follows_the_images_until_the_prediction_is_right_again():
    rng = np.random.default_rng(7)
    fusion = Fusion()
    _, images, motions = moving(0.0, 5e-4, rng)
    follow(fusion, images, motions)
    trusting = fusion.wrong_share
    truth, images, motions = moving(0.4, 5e-4, rng, n=30)
    errors = []
    for doubts in (False, True):
        if doubts:
            fusion.doubt()
        else:
            fusion._wrong2 = trusting**2
        errors.append(np.abs(follow(fusion, images, motions)[:10] - truth[1:11]).max())
    assert errors[1] < 0.5 * errors[0]
    _, images, motions = moving(0.0, 5e-4, rng, n=60)
    follow(fusion, images, motions)
    assert fusion.wrong_share < 0.12


def test_a_camera_that_is_turned_is_followed_at_once():
    errors = []
    for seed in range(5):
        rng, tracker = np.random.default_rng(seed), Tracker()
        for k in range(110):
            moved = np.array([0.1 * np.sin(0.1 * k), 0.0, 0.0])
            truth = np.array([0.0, 0.1, 1.0]) + (moved if k < 90 else moved[[1, 0, 2]])
            tracker.add(Image(k / 30.0, truth + 0.001 * rng.normal(size=3), moved))
            if k >= 93:
                errors.append(tracker.estimate_m - truth)
    assert np.sqrt(np.mean(np.square(errors))) < 0.0015


def test_a_doubt_fades_where_the_ball_is_too_slow_to_learn_from():
    rng = np.random.default_rng(8)
    fusion = Fusion()
    fusion.doubt()
    follow(fusion, 1e-3 * rng.normal(size=(60, 3)), np.zeros((60, 3)))
    assert fusion.wrong_share > 0.45  # at rest nothing was seen of the prediction
    way = np.outer(np.arange(200), [0.0015, 0.0, 0.0])
    follow(fusion, way + 1e-3 * rng.normal(size=way.shape), np.diff(way, axis=0, prepend=way[:1]))
    assert fusion.wrong_share < 0.15


def test_an_outlier_changes_nothing():
    rng = np.random.default_rng(4)
    images = 1e-3 * rng.normal(size=(200, 3))
    fusion = Fusion()
    follow(fusion, images, np.zeros((200, 3)))
    before = fusion.noise_m, fusion.deviation_m
    assert fusion.correct(np.array([0.0, 0.05, 0.0]), np.zeros(3)) is None
    assert fusion.correct(np.array([0.0, np.inf, 0.0]), np.zeros(3)) is None
    assert fusion.correct(np.array([0.0, np.nan, 0.0]), np.zeros(3)) is None
    assert (fusion.noise_m, fusion.deviation_m) == before


def test_a_restart_keeps_what_was_learned_and_doubts_the_position():
    fusion = Fusion()
    images = 3e-3 * np.random.default_rng(5).normal(size=(300, 3))
    follow(fusion, images, np.zeros((300, 3)))
    noise_m, deviation_m = fusion.noise_m, fusion.deviation_m
    fusion.restart()
    assert fusion.noise_m == noise_m
    assert fusion.deviation_m > 3.0 * deviation_m
