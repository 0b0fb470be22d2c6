"""A lost ball is explained in one sentence that says what to do."""

import re

import cv2
import numpy as np
from cases import each
from drawn_balls import RADIUS_M, VGA, draw, hide, red

from fvs_detector_node.ball_detector import BallDetector
from fvs_detector_node.config import BallColour, DetectorConfig
from fvs_detector_node.images import Region
from fvs_ros.camera import CameraModel

CENTRE = np.array([0.05, 0.02, 1.2])


def look(rgb, depth, camera=VGA, **colour):
    config = DetectorConfig(ball_radius_m=RADIUS_M, colour=BallColour(**colour))
    return BallDetector(config).detect(0.0, rgb, depth, CameraModel(camera))


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


def mostly_hidden(rgb, depth):
    columns = np.flatnonzero(red(rgb).any(axis=0))
    hide(rgb, depth, np.s_[:, : columns[int(0.8 * len(columns))]])
    return rgb, depth


OTHER = ("ball_radius_m", "uncover", "align_depth.enable:=true")


@each(
    ("spoil", "hints"),
    [
        (lambda rgb, depth: draw([]), ("out of view",)),
        (lambda rgb, depth: (rgb, 0.0 * depth), ("no depth",)),
        (lambda rgb, depth: (rgb, depth * 1e-3), OTHER),
        (lambda rgb, depth: (rgb, np.roll(depth, 60, axis=1)), OTHER),
        (mostly_hidden, OTHER),
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
