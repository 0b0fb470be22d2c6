"""The ball is found where it is, whatever else is in view; a lost one is explained."""

import re

import cv2
import numpy as np
import pytest
from cases import each
from drawn_balls import RADIUS_M, VGA, draw, hide, red

from fvs_detector_node.ball_detector import BallDetector
from fvs_detector_node.config import BallColour, DetectorConfig
from fvs_detector_node.images import Region
from fvs_ros.camera import CameraModel, Intrinsics

CENTRE = np.array([0.1, -0.05, 1.0])


def look(rgb, depth, camera=VGA, **colour):
    config = DetectorConfig(ball_radius_m=RADIUS_M, colour=BallColour(**colour))
    return BallDetector(config).detect(0.0, rgb, depth, CameraModel(camera))


def find(spheres, spoil=None, **scene):
    """The ball in drawn pictures, changed in place by ``spoil``."""
    rgb, depth = draw(spheres, **scene)
    if spoil is not None:
        spoil(rgb, depth)
    return look(rgb, depth).detection


def error_mm(detection, centre):
    return 1e3 * np.linalg.norm(detection.position_m - centre)


def test_an_ideal_ball_is_exact_anywhere_in_the_image():
    rng = np.random.default_rng(0)
    for _ in range(20):
        z = rng.uniform(0.6, 1.8)
        centre = z * VGA.rays(rng.uniform(60, 580), rng.uniform(60, 420))
        detection = find([(centre, RADIUS_M)])
        assert error_mm(detection, centre) < 0.6
        assert detection.visible_fraction == pytest.approx(1.0, abs=0.02)
        assert detection.quality > 0.9
        assert detection.residual_m < 0.001
        assert detection.radius_px == pytest.approx(VGA.fx * RADIUS_M / z, rel=0.15)


def without_depth(rgb, camera=VGA):
    config = DetectorConfig(ball_radius_m=RADIUS_M, use_depth=False)
    return BallDetector(config).detect(0.0, rgb, None, CameraModel(camera))


def test_without_depth_a_balls_size_tells_its_distance():
    rng, fine = np.random.default_rng(0), 4
    for z in (0.6, 1.0, 1.4):
        size = Intrinsics(320, 240, 615.0, 615.0, rng.uniform(40, 280), rng.uniform(40, 200))
        middle = size.rays(rng.uniform(90, 230), rng.uniform(80, 160))
        sharp = Intrinsics(
            fine * size.width,
            fine * size.height,
            fine * size.fx,
            fine * size.fy,
            fine * (size.cx + 0.5) - 0.5,
            fine * (size.cy + 0.5) - 0.5,
        )
        drawn = cv2.resize(
            draw([(z * middle, RADIUS_M)], camera=sharp)[0],
            (size.width, size.height),
            interpolation=cv2.INTER_AREA,
        )
        error = without_depth(drawn, size).detection.position_m - z * middle
        along = error @ middle / np.linalg.norm(middle)
        # A tenth of a pixel of the radius.
        assert abs(along) < 0.1 * z / (size.fx * RADIUS_M / z)
        assert np.linalg.norm(error - along * middle / np.linalg.norm(middle)) < 3e-4


def test_without_depth_a_ball_that_is_partly_hidden_is_no_further_and_a_box_is_none():
    rgb, depth = draw([(CENTRE, RADIUS_M)])
    columns = np.nonzero(red(rgb))[1]
    hide(rgb, depth, np.s_[:, int(np.quantile(columns, 0.75)) :])
    assert error_mm(without_depth(rgb).detection, CENTRE) < 5.0
    rgb[200:280, 300:400] = (200, 20, 20)
    rgb[red(rgb) & (np.indices(rgb.shape[:2])[0] < 200)] = 150
    assert "not round" in without_depth(rgb).problem


@each("shown", [0.75, 0.5, 0.35, 0.23, 0.1])
@each("angle", [0.0, 1.0, 2.5, 4.0])
def test_a_partly_hidden_ball_is_measured_if_a_quarter_is_seen(shown, angle):
    rows, columns = np.mgrid[:480, :640]
    across = np.cos(angle) * columns + np.sin(angle) * rows

    def cover(rgb, depth):
        hide(rgb, depth, across > np.quantile(across[red(rgb)], shown))

    detection = find([(CENTRE, RADIUS_M)], cover)
    if shown < 0.25:
        assert detection is None
        return
    assert detection.visible_fraction == pytest.approx(shown, abs=0.06)
    assert error_mm(detection, CENTRE) < 2.0
    assert detection.quality < shown + 0.06


