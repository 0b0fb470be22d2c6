"""The camera's picture: small, with ball and target where they are, and honest about its age."""

import numpy as np
import pytest

from fvs_dashboard.picture import BALL_RGB, TARGET_RGB, Picture
from fvs_ros.camera import Intrinsics

CAMERA = Intrinsics(640, 480, 600.0, 600.0, 319.5, 239.5)
BLACK = np.zeros((480, 640, 3), np.uint8)


@pytest.fixture
def picture():
    picture = Picture(ball_radius_m=0.03)
    picture.intrinsics = CAMERA
    return picture


def drawn(image, colour):
    """Middle and half width, pixels (column, row), of what has about a colour."""
    found = np.argwhere(image @ (np.array(colour) / 255.0) > 120)[:, ::-1]
    return (found.min(axis=0) + found.max(axis=0)) / 2, np.ptp(found, axis=0) / 2


def test_ball_and_target_are_drawn_where_the_image_itself_shows_them(picture):
    ball_m, target_m = np.array([0.1, -0.05, 1.2]), np.array([-0.2, 0.1, 1.5])
    picture.add_ball(10.0, ball_m)
    picture.add_ball(10.1, np.array([0.3, 0.0, 1.2]))
    picture.add_image(0.0, 10.0, BLACK)
    image = picture.newest(None)
    assert image.shape == (240, 320, 3)
    middle, half = drawn(image, BALL_RGB)
    np.testing.assert_allclose(middle, CAMERA.project(ball_m) / 2, atol=1.0)
    np.testing.assert_allclose(half, 300.0 * 0.03 / 1.2, atol=1.5)
    assert not image[tuple(np.round(middle).astype(int))[::-1]].any()  # the ball stays visible
    picture.add_image(0.0, 11.0, BLACK)  # the ball was not found in this one
    middle, half = drawn(picture.newest(target_m), TARGET_RGB)
    np.testing.assert_allclose(middle, CAMERA.project(target_m) / 2, atol=1.0)
    assert not BLACK.any()


@pytest.mark.parametrize("where_m", [[0.0, 0.0, -1.0], [9.0, 9.0, 0.06]])
def test_a_target_behind_the_camera_or_far_outside_is_not_drawn(picture, where_m):
    picture.add_image(0.0, 10.0, BLACK)
    assert not picture.newest(np.array(where_m)).any()
