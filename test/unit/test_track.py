"""Images judged and predicted to now: exact on a linear plant, fusing, surviving mishaps."""

import numpy as np
import pytest
from cases import each

from fvs_ros.filter import Image, PathFilter
from fvs_ros.kinds.ball import Ball
from fvs_ros.track import Track


def at_rest(images, truth):
    """Errors of the prediction, m, and noise learned, m, from images of an arm at rest."""
    track, errors = Track(Ball()), []
    for k, (image, true) in enumerate(zip(images, truth, strict=True)):
        for part in range(4):
            track.add_joints((k + part / 4.0) / 30.0, np.zeros(6), np.zeros((3, 6)))
        track.add_image(k / 30.0, image)
        errors.append(np.linalg.norm(track.now() - true))
    return errors, track.filter.noise_m


@each("drift_m", [0.0003, 0.003, 0.012])
def test_a_camera_that_is_carried_is_no_noise_and_the_estimate_is_soon_right(drift_m):
    rng = np.random.default_rng(10)
    travel_m = np.concatenate([np.zeros(100), np.cumsum(np.full(60, drift_m)), np.zeros(20)])
    travel_m[160:] = travel_m[159]
    truth = np.outer(travel_m, [0.6, 0.0, 0.8])
    images = truth + 1e-3 * rng.normal(size=truth.shape)
    errors, noise_m = at_rest(images, truth)
    assert noise_m == pytest.approx(1e-3, rel=0.4)
    # Six images' way at most while it is carried, and the noise; soon after, noise alone.
    assert max(errors[100:160]) < 6.0 * drift_m + 5e-3
    assert max(errors[166:]) < 2.5e-3


def test_one_wrong_position_within_the_gate_moves_the_estimate_little_however_far_it_is_off():
    rest = 1e-3 * np.random.default_rng(12).normal(size=(300, 3))
    for off_m in np.linspace(0.001, 0.02, 20):
        for direction in np.vstack([np.eye(3), np.ones(3) / 3.0**0.5]):
            path = PathFilter()
            for k, z in enumerate(rest):
                path.add(Image(k / 30.0, np.zeros(0), z, z, np.zeros(3)))
            before_m = path.x
            wrong_m = before_m + off_m * direction
            path.add(Image(10.0, np.zeros(0), wrong_m, wrong_m, np.zeros(3)))
            assert np.linalg.norm(path.x - before_m) < 1.5e-3


@each("off_m", [0.02, 0.05, 0.2])
@each("period", [2, 3, 5])
def test_an_image_that_flickers_between_two_things_is_no_noise(period, off_m):
    images = 1e-3 * np.random.default_rng(13).normal(size=(400, 3))
    images[100:][::period] += [off_m, 0.0, 0.0]
    errors, noise_m = at_rest(images, np.zeros_like(images))
    assert np.median(errors[100:]) < 5e-4
    assert noise_m < 2e-3


# ---- the prediction ---------------------------------------------------------------------

ORIGIN = np.array([0.1, -0.2, 1.2])
JOINT_S = 0.008


def standing(positions):
    """Predictions at rest after each of some positions, and how many are then believed."""
    track, predictions, believed = Track(Ball()), [], []
    track.add_joints(0.0, np.zeros(6), np.eye(3, 6))
    track.add_joints(0.09, np.zeros(6), np.eye(3, 6))
    for k, position in enumerate([*[ORIGIN] * 8, *positions]):
        believed.append(len(track.add_image(0.005 * k, position)))
        predictions.append(track.now())
    return predictions[8:], believed[8:]


def test_an_outlier_is_passed_over_and_what_two_say_alike_or_six_in_a_row_is_believed():
    away, other = np.array([0.1, 0.0, 0.0]), np.array([0.0, 0.2, 0.0])
    alike, believed = standing([ORIGIN, ORIGIN, ORIGIN + away, ORIGIN + away])
    np.testing.assert_allclose(alike[2], ORIGIN)
    np.testing.assert_allclose(alike[3], ORIGIN + away)
    assert believed == [1, 1, 0, 2]
    unlike, _ = standing(
        [ORIGIN, ORIGIN, *(ORIGIN + k * away + (-1) ** k * other for k in range(6))]
    )
    np.testing.assert_allclose(unlike[6], ORIGIN)
    np.testing.assert_allclose(unlike[7], ORIGIN + 5.0 * away - other)


def test_over_a_long_latency_it_follows_the_bend_of_the_path():
    """On a circle of 0.5 m; a straight line from the newest Jacobian is 7 mm off."""
    track = Track(Ball())

    def on_circle(angle: float) -> np.ndarray:
        return 0.5 * np.array([np.cos(angle), np.sin(angle), 0.0])

    def tangent(angle: float) -> np.ndarray:
        jacobian = np.zeros((3, 6))
        jacobian[:, 0] = 0.5 * np.array([-np.sin(angle), np.cos(angle), 0.0])
        return jacobian

    for k in range(50):  # 1 rad/s; the Jacobian is one joint state late
        angle = k * JOINT_S
        track.add_joints(angle, np.array([angle, 0, 0, 0, 0, 0]), tangent(angle - JOINT_S))
    track.add_image(angle - 0.17, on_circle(angle - 0.17))
    np.testing.assert_allclose(track.now(), on_circle(angle), atol=1.1e-3)
