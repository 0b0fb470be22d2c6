"""From a wanted ball velocity to joint velocities, and how well that is posed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import sqrt
from typing import Any, ClassVar, NamedTuple

import numpy as np

from fvs_ros.joints import HOME_JOINTS_RAD, N_JOINTS
from fvs_ros.params import Parameter

#: The posture term never asks for more than this of any joint, rad/s.
POSTURE_SPEED_RAD_S = 0.2

_NO_POSTURE = (0.0,) * N_JOINTS


class Conditioning(NamedTuple):
    """How far a Jacobian is from singular.

    Attributes
    ----------
    smallest : float
        Smallest singular value, m/rad: the slowest the ball moves, in its worst direction,
        for a unit of joint motion.
    condition : float
        Largest over smallest singular value; infinite when singular.
    """

    smallest: float
    condition: float


def conditioning(jacobian: np.ndarray) -> Conditioning:
    """Measure smallest singular value and condition number of a (3, 6) Jacobian.

    Examples
    --------
    >>> conditioning(np.eye(3, 6))
    Conditioning(smallest=1.0, condition=1.0)
    """
    values = np.linalg.svd(jacobian, compute_uv=False)
    largest, smallest = float(values[0]), float(values[-1])
    return Conditioning(smallest, largest / smallest if smallest > 0.0 else float("inf"))


@dataclass(frozen=True)
class DampedInverse:
    """The damped pseudo inverse, with an optional pull towards a posture in its null space.

    ``rdot = J' (J J' + mu I)^-1 v + (I - J^+ J) gain (posture - r)``

    Six joints move a point, so three degrees of freedom are left to drift. The posture term
    brings the arm back without moving the ball (to first order), at most
    ``POSTURE_SPEED_RAD_S`` a joint.

    Parameters
    ----------
    damping : float
        mu, m^2/rad^2. It slows the direction of singular value w by w^2 / (w^2 + mu).
    posture_gain : float
        Gain of the pull, 1/s; 0 switches it off.
    posture_rad : tuple of 6 float
        The posture, rad.
    """

    damping: float = 1e-4
    posture_gain: float = 0.0
    posture_rad: tuple[float, ...] = _NO_POSTURE

    def __post_init__(self) -> None:
        if not 0.0 < self.damping < np.inf:
            raise ValueError(f"damping must be positive, got {self.damping}")
        if not 0.0 <= self.posture_gain < np.inf:
            raise ValueError(f"posture_gain must not be negative, got {self.posture_gain}")
        if len(self.posture_rad) != N_JOINTS:
            raise ValueError(f"the posture needs {N_JOINTS} joints, got {self.posture_rad}")

    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (
        Parameter(
            "damping",
            1e-4,
            "Damping mu of the pseudo inverse J' (J J' + mu I)^-1, m^2/rad^2.",
            1e-12,
            1.0,
            live=True,
        ),
        Parameter(
            "posture_gain_1_s",
            0.0,
            "Pull towards posture_rad that does not move the ball, with allocation two_norm, 1/s; "
            "0 is off.",
            0.0,
            5.0,
            live=True,
        ),
        Parameter(
            "posture_rad",
            list(HOME_JOINTS_RAD),
            "Posture of the pull, kinematic order, rad; the middle of the training box.",
            -2.0 * np.pi,
            2.0 * np.pi,
            size=N_JOINTS,
            live=True,
        ),
    )

    @classmethod
    def from_values(cls, values: Mapping[str, Any]) -> DampedInverse:
        """Build the inverse with the gains in ``values``, by parameter name."""
        return cls(values["damping"], values["posture_gain_1_s"], tuple(values["posture_rad"]))

    def joint_velocity(
        self,
        jacobian: np.ndarray,
        velocity_m_s: np.ndarray,
        joints_rad: np.ndarray | None = None,
        _home_rad: np.ndarray | None = None,
    ) -> np.ndarray:
        """Joint velocities that move the ball as wanted.

        Parameters
        ----------
        jacobian : ndarray, shape (3, 6)
            Estimated Jacobian, m/rad.
        velocity_m_s : ndarray, shape (3,)
            Wanted ball velocity, m/s.
        joints_rad : ndarray, shape (6,), optional
            Present joints, rad; without them there is no posture term.
        _home_rad : ndarray, shape (6,), optional
            Not used: only the posture of the parameters counts, as long as there is a gain.

        Returns
        -------
        ndarray, shape (6,)
            Joint velocities, rad/s.
        """
        if self.posture_gain == 0.0 or joints_rad is None:
            return damped_solution(jacobian, velocity_m_s, self.damping)
        pull = self.posture_gain * (np.asarray(self.posture_rad) - joints_rad)
        pull *= min(1.0, POSTURE_SPEED_RAD_S / max(float(np.abs(pull).max()), 1e-12))
        return pull + damped_solution(jacobian, velocity_m_s - jacobian @ pull, self.damping)


def damped_solution(jacobian: np.ndarray, velocity_m_s: np.ndarray, damping: float) -> np.ndarray:
    """Find ``J' (J J' + mu I)^-1 v``, shape (6,), of a (3, 6) Jacobian.

    By Cholesky's factors in plain numbers: for three equations a tenth of the time of a call of
    numpy's solver. No pivot is below mu but for rounding.
    """
    (a, _, _), (b, c, _), (d, e, f) = (jacobian @ jacobian.T).tolist()
    x, y, z = velocity_m_s.tolist()
    l11 = sqrt(a + damping)
    l21, l31 = b / l11, d / l11
    l22 = sqrt(max(c + damping - l21 * l21, damping))
    l32 = (e - l31 * l21) / l22
    l33_squared = max(f + damping - l31 * l31 - l32 * l32, damping)
    x /= l11
    y = (y - l21 * x) / l22
    z = (z - l31 * x - l32 * y) / l33_squared
    y = (y - l32 * z) / l22
    x = (x - l21 * y - l31 * z) / l11
    return jacobian.T @ np.array((x, y, z))
