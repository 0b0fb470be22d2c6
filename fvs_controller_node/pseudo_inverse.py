"""From a wanted feature velocity to joint velocities, and how well that is posed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dposv

from fvs_ros.vectors import largest

#: The pull towards the posture asks no joint for more than this, rad/s.
POSTURE_SPEED_RAD_S = 0.2


class Conditioning(NamedTuple):
    """How far a Jacobian is from singular.

    Attributes
    ----------
    smallest : float
        Smallest singular value: the slowest the feature moves, in its worst direction, for a unit
        of joint motion.
    condition : float
        Largest over smallest singular value; infinite when singular.
    """

    smallest: float
    condition: float


def conditioning(jacobian: np.ndarray) -> Conditioning:
    """Measure smallest singular value and condition number of a Jacobian, shape (m, n).

    Examples
    --------
    >>> conditioning(np.eye(3, 6))
    Conditioning(smallest=1.0, condition=1.0)
    """
    values = np.linalg.svd(jacobian, compute_uv=False).tolist()
    return Conditioning(values[-1], values[0] / values[-1] if values[-1] > 0.0 else float("inf"))


@dataclass(frozen=True)
class DampedInverse:
    """The damped pseudo inverse, with an optional pull towards a posture in its null space.

    ``rdot = J' (J J' + mu I)^-1 v + (I - J^+ J) gain (home - r)``

    Joints beyond those that the feature needs are left to drift. The posture term brings them back
    without moving the feature (to first order), at most ``POSTURE_SPEED_RAD_S`` a joint.

    Parameters
    ----------
    damping : float
        mu, m^2/rad^2. It slows the direction of singular value w by w^2 / (w^2 + mu).
    posture_gain_1_s : float
        Gain of the pull; 0 switches it off.
    """

    damping: float = 1e-4
    posture_gain_1_s: float = 0.0

    def joint_velocity(
        self,
        jacobian: np.ndarray,
        velocity: np.ndarray,
        joints_rad: np.ndarray | None = None,
        home_rad: np.ndarray | None = None,
    ) -> np.ndarray:
        """Joint velocities that move the feature as wanted.

        Parameters
        ----------
        jacobian : ndarray, shape (m, n)
            Estimated Jacobian, m/rad.
        velocity : ndarray, shape (m,)
            Wanted feature velocity, m/s.
        joints_rad, home_rad : ndarray, shape (n,), optional
            Present joints and the posture of the pull, rad; without either there is none.

        Returns
        -------
        ndarray, shape (n,)
            Joint velocities, rad/s.
        """
        if self.posture_gain_1_s == 0.0 or joints_rad is None or home_rad is None:
            return damped_solution(jacobian, velocity, self.damping)
        pull = self.posture_gain_1_s * (home_rad - joints_rad)
        pull *= min(1.0, POSTURE_SPEED_RAD_S / max(largest(pull), 1e-12))
        return pull + damped_solution(jacobian, velocity - jacobian @ pull, self.damping)


def damped_solution(jacobian: np.ndarray, velocity: np.ndarray, damping: float) -> np.ndarray:
    """Find ``J' (J J' + mu I)^-1 v``, shape (n,), of a Jacobian of shape (m, n).

    Straight from LAPACK: numpy's solver takes four times as long.
    """
    gram = jacobian @ jacobian.T
    # Beside a huge Jacobian mu would be lost to rounding, and Cholesky's factors with it.
    gram.flat[:: len(gram) + 1] += max(damping, 1e-14 * float(gram.trace()))
    return jacobian.T @ dposv(gram, velocity)[1]
