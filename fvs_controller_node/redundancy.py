"""Redundancy resolution: from a wanted feature velocity to joint velocities.

The damped pseudo inverse minimises the sum of squares, but each joint has its own limit: one joint
may saturate while others could help. Minimising the largest speed is a linear programme. A small
weight on the sum of squares makes its solution unique and smooth in the Jacobian,

    minimise t^2 + eps^2 |u|^2  subject to  J u = v,  |u_i| <= t,

a least distance problem (t, and u in the null space of J), which Lawson and Hanson's non-negative
least squares solves (Solving Least Squares Problems, ch. 23). Where a joint nears an end of its
range, the solution blends into a pseudo inverse that uses only a share of that joint. The other
joints compensate for most of what it leaves out of ``v``. If the target is out of their reach, they
do not speed up without bound.

None of this holds the null space of the feature. From target to target the joints would drift until
the wrist hides the ball. So the sum of squares may be measured from a motion ``p`` back to a
posture,

    minimise t^2 + eps^2 |u - p|^2.

``p`` is as fast as the wanted motion and slower near the posture. It costs hardly any speed, and is
zero at rest.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.linalg.lapack import dgeqrf, dgesdd, dorgqr, dposv
from scipy.optimize import nnls

from fvs_ros.limits import JointLimits
from fvs_ros.params import Parameters, live_parameter, parameter
from fvs_ros.vectors import largest

#: Weight of the sum of squares (eps): the fastest joint is 2 % faster than need be, at most.
_SMOOTHING = 0.2
#: Blend gain toward the shared pseudo inverse, per part of the fastest speed that a joint near its
#: end leaves out. Without it the least largest speed would jump from corner to corner.
_CALM = 4.0
#: Part of the left-out motion that the other joints do not compensate (kappa), 0 to 1: more is
#: calmer where the target is out of reach.
_LEFT_OUT = 0.1
#: Weight of the sum of squares counted from the way back to a posture.
_HOMING = 0.5
#: Closer to the posture than this, the way back is slower in proportion, rad.
_NEAR_HOME_RAD = 0.3
_TINY = 1e-12
#: Share of the largest singular value below which one is rounding.
_DEPENDENT = 1e-9


@dataclass
class DampedInverse:
    """The damped pseudo inverse ``rdot = J' (J J' + mu I)^-1 v``."""

    #: mu, m^2/rad^2. It slows the direction of singular value w by w^2 / (w^2 + mu).
    damping: float = 1e-4
    #: The last Jacobian, which serves several ticks, and its inverse.
    _last: tuple[np.ndarray | None, np.ndarray] = field(
        default=(None, np.zeros((0, 0))), init=False, repr=False, compare=False
    )

    def joint_velocity(
        self,
        jacobian: np.ndarray,
        velocity: np.ndarray,
        joints_rad: np.ndarray | None = None,
        home_rad: np.ndarray | None = None,
    ) -> np.ndarray:
        """Joint velocities, (n,), rad/s, that move the feature as wanted, (m,), m/s.

        The joints and a posture to come back to, (n,), rad, are for the least speed only.
        """
        last, inverse = self._last
        if last is not jacobian:
            inverse = damped_solution(jacobian, np.eye(len(jacobian)), self.damping)
            self._last = jacobian, inverse
        return inverse.dot(velocity)


def damped_solution(jacobian: np.ndarray, velocity: np.ndarray, damping: float) -> np.ndarray:
    """Find ``J' (J J' + mu I)^-1 v``, shape (n, ...), of a Jacobian of shape (m, n).

    Straight from LAPACK: numpy's solver takes four times as long.
    """
    gram = jacobian.dot(jacobian.T)
    # With a huge Jacobian mu would be lost to rounding, and the Cholesky factors would fail.
    entries = jacobian.ravel()
    gram.flat[:: len(gram) + 1] += max(damping, 1e-14 * float(entries.dot(entries)))
    return jacobian.T.dot(dposv(gram, velocity)[1])


def singular_values(matrix: np.ndarray) -> np.ndarray:
    """Singular values, the largest first, of a matrix; straight from LAPACK, too."""
    return dgesdd(matrix, compute_uv=0)[1]


@dataclass
class LeastSpeedInverse(DampedInverse):
    """The least largest joint speed for the feature velocity of :class:`DampedInverse`.

    Joints keep away from the ends of their ranges, where these are given.
    """

    limits: JointLimits | None = None

    def joint_velocity(
        self,
        jacobian: np.ndarray,
        velocity: np.ndarray,
        joints_rad: np.ndarray | None = None,
        home_rad: np.ndarray | None = None,
        near: np.ndarray | None = None,
    ) -> np.ndarray:
        """Find those whose fastest joint is slowest: as :meth:`DampedInverse.joint_velocity`.

        Without ``joints_rad`` the ends of their ranges do not count. The sum of squares may be
        counted from ``near``, (n,), rad/s, instead of from the way back to ``home_rad``.
        """
        # In units of the joints' shares, in which all of them are equally fast.
        unit = 1.0 if self.limits is None else self.limits.share
        jacobian = jacobian * unit
        least = damped_solution(jacobian, velocity, self.damping)
        free, shares = _orthogonal_to_rows(jacobian), self._shares(joints_rad)
        nearness = _SMOOTHING
        if near is not None:
            least = least + (free @ (near / unit)) @ free
        elif home_rad is not None and joints_rad is not None:
            room = 1.0 if shares is None else float(shares.min())
            homing = _homing((home_rad - joints_rad) / unit, largest(least), room)
            least, nearness = least + (free @ homing) @ free, _HOMING
        solution = _least_largest(least, free, nearness)
        if shares is None:
            return unit * solution
        share = np.where(solution > 0.0, *np.split(shares, 2))
        left_out = largest((1.0 - share) * solution) / max(largest(solution), _TINY)
        spared = self._sparing(jacobian, velocity, share)
        return unit * (solution + min(1.0, _CALM * left_out) * (spared - solution))

    def _sparing(
        self, jacobian: np.ndarray, velocity_m_s: np.ndarray, share: np.ndarray
    ) -> np.ndarray:
        """Joint velocities in which each joint contributes only its share, (n,).

        With W the shares and ``D = W + kappa (I - W)`` it is ``W J' (J D J' + mu I)^-1 v``. With
        kappa = 0 the other joints would compensate for everything left out, with excessive speed at
        the edge of their reach.
        """
        root = np.sqrt(share + _LEFT_OUT * (1.0 - share))
        return share / root * damped_solution(jacobian * root, velocity_m_s, self.damping)

    def _shares(self, joints_rad: np.ndarray | None) -> np.ndarray | None:
        """Upward, then downward shares of the joints' speeds, (2 n,); None where all are 1."""
        ends = self.limits
        if ends is None or joints_rad is None or not ends.near_end(joints_rad):
            return None
        room = ends.upper_rad - joints_rad, joints_rad - ends.lower_rad
        return np.clip(np.concatenate(room / ends.margin_rad), 0.0, 1.0)


