"""Does the image follow the arm, and as predicted? A frozen one is found at any speed."""

from functools import partial

import numpy as np
import pytest
from cases import each

from fvs_controller_node.agreement import Agreement
from fvs_controller_node.monitors import LEAST_SEEN
from fvs_ros.filter import Image

IMAGE_S = 1.0 / 30.0
QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def image(stamp_s, seen_m, moved_m):
    return Image(stamp_s, np.zeros(0), seen_m, seen_m, moved_m)


def verdicts(seen_of, path_of, seconds=4.0, noise_m=0.0, seed=1):
    """Times, s, and verdicts along a motion; ``seen_of`` and ``path_of`` are of time, m."""
    agreement, rng = Agreement(), np.random.default_rng(seed)
    for k in range(round(seconds / IMAGE_S)):
        t = k * IMAGE_S
        seen = seen_of(t) + noise_m * rng.normal(size=3)
        agreement.add(image(t, seen, np.asarray(path_of(t))), max(noise_m, 5e-5))
        yield t, agreement.verdict


def line(speed_m_s):
    return lambda t: np.array([speed_m_s * t, 0.0, 0.0])


def scaled(factor, path, t):
    return factor @ path(t)


def frozen(t):
    return np.array([0.1, 0.2, 1.0])


def frozen_after_s(*motion):
    judged = verdicts(*motion)
    return next((t for t, verdict in judged if verdict and verdict.seen_share < LEAST_SEEN), None)


@each(
    ("speed_m_s", "noise_m"),
    [(speed, noise) for speed in (1e-4, 5e-4, 2e-3, 5e-3) for noise in (0.0, 0.001, 0.004)]
    + [(0.02, 0.0), (0.02, 0.002), (0.05, 0.001)],
)
def test_a_frozen_picture_is_found_within_20_mm_however_slowly_the_arm_drifts(speed_m_s, noise_m):
    for seed in range(2):
        path = line(speed_m_s)
        after_s = frozen_after_s(frozen, path, 0.025 / speed_m_s, noise_m, seed)
        assert after_s is not None
        assert after_s * speed_m_s < 0.02


@each(
    ("factor", "ratio"),
    [(1.0, 0.0), (0.7, 0.3), (1.4, 0.29), (0.0, 1.0), (-1.0, 2.0), (-2.0, 1.5), (QUARTER, 1.41)],
)
def test_the_error_ratio_is_that_of_the_prediction_and_only_a_frozen_image_stands(factor, ratio):
    for path in (line(0.01), line(0.3)):
        seen = partial(scaled, factor * np.eye(3) if np.isscalar(factor) else factor, path)
        judged = [verdict for _, verdict in verdicts(seen, path, noise_m=1e-3) if verdict]
        ratios = [verdict.error_ratio for verdict in judged]
        assert np.median(ratios) == pytest.approx(ratio, abs=0.08)
        assert any(verdict.seen_share < LEAST_SEEN for verdict in judged) is (ratio == 1.0)


@each("step_s", [0.6, -0.15, -100.0])
def test_neither_a_gap_between_images_nor_a_clock_that_steps_back_forgives_anything(step_s):
    agreement = Agreement()
    for k in range(40):
        agreement.add(image(k * IMAGE_S, np.zeros(3), np.array([0.01 * k, 0.0, 0.0])), 1e-3)
    assert agreement.verdict is not None
    agreement.add(image(k * IMAGE_S + step_s, np.zeros(3), np.array([0.01 * k, 0.0, 0.0])), 1e-3)
    assert agreement.verdict.seen_share < LEAST_SEEN
    assert 0.0 < agreement.verdict.time_s < 2.0
