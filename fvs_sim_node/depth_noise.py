"""Noise of a stereo depth camera (Intel RealSense D435) on an ideal depth image.

The spread follows Intel's tuning guide for the D400 family: subpixel * z^2 / (f * baseline).
"""

from __future__ import annotations

import cv2
import numpy as np

#: Standard deviation of the disparity, pixels, and distance between the two imagers, m.
SUBPIXEL_PX, BASELINE_M = 0.08, 0.05
#: Part of the variance that neighbouring pixels share.
CORRELATED = 0.25
#: Depth is reported in steps of this size, m.
STEP_M = 0.001
#: Probabilities that a pixel has no depth: anywhere, and where the depth within its 3 x 3
#: neighbourhood spans more than a jump, m.
DROPOUT, EDGE_LOSS, EDGE_JUMP_M = 0.01, 0.5, 0.05

_KERNEL = np.ones((3, 3), np.uint8)


def add_depth_noise(
    depth_m: np.ndarray, fx: float, rng: np.random.Generator, scale: float = 1.0
) -> np.ndarray:
    """Turn a depth image into what a real camera would report.

    Parameters
    ----------
    depth_m : ndarray of float32, shape (H, W)
        Ideal depth along z, m; 0 where there is none.
    fx : float
        Focal length, pixels.
    rng : numpy.random.Generator
        Source of the noise.
    scale : float
        Factor on the spread and on the probabilities of loss; 0 gives a plain copy.

    Returns
    -------
    ndarray of float32, shape (H, W)
        Noisy depth, m; 0 where there is none.
    """
    depth = np.array(depth_m, dtype=np.float32)
    if scale <= 0.0:
        return depth
    lost = depth <= 0.0
    edge = cv2.dilate(depth, _KERNEL) - cv2.erode(depth, _KERNEL) > EDGE_JUMP_M

    noise = rng.standard_normal(depth.shape, dtype=np.float32)
    noise *= np.float32(np.sqrt(1.0 - CORRELATED))
    # The mean of 3 x 3 unit normals has a standard deviation of 1/3.
    shared = cv2.blur(rng.standard_normal(depth.shape, dtype=np.float32), (3, 3))
    shared *= np.float32(3.0 * np.sqrt(CORRELATED))
    noise += shared
    noise *= np.float32(SUBPIXEL_PX / (fx * BASELINE_M)) * np.square(depth)
    noise *= np.float32(scale)
    depth += noise
    depth *= np.float32(1.0 / STEP_M)
    np.rint(depth, out=depth)
    depth *= np.float32(STEP_M)

    luck = rng.random(depth.shape, dtype=np.float32)
    lost |= luck < np.float32(scale * DROPOUT)
    lost |= edge & (luck < np.float32(scale * EDGE_LOSS))
    lost |= depth < 0.0
    depth[lost] = 0.0
    return depth
