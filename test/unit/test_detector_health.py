"""Whatever keeps the ball from being published is said, with what to do about it."""

import math
from dataclasses import replace

import pytest

from fvs_detector_node.detector import Sighting
from fvs_detector_node.health import FAULT, LOST, TRACKING, WAITING, Input, judge, mismatch
from fvs_detector_node.synchroniser import Synchroniser

COLOUR = Input("colour images", "/camera/color/image_raw", 0.02, 1, "is the camera running?")
DEPTH = Input("depth images", "/camera/depth", 0.02, 1, "set align_depth.enable:=true")
SEEN = Sighting(None)


def unpaired(repeats=0, offset_s=0.021):
    pairing = Synchroniser(0.015)
    for stamp_s in (1.0,) * (1 + repeats):
        pairing.add_colour(stamp_s, "colour")
    pairing.add_depth(1.0 + offset_s, "depth")
    return pairing


def judged(inputs=(COLOUR, DEPTH), problem="", pair_age_s=0.02, pairing=None, sighting=SEEN):
    return judge(inputs, problem, pair_age_s, pairing or unpaired(), sighting)


@pytest.mark.parametrize(
    ("changes", "state", "said"),
    [
        ({}, TRACKING, "published"),
        (
            {"inputs": [replace(COLOUR, age_s=math.inf, publishers=0), DEPTH]},
            WAITING,
            "no colour images on /camera/color/image_raw: no node publishes there; is the camera",
        ),
        ({"inputs": [replace(COLOUR, age_s=math.inf)]}, WAITING, "no message arrives"),
        ({"inputs": [COLOUR, replace(DEPTH, age_s=2.0)]}, WAITING, "no depth images on /camera/"),
        ({"pair_age_s": math.inf}, WAITING, "+21.0 ms apart: start the camera with enable_sync"),
        ({"inputs": [replace(COLOUR, age_s=0.5)], "pair_age_s": 0.5}, TRACKING, "published"),
        ({"pair_age_s": 2.0, "pairing": unpaired(10)}, FAULT, "stamps do not advance, 10 in"),
        ({"pair_age_s": 2.0, "pairing": unpaired(2)}, WAITING, "enable_sync:=true"),
        ({"sighting": None}, WAITING, "first pair"),
        ({"sighting": Sighting(None, "too dark: x")}, LOST, "too dark: x"),
        ({"problem": "/a: bad"}, FAULT, "/a: bad"),
    ],
)
def test_what_is_said(changes, state, said):
    found, reason = judged(**changes)
    assert found == state
    assert said in reason
    assert "\n" not in reason


def test_images_of_different_cameras_do_not_fit_together():
    vga, small = (480, 640), (240, 320)
    assert mismatch(vga, vga, "color", "color", vga) == ""
    assert "320x240 pixels against 640x480" in mismatch(vga, small, "color", "color", vga)
    assert "frame 'depth' against 'color'" in mismatch(vga, vga, "color", "depth", vga)
    assert "align_depth.enable:=true" in mismatch(vga, vga, "color", "depth", vga)
    assert "camera_info is for 320x240" in mismatch(vga, vga, "color", "color", small)