def _least_largest(least: np.ndarray, free: np.ndarray, nearness: float) -> np.ndarray:
    """The least largest of joint velocities, (n,), plus a mix of free ones, (n - m, n)."""
    scale, joints = largest(least), least.size
    if not _TINY < scale < np.inf:
        return least
    distance = np.empty((2 + len(free), 2 * joints))
    upward, downward = distance[:, :joints], distance[:, joints:]
    np.multiply(free, -1.0 / nearness, out=upward[1:-1])
    np.divide(least, scale, out=upward[-1])
    np.negative(upward[1:], out=downward[1:])
    distance[0] = 1.0
    try:
        weights, _ = nnls(distance, np.eye(len(distance))[-1])
    except RuntimeError:  # it did not converge
        return least
    rest = distance.dot(weights)
    last = nearness * (float(rest[-1]) - 1.0)
    return least if abs(last) < _TINY else least - rest[1:-1].dot(free) * (scale / last)


def _homing(away_rad: np.ndarray, speed: float, room: float) -> np.ndarray:
    """The way back to a posture, as fast as the wanted motion and slower near the posture.

    Nothing where a joint is at its end: the others have enough to do.
    """
    furthest_rad = largest(away_rad)
    share = room * min(1.0, furthest_rad / _NEAR_HOME_RAD)
    return away_rad * (share * speed / max(furthest_rad, _TINY))


def _orthogonal_to_rows(jacobian: np.ndarray) -> np.ndarray:
    """Orthonormal rows, (n - r, n), orthogonal to those of an (m, n) Jacobian of rank r.

    By QR factors straight from LAPACK: numpy's wrapper takes five times as long. Where rows depend
    on each other, as those of several webcams do, by singular values.
    """
    m, n = jacobian.shape
    factors, scales, _, _ = dgeqrf(jacobian.T)
    pivots = np.abs(factors.diagonal())
    if m > n or pivots.min() < _DEPENDENT * pivots.max():
        _, values, rows, _ = dgesdd(jacobian)
        return np.asarray(rows[np.count_nonzero(values > _DEPENDENT * values[0]) :])
    if m == n:
        return np.empty((0, n))
    q, padded = np.zeros((n, n), order="F"), np.zeros(n)
    q[:, :m], padded[:m] = factors, scales
    return dorgqr(q, padded)[0][:, m:].T


TWO_NORM, LEAST_SPEED = "two_norm", "least_speed"


@dataclass(frozen=True)
class RedundancyConfig(Parameters):
    """Redundancy resolution and damping."""

    redundancy_resolution: str = parameter(
        TWO_NORM,
        "Redundancy resolution: two_norm minimises the sum of squared joint velocities, "
        "least_speed the largest one. The law minimum_time always uses least_speed.",
        choices=(TWO_NORM, LEAST_SPEED),
    )
    damping: float = live_parameter(
        1e-4, "Damping mu of the pseudo inverse J' (J J' + mu I)^-1, m^2/rad^2.", 1e-12, 1.0
    )


def make_inverse(values: Mapping[str, Any], *, least_speed: bool = False) -> DampedInverse:
    """Build what ``redundancy_resolution`` names, or the least speed, with the numbers given."""
    config = RedundancyConfig.from_values(values)
    if least_speed or config.redundancy_resolution == LEAST_SPEED:
        return LeastSpeedInverse(config.damping, JointLimits.from_values(values))
    return DampedInverse(config.damping)
