"""A calibration in words and files: what the data lack, what does not fit, and the verdict."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from shlex import quote
from textwrap import wrap
from typing import Any

import numpy as np
import yaml

from fvs_estimator_node import joint_path
from fvs_estimator_node.files import DataSet
from fvs_estimator_node.joint_path import MAX_OFFSET_S
from fvs_ros.kinds import BodyConfig
from fvs_ros.params import parameter
from fvs_ros.rotations import quaternion_from_rotation
from fvs_ros.timeline import MAX_GAP_S
from fvs_ros.vectors import LARGEST, plausible
from fvs_tools.demo import COLOURS
from fvs_tools.hand_eye import Estimate, solve
from fvs_tools.kinematics import Kinematics


@dataclass(frozen=True)
class CalibrateConfig(BodyConfig):
    """Parameters of ``fvs_calibrate_node``."""

    urdf_path: str = parameter("", "URDF of the arm; empty: robot_description")
    tip_link: str = parameter(
        "", "link that carries ball, tag or camera; empty: tool0, flange, or the arm's last link"
    )
    output_path: str = parameter(
        "out/calibrate/camera.yaml", "file to write; a picture of the residuals is put beside it"
    )
    duration_s: float = parameter(
        120.0, "time after the first image in which the motion has to be enough, s", 10.0, 3600.0
    )
    stop_at_m: float = parameter(
        0.0005, "standard deviation of the camera's position that is good enough, m", 1e-5, 1.0
    )
    stop_at_rad: float = parameter(
        0.001, "standard deviation of its rotation that is good enough, rad", 1e-5, 1.0
    )


PARAMETERS = CalibrateConfig.declared()

#: Standard deviations of the camera's position, m, and rotation, rad.
GOOD, USABLE = (0.001, np.radians(0.1)), (0.01, np.radians(1.0))
#: A joint that moves less, standard deviation in rad or m, is still.
_STILL = 0.005
#: A camera is further off, median, m; poses of the robot itself, rounded to 0.1 mm, are not.
_LEAST_RESIDUAL_M = 6e-5
#: Images that are this share of their spread off are not explained.
_UNEXPLAINED = 0.2
#: With a zero of this size, rad, the joint turns the other way, or is another.
_OTHER_RAD = np.radians(10.0)
#: Deviations from which on a part counts as off.
_SIGMAS = 5.0


def calibrate(data: DataSet, arm: Kinematics, camera_on_arm: bool = False) -> Estimate:
    """Find the camera in the arm's frame.

    Parameters
    ----------
    data : DataSet
        Images of a ball or tag on the tip of the moving arm; or, if the arm carries the camera, of
        a ball or tag at rest.
    arm : Kinematics
        From the URDF.
    camera_on_arm : bool
        Whether the camera is on the tip.

    Raises
    ------
    ValueError
        If there are too few images, a joint is missing, all but one are still, or nothing fits.
    """
    arm = arm.reversed() if camera_on_arm else arm
    data = _ordered(data, arm)
    estimate = solve(data, arm)
    delay_s = np.clip(estimate.mean.delay_s.item(), -MAX_OFFSET_S, MAX_OFFSET_S)
    if abs(delay_s) > 0.95 * MAX_OFFSET_S:
        raise ValueError(
            f"the images are stamped {delay_s:+.2f} s late, or more: correct their stamps"
        )
    spread_m = np.median(np.linalg.norm(data.z[:, :3] - data.z[:, :3].mean(axis=0), axis=1))
    if estimate.median_residual_m > _UNEXPLAINED * spread_m:
        raise ValueError(
            f"no arm with the joints {', '.join(arm.names)[:200]} explains the images: check tip "
            f"link ({arm.tip}), joint units, names and directions, and that camera and target "
            "stayed fixed"
        )
    return estimate


def _ordered(data: DataSet, arm: Kinematics) -> DataSet:
    """The data with the joints of the URDF, in its order."""
    if data.feature_frame in ("", arm.root):
        raise ValueError(f"ball or tag has the frame {data.feature_frame!r}, expected the camera's")
    if not (plausible(data.z) and plausible(arm.points_m)):
        raise ValueError(f"the images or the URDF have positions above {LARGEST:g} m: metres?")
    missing = [name for name in arm.names if name not in data.joint_names]
    if missing:
        raise ValueError(
            f"the data lack {', '.join(missing)[:200]}, which move {arm.tip} in the URDF; they "
            f"hold {', '.join(data.joint_names)[:400]}"
        )
    joints = data.joints_rad[:, [data.joint_names.index(name) for name in arm.names]]
    still = [
        name for name, size in zip(arm.names, joints.std(axis=0), strict=True) if size < _STILL
    ]
    if len(still) > len(arm.names) - 2:
        raise ValueError(f"{', '.join(still)[:200]} never moved: move every joint")
    least = 2 * (12 + data.kind.numbers) // data.kind.numbers  # twice the start's unknowns
    if len(data) < least:
        raise ValueError(f"there are {len(data)} images, expected at least {least}")
    if len(joint_path.Path(data).indices) < least:
        raise ValueError(
            f"images follow each other by more than {MAX_GAP_S:g} s: take them faster, or, if the "
            "arm rests at each, leave out their stamps"
        )
    return replace(data, joints_rad=joints, joint_names=arm.names)


def verdict(estimate: Estimate) -> tuple[str, str]:
    """``good``, ``poor`` or ``unusable``, and the reason."""
    model, deviations = estimate.model, (estimate.deviation_m, estimate.deviation_rad)
    known = (
        f"the camera is known to {1e3 * deviations[0]:.2g} mm and "
        f"{np.degrees(deviations[1]):.2g} degrees (standard deviation)"
    )
    if estimate.median_residual_m < _LEAST_RESIDUAL_M:
        return "unusable", (
            f"{model.arm.tip} explains the {model.kind.what} better than any camera sees it: are "
            "these poses that the robot computed? Name the topic of ball or tag"
        )
    zeros_rad = np.where(model.arm.prismatic > 0.0, 0.0, np.abs(estimate.mean.zeros))
    if zeros_rad.max() > _OTHER_RAD:
        return "unusable", (
            f"{model.arm.names[int(zeros_rad.argmax())]} differs from the URDF by more than 10 "
            "degrees: are joints swapped or mirrored?"
        )
    if np.all(np.less(deviations, GOOD)):
        return "good", known
    word = "poor" if np.all(np.less(deviations, USABLE)) else "unusable"
    joints = model.data.joints_rad
    still = np.flatnonzero(joints.std(axis=0) < _STILL)
    if still.size:
        return word, f"{known}: {', '.join(model.arm.names[i] for i in still)[:200]} never moved"
    if links := _links(estimate):
        right = ": are joints swapped or mirrored, is the tip link right?"
        return word, f"{known}: {links}{right if word == 'unusable' else ''}"
    spans = np.where(model.arm.prismatic > 0.0, np.inf, np.ptp(joints, axis=0))
    return word, f"{known}: move all joints further, {model.arm.names[int(spans.argmin())]} first"


def _links(estimate: Estimate) -> str:
    """Which links differ from the URDF, if any."""
    if estimate.links_evidence < _SIGMAS:
        return ""
    shifts_m = np.linalg.norm(estimate.mean.links.reshape(-1, 6)[:, :3], axis=1)
    names = estimate.model.arm.names
    # Links that the images cannot tell apart share the shift.
    alike = np.flatnonzero(shifts_m > 0.5 * shifts_m.max())
    links = " or ".join(f"{names[i]} to {names[i + 1]}" for i in alike)
    return f"from {links[:200]} the URDF is off by some {1e3 * shifts_m[alike].sum():.1f} mm"


def notes(estimate: Estimate) -> Iterator[str]:
    """What else is off."""
    mean, deviation, arm = estimate.mean, estimate.deviation, estimate.model.arm

    def off(name: str, least: float) -> np.ndarray:
        values, deviations = getattr(mean, name), getattr(deviation, name)
        return np.flatnonzero(np.abs(values) > np.maximum(_SIGMAS * deviations, least))

    for i in off("zeros", np.radians(0.2)):
        zero = -mean.zeros[i]
        size = f"{1e3 * zero:+.1f} mm" if arm.prismatic[i] else f"{np.degrees(zero):+.2f} degrees"
        yield f"the zero of {arm.names[i]} is off by {size}"
    for i in off("encoders", 0.001):
        yield f"{arm.names[i]} moves {100.0 * mean.encoders[i]:+.2f} % further than it reports"
    for name, least, words in (
        (
            "scale",
            0.002,
            "lengths {:+.2%} too long are reported: is the size of ball or tag right?",
        ),
        ("focal", 0.002, "the focal length is {:+.2%} longer than in camera_info"),
        ("radial", 0.01, "the lens has a distortion of k1 = {:.3f} that is not removed"),
    ):
        if off(name, least).size:
            yield words.format(getattr(mean, name).item())
    if _links(estimate):
        yield _links(estimate)


def report(estimate: Estimate) -> str:
    """The printed summary."""
    usable = verdict(estimate)[0] != "unusable"
    return "\n".join(["", *_numbers(estimate), *["", static_transform(estimate)][: 2 * usable]])


def _numbers(estimate: Estimate) -> list[str]:
    """Its lines for printout and picture."""
    word, reason = verdict(estimate)
    model, mean, deviation = estimate.model, estimate.mean, estimate.deviation
    position, quaternion = (
        ", ".join(f"{number:.5f}" for number in numbers) for numbers in _pose(estimate)
    )
    late_ms = round(1e3 * mean.delay_s.item(), 1) + 0.0  # no -0.0
    late = f"images stamped late: {late_ms:.1f} +- {1e3 * deviation.delay_s.item():.1f} ms"
    return [
        f"{word}: {reason}",
        f"{model.arm.root} to {model.data.feature_frame}: ({position}) m, "
        f"quaternion ({quaternion})",
        f"{model.kind.what} in {model.arm.tip}: {model.kind.text(estimate.target)}",
        *([] if model.data.still else [late]),
        f"residual {1e3 * estimate.median_residual_m:.2f} mm (median); "
        f"{len(model.measured)} images, {estimate.outliers} outliers",
        *(f"note: {note}" for note in notes(estimate)),
    ]


def _pose(estimate: Estimate) -> tuple[list[float], list[float]]:
    """The camera's position, m, and quaternion."""
    pose = estimate.base_from_camera
    return pose[:3, 3].tolist(), quaternion_from_rotation(pose[:3, :3]).tolist()


