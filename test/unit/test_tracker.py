"""How much of an image is believed, and which ones are outliers."""

import numpy as np
import pytest
from cases import each

from fvs_controller_node.prediction import FeaturePredictor
from fvs_ros.tracker import Image, Tracker


def follow(tracker, images, motions):
    """Estimates along images (n, 3) m with predicted motions (n, 3) m in between."""
    tracker.restart()
    found = []
    for k, (image, moved) in enumerate(zip(images, np.cumsum(motions, axis=0), strict=True)):
        tracker.add(Image(k / 30.0, image, moved))
        found.append(tracker.estimate_m.copy())
    return np.array(found[1:])


@each("sigma_m", [2e-4, 1e-3, 4e-3])
def test_at_rest_it_learns_the_noise_and_averages_it_away(sigma_m):
    rng = np.random.default_rng(1)
    truth = np.array([0.1, -0.2, 1.3])
    images = truth + sigma_m * rng.normal(size=(400, 3))
    tracker = Tracker()
    estimates = follow(tracker, images, np.zeros((400, 3)))
    assert tracker.noise_m == pytest.approx(sigma_m, rel=0.25)
    error = np.sqrt(np.mean((estimates[60:] - truth) ** 2))
    assert error < 0.2 * sigma_m


def at_rest(images, truth):
    """Errors of the prediction, m, and noise learned, m, from images of an arm at rest."""
    predictor, errors = FeaturePredictor(), []
    for k, (image, true) in enumerate(zip(images, truth, strict=True)):
        for part in range(4):
            predictor.add_joints((k + part / 4.0) / 30.0, np.zeros(6), np.zeros((3, 6)))
        predictor.add_feature(k / 30.0, image)
        errors.append(np.linalg.norm(predictor.predict() - true))
    return errors, predictor.tracker.noise_m


@each("drift_m", [0.0003, 0.003, 0.012])
def test_a_camera_that_is_carried_is_no_noise_and_the_estimate_is_soon_right(drift_m):
    rng = np.random.default_rng(10)
    way = np.concatenate([np.zeros(100), np.cumsum(np.full(60, drift_m)), np.zeros(20)])
    way[160:] = way[159]
    truth = np.outer(way, [0.6, 0.0, 0.8])
    images = truth + 1e-3 * rng.normal(size=truth.shape)
    errors, noise_m = at_rest(images, truth)
    assert noise_m == pytest.approx(1e-3, rel=0.4)
    # Six images' way at most while it is carried, and the noise; soon after, noise alone.
    assert max(errors[100:160]) < 6.0 * drift_m + 5e-3
    assert max(errors[166:]) < 2.5e-3


def see(tracker, off_m):
    """Show an image that is off the estimate, of an arm at rest; whether any was believed."""
    return tracker.add(Image(99.0, tracker.estimate_m + off_m, tracker.moved_m))


def test_one_wrong_position_within_the_gate_moves_the_estimate_little_however_far_it_is_off():
    rest = 1e-3 * np.random.default_rng(12).normal(size=(300, 3))
    for off_m in np.linspace(0.001, 0.02, 20):
        for direction in np.vstack([np.eye(3), np.ones(3) / 3.0**0.5]):
            tracker = Tracker()
            follow(tracker, rest, np.zeros((300, 3)))
            before_m = tracker.estimate_m
            see(tracker, off_m * direction)
            assert np.linalg.norm(tracker.estimate_m - before_m) < 1.5e-3


@each("off_m", [0.02, 0.05, 0.2])
@each("period", [2, 3, 5])
def test_an_image_that_flickers_between_two_things_is_no_noise(period, off_m):
    images = 1e-3 * np.random.default_rng(13).normal(size=(400, 3))
    images[100:][::period] += [off_m, 0.0, 0.0]
    errors, noise_m = at_rest(images, np.zeros_like(images))
    assert np.median(errors[100:]) < 5e-4
    assert noise_m < 2e-3
