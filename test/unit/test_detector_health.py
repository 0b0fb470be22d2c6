"""Whatever keeps the ball from being published is said, with what to do about it."""

from dataclasses import replace

import pytest

from fvs_detector_node.detector import Sighting
from fvs_detector_node.health import (
    FAULT,
    LOST,
    TRACKING,
    WAITING,
    Input,
    Snapshot,
    judge,
    mismatch,
)

WELL = Snapshot(
    colour=Input("/camera/color/image_raw", 0.02, 1),
    depth=Input("/camera/depth", 0.02, 1),
    info=Input("/camera/color/camera_info", 0.02, 1),
    pair_age_s=0.02,
    offset_s=0.0,
    tolerance_s=0.015,
    calibrated=True,
    sighting=Sighting(None),
)
SILENT = float("inf")


@pytest.mark.parametrize(
    ("changes", "state", "said"),
    [
        ({}, TRACKING, "published"),
        (
            {"colour": Input("/cam/image", SILENT, 0)},
            WAITING,
            "no colour images on /cam/image: nobody publishes there; is the camera running",
        ),
        ({"colour": Input("/cam/image", SILENT, 2)}, WAITING, "but nothing arrives"),
        ({"depth": Input("/cam/depth", 2.0, 1)}, WAITING, "no depth images on /cam/depth"),
        ({"depth": Input("/cam/depth", 5.0, 0)}, WAITING, "align_depth.enable:=true"),
        ({"calibrated": False, "sighting": None}, WAITING, "no camera_info on /camera/color"),
        ({"pair_age_s": SILENT, "offset_s": 0.021}, WAITING, "off by +21.0 ms"),
        ({"pair_age_s": SILENT, "offset_s": -0.3}, WAITING, "enable_sync:=true"),
        ({"colour": Input("/cam/image", 0.5, 1), "pair_age_s": 0.5}, TRACKING, "published"),
        ({"pair_age_s": 2.0, "repeats": 10}, FAULT, "stamps of the images do not advance, 10"),
        ({"pair_age_s": 2.0, "repeats": 2}, WAITING, "enable_sync:=true"),
        ({"sighting": None}, WAITING, "first pair"),
        ({"sighting": Sighting(None, "too dark: x")}, LOST, "too dark: x"),
        ({"problem": "/a: bad", "problem_age_s": 0.8}, FAULT, "/a: bad"),
        ({"problem": "/a: bad", "problem_age_s": 2.0}, TRACKING, "published"),
    ],
)
def test_what_is_said(changes, state, said):
    found, reason = judge(replace(WELL, **changes))
    assert found == state
    assert said in reason
    assert "\n" not in reason


def test_images_of_different_cameras_do_not_fit_together():
    vga, small = (640, 480), (320, 240)
    assert mismatch(vga, vga, "color", "color", vga) == ""
    assert "320x240 pixels against 640x480" in mismatch(vga, small, "color", "color", vga)
    assert "frame 'depth' against 'color'" in mismatch(vga, vga, "color", "depth", vga)
    assert "align_depth.enable:=true" in mismatch(vga, vga, "color", "depth", vga)
    assert "camera_info is for 320x240" in mismatch(vga, vga, "color", "color", small)
