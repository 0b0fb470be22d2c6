"""Pictures of tags, drawn through their homography with many samples a pixel."""

import cv2
import numpy as np
from drawn_balls import VGA

SIZE_M = 0.06
_CELL_PX, _SAMPLES = 60, 4


def dictionary(name="APRILTAG_36h11"):
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{name}"))


def corners_px(rotation, position_m, camera=VGA, size_m=SIZE_M):
    """Of a tag, clockwise from the upper left, (4, 2)."""
    corners_m = 0.5 * size_m * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])
    return camera.project(corners_m @ rotation.T + position_m)


def random_pose(rng, most_tilt_rad=1.1, camera=VGA):
    """A tag in view that looks at the camera: its rotation and position, m."""
    tilt, direction_rad, spin = rng.uniform(0.0, most_tilt_rad), *rng.uniform(0.0, 2 * np.pi, 2)
    facing = np.diag([1.0, -1.0, -1.0]) @ cv2.Rodrigues(np.array([0.0, 0.0, spin]))[0]
    rotation = (
        cv2.Rodrigues(tilt * np.array([np.cos(direction_rad), np.sin(direction_rad), 0.0]))[0]
        @ facing
    )
    z = rng.uniform(0.4, 1.2)
    room = 0.8 * np.array([camera.width / camera.fx, camera.height / camera.fy]) / 2.0
    return rotation, z * np.append(rng.uniform(-room, room), 1.0)


def draw(
    tags, camera=VGA, size_m=SIZE_M, name="APRILTAG_36h11", noise=2.0, mirrored=False, rng=None
):
    """Tags, (number, rotation, position in m), before a grey wall: an RGB image."""
    several = _SAMPLES
    shape = several * camera.height, several * camera.width
    picture = np.full(shape, 150, np.uint8)
    for number, rotation, position_m in tags:
        cells = dictionary(name).markerSize + 2
        texture = cv2.aruco.generateImageMarker(dictionary(name), number, cells * _CELL_PX)
        texture = texture[:, ::-1] if mirrored else texture
        texture = cv2.copyMakeBorder(texture, *4 * [_CELL_PX], cv2.BORDER_CONSTANT, value=255)
        m_px = size_m / (cells * _CELL_PX)
        first = 0.5 * size_m + (_CELL_PX - 0.5) * m_px  # from the middle to the first pixel's, m
        to_tag = np.array([[m_px, 0, -first], [0, -m_px, first], [0, 0, 1]])
        pinhole = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
        finer = np.array(
            [[several, 0, (several - 1) / 2], [0, several, (several - 1) / 2], [0, 0, 1]]
        )
        to_picture = finer @ pinhole @ np.column_stack([rotation[:, :2], position_m]) @ to_tag
        cv2.warpPerspective(
            texture, to_picture, shape[::-1], dst=picture, borderMode=cv2.BORDER_TRANSPARENT
        )
    grey = cv2.resize(picture, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    grey = 20.0 + 0.7 * cv2.GaussianBlur(grey.astype(float), (0, 0), 0.6)
    if noise:
        grey += (rng or np.random.default_rng(0)).normal(0.0, noise, grey.shape)
    return np.repeat(np.clip(grey, 0, 255).astype(np.uint8)[..., None], 3, axis=2)
