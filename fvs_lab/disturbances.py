"""What disturbs a run: noise with heavy tails, a blow to the camera, a camera carried round."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from fvs_sim_node.rendering import CameraPose, camera_preset
from fvs_sim_node.simulation import Simulation

#: Exponent of noise without heavy tails.
WHITE = 2.0
#: No error of a coordinate is larger than this, m: the detection knows the size of the ball.
_LARGEST_ERROR_M = 0.1


@dataclass(frozen=True)
class StableNoise:
    """Symmetric alpha-stable errors of a ball position, by Chambers, Mallows and Stuck.

    Parameters
    ----------
    scale_m : float
        Standard deviation at exponent 2, m; with less, the bulk is as wide and the tails heavy.
    exponent : float
        Above 1, up to 2 (white, normally distributed).
    """

    scale_m: float
    exponent: float

    def __call__(self, rng: np.random.Generator) -> np.ndarray:
        """Draw the errors of the three coordinates, cut off where no camera errs that far, m."""
        alpha = self.exponent
        angle = rng.uniform(-0.5 * np.pi, 0.5 * np.pi, 3)
        waiting = rng.exponential(size=3)
        spread = (np.cos((1.0 - alpha) * angle) / waiting) ** ((1.0 - alpha) / alpha)
        draw = np.sin(alpha * angle) / np.cos(angle) ** (1.0 / alpha) * spread
        error_m = self.scale_m / np.sqrt(2.0) * draw
        return np.clip(error_m, -_LARGEST_ERROR_M, _LARGEST_ERROR_M)


@dataclass(frozen=True)
class Bump:
    """A blow to the camera in mid-run.

    The target is given anew at once, where it is for the camera now; nothing else is told.

    Parameters
    ----------
    time_s : float
        After the target was given, s.
    rotation_deg : tuple of 3 float
        Rotation vector about the camera's own centre, camera frame, degrees.
    translation_m : tuple of 3 float
        In the world frame, m.
    """

    time_s: float
    rotation_deg: tuple[float, float, float]
    translation_m: tuple[float, float, float]

    def divided(self, parts: int) -> Bump:
        """One of several equal blows that add up to this one."""
        (a, b, c), (x, y, z) = self.rotation_deg, self.translation_m
        return replace(
            self,
            rotation_deg=(a / parts, b / parts, c / parts),
            translation_m=(x / parts, y / parts, z / parts),
        )

    def strike(self, simulation: Simulation) -> None:
        """Move the camera."""
        simulation.rotate_camera(np.radians(self.rotation_deg))
        simulation.move_camera(self.translation_m)


def carried_camera(turn_rad: np.ndarray) -> CameraPose:
    """The front camera, carried round the scene by a rotation vector in its own frame, rad.

    The Jacobian turns with it; the ball stays in view, which a mere turn by 30 degrees on the
    spot would not allow.
    """
    camera = camera_preset("front")
    local = cv2.Rodrigues(np.asarray(turn_rad, dtype=float).reshape(3, 1))[0]
    turn = camera.rotation @ local @ camera.rotation.T
    return CameraPose(_SCENE_M + turn @ (camera.position_m - _SCENE_M), camera.rotation @ local)


#: What the camera looks at: about where the ball is at home, world frame, m.
_SCENE_M = np.array([-0.47, -0.1, 0.33])
