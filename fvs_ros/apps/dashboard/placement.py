"""Where the camera stands in the robot's base frame: told, or learned from the motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fvs_ros.apps.dashboard.registration import Registrar, Registration

#: A ball that is seen further than this from where it should be is a contradiction, m; so many of
#: them in a row, and the camera was moved.
_MOVED_M, _CONTRADICTIONS = 0.05, 6
#: Learned anew with every so many positions.
_EVERY = 3

UNKNOWN = "the camera's place is not known yet: it is learned while the arm moves"


@dataclass(frozen=True)
class Pose:
    """A frame seen from the robot's base.

    Parameters
    ----------
    rotation : ndarray, shape (3, 3)
        Its axes as columns.
    position_m : ndarray, shape (3,)
        Its origin, m.
    """

    rotation: np.ndarray
    position_m: np.ndarray


class CameraPlacement:
    """The camera's pose, as a simulator tells it, or as the arm's motion does."""

    def __init__(self) -> None:
        self._told: Pose | None = None
        self._registrar = Registrar()
        self._learned: Registration | None = None
        self._contradictions = 0
        self._count = 0

    @property
    def told(self) -> bool:
        """Whether somebody who knows has told it."""
        return self._told is not None

    @property
    def pose(self) -> Pose | None:
        """The camera's optical frame in the robot's base frame, or None."""
        if self._told is not None:
            return self._told
        if self._learned is None:
            return None
        return Pose(self._learned.rotation, self._learned.position_m)

    @property
    def note(self) -> str:
        """A sentence about it for a person, or empty."""
        if self._told is not None:
            return ""
        if self._learned is None:
            return UNKNOWN
        agree_mm = 1e3 * self._learned.error_m
        return f"the camera's place is learned: ball and arm agree to {agree_mm:.0f} mm"

    def tell(self, pose: Pose) -> None:
        """Take the word of who knows."""
        self._told = pose

    def add(self, flange: np.ndarray, ball_m: np.ndarray) -> None:
        """Learn from where flange and ball were at one time.

        Parameters
        ----------
        flange : ndarray, shape (4, 4)
            Pose of the flange in the base's frame, m.
        ball_m : ndarray, shape (3,)
            The ball in the camera's frame, m.
        """
        if self._learned is not None and self._contradicts(self._learned, flange, ball_m):
            self._contradictions += 1
            if self._contradictions < _CONTRADICTIONS:
                return  # perhaps a wrong detection
            self._registrar.reset()
            self._learned = None
        self._contradictions = 0
        self._registrar.add(flange, ball_m)
        self._count += 1
        if self._learned is None or self._count % _EVERY == 0:
            self._learned = self._registrar.solve()

    @staticmethod
    def _contradicts(known: Registration, flange: np.ndarray, ball_m: np.ndarray) -> bool:
        seen = known.rotation @ ball_m + known.position_m
        there = flange[:3, :3] @ known.ball_m + flange[:3, 3]
        return float(np.linalg.norm(seen - there)) > _MOVED_M