def static_transform(estimate: Estimate) -> str:
    """The command that publishes it."""
    names = ("x", "y", "z", "qx", "qy", "qz", "qw")
    numbers = [number for part in _pose(estimate) for number in part]
    words = " ".join(f"--{name} {number:.6f}" for name, number in zip(names, numbers, strict=True))
    parent, camera = estimate.model.arm.root, estimate.model.data.feature_frame
    frames = f"--frame-id {quote(parent)} --child-frame-id {quote(camera)}"
    return f"ros2 run tf2_ros static_transform_publisher {words} {frames}"


def _content(estimate: Estimate) -> dict[str, Any]:
    word, reason = verdict(estimate)
    model, (position_m, quaternion) = estimate.model, _pose(estimate)

    def numbers(values: np.ndarray | Sequence[float]) -> list[float]:
        return [float(f"{value:.6g}") for value in values]

    return {
        "parent_frame": model.arm.root,
        "camera_frame": model.data.feature_frame,
        "translation_m": position_m,
        "rotation_xyzw": quaternion,
        "covariance": [numbers(row) for row in estimate.covariance],
        "verdict": word,
        "reason": reason,
        "notes": list(notes(estimate)),
        "target_in_tip": f"{model.arm.tip}: {model.kind.text(estimate.target)}",
        "joint_names": list(model.arm.names),
        # An infinite deviation: the images do not tell.
        "unknowns": {
            name: {
                "mean": numbers(getattr(estimate.mean, name)),
                "deviation": numbers(getattr(estimate.deviation, name)),
            }
            for name in ("delay_s", "scale", "focal", "radial", "zeros", "encoders")
        },
        "images": len(model.measured),
        "outliers": estimate.outliers,
        "residual_m": float(estimate.median_residual_m),
        "static_transform": static_transform(estimate),
    }


