"""Where the camera stands, from flange poses and ball positions: to draw by, never to control by.

With the flange at ``p``, turned by ``A``, a ball ``b`` on the flange is seen at ``x``:
``Q x + u = p + A b`` where Q and u take the camera's frame to the robot's base. Multiplied by
``A'`` that is linear in the fifteen numbers Q, u and b, so that normal equations with a memory
do, and the nearest rotation is taken from the solution; u and b follow from the rotation once more.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp

import numpy as np

#: Ball positions after which an old one has lost 63 % of its say.
_MEMORY = 600.0
#: A flange that has moved less than this since the last position that was taken teaches nothing
#: new: m, and as the change of its rotation matrix.
_STEP_M, _STEP_TURN = 0.01, 0.03
#: Fewer positions than this, or a smallest eigenvalue over the largest below, are not enough.
_FEWEST, _CONDITION = 12, 1e-6
#: A camera whose view is off by more than this is not known yet, m.
_LARGEST_ERROR_M = 0.03


@dataclass(frozen=True)
class Registration:
    """The camera seen from the robot's base: ``p_base = rotation @ p_camera + position_m``.

    Parameters
    ----------
    rotation : ndarray, shape (3, 3)
        Axes of the camera's optical frame as columns.
    position_m : ndarray, shape (3,)
        Its centre, m.
    ball_m : ndarray, shape (3,)
        The ball in the flange's frame, m.
    error_m : float
        Root mean square distance of the positions taken from where this puts them, m.
    """

    rotation: np.ndarray
    position_m: np.ndarray
    ball_m: np.ndarray
    error_m: float


class Registrar:
    """Learns the camera's pose while the arm moves."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget everything (the camera was moved)."""
        self._normal = np.zeros((15, 15))
        self._right = np.zeros(15)
        self._square = 0.0
        self._weight = 0.0
        self._count = 0
        self._last: np.ndarray | None = None

    def add(self, flange: np.ndarray, ball_m: np.ndarray) -> None:
        """Tell where flange and ball were at one time.

        Parameters
        ----------
        flange : ndarray, shape (4, 4)
            Pose of the flange in the base's frame, m.
        ball_m : ndarray, shape (3,)
            The ball in the camera's frame, m.
        """
        if self._last is not None:
            moved = np.abs(flange - self._last)
            if moved[:3, 3].max() < _STEP_M and moved[:3, :3].max() < _STEP_TURN:
                return
        self._last = np.array(flange)
        turn, position = flange[:3, :3], flange[:3, 3]
        # A' Q x + A' u - b = A' p
        rows = np.hstack([np.kron(ball_m[None], turn.T), turn.T, -np.eye(3)])
        wanted = turn.T @ position
        keep = exp(-1.0 / _MEMORY)
        self._normal = keep * self._normal + rows.T @ rows
        self._right = keep * self._right + rows.T @ wanted
        self._square = keep * self._square + float(wanted @ wanted)
        self._weight = keep * self._weight + 1.0
        self._count += 1

    def solve(self) -> Registration | None:
        """The camera's pose, or None while the motion does not tell it."""
        if self._count < _FEWEST:
            return None
        values = np.linalg.eigvalsh(self._normal)
        if values[0] < _CONDITION * values[-1]:
            return None
        free = np.linalg.solve(self._normal, self._right)
        # Q stands column by column, for kron(x', A').
        left, _, right = np.linalg.svd(free[:9].reshape(3, 3).T)
        rotation = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
        fixed = rotation.T.reshape(-1)
        rest = np.linalg.solve(self._normal[9:, 9:], self._right[9:] - self._normal[9:, :9] @ fixed)
        solution = np.concatenate([fixed, rest])
        square = (
            self._square
            - 2.0 * float(solution @ self._right)
            + float(solution @ self._normal @ solution)
        )
        error_m = max(square, 0.0) ** 0.5 / self._weight**0.5
        if error_m > _LARGEST_ERROR_M:
            return None
        return Registration(rotation, rest[:3], rest[3:], error_m)
