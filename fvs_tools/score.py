"""Scores of runs, the same for demo, laboratory and recordings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fvs_ros.kinds import Kind

#: The final error is that of the last second, s.
FINAL_S = 1.0
#: True errors below which a target counts as settled, and as finely settled, m: the controller's
#: ``settled_error_m``, and the limit of the depth camera's noise.
SETTLED_ERROR_M, FINE_ERROR_M = 0.005, 0.002


@dataclass(frozen=True)
class TargetScore:
    """One row of the demo's table; a settling time is None where it was not reached."""

    start_distance_m: float
    settling_5mm_s: float | None
    settling_2mm_s: float | None
    final_rms_m: float
    peak_joint_speed_rad_s: float
    final_rms_deg: float | None = None

    def final(self, kind: Kind) -> str:
        """The final errors in words."""
        angle = "" if self.final_rms_deg is None else f", {self.final_rms_deg:.3f} deg"
        return kind.length_text(self.final_rms_m, 2) + angle


def judge(
    kind: Kind, time_s: np.ndarray, errors_m: np.ndarray, joint_velocity_rad_s: np.ndarray
) -> TargetScore:
    """Judge the motion to one target, which has settled with the largest part of its error.

    Times since it was given, (n,), and errors, m, (n, d); joint velocities, (k, joints).
    """
    final, parts_m = time_s >= time_s[-1] - FINAL_S, kind.parts_m(errors_m)
    longer_m = np.max(list(parts_m.values()), axis=0)
    distance_m, arc_m = parts_m["way_m"], parts_m.get("arc_m")
    return TargetScore(
        start_distance_m=float(distance_m[0]),
        settling_5mm_s=settling_time_s(time_s, longer_m, SETTLED_ERROR_M),
        settling_2mm_s=settling_time_s(time_s, longer_m, FINE_ERROR_M),
        final_rms_m=_rms(distance_m[final]),
        peak_joint_speed_rad_s=float(np.max(np.abs(joint_velocity_rad_s), initial=0.0)),
        final_rms_deg=None if arc_m is None else _rms(np.degrees(arc_m[final] / kind.unit[-1])),
    )


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def settling_time_s(times_s: np.ndarray, errors_m: np.ndarray, bound_m: float) -> float | None:
    """Time when the error, (n,), last fell below a bound; None if the record ends above it."""
    above = np.flatnonzero(~(errors_m < bound_m))  # an unknown error is not below
    first = above[-1] + 1 if above.size else 0
    return float(times_s[first]) if first < len(times_s) else None
