"""Pictures of red balls, cast ray by ray, and so exact."""

import numpy as np

from fvs_ros.camera import Intrinsics

VGA = Intrinsics(640, 480, 615.0, 615.0, 319.5, 239.5)
RADIUS_M = 0.04


def draw(spheres, camera=VGA, wall_m=2.0):
    """Red spheres, (centre, radius), m, before a grey wall: colours, depth, expected mask."""
    rays = camera.rays(*np.meshgrid(np.arange(camera.width), np.arange(camera.height)))
    length = np.linalg.norm(rays, axis=-1)
    rgb = np.full((camera.height, camera.width, 3), 150, np.uint8)
    depth = np.full((camera.height, camera.width), wall_m, np.float32)
    for centre, radius in spheres:
        along = rays @ np.asarray(centre) / length
        under_root = radius**2 - (np.dot(centre, centre) - along**2)
        near = (along - np.sqrt(np.maximum(under_root, 0.0))) / length
        visible = (under_root > 0.0) & (near < depth)
        shade = np.clip(255 * (0.4 + 0.6 * np.sqrt(np.maximum(under_root, 0.0)) / radius), 0, 255)
        rgb[visible] = np.stack([shade, 0.1 * shade, 0.1 * shade], axis=-1)[visible]
        depth[visible] = near[visible]
    return rgb, depth


def red(rgb):
    """Which pixels are a drawn ball's."""
    return rgb[..., 0] > 2.0 * rgb[..., 1]


def hide(rgb, depth, part, depth_m=0.8):
    """Hold a grey card before a part of the image."""
    rgb[part] = (120, 125, 130)
    depth[part] = depth_m
