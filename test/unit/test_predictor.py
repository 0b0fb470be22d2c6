"""The ball predicted to now: exact on a linear plant, waiting, fusing, and surviving mishaps."""

import numpy as np
import pytest

from fvs_controller_node.prediction import FeaturePredictor

RNG = np.random.default_rng(5)
JACOBIAN = 0.4 * RNG.normal(size=(3, 6))
ORIGIN = np.array([0.1, -0.2, 1.2])
JOINT_S = 0.008


def joints(t: float) -> np.ndarray:
    """Smooth motion, linear between samples in what the tests compare."""
    return 0.5 * np.sin(np.arange(1.0, 7.0) * 0.4 * t)


def ball(t: float) -> np.ndarray:
    return ORIGIN + JACOBIAN @ joints(t)


def feed(predictor: FeaturePredictor, start_s: float, end_s: float, offset_s: float = 0.0) -> None:
    for k in range(round(start_s / JOINT_S), round(end_s / JOINT_S)):
        predictor.add_joints(k * JOINT_S + offset_s, joints(k * JOINT_S), JACOBIAN)


def newest(predictor: FeaturePredictor) -> np.ndarray:
    predicted = predictor.predict()
    assert predicted is not None
    return predicted


def test_it_carries_an_old_image_to_the_newest_joints():
    predictor = FeaturePredictor()
    feed(predictor, 0.0, 1.0)
    predictor.add_feature(0.9, ball(0.9))
    np.testing.assert_allclose(newest(predictor), ball(0.992), atol=5e-5)
    assert predictor.latency_s == pytest.approx(0.092)
    assert predictor.problem == ""


def standing(positions: list[np.ndarray]) -> list[np.ndarray]:
    """Predictions at rest after each of some positions, once the noise is known."""
    predictor, found = FeaturePredictor(), []
    predictor.add_joints(0.0, np.zeros(6), JACOBIAN)
    predictor.add_joints(0.09, np.zeros(6), JACOBIAN)
    for k, position in enumerate([*[ORIGIN] * 8, *positions]):
        predictor.add_feature(0.005 * k, position)
        found.append(newest(predictor))
    return found[8:]


def test_an_outlier_is_passed_over_and_what_two_say_alike_or_six_in_a_row_is_believed():
    away, other = np.array([0.1, 0.0, 0.0]), np.array([0.0, 0.2, 0.0])
    alike = standing([ORIGIN, ORIGIN, ORIGIN + away, ORIGIN + away])
    np.testing.assert_allclose(alike[2], ORIGIN)
    np.testing.assert_allclose(alike[3], ORIGIN + away)
    unlike = standing([ORIGIN, ORIGIN, *(ORIGIN + k * away + (-1) ** k * other for k in range(6))])
    np.testing.assert_allclose(unlike[6], ORIGIN)
    np.testing.assert_allclose(unlike[7], ORIGIN + 5.0 * away - other)


def test_over_a_long_latency_it_follows_the_bend_of_the_path():
    """On a circle of 0.5 m; a straight line from the newest Jacobian is 7 mm off."""
    predictor = FeaturePredictor()

    def on_circle(angle: float) -> np.ndarray:
        return 0.5 * np.array([np.cos(angle), np.sin(angle), 0.0])

    def tangent(angle: float) -> np.ndarray:
        jacobian = np.zeros((3, 6))
        jacobian[:, 0] = 0.5 * np.array([-np.sin(angle), np.cos(angle), 0.0])
        return jacobian

    for k in range(50):  # 1 rad/s; the Jacobian is one joint state late
        angle = k * JOINT_S
        predictor.add_joints(angle, np.array([angle, 0, 0, 0, 0, 0]), tangent(angle - JOINT_S))
    predictor.add_feature(angle - 0.17, on_circle(angle - 0.17))
    np.testing.assert_allclose(newest(predictor), on_circle(angle), atol=1.1e-3)
