"""Where the camera stands in the robot's base frame: told, or learned from the motion.

It is to draw by, never to control by. With the flange at ``p``, turned by ``A``, a ball ``b`` on
the flange is seen at ``x``: ``Q x + u = p + A b``, where Q and u take the camera's frame to the
robot's base. Multiplied by ``A'`` that is linear in the fifteen numbers Q, u and b: least squares
gives the ball b. The rotation that best turns what was seen to where it was gives Q and u.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from scipy.spatial.transform import Rotation

#: Ball positions that are remembered, and the fewest that are enough.
_MEMORY, _FEWEST = 300, 12
#: A flange that moved less than this adds nothing: m, and as the change of its rotation.
_STEP_M, _STEP_TURN = 0.01, 0.03
#: Smallest singular value over the largest that determines all fifteen numbers.
_CONDITION = 1e-3
#: A ball further than this from where it should be is an outlier, m; after six in a row the
#: camera was moved. A pose with a larger median error is none.
_OUTLIER_M, _OUTLIERS = 0.05, 6

UNKNOWN = "the camera's place is not known yet: it is learned while the arm moves"


class CameraPlacement:
    """The camera's pose, as a simulator tells it, or as the arm's motion does.

    Attributes
    ----------
    told : bool
        Whether it was told, not learned.
    pose : ndarray, shape (4, 4), or None
        The camera's optical frame in the robot's base frame, m.
    note : str
        A sentence about it for a person, or empty.
    """

    def __init__(self) -> None:
        self.told = False
        self.pose: np.ndarray | None = None
        self.note = UNKNOWN
        self._pairs: deque[tuple[np.ndarray, np.ndarray]] = deque(maxlen=_MEMORY)
        self._ball_m = np.zeros(3)  # in the flange's frame
        self._outliers = 0

    def tell(self, pose: np.ndarray) -> None:
        """Take a pose from a node that knows it."""
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
            seen_m = self.pose[:3, :3] @ ball_m + self.pose[:3, 3]
            there_m = flange[:3, :3] @ self._ball_m + flange[:3, 3]
            self._outliers += 1
            if np.linalg.norm(seen_m - there_m) < _OUTLIER_M:
                self._outliers = 0
            elif self._outliers < _OUTLIERS:
                return
            else:
                self._pairs.clear()
                self.pose, self.note = None, UNKNOWN
        if self._pairs:
            moved = np.abs(flange - self._pairs[-1][0])
            if moved[:3, 3].max() < _STEP_M and moved[:3, :3].max() < _STEP_TURN:
                return
        self._pairs.append((flange, ball_m))
        if len(self._pairs) >= _FEWEST:
            self._solve()

    def _solve(self) -> None:
        """Find the camera's pose, or none while the motion does not determine it."""
        flanges, seen_m = (np.array(part) for part in zip(*self._pairs, strict=True))
        turns, origins_m = flanges[:, :3, :3], flanges[:, :3, 3]
        back = turns.transpose(0, 2, 1)
        # A' Q x + A' u - b = A' p, with Q column by column.
        rows = np.concatenate(
            [
                np.einsum("nj,nik->nijk", seen_m, back).reshape(len(turns), 3, 9),
                back,
                np.broadcast_to(-np.eye(3), turns.shape),
            ],
            axis=2,
        ).reshape(-1, 15)
        wanted = np.einsum("nik,nk->ni", back, origins_m).reshape(-1)
        free, _, _, sizes = np.linalg.lstsq(rows, wanted, rcond=None)
        where_m = origins_m + turns @ free[12:]
        rotation, _ = Rotation.align_vectors(
            where_m - where_m.mean(axis=0), seen_m - seen_m.mean(axis=0)
        )
        pose = np.eye(4)
        pose[:3, :3] = rotation.as_matrix()
        pose[:3, 3] = where_m.mean(axis=0) - pose[:3, :3] @ seen_m.mean(axis=0)
        off_m = np.linalg.norm(seen_m @ pose[:3, :3].T + pose[:3, 3] - where_m, axis=1)
        error_m = np.median(off_m)
        self.pose, self.note, self._ball_m = None, UNKNOWN, free[12:]
        if sizes[-1] > _CONDITION * sizes[0] and error_m < _OUTLIER_M:
            self.pose = pose
            self.note = (
                f"the camera's place is learned: ball and arm agree to {1e3 * error_m:.0f} mm"
            )
