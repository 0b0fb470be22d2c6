"""A lost ball is explained in one sentence that says what to do."""

import re

import cv2
import numpy as np
from cases import each
from drawn_balls import RADIUS_M, VGA, draw, hide, red

from fvs_detector_node.detection import BallColour, Cause, detect_ball
from fvs_detector_node.detector import diagnose

CENTRE = np.array([0.05, 0.02, 1.2])


def reason(rgb, depth, colour=None):
    """The diagnosis of pictures in which the ball is not found."""
    colour = colour or BallColour()
    assert detect_ball(rgb, depth, VGA, RADIUS_M, colour) is None
    miss = diagnose(rgb, depth, VGA, RADIUS_M, colour)
    assert "\n" not in miss.text
    assert len(miss.text) < 240
    return miss


def the_ball():
    return draw([(CENTRE, RADIUS_M)])


@each("name", ["min_value", "min_saturation"])
def test_what_is_said_of_a_ball_too_dark_or_too_pale_helps(name):
    rgb, depth = the_ball()
    if name == "min_value":
        rgb = (rgb * 0.12).astype(np.uint8)
    else:
        rgb[red(rgb)] = (0.35 * rgb[red(rgb)] + 0.65 * 220).astype(np.uint8)
    miss = reason(rgb, depth)
    assert miss.cause is Cause.OFF_COLOUR
    lower = int(re.search(rf"lower {name} to (\d+)", miss.text).group(1))
    assert detect_ball(rgb, depth, VGA, RADIUS_M, BallColour(**{name: lower})) is not None


def mostly_hidden(rgb, depth):
    columns = np.flatnonzero(red(rgb).any(axis=0))
    hide(rgb, depth, np.s_[:, : columns[int(0.8 * len(columns))]])
    return rgb, depth


def flat(rgb, depth):
    depth[red(rgb)] = 1.2
    return rgb, depth


OTHER = Cause.OTHER_THING, ("ball_radius_m", "uncover", "align_depth.enable:=true")


@each(
    ("spoil", "cause", "hints"),
    [
        (lambda rgb, depth: draw([]), Cause.OUT_OF_VIEW, ("out of view",)),
        (lambda rgb, depth: (rgb, depth * 1e-3), *OTHER),
        (lambda rgb, depth: (rgb, np.roll(depth, 60, axis=1)), *OTHER),
        (mostly_hidden, *OTHER),
        (flat, *OTHER),
    ],
)
def test_what_is_not_the_ball_is_described_with_all_that_may_be_wrong(spoil, cause, hints):
    miss = reason(*spoil(*the_ball()))
    assert miss.cause is cause
    assert all(hint in miss.text for hint in hints)


def test_any_picture_gets_an_answer():
    rng = np.random.default_rng(0)
    small = VGA.window(0, 0, 120, 90)
    for _ in range(100):
        rgb = cv2.resize(rng.integers(0, 256, (6, 8, 3), np.uint8), (120, 90))
        rgb[..., 1:] = rgb[..., 1:] // rng.integers(1, 20)
        depth = cv2.resize(rng.uniform(-1, 3, (6, 8)).astype(np.float32), (120, 90))
        depth[rng.random(depth.shape) < 0.2] = rng.choice([np.nan, np.inf, 0.0, 1e30])
        assert diagnose(rgb, depth, small, RADIUS_M, BallColour()).text
        ball = detect_ball(rgb, depth, small, RADIUS_M)
        assert ball is None or np.isfinite([*ball.position_m, ball.quality]).all()
