"""The picture of a calibration: the URDF's arm as the camera sees it, and the residuals."""

from __future__ import annotations

from typing import Any

import numpy as np

from fvs_ros.timeline import MAX_GAP_S
from fvs_tools.hand_eye import Estimate

#: Points nearer to the camera's plane are not drawn, m; half the length of an axis as drawn, m.
_NEAR_M, _HALF_M = 0.05, 0.06


def draw(estimate: Estimate, title: str = "") -> Any:
    """A figure: the arm as the calibration has it, among the measured points; and the residuals."""
    from matplotlib.figure import Figure  # slow, and not needed for --help

    figure = Figure(figsize=(11.0, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    _draw_arm(left, estimate)
    stamps_s = estimate.model.path.stamps_s
    time_s = stamps_s - stamps_s[0]
    gaps = np.flatnonzero(np.diff(time_s) > MAX_GAP_S) + 1  # broken there
    time_s, off_mm = (
        np.insert(values, gaps, np.nan, axis=0) for values in (time_s, 1e3 * estimate.residual_m)
    )
    for i, name in enumerate("xyz"):
        right.plot(time_s, off_mm[:, i], linewidth=0.6, label=name)
    limit = 6.0 * 1e3 * max(estimate.median_residual_m, 1e-5)
    right.set(xlabel="time, s", ylabel="residual, mm", ylim=(-limit, limit), title=title)
    right.legend(fontsize=8)
    return figure


def _draw_arm(axes: Any, estimate: Estimate) -> None:
    """At the mean joints: the joints' axes, and the line from joint to joint to ball or tag."""
    arm, measured_m = estimate.model.arm, estimate.model.measured[:, :3]
    joints = estimate.true_joints(estimate.model.data.joints_rad.mean(axis=0))
    points_m, directions = arm.at(joints)
    axes.plot(*_tangents(measured_m[:: max(1, len(measured_m) // 600)]), ".", color="0.6", ms=2)
    for i, name in enumerate(arm.names):
        ends_m = points_m[i] + np.array([[-_HALF_M], [_HALF_M]]) * directions[i]
        ends = _tangents(estimate.in_camera(ends_m))
        axes.plot(*ends, linewidth=2.5, color=f"C{i}", label=name)
    rotation, tip_m = arm.tip_at(joints)  # rows: the tip's axes
    line_m = np.vstack([points_m, tip_m, tip_m + estimate.target[:3] @ rotation])
    line = _tangents(estimate.in_camera(line_m))
    axes.plot(*line, "o-", color="#00c853", linewidth=1.2, markersize=4)
    axes.set(xlabel="x / z", ylabel="y / z", title="the URDF's arm, as the camera sees it")
    axes.invert_yaxis()
    axes.set_aspect("equal")
    axes.legend(fontsize=8, loc="best")


def _tangents(points_m: np.ndarray) -> np.ndarray:
    """``x / z`` and ``y / z``, (2, n), of points, camera frame, m; NaN for what is behind it."""
    return (points_m[:, :2] / np.where(points_m[:, 2:] > _NEAR_M, points_m[:, 2:], np.nan)).T
