"""Noise of a stereo depth camera (Intel RealSense D435) on an ideal depth image."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np


@dataclass(frozen=True)
class DepthNoiseConfig:
    """Constants of the noise.

    The spread follows Intel's tuning guide for the D400 family: subpixel_px * z^2 / (f * baseline).

    Parameters
    ----------
    subpixel_px : float
        Standard deviation of the disparity, pixels.
    baseline_m : float
        Distance between the two imagers, m.
    correlated : float
        Part of the variance that neighbouring pixels share, 0 to 1.
    step_m : float
        Depth is reported in steps of this size, m.
    dropout : float
        Probability that a pixel has no depth.
    edge_loss : float
        Probability that a pixel at a depth edge has no depth.
    edge_jump_m : float
        A pixel is at an edge if the depth within its 3 x 3 neighbourhood spans more than this, m.
    """

    subpixel_px: float = 0.08
    baseline_m: float = 0.05
    correlated: float = 0.25
    step_m: float = 0.001
    dropout: float = 0.01
    edge_loss: float = 0.5
    edge_jump_m: float = 0.05

    def sigma_m(self, depth_m: np.ndarray, fx: float) -> np.ndarray:
        """Give the standard deviation of the depth, m, at depths in m and focal length in px."""
        factor = np.float32(self.subpixel_px / (fx * self.baseline_m))
        return factor * np.square(depth_m)


_KERNEL = np.ones((3, 3), np.uint8)


def add_depth_noise(
    depth_m: np.ndarray,
    fx: float,
    rng: np.random.Generator,
    scale: float = 1.0,
    config: DepthNoiseConfig | None = None,
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
    config : DepthNoiseConfig, optional
        Constants; default a D435.

    Returns
    -------
    ndarray of float32, shape (H, W)
        Noisy depth, m; 0 where there is none.
    """
    depth = np.array(depth_m, dtype=np.float32)
    if scale <= 0.0:
        return depth
    cfg = config or DepthNoiseConfig()
    lost = depth <= 0.0
    edge = cv2.dilate(depth, _KERNEL) - cv2.erode(depth, _KERNEL) > cfg.edge_jump_m

    noise = rng.standard_normal(depth.shape, dtype=np.float32)
    noise *= np.float32(np.sqrt(1.0 - cfg.correlated))
    # The mean of 3 x 3 unit normals has a standard deviation of 1/3.
    shared = cv2.blur(rng.standard_normal(depth.shape, dtype=np.float32), (3, 3))
    shared *= np.float32(3.0 * np.sqrt(cfg.correlated))
    noise += shared
    noise *= cfg.sigma_m(depth, fx)
    noise *= np.float32(scale)
    depth += noise
    depth *= np.float32(1.0 / cfg.step_m)
    np.rint(depth, out=depth)
    depth *= np.float32(cfg.step_m)

    luck = rng.random(depth.shape, dtype=np.float32)
    lost |= luck < np.float32(scale * cfg.dropout)
    lost |= edge & (luck < np.float32(scale * max(cfg.edge_loss, cfg.dropout)))
    lost |= depth < 0.0
    depth[lost] = 0.0
    return depth
