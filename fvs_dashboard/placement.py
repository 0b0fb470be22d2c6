"""Where the camera stands in the robot's base frame: told, or learned from the motion.

It is to draw by, never to control by. With the flange at ``p``, turned by ``A``, a ball ``b`` on
the flange is seen at ``x``: ``Q x + u = p + A b`` where Q and u take the camera's frame to the
robot's base. Multiplied by ``A'`` that is linear in the fifteen numbers Q, u and b. The nearest
rotation is taken from the least squares solution; u and b follow from the rotation once more.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

#: Ball positions that are remembered, the fewest that are enough, and how often they are used.
_MEMORY, _FEWEST, _EVERY = 300, 12, 3
#: A flange that has moved less than this teaches nothing new: m, and as the change of its rotation.
_STEP_M, _STEP_TURN = 0.01, 0.03
#: Smallest singular value over the largest that tells all fifteen numbers.
_CONDITION = 1e-3
#: A camera whose view is off by more than this is not known yet, m.
_LARGEST_ERROR_M = 0.03
#: A ball seen further than this from where it should be is a contradiction, m; after so many in a
#: row, the camera was moved.
_MOVED_M, _CONTRADICTIONS = 0.05, 6

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
    """The camera's pose, as a simulator tells it, or as the arm's motion does.

    Attributes
    ----------
    told : bool
        Whether somebody who knows has told it.
    pose : Pose or None
        The camera's optical frame in the robot's base frame.
    note : str
        A sentence about it for a person, or empty.
    """

    def __init__(self) -> None:
        self.told = False
        self.pose: Pose | None = None
        self.note = UNKNOWN
        self._ball_m = np.zeros(3)  # in the flange's frame
        self._pairs: deque[tuple[np.ndarray, np.ndarray]] = deque(maxlen=_MEMORY)
        self._contradictions = 0
        self._count = 0

    def tell(self, pose: Pose) -> None:
        """Take the word of who knows."""
        self.told, self.pose, self.note = True, pose, ""

    def add(self, flange: np.ndarray, ball_m: np.ndarray) -> None:
        """Learn from where flange and ball were at one time.

        Parameters
        ----------
        flange : ndarray, shape (4, 4)
            Pose of the flange in the base's frame, m.
        ball_m : ndarray, shape (3,)
            The ball in the camera's frame, m.
        """
        if self.pose is not None:
            seen = self.pose.rotation @ ball_m + self.pose.position_m
            there = flange[:3, :3] @ self._ball_m + flange[:3, 3]
            if np.linalg.norm(seen - there) > _MOVED_M:
                self._contradictions += 1
                if self._contradictions < _CONTRADICTIONS:
                    return  # perhaps a wrong detection
                self._pairs.clear()
                self.pose, self.note = None, UNKNOWN
        self._contradictions = 0
        if self._pairs:
            moved = np.abs(flange - self._pairs[-1][0])
            if moved[:3, 3].max() < _STEP_M and moved[:3, :3].max() < _STEP_TURN:
                return
        self._pairs.append((np.array(flange), ball_m))
        self._count += 1
        if len(self._pairs) >= _FEWEST and self._count % _EVERY == 0:
            self._solve()

    def _solve(self) -> None:
        """Find the camera's pose, or none while the motion does not tell it."""
        flanges, balls_m = (np.array(part) for part in zip(*self._pairs, strict=True))
        turns = flanges[:, :3, :3].transpose(0, 2, 1)
        # A' Q x + A' u - b = A' p, with Q column by column.
        by_rotation = np.einsum("nj,nik->nijk", balls_m, turns).reshape(len(turns), 3, 9)
        minus = np.broadcast_to(-np.eye(3), turns.shape)
        rows = np.concatenate([by_rotation, turns, minus], axis=2).reshape(-1, 15)
        wanted = np.einsum("nik,nk->ni", turns, flanges[:, :3, 3]).reshape(-1)
        free, _, _, sizes = np.linalg.lstsq(rows, wanted, rcond=None)
        left, _, right = np.linalg.svd(free[:9].reshape(3, 3).T)
        rotation = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
        left_over = wanted - rows[:, :9] @ rotation.T.reshape(-1)
        rest = np.linalg.lstsq(rows[:, 9:], left_over, rcond=None)[0]
        off_m = (left_over - rows[:, 9:] @ rest).reshape(-1, 3)
        error_m = float(np.sqrt((off_m**2).sum(axis=1).mean()))
        if sizes[-1] < _CONDITION * sizes[0] or error_m > _LARGEST_ERROR_M:
            self.pose, self.note = None, UNKNOWN
            return
        self.pose, self._ball_m = Pose(rotation, rest[:3]), rest[3:]
        self.note = f"the camera's place is learned: ball and arm agree to {1e3 * error_m:.0f} mm"
