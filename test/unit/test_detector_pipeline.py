"""From two images to a position that is believed, with and without distortion."""

import dataclasses

import cv2
import numpy as np
import pytest
from cases import each
from drawn_balls import RADIUS_M, VGA, draw
from hypothesis import given, settings
from hypothesis import strategies as st
from sensor_msgs.msg import CameraInfo, RegionOfInterest

from fvs_detector_node.ball_detector import BallDetector
from fvs_detector_node.config import DetectorConfig
from fvs_detector_node.pairing import Pairing
from fvs_ros.camera import CameraModel, camera_model

PINHOLE = CameraModel(VGA)
DT = 1 / 30
CENTRE = np.array([0.1, -0.05, 1.2])
K = [615.0, 0.0, 319.5, 0.0, 615.0, 239.5, 0.0, 0.0, 1.0]


def calibration(model="plumb_bob", d=(0.0,) * 5, **changes):
    values = {"width": 640, "height": 480, "k": K, "distortion_model": model, "d": list(d)}
    return CameraInfo(**{**values, **changes})


def detector(**values):
    return BallDetector(DetectorConfig(**values))


def ball(*centres):
    return draw([(np.asarray(centre, dtype=float), RADIUS_M) for centre in centres])


def error_mm(sighting, centre):
    return 1e3 * np.linalg.norm(sighting.detection.position_m - centre)


# ------------------------------------------------------------------------------- searching


@each("shift_m", [-0.3, 0.05, 0.06, 0.07, 0.08])
def test_a_ball_that_left_the_window_or_is_cut_by_it_is_measured_whole(shift_m):
    looks = detector()
    looks.detect(0.0, *ball(CENTRE), PINHOLE)
    moved = CENTRE + [shift_m, 0.0, 0.0]
    sighting = looks.detect(DT, *ball(moved), PINHOLE)
    assert sighting.detection.visible_fraction == pytest.approx(1.0, abs=0.02)
    assert error_mm(sighting, moved) < 0.6


# ------------------------------------------------------------------------------ distortion
LENSES = [
    ("plumb_bob", (-0.28, 0.08, 0.001, -0.0007, 0.0)),
    ("rational_polynomial", (0.4, -0.2, 0.001, 0.0003, 0.02, 0.7, -0.3, 0.05)),
    ("equidistant", (0.05, -0.02, 0.003, 0.0)),
    ("equidistant", (0.0, 0.0, 0.0, 0.0)),
]


def distorted(model, coefficients, *pictures):
    """What a camera with a lens takes of what an ideal one takes: each pixel by its ray."""
    matrix, pixels = np.array(K).reshape(3, 3), np.moveaxis(np.mgrid[:480, :640], 0, -1)[..., ::-1]
    undistort = cv2.fisheye.undistortPoints if model == "equidistant" else cv2.undistortPoints
    points = pixels.reshape(-1, 1, 2).astype(float)
    at = (
        undistort(points, matrix, np.array(coefficients), P=matrix)
        .reshape(pixels.shape)
        .astype(np.float32)
    )
    return [cv2.remap(picture, at, None, cv2.INTER_NEAREST) for picture in pictures]


@each(("model", "coefficients"), LENSES)
def test_the_lens_does_not_move_the_ball(model, coefficients):
    camera = camera_model(calibration(model, coefficients))
    centre = np.array([0.33, -0.24, 1.2])
    rgb, depth = distorted(model, coefficients, *ball(centre))
    looks = detector()
    whole = looks.detect(0.0, rgb, depth, camera)
    assert error_mm(whole, centre) < 1.5
    window = looks.detect(DT, rgb, depth, camera)
    assert error_mm(window, centre) < 1.5
    # Without the correction it would be off.
    raw = detector().detect(0.0, rgb, depth, PINHOLE)
    assert raw.detection is None or error_mm(raw, centre) > 4.0


# ----------------------------------------------------------------------------- calibration
@each(
    ("changes", "words"),
    [
        ({"k": [0.0] * 9}, "not calibrated"),
        ({"k": [np.nan, *K[1:]]}, "focal lengths"),
        ({"k": [615.0, 0.0, 1e7, *K[3:]]}, "principal point"),
        ({"model": "fov"}, "plumb_bob, rational_polynomial, equidistant"),
        ({"d": [0.1]}, "1 coefficients for plumb_bob, expected 0 or 4 or 5"),
        ({"model": "equidistant", "d": [0.1] * 5}, "5 coefficients for equidistant"),
        ({"model": "none", "d": [0.1] * 5}, "distortion model 'none'"),
        ({"d": [1e300] * 5}, "above 1000"),
        ({"binning_x": 2}, "binning"),
    ],
)
def test_a_calibration_that_cannot_be_is_refused(changes, words):
    with pytest.raises(ValueError, match=words):
        camera_model(calibration(**changes))


def test_a_calibration_may_lack_distortion_or_cut_a_region_out():
    for model in ("plumb_bob", "", "none", "rational_polynomial"):
        camera = camera_model(calibration(model))
        assert camera.intrinsics == VGA
        assert not camera.distorts
    roi = RegionOfInterest(x_offset=100, y_offset=50, width=320, height=240)
    camera = camera_model(calibration(roi=roi))
    assert camera.intrinsics == dataclasses.replace(VGA, width=320, height=240, cx=219.5, cy=189.5)


# ----------------------------------------------------------------------------- pairing


STAMPS_MS = st.integers(-50, 400) | st.sampled_from([-(10**9), 10**9, 10**6])


@given(st.lists(st.tuples(st.sampled_from(["colour", "depth"]), STAMPS_MS), max_size=120))
@settings(max_examples=200, deadline=None)
def test_pairs_advance_and_keep_the_tolerance_whatever_comes(events):
    pairing = Pairing(0.015)
    last_s = float("-inf")
    for name, stamp_ms in events:
        pair = pairing.add(name, stamp_ms / 1000, stamp_ms)
        if pairing.offset_s is None:  # the clock was set back, or there was no pair
            last_s = float("-inf")
        if pair is not None:
            assert abs(pair.depth - pair.colour) <= 15
            assert pair.stamp_s > last_s
            last_s = pair.stamp_s
    later_ms = [100 * n // 3 for n in range(10**8, 10**8 + 30)]
    pairs = [pairing.add(name, ms / 1000, ms) for ms in later_ms for name in ("colour", "depth")]
    assert sum(pair is not None for pair in pairs) >= 20


def test_the_nearest_of_frequent_depth_images_is_taken_although_it_comes_later():
    pairing, offsets_ms = Pairing(0.015), []
    events = [("depth", 11 * n) for n in range(60)] + [("colour", 33 * n + 8) for n in range(20)]
    for name, stamp_ms in sorted(events, key=lambda event: event[1]):
        pair = pairing.add(name, stamp_ms / 1000, stamp_ms)
        if pair is not None:
            offsets_ms.append(pair.depth - pair.colour)
    assert len(offsets_ms) >= 18
    assert set(offsets_ms[1:]) == {3}
