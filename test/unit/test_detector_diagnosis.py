"""A lost ball is explained in one sentence that says what to do."""

import cv2
import numpy as np
import pytest
from drawn_balls import RADIUS_M, VGA, draw, hide

from fvs_detector_node.detection import BallColour, detect_ball
from fvs_detector_node.diagnosis import Why, diagnose

CENTRE = np.array([0.05, 0.02, 1.2])


def reason(rgb, depth, radius_m=RADIUS_M, colour=None):
    """The diagnosis of pictures in which the ball is not found."""
    colour = colour or BallColour()
    assert detect_ball(rgb, depth, VGA, radius_m, colour) is None
    miss = diagnose(rgb, depth, VGA, radius_m, colour)
    assert "\n" not in miss.text
    assert len(miss.text) < 260
    return miss


def the_ball():
    return draw([(CENTRE, RADIUS_M)])


def red(rgb):
    return rgb[..., 0] > 2.0 * rgb[..., 1]


def test_ball_out_of_view():
    miss = reason(*draw([]))
    assert miss.why is Why.OUT_OF_VIEW
    assert "out of view" in miss.text


def test_ball_too_dark():
    rgb, depth = the_ball()
    rgb = (rgb * 0.12).astype(np.uint8)
    miss = reason(rgb, depth)
    assert miss.why is Why.TOO_DARK
    assert "min_value 35" in miss.text
    # What it says helps.
    lower = int(miss.text.split("lower min_value to ")[1].split(",")[0])
    assert lower < 35
    assert detect_ball(rgb, depth, VGA, RADIUS_M, BallColour(min_value=lower)) is not None


def test_ball_darker_than_an_asking_too_much():
    rgb, depth = the_ball()
    miss = reason(rgb, depth, colour=BallColour(min_value=254))
    assert miss.why is Why.TOO_DARK
    assert "a ball in view" in miss.text


def test_ball_too_pale():
    rgb, depth = the_ball()
    rgb[red(rgb)] = (0.35 * rgb[red(rgb)] + 0.65 * 220).astype(np.uint8)
    miss = reason(rgb, depth)
    assert miss.why is Why.TOO_PALE
    lower = int(miss.text.split("lower min_saturation to ")[1].split(",")[0])
    assert detect_ball(rgb, depth, VGA, RADIUS_M, BallColour(min_saturation=lower)) is not None


@pytest.mark.parametrize("true_radius_m", [0.025, 0.06])
def test_ball_of_another_radius(true_radius_m):
    miss = reason(*draw([(CENTRE, true_radius_m)]))
    assert miss.why is Why.WRONG_SIZE
    assert "ball_radius_m says 40 mm" in miss.text
    said_mm = float(miss.text.split("a ball of ")[1].split(" mm")[0])
    assert said_mm == pytest.approx(1e3 * true_radius_m, rel=0.15)


def test_a_smaller_ball_before_an_empty_background():
    # Nothing but its holder, as far away as the ball, has a depth.
    rgb, depth = the_ball()
    depth[~red(rgb)] = 0.0
    u, v = VGA.project(CENTRE).astype(int)
    depth[v - 60 : v - 22, u - 5 : u + 5] = 1.17
    miss = reason(rgb, depth, radius_m=0.07)
    assert miss.why is Why.WRONG_SIZE
    assert "a ball of 41 mm radius; ball_radius_m says 70 mm" in miss.text


@pytest.mark.parametrize("nothing", [0.0, np.nan, np.inf])
def test_red_disc_without_depth(nothing):
    rgb, depth = the_ball()
    depth[red(rgb)] = nothing
    miss = reason(rgb, depth)
    assert miss.why is Why.NO_DEPTH
    assert "too near" in miss.text
    assert "reflective" in miss.text


def test_metres_taken_for_millimetres():
    rgb, depth = the_ball()
    miss = reason(rgb, depth * 1e-3)
    assert "depth_unit_m" in miss.text


@pytest.mark.parametrize("shift_px", [35, 60, 200])
def test_depth_that_is_not_registered(shift_px):
    rgb, depth = the_ball()
    miss = reason(rgb, np.roll(depth, shift_px, axis=1))
    assert miss.why is Why.NOT_REGISTERED
    assert "align_depth.enable:=true" in miss.text


def test_ball_mostly_hidden():
    rgb, depth = the_ball()
    columns = np.flatnonzero(red(rgb).any(axis=0))
    hide(rgb, depth, np.s_[:, : columns[int(0.80 * len(columns))]])
    miss = reason(rgb, depth)
    assert miss.why in (Why.HIDDEN, Why.WRONG_SIZE)
    assert "hidden" in miss.text


def test_share_that_is_visible_is_told():
    rgb, depth = the_ball()
    columns = np.flatnonzero(red(rgb).any(axis=0))
    hide(rgb, depth, np.s_[:, : columns[int(0.755 * len(columns))]])
    miss = reason(rgb, depth)
    if miss.why is Why.HIDDEN:
        assert "25%" in miss.text
    assert "hidden" in miss.text


def test_red_box_of_the_balls_size():
    rgb, depth = draw([])
    rgb[215:250, 300:335] = (200, 20, 20)
    depth[215:250, 300:335] = 1.2
    miss = reason(rgb, depth)
    assert miss.why in (Why.NO_BALL, Why.WRONG_SIZE)
    assert "ball's colour, 1.2" in miss.text


def test_the_likeliest_of_several_things_is_explained():
    rgb, depth = the_ball()
    depth[red(rgb)] = 0.0
    rgb[5:9, 5:9] = (200, 20, 20)
    assert reason(rgb, depth).why is Why.NO_DEPTH


def test_the_box_is_where_the_thing_is():
    rgb, depth = the_ball()
    depth[red(rgb)] = 0.0
    u0, v0, width, height = reason(rgb, depth).box
    u, v = VGA.project(CENTRE)
    assert u0 < u < u0 + width
    assert v0 < v < v0 + height


def test_any_picture_gets_an_answer():
    rng = np.random.default_rng(0)
    small = VGA.window(0, 0, 120, 90)
    for _ in range(150):
        rgb = cv2.resize(rng.integers(0, 256, (6, 8, 3), np.uint8), (120, 90))
        rgb[..., 1:] = rgb[..., 1:] // rng.integers(1, 20)
        depth = cv2.resize(rng.uniform(-1, 3, (6, 8)).astype(np.float32), (120, 90))
        depth[rng.random(depth.shape) < 0.2] = rng.choice([np.nan, np.inf, 0.0, 1e30])
        assert diagnose(rgb, depth, small, RADIUS_M, BallColour()).text