def write(estimate: Estimate, path: Path) -> None:
    """Write the file, and a picture of the residuals beside it."""
    from matplotlib.figure import Figure  # slow, and not needed for --help

    path.write_text(yaml.safe_dump(_content(estimate), sort_keys=False), encoding="utf-8")
    figure = Figure(figsize=(10.0, 6.6), layout="constrained")
    lines = "\n".join(line for words in _numbers(estimate) for line in wrap(words, 135))
    figure.suptitle(lines, size=10, x=0.01, ha="left")
    model, mean, deviation = estimate.model, estimate.mean, estimate.deviation
    stamps_s, names = model.path.stamps_s, model.arm.names
    axes = figure.subplot_mosaic([["images", "images"], ["joints", "links"]])
    images = axes["images"]
    for name, colour, residual_m in zip("xyz", COLOURS, estimate.residual_m.T, strict=False):
        time_s = stamps_s - stamps_s[0]
        images.plot(time_s, 1e3 * residual_m, ".", markersize=3, color=colour, label=name)
    limit_mm = 6e3 * max(estimate.median_residual_m, 1e-5)
    images.set(xlabel="time (s)", ylabel="residual (mm)", ylim=(-limit_mm, limit_mm))
    images.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, markerscale=3)
    unit = np.where(model.arm.prismatic > 0.0, 1e3, np.degrees(1.0))
    zeros = (-unit * mean.zeros, unit * deviation.zeros)
    links = (part.links.reshape(-1, 6)[:, :3] for part in (mean, deviation))
    shifts = (1e3 * np.linalg.norm(part, axis=1) for part in links)
    for axis, label, rows, (values, deviations) in (
        (axes["joints"], "zero of a joint (degrees; slide: mm); no bar: assumed", names, zeros),
        (axes["links"], "shift of the link before a joint (mm); bar: deviation", names[1:], shifts),
    ):
        bars = np.where(np.isinf(deviations), 0.0, deviations)  # those zeros count as exact
        axis.errorbar(values, range(len(rows)), xerr=bars, fmt="o", capsize=3, color=COLOURS[0])
        axis.set_yticks(range(len(rows)), rows)
        axis.set(xlabel=label, ylim=(len(rows) - 0.5, -0.5))
        axis.locator_params(axis="x", nbins=6)
    for axis in axes.values():
        axis.grid(alpha=0.3)
    figure.savefig(path.with_suffix(".png"), dpi=110)