@each(
    ("share", "factor", "shift_m"),
    [(0.4, f, 0.0) for f in (0.0, np.nan, np.inf, -1.0)] + [(0.2, 1.0, m) for m in (-0.4, 0.04)],
)
def test_no_depth_or_that_of_something_else_does_not_move_the_ball(share, factor, shift_m):
    def spoil(_rgb, depth):
        wrong = np.random.default_rng(1).random(depth.shape) < share
        depth[wrong] = factor * depth[wrong] + shift_m

    assert error_mm(find([(CENTRE, RADIUS_M)], spoil), CENTRE) < 0.6


@each(("share", "is_ball"), [(0.5, False), (0.7, False), (0.95, True), (1.05, True), (1.4, False)])
def test_a_ball_of_another_size_is_not_the_ball_and_a_slightly_wrong_radius_is(share, is_ball):
    for z in (0.7, 1.0, 1.3, 1.6):
        centre = np.array([0.05, 0.02, z])
        ball = find([(centre, share * RADIUS_M)])
        assert error_mm(ball, centre) < 4.0 if is_ball else ball is None


def test_a_ball_is_found_among_many_larger_red_things_and_before_one():
    ball = (np.array([0.0, 0.0, 1.2]), RADIUS_M)
    others = [(np.array([x, y, 1.2]), 0.06) for x in (-0.4, -0.2, 0.2, 0.4) for y in (-0.3, 0.3)]
    assert error_mm(find([*others, ball]), ball[0]) < 0.6
    behind = (np.array([0.03, 0.03, 1.5]), 0.12)
    assert error_mm(find([ball, behind]), ball[0]) < 3.0


def test_red_flat_things_are_not_the_ball():
    for half in (10, 18, 24, 60, 200):

        def paint(rgb, depth, part=np.s_[240 - half : 240 + half, 320 - half : 320 + half]):
            rgb[part], depth[part] = (200, 20, 20), 1.2

        assert find([], paint) is None


# ---- what is said of a lost ball ------------------------------------------------------------


def the_ball():
    return draw([(CENTRE, RADIUS_M)])


def pale(rgb):
    rgb[red(rgb)] = (0.35 * rgb[red(rgb)] + 0.65 * 220).astype(np.uint8)
    return rgb


@each("spoil", [lambda rgb: (0.12 * rgb).astype(np.uint8), pale])
def test_what_is_said_of_a_ball_too_dark_or_too_pale_helps(spoil):
    rgb, depth = the_ball()
    rgb = spoil(rgb)
    problem = look(rgb, depth).problem
    value, saturation = map(int, re.findall(r"min_\w+ to (\d+)", problem))
    helped = look(rgb, depth, min_value=value, min_saturation=saturation)
    assert helped.detection is not None


OTHER = ("ball_radius_m", "uncover", "align_depth.enable:=true")


@each(
    ("spoil", "hints"),
    [
        (lambda rgb, depth: draw([]), ("out of view",)),
        (lambda rgb, depth: (rgb, 0.0 * depth), ("no depth",)),
        (lambda rgb, depth: (rgb, depth * 1e-3), OTHER),
        (lambda rgb, depth: (rgb, np.roll(depth, 60, axis=1)), OTHER),
    ],
)
def test_what_is_not_the_ball_is_described_with_all_that_may_be_wrong(spoil, hints):
    sighting = look(*spoil(*the_ball()))
    assert sighting.detection is None
    assert len(sighting.problem) < 240
    assert all(hint in sighting.problem for hint in hints)


def test_any_picture_gets_an_answer():
    rng = np.random.default_rng(0)
    small = Region(0, 0, 120, 90).view(VGA)
    for _ in range(100):
        rgb = cv2.resize(rng.integers(0, 256, (6, 8, 3), np.uint8), (120, 90))
        rgb[..., 1:] = rgb[..., 1:] // rng.integers(1, 20)
        depth = cv2.resize(rng.uniform(-1, 3, (6, 8)).astype(np.float32), (120, 90))
        depth[rng.random(depth.shape) < 0.2] = rng.choice([np.nan, np.inf, 0.0, 1e30])
        sighting = look(rgb, depth, small)
        ball = sighting.detection
        assert sighting.problem or np.isfinite([*ball.position_m, ball.quality]).all()
