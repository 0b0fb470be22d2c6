"""A tag far from the axis of a wide lens, where its rectified image has no room for it."""

import cv2
import numpy as np
from drawn_tags import SIZE_M, draw

from fvs_detector_node.config import DetectorConfig
from fvs_detector_node.detector import annotate
from fvs_detector_node.tag_detector import TagDetector
from fvs_detector_node.tags import Tag
from fvs_ros.camera import Intrinsics, camera_model
from fvs_ros.rotations import rotation_angle_rad

_FISHEYE_PX = 640.0 / np.radians(80.0)


def fisheye_image(rotation, position_m, side):
    """A tag as an equidistant lens of 160 degrees shows it: drawn by a pinhole that looks at it."""
    camera = camera_model(
        1280, 960, [_FISHEYE_PX, 0, 639.5, 0, _FISHEYE_PX, 479.5, 0, 0, 1], "fisheye", [0.0] * 5
    )
    finer = Intrinsics(1600, 1200, 3.0 * _FISHEYE_PX, 3.0 * _FISHEYE_PX, 799.5, 599.5)
    picture = draw([(7, side @ rotation, side @ position_m)], finer, SIZE_M, noise=0.0)
    view = camera.intrinsics
    u, v = np.meshgrid(np.arange(view.width), np.arange(view.height))
    x, y = (u - view.cx) / view.fx, (v - view.cy) / view.fy
    angle = np.hypot(x, y)
    scale = np.sin(angle) / np.maximum(angle, 1e-9)
    rays = np.stack([x * scale, y * scale, np.cos(angle)], axis=-1) @ side.T
    behind = rays[..., 2] < 0.1
    at = finer.project(np.where(behind[..., None], [0.0, 0.0, 1.0], rays)).astype(np.float32)
    at[behind] = -1.0
    shown = cv2.remap(
        picture, at, None, cv2.INTER_AREA, borderMode=cv2.BORDER_CONSTANT, borderValue=(120,) * 3
    )
    return cv2.GaussianBlur(shown, (0, 0), 0.7), camera


def test_a_tag_60_degrees_from_the_axis_of_a_wide_lens_is_seen():
    side = cv2.Rodrigues(np.radians(60.0) * np.array([-0.4, -0.9, 0.0]) / np.hypot(0.4, 0.9))[0]
    facing = cv2.Rodrigues(np.array([0.4, 0.3, 0.0]))[0] @ np.diag([1.0, -1.0, -1.0])
    rotation, position_m = side.T @ facing, side.T @ np.array([0.0, 0.0, 0.35])
    picture, camera = fisheye_image(rotation, position_m, side)
    detector = TagDetector(DetectorConfig(feature="pose", tag=Tag(tag_id=7, tag_size_m=SIZE_M)))
    for stamp_s in (0.0, 0.03):
        sighting = detector.look(stamp_s, picture, None, camera)
        assert sighting.problem == ""
        assert np.linalg.norm(sighting.found.position_m - position_m) < 2e-3
        assert rotation_angle_rad(sighting.found.rotation.T @ rotation) < 0.02
    assert annotate(detector.rectified(picture, camera), sighting, camera.intrinsics).any()
    # A tag ahead is seen as well, and by a lens that sees little beyond there is nothing else.
    nothing = np.full_like(picture, 120)
    assert "is not in view" in detector.look(1.0, nothing, None, camera).problem
