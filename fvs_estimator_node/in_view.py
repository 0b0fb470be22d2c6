"""Keeps an object in view of the camera on the arm while the arm explores.

Nothing is known of the arm at first. Where the object is seen is fitted by quadratic polynomials of
the joints, to all images so far. The motion is small at first, and deflected as little as possible.
"""

from __future__ import annotations

import numpy as np

from fvs_ros.bounded import nearest
from fvs_ros.kinds import Kind

#: Largest directions from the camera to the object, inside the picture of any usual camera, and
#: from a tag to the camera, rad; largest change of the distance, as a logarithm. What is beyond at
#: the start may stay there.
_DIRECTION_RAD, _TILT_RAD, _DISTANCE = 0.15, 0.8, 0.3
#: Share of the limits that is left after the object was lost.
_NARROWER = 0.7
#: A limit is approached at most at the rate that reaches it in this time, s.
_APPROACH_S = 0.5
#: Squared ratio of the polynomials' errors to their coefficients: holds what is not determined.
_RIDGE = 1e-4


class InView:
    """Learns where motion takes an object in view, and limits the arm's velocity to what keeps it.

    The joints move within a box, rad, (2, n); ``unit`` is what of each counts as much, (n,).
    """

    def __init__(self, kind: Kind, box_rad: np.ndarray, unit: np.ndarray) -> None:
        self._kind, self._box, self._unit = kind, box_rad / unit, unit
        self._pairs = np.triu_indices(len(unit))
        size = 1 + len(unit) + len(self._pairs[0])
        self._normal, self._right = _RIDGE * np.eye(size), np.zeros((size, 1))
        self._newest: tuple[np.ndarray, np.ndarray] | None = None

    def learn(self, joints_rad: np.ndarray, z: np.ndarray) -> None:
        """Take a measurement, (m,), and the joints at its exposure, rad, (n,)."""
        view = _view(self._kind, z)
        if self._newest is None:
            self._first = view * (np.arange(len(view)) == 0)  # of the distance alone
            limits = np.repeat([_DISTANCE, _DIRECTION_RAD, _TILT_RAD], [1, 2, len(view) - 3])
            self._limits = np.maximum(limits, np.abs(view - self._first))
        view = view - self._first
        terms, _ = self._terms(joints_rad)
        self._newest = terms, view
        self._normal += np.outer(terms, terms)
        self._right = self._right + np.outer(terms, view)
        self._weights = np.linalg.solve(self._normal, self._right)

    def lost(self) -> None:
        """Keep the object nearer to where it was at the start: it was lost."""
        if self._newest is not None:
            self._limits *= _NARROWER

    def limited(self, velocity: np.ndarray, joints_rad: np.ndarray) -> np.ndarray:
        """The velocity nearest to one, rad/s, (n,), that keeps the object in view."""
        if self._newest is None:
            return velocity
        terms, slopes = self._terms(joints_rad)
        seen_terms, seen = self._newest
        view = seen + (terms - seen_terms) @ self._weights
        velocity, joints = velocity / self._unit, joints_rad / self._unit
        rows = np.vstack([self._weights.T @ slopes, np.eye(len(joints))])
        # What deflects a joint takes it no further beyond its box.
        low, high = (self._box - joints) / _APPROACH_S
        low = np.append((-self._limits - view) / _APPROACH_S, np.minimum(low, velocity))
        high = np.append((self._limits - view) / _APPROACH_S, np.maximum(high, velocity))
        velocity, _ = nearest(velocity, np.vstack([rows, -rows]), np.append(low, -high))
        return self._unit * velocity

    def _terms(self, joints_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Terms of the polynomials, (k,), and their derivatives by the joints, (k, n)."""
        joints = np.clip(joints_rad / self._unit, *self._box) - self._box.mean(axis=0)
        (i, j), unit = self._pairs, np.eye(len(joints))
        slopes = joints[i, None] * unit[j] + joints[j, None] * unit[i]
        terms = np.concatenate([[1.0], joints, joints[i] * joints[j]])
        return terms, np.vstack([np.zeros(len(joints)), unit, slopes])


def _view(kind: Kind, z: np.ndarray) -> np.ndarray:
    """Logarithm of the distance, and directions, rad: of the object and, from a tag, back."""
    places = [z[:3]] if kind.rotation(z) is None else [z[:3], kind.inverse(z)[:3]]
    directions = [np.arctan2(place[:2], place[2]) for place in places]
    return np.concatenate([[np.log(np.linalg.norm(z[:3]) + 1e-6)], *directions])
