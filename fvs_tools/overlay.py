"""The picture of a calibration: the URDF's arm over the camera's image, and the residuals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from fvs_detector_node.images import Rectifier, Region
from fvs_estimator_node.calibration import Calibration
from fvs_estimator_node.files import DataSet
from fvs_ros.camera import CameraModel, Intrinsics
from fvs_ros.timeline import MAX_GAP_S

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


def arm_px(found: Calibration, joints_rad: np.ndarray, camera: Intrinsics) -> np.ndarray:
    """Where the image shows the joints of the URDF, its tip, and ball or tag, px, (n + 2, 2).

    At reported joints, rad, (n,); NaN for what is behind the camera.
    """
    joints = found.true_joints(joints_rad)
    turn, tip_m = found.arm.tip_at(joints)  # rows: the tip's axes
    points_m = np.vstack([found.arm.at(joints)[0], tip_m, tip_m + found.carried_m @ turn])
    return _px(found.seen(points_m), camera)


def residual_px(found: Calibration, camera: Intrinsics) -> float:
    """Median distance of the images from the model, px."""
    off_px = _px(found.seen_m + found.residuals_m, camera) - _px(found.seen_m, camera)
    return float(np.nanmedian(np.linalg.norm(off_px, axis=1)))


def _px(points_m: np.ndarray, camera: Intrinsics) -> np.ndarray:
    return camera.project(np.where(points_m[:, 2:] > _NEAR_M, points_m, np.nan))


def draw(found: Calibration, data: DataSet, photo: Photograph | None = None) -> Any:
    """A figure: the arm as the calibration has it, over an image of it; and the residuals."""
    from matplotlib.figure import Figure  # slow, and not needed for --help

    figure = Figure(figsize=(11.0, 4.6), layout="constrained")
    seen, over = figure.subplots(1, 2)
    _draw_arm(seen, found, data, photo)
    time_s = found.stamps_s - found.stamps_s[0]
    gaps = np.flatnonzero(np.diff(time_s) > MAX_GAP_S) + 1  # broken there
    time_s, off_mm = (
        np.insert(one, gaps, np.nan, axis=0) for one in (time_s, 1e3 * found.residuals_m)
    )
    for i, name in enumerate("xyz"):
        over.plot(time_s, off_mm[:, i], linewidth=0.6, label=name)
    limit = 6.0 * 1e3 * max(found.residual_m, 1e-5)
    over.set(xlabel="time, s", ylabel="residual, mm", ylim=(-limit, limit), title=found.verdict[0])
    over.legend(fontsize=8)
    return figure


def _draw_arm(seen: Any, found: Calibration, data: DataSet, photo: Photograph | None) -> None:
    """The joints' axes and the line from joint to joint to the tip."""
    joints = data.joints_rad[:, [data.joint_names.index(name) for name in found.arm.names]]
    within = photo is not None and data.stamps_s[0] <= photo.stamp_s <= data.stamps_s[-1]
    if photo is not None and within:
        exposed_s = photo.stamp_s - found.delay_s
        at = np.array([np.interp(exposed_s, data.stamps_s, one) for one in joints.T])
        camera = photo.camera
        seen.imshow(photo.rgb)
        seen.set(xlim=(0, camera.width), ylim=(camera.height, 0), xticks=[], yticks=[])
        seen.set_title("the URDF's arm over the camera's image")
    else:
        at, camera = joints.mean(axis=0), Intrinsics(1, 1, 1.0, 1.0, 0.0, 0.0)
        ball = _px(found.seen_m[:: max(1, len(found.seen_m) // 600)], camera)
        seen.plot(*ball.T, ".", color="0.6", markersize=2)
        seen.set(xlabel="x / z", ylabel="y / z", title="the URDF's arm, as the camera sees it")
        seen.invert_yaxis()
        seen.set_aspect("equal")
    points_m, axes = found.arm.at(found.true_joints(at))
    for i, (name, axis, point_m) in enumerate(zip(found.arm.names, axes, points_m, strict=True)):
        ends = _px(found.seen(point_m + np.array([[-_HALF_M], [_HALF_M]]) * axis), camera)
        seen.plot(*ends.T, linewidth=2.5, color=f"C{i}", label=name)
    seen.plot(*arm_px(found, at, camera).T, "o-", color="#00c853", linewidth=1.2, markersize=4)
    seen.legend(fontsize=8, loc="best")
