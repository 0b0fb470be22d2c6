"""What a step of the simulation gives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fvs_detector_node.detection import BallDetection
from fvs_sim_node.depth_noise import add_depth_noise
from fvs_sim_node.rendering import CameraPose, Renderer


@dataclass(frozen=True)
class BallObservation:
    """What one image gave.

    Parameters
    ----------
    stamp_s : float
        Exposure, s.
    detection : BallDetection or None
        The ball as detected in the image; None if it was not seen.
    true_position_m : ndarray, shape (3,)
        Where it was, camera frame, m. For evaluation only.
    joints_rad : ndarray, shape (n,)
        Joint angles at the exposure, rad.
    camera : CameraPose
        Where the camera was.
    covered : bool
        Whether the lens was covered.
    frame : Frame or None
        The image, if full frames are wanted.
    """

    stamp_s: float
    detection: BallDetection | None
    true_position_m: np.ndarray
    joints_rad: np.ndarray
    camera: CameraPose
    covered: bool = False
    frame: Frame | None = None


@dataclass(frozen=True)
class Frame:
    """A full image with its noisy depth.

    Parameters
    ----------
    stamp_s : float
        Exposure, s.
    rgb : ndarray of uint8, shape (H, W, 3)
        Colours.
    depth_m : ndarray of float32, shape (H, W)
        Depth along the optical axis, m; 0 where there is none.
    """

    stamp_s: float
    rgb: np.ndarray
    depth_m: np.ndarray

    @classmethod
    def of(
        cls, seen: BallObservation, renderer: Renderer, rng: np.random.Generator, depth_noise: float
    ) -> Frame:
        """Draw the image of an exposure; the world must be as it was then."""
        camera = renderer.intrinsics
        if seen.covered:
            shape = (camera.height, camera.width)
            return cls(seen.stamp_s, np.zeros((*shape, 3), np.uint8), np.zeros(shape, np.float32))
        rgb, depth_m = renderer.render(seen.camera)
        return cls(seen.stamp_s, rgb, add_depth_noise(depth_m, camera.fx, rng, depth_noise))


@dataclass(frozen=True)
class SimStep:
    """The world after one joint-state period.

    Parameters
    ----------
    time_s : float
        Simulated time, s.
    joints_rad, joint_velocities_rad_s : ndarray, shape (n,)
        Joint angles, as the encoders report them, and velocities now, kinematic order.
    observations : tuple of BallObservation
        Those that were released during this period.
    """

    time_s: float
    joints_rad: np.ndarray
    joint_velocities_rad_s: np.ndarray
    observations: tuple[BallObservation, ...]
