"""Scores of runs, the same for demo, laboratory and recordings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fvs_ros.feature import Feature

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

    @property
    def final(self) -> str:
        """The final errors in words."""
        angle = "" if self.final_rms_deg is None else f", {self.final_rms_deg:.3f} deg"
        return f"{self.final_rms_m * 1e3:.2f} mm{angle}"


def way_and_arc_m(errors_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Ways and, of poses, arcs at the lever arm of task errors, m, (n, d): (n,) each."""
    return np.linalg.norm(errors_m[:, :3], axis=1), np.linalg.norm(errors_m[:, 3:], axis=1)


def judge(
    feature: Feature, time_s: np.ndarray, errors_m: np.ndarray, joint_velocity_rad_s: np.ndarray
) -> TargetScore:
    """Judge the way to one target; a pose has settled with both way and arc.

    Times since it was given, (n,), and task errors, m, (n, d); joint velocities, (k, joints).
    """
    way_m, arc_m = way_and_arc_m(errors_m)
    final = time_s >= time_s[-1] - FINAL_S
    longer_m = np.maximum(way_m, arc_m)
    final_rad = _rms(arc_m[final]) / feature.task_scale[-1]
    return TargetScore(
        start_distance_m=float(way_m[0]),
        settling_5mm_s=settling_time_s(time_s, longer_m, SETTLED_ERROR_M),
        settling_2mm_s=settling_time_s(time_s, longer_m, FINE_ERROR_M),
        final_rms_m=_rms(way_m[final]),
        peak_joint_speed_rad_s=float(np.max(np.abs(joint_velocity_rad_s), initial=0.0)),
        final_rms_deg=float(np.degrees(final_rad)) if errors_m.shape[1] > 3 else None,
    )


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def settling_time_s(times_s: np.ndarray, errors_m: np.ndarray, bound_m: float) -> float | None:
    """Time when the error, (n,), last fell below a bound; None if the record ends above it."""
    above = np.flatnonzero(~(errors_m < bound_m))  # an unknown error is not below
    if above.size == 0:
        return float(times_s[0])
    if above[-1] + 1 >= len(errors_m):
        return None
    return float(times_s[above[-1] + 1])


def jitter_rad_s(commands_rad_s: np.ndarray) -> float:
    """Rms of the worst joint's changes from tick to tick, rad/s, of velocities, (n, joints)."""
    return float(np.sqrt(np.mean(np.diff(commands_rad_s, axis=0) ** 2, axis=0)).max())


def criteria(wrong_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The paper's criteria T1 and T2, eqs (40) to (42), of errors dx - J dr, m, shape (n, 3).

    Length of each error, and of the sum of all errors up to each step, m, each of shape (n,).
    """
    return np.linalg.norm(wrong_m, axis=1), np.linalg.norm(np.cumsum(wrong_m, axis=0), axis=1)
