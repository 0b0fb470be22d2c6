"""The camera's picture: small, with ball and target where they are."""

from __future__ import annotations

import numpy as np
import pytest

from fvs_dashboard import picture
from fvs_ros.camera import Intrinsics

CAMERA = Intrinsics(640, 480, 600.0, 600.0, 319.5, 239.5)


def blank():
    return np.zeros((480, 640, 3), np.uint8)


def pixels(image, colour):
    """Rows and columns of the pixels that are about of a colour."""
    off = np.abs(image.astype(int) - np.array(colour)).max(axis=2)
    return np.argwhere(off < 60)


def test_the_scaled_camera_sees_the_same_ray_at_the_same_place():
    small = picture.scaled(CAMERA, 320)
    assert (small.width, small.height) == (320, 240)
    # the outer corner of the image stays its outer corner
    assert small.rays(-0.5, -0.5) == pytest.approx(CAMERA.rays(-0.5, -0.5))
    assert small.rays(319.5, 239.5) == pytest.approx(CAMERA.rays(639.5, 479.5))


def test_the_circle_has_the_balls_place_and_size():
    ball = np.array([0.1, -0.05, 1.2])
    small = picture.draw(blank(), CAMERA, ball, 0.03, None)
    rows, columns = pixels(small, picture.BALL_RGB).T
    u, v = picture.scaled(CAMERA, 320).project(ball)
    radius = 300.0 * 0.03 / 1.2
    assert (columns.min() + columns.max()) / 2 == pytest.approx(u, abs=0.6)
    assert (rows.min() + rows.max()) / 2 == pytest.approx(v, abs=0.6)
    assert (columns.max() - columns.min()) / 2 == pytest.approx(radius, abs=0.8)
    assert tuple(small[round(v), round(u)]) == (0, 0, 0)  # the ball itself stays to be seen


def test_the_cross_stands_on_the_target():
    target = np.array([-0.2, 0.1, 1.5])
    small = picture.draw(blank(), CAMERA, None, 0.03, target)
    u, v = picture.scaled(CAMERA, 320).project(target)
    found = np.argwhere(small.max(axis=2) > 60)  # a line between two rows is two, half as bright
    assert np.abs(found.mean(axis=0) - [v, u]).max() < 0.7
    assert np.ptp(found, axis=0) == pytest.approx([14, 14], abs=2)


def test_what_is_behind_the_camera_or_far_out_of_the_image_is_no_trouble():
    behind, out = np.array([0.0, 0.0, -1.0]), np.array([9.0, 9.0, 0.06])
    assert picture.draw(blank(), CAMERA, behind, 0.03, behind).max() == 0
    picture.draw(blank(), CAMERA, out, 0.03, out)


def test_a_camera_without_intrinsics_and_a_small_image():
    image = np.full((90, 120, 3), 77, np.uint8)
    small = picture.draw(image, None, np.ones(3), 0.03, np.ones(3))
    assert small.shape == (90, 120, 3)
    assert (small == 77).all()


def test_the_image_itself_is_not_painted_on():
    image = blank()[:240, :320]
    picture.draw(image, CAMERA, np.array([0.0, 0.0, 1.0]), 0.03, None)
    assert image.max() == 0


def test_words_stand_in_the_middle_however_long_they_are():
    dark = picture.with_words(picture.BLANK, "no picture: no node publishes " + "name/" * 8)
    rows, columns = np.argwhere(dark.min(axis=2) > 150).T
    assert rows.mean() == pytest.approx(120, abs=15)
    assert 5 < columns.min() < columns.max() < 315
