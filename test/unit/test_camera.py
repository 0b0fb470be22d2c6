import numpy as np
import pytest

from fvs_ros.camera import Intrinsics

CAMERA = Intrinsics(640, 480, 615.0, 610.0, 319.5, 239.5)


def test_rays_undo_projection():
    points = np.random.default_rng(0).uniform([-1, -1, 0.5], [1, 1, 3], (100, 3))
    uv = CAMERA.project(points)
    np.testing.assert_allclose(CAMERA.rays(uv[:, 0], uv[:, 1]) * points[:, 2:], points, atol=1e-12)


def test_a_window_sees_the_same_point_at_shifted_pixels():
    point = np.array([0.1, -0.2, 1.3])
    window = CAMERA.window(100, 50, 96, 96)
    np.testing.assert_allclose(window.project(point), CAMERA.project(point) - [100, 50])
    assert (window.width, window.height) == (96, 96)


def test_bad_cameras_are_refused():
    with pytest.raises(ValueError, match="positive"):
        Intrinsics(640, 480, 0.0, 600.0, 320.0, 240.0)
    with pytest.raises(ValueError, match="finite"):
        Intrinsics(640, 480, 600.0, 600.0, float("nan"), 240.0)
    with pytest.raises(ValueError, match="size"):
        Intrinsics(0, 480, 600.0, 600.0, 320.0, 240.0)
