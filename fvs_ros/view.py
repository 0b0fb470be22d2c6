"""What a camera on the arm sees stays in its view: margins, and commands that keep them.

A margin c is a length, m: how far what is seen is inside of one bound of the view. Edges of the
picture and distances are planes around a convex room, so the straight way between two points in
view stays in view. A command u keeps a margin if it falls no faster than in proportion,

    dc/dt = s J u >= -rate c,

with the slopes s of the margin, and the Jacobian J. Where c is negative, it turns back. The
Jacobian errs by a share eps, so what is predicted must leave room for that,

    s J u + rate c >= eps |s J| |u|.

The nearest such command slides along the bounds, the further inside the faster it is.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from fvs_ros.bounded import nearest
from fvs_ros.kinds import Kind
from fvs_ros.params import ParameterError, Parameters, live_parameter
from fvs_ros.vectors import length

#: Where what is seen is when a margin is small, in the order of the margins.
WHERE = (
    "at the left edge of the view",
    "at the right edge of the view",
    "at the top edge of the view",
    "at the bottom edge of the view",
    "too near",
    "too far away",
    "seen too flat",
)
#: Times that the command is found with the speed found before. The iteration over- and
#: underestimates the speed in turn; an odd count ends on the safe side.
_TIMES = 3


class Barrier(NamedTuple):
    """What keeps k margins at a command u, rad/s: ``rows @ u + closing >= error |rows| |u|``."""

    rows: np.ndarray  #: slopes of the margins, (k, n), m/rad
    closing: np.ndarray  #: how fast they may fall, (k,), m/s; negative outside
    error: float  #: relative, of the Jacobian

    def nearest(self, velocity: np.ndarray, unit: np.ndarray) -> tuple[np.ndarray, str]:
        """The command nearest to one, (n,), and for what it was changed; empty if it was not.

        Near is meant in units of the joints' shares, (n,).
        """
        wanted, rows = velocity / unit, self.rows * unit
        errors = self.error * np.sqrt(np.sum(rows**2, axis=1))
        command, where = wanted, ""
        for _ in range(_TIMES):
            command, pushes = nearest(wanted, rows, errors * length(command) - self.closing)
            if command is wanted and not where:
                return velocity, ""
            where = where or WHERE[int(pushes.argmax())]
        return unit * command, where

    def shortened(self, velocity: np.ndarray) -> np.ndarray:
        """The longest share of a command, (n,), that keeps the margins by the Jacobian."""
        falling, closing = -self.rows @ velocity, np.maximum(0.0, self.closing)
        fast = falling > closing
        if not fast.any():
            return velocity
        return velocity * (closing[fast] / falling[fast]).min()


@dataclass(frozen=True)
class ViewConfig(Parameters):
    """The view of a camera on the arm; by default a RealSense D435's 4:3 colour."""

    #: A margin may fall at most at this rate, 1/s: ln 2 over the 0.13 s from exposure to motion. As
    #: the speed falls with it, what erred meanwhile is less than what is left.
    view_rate_1_s = 5.0
    #: Error of the Jacobian, relative: as that of a bracket that was turned by 11 degrees.
    view_error = 0.2

    view_half_angles_deg: tuple[float, ...] = live_parameter(
        (27.0, 20.5),
        "Half the angles of view, horizontal and vertical, of a camera on the arm, degrees.",
        1.0,
        89.0,
        size=2,
    )
    view_distance_m: tuple[float, ...] = live_parameter(
        (0.1, 3.0), "Nearest and farthest distance that it sees, m.", 0.0, 100.0, size=2
    )
    view_tilt_deg: float = live_parameter(
        65.0, "Largest angle between a tag's normal and the line to the camera, degrees.", 1.0, 90.0
    )
    view_radius_m: float = live_parameter(
        0.075,
        "Radius of ball or tag, with its white border, that stays in the picture, m.",
        0.0,
        1.0,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        near_m, far_m = self.view_distance_m
        if near_m >= far_m:
            raise ParameterError(f"view_distance_m must rise, got {[near_m, far_m]}")

    @cached_property
    def _planes(self) -> tuple[np.ndarray, np.ndarray]:
        """Normals of the planes around the view, (6, 3), and the margins at the camera, m."""
        angles = np.radians(self.view_half_angles_deg)
        (cx, cy), (sx, sy) = np.cos(angles), np.sin(angles)
        normals = [[cx, 0, sx], [-cx, 0, sx], [0, cy, sy], [0, -cy, sy], [0, 0, 1], [0, 0, -1]]
        near_m, far_m = self.view_distance_m
        return np.array(normals), np.array([-self.view_radius_m] * 4 + [-near_m, far_m])

    def margins(self, kind: Kind, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How far inside of the view z, (m,), is, m, (k,), and the slopes by its motion, (k, d)."""
        normals, margins_m = self._planes
        slopes = np.zeros((len(normals), kind.size))
        slopes[:, :3] = normals
        cosines, by_motion = kind.facing(z)
        tilt = np.radians(self.view_tilt_deg)
        scale_m = kind.unit[-1] / np.sin(tilt)  # near the bound this is the arc
        tilt_m = scale_m * (cosines - np.cos(tilt))
        margins_m = np.append(margins_m + normals @ z[:3], tilt_m)
        return margins_m, np.concatenate([slopes, scale_m * by_motion])

    def out_of_view(self, kind: Kind, z: np.ndarray) -> str:
        """Say by which bounds z, (m,), is out of view; empty if it is in view."""
        margins_m, _ = self.margins(kind, z)
        amounts = [kind.length_text(-margin_m) for margin_m in margins_m.tolist()]
        amounts[6:] = [f"{d:.0f} degrees" for d in np.degrees(-margins_m[6:] / kind.unit[-1])]
        out = [f"{WHERE[i]} by {amounts[i]}" for i in np.flatnonzero(margins_m < 0.0)]
        return f"{', '.join(out)} (see the parameters view_*)" if out else ""

    def barrier(
        self,
        kind: Kind,
        z: np.ndarray,
        jacobian: np.ndarray,
        pending_rad: np.ndarray,
        drift_m_s: np.ndarray | None = None,
    ) -> Barrier:
        """What keeps z, (m,), in view.

        The Jacobian is (d, n), m/rad, and ``pending_rad``, (n,), is motion that is still to come,
        ``drift_m_s``, (d,), the object's own.
        """
        margins_m, slopes = self.margins(kind, z)
        rows = slopes @ jacobian
        closing = self.view_rate_1_s * (margins_m + rows @ pending_rad)
        if drift_m_s is not None:
            closing = closing + slopes @ drift_m_s
        return Barrier(rows, closing, self.view_error)
