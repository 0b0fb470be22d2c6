"""The picture of a calibration: the URDF's arm over the camera's image, and the residuals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from fvs_detector_node.images import Rectifier, Region
from fvs_ros.camera import CameraModel, Intrinsics
from fvs_ros.timeline import MAX_GAP_S
from fvs_tools.hand_eye import Estimate

#: Points nearer to the camera's plane are not drawn, m; half the length of an axis as drawn, m.
_NEAR_M, _HALF_M = 0.05, 0.06


@dataclass(frozen=True)
class Photograph:
    """An image, uint8, (H, W, 3), red first, without distortion; its camera; its stamp, s."""

    rgb: np.ndarray
    camera: Intrinsics
    stamp_s: float

    @classmethod
    def of(cls, rgb: np.ndarray, camera: CameraModel, stamp_s: float) -> Photograph:
        """Remove the distortion; a ``ValueError`` if the image has not the camera's size."""
        view = camera.intrinsics
        if rgb.shape[:2] != (view.height, view.width):
            raise ValueError(
                f"the image has {rgb.shape[1]}x{rgb.shape[0]} pixels, its camera_info "
                f"{view.width}x{view.height}"
            )
        return cls(Rectifier(camera).colour(rgb, Region.whole(view)), view, stamp_s)


def arm_px(estimate: Estimate, joints_rad: np.ndarray, camera: Intrinsics) -> np.ndarray:
    """Where the image shows the joints of the URDF, its tip, and ball or tag, px, (n + 2, 2).

    At reported joints, rad, (n,); NaN for what is behind the camera.
    """
    arm, joints = estimate.model.arm, estimate.true_joints(joints_rad)
    rotation, tip_m = arm.tip_at(joints)  # rows: the tip's axes
    points_m = np.vstack([arm.at(joints)[0], tip_m, tip_m + estimate.target[:3] @ rotation])
    return _px(estimate.in_camera(points_m), camera)


def residual_px(estimate: Estimate, camera: Intrinsics) -> float:
    """Median distance of the images from the model, px."""
    shown_m = estimate.model.measured[:, :3]
    off_px = _px(shown_m + estimate.residual_m, camera) - _px(shown_m, camera)
    return float(np.nanmedian(np.linalg.norm(off_px, axis=1)))


def _px(points_m: np.ndarray, camera: Intrinsics) -> np.ndarray:
    return camera.project(np.where(points_m[:, 2:] > _NEAR_M, points_m, np.nan))


def draw(estimate: Estimate, photo: Photograph | None = None, title: str = "") -> Any:
    """A figure: the arm as the calibration has it, over an image of it; and the residuals."""
    from matplotlib.figure import Figure  # slow, and not needed for --help

    figure = Figure(figsize=(11.0, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    _draw_arm(left, estimate, photo)
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


def _draw_arm(axes: Any, estimate: Estimate, photo: Photograph | None) -> None:
    """The joints' axes and the line from joint to joint to the tip."""
    data, arm = estimate.model.data, estimate.model.arm
    if photo is not None and data.stamps_s[0] <= photo.stamp_s <= data.stamps_s[-1]:
        exposed_s = photo.stamp_s - estimate.mean.delay_s.item()
        joints = np.array(
            [np.interp(exposed_s, data.stamps_s, column) for column in data.joints_rad.T]
        )
        camera = photo.camera
        axes.imshow(photo.rgb)
        axes.set(xlim=(0, camera.width), ylim=(camera.height, 0), xticks=[], yticks=[])
        axes.set_title("the URDF's arm over the camera's image")
    else:
        joints, camera = data.joints_rad.mean(axis=0), Intrinsics(1, 1, 1.0, 1.0, 0.0, 0.0)
        shown_m = estimate.model.measured[:: max(1, len(estimate.model.measured) // 600), :3]
        axes.plot(*_px(shown_m, camera).T, ".", color="0.6", markersize=2)
        axes.set(xlabel="x / z", ylabel="y / z", title="the URDF's arm, as the camera sees it")
        axes.invert_yaxis()
        axes.set_aspect("equal")
    lines = zip(arm.names, *arm.at(estimate.true_joints(joints)), strict=True)
    for i, (name, point_m, axis) in enumerate(lines):
        ends_m = point_m + np.array([[-_HALF_M], [_HALF_M]]) * axis
        ends = _px(estimate.in_camera(ends_m), camera)
        axes.plot(*ends.T, linewidth=2.5, color=f"C{i}", label=name)
    axes.plot(
        *arm_px(estimate, joints, camera).T, "o-", color="#00c853", linewidth=1.2, markersize=4
    )
    axes.legend(fontsize=8, loc="best")
