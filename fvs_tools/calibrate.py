"""``fvs_calibrate``: where the camera is, from an arm that moved before it and the arm's URDF."""

from __future__ import annotations

import argparse
import importlib.util
import sys
from collections.abc import Sequence
from pathlib import Path
from shlex import quote
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from fvs_estimator_node.calibration import Calibration
from fvs_estimator_node.files import DataSet, load_data_set
from fvs_estimator_node.hand_eye import calibrate
from fvs_ros import console
from fvs_ros.arguments import Parser, how_to_install
from fvs_ros.paths import find_file
from fvs_ros.rotations import quaternion_from_rotation
from fvs_ros.stop import EXIT_BAD_INPUT, EXIT_FAILURE, EXIT_OK
from fvs_ros.urdf import Kinematics, kinematics, read_joints
from fvs_tools.overlay import Photograph, draw, residual_px
from fvs_tools.table import read_table


@console.reader_may_leave()
def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit code."""
    given, left_out = _parser().parse_args(argv), ""
    try:
        if not given.output.absolute().parent.is_dir():
            raise ValueError(f"the folder {given.output.absolute().parent} does not exist")
        if given.output.suffix == ".png":
            raise ValueError(f"{given.output}: expected .yaml; the picture is written beside it")
        data, photo, arm = _inputs(given)
        left_out = data.provenance.get("left_out", "")
        say = None if given.quiet else (lambda words: print(f"{words} ...", file=sys.stderr))
        found = calibrate(data, arm, given.camera_on_arm, say)
        write(found, given.output, data, photo)
    except (ValueError, OSError) as error:
        print(f"fvs_calibrate: {error}{left_out and f' ({left_out})'}", file=sys.stderr)
        return EXIT_BAD_INPUT
    print(report(found, photo))
    if left_out:
        print(f"note: {left_out}")
    print(f"written to {given.output} and {given.output.with_suffix('.png').name}")
    return EXIT_FAILURE if found.verdict[0] == "unusable" else EXIT_OK


def _inputs(given: argparse.Namespace) -> tuple[DataSet, Photograph | None, Kinematics]:
    if given.data.suffix == ".csv":
        data, hand = read_table(given.data)
        if hand is not None:
            return data, None, hand
    if not given.urdf:
        raise ValueError("expected the arm's URDF behind --urdf")
    joints, photo = read_joints(find_file(given.urdf).read_bytes()), None
    if given.data.suffix == ".npz":
        data = load_data_set(given.data)
    elif given.data.suffix != ".csv":
        if importlib.util.find_spec("rosbags") is None:
            raise ValueError(f"a bag needs rosbags: {how_to_install('record', ['rosbags'])}")
        from fvs_tools.recorded import read_data_set, read_photograph

        names = kinematics(joints, given.tip).names
        data = read_data_set(given.data, names, given.joint_states, given.seen)
        photo = read_photograph(given.data, data.feature_frame)
    return data, photo, kinematics(joints, given.tip, data.joint_names)


def _parser() -> argparse.ArgumentParser:
    parser = Parser("fvs_calibrate", __doc__)
    parser.add_argument(
        "data",
        type=Path,
        metavar="DATA",
        help="data set of the collector, .npz, a rosbag2 of any arm that moved, or a table, .csv",
    )
    parser.add_argument("--urdf", help="the arm's URDF, no xacro; a table of hand poses needs none")
    parser.add_argument(
        "--tip",
        default="",
        help="link that carries ball, tag or camera (default tool0, flange or the last)",
    )
    parser.add_argument(
        "--camera-on-arm",
        action="store_true",
        help="the tip carries the camera, and the ball or tag is at rest",
    )
    parser.add_argument(
        "-o", "--output", type=Path, default=Path("camera.yaml"), help="file to write"
    )
    parser.add_argument("--joint-states", default="", help="topic of a bag's joint states")
    parser.add_argument("--seen", default="", help="topic of a bag's ball positions or tool poses")
    parser.add_argument("--quiet", action="store_true", help="no progress")
    return parser


def report(found: Calibration, photo: Photograph | None = None) -> str:
    """The printed summary; residuals in pixels with the camera of a photograph."""
    word, reason = found.verdict
    place = ", ".join(f"{1e3 * one:.1f}" for one in found.translation_m)
    turn = ", ".join(f"{one:.5f}" for one in quaternion_from_rotation(found.rotation))
    carried = ", ".join(f"{1e3 * one:.1f}" for one in found.carried_m)
    lines = [
        "",
        f"{word}: {reason}",
        f"{found.arm.root} to {found.camera}: ({place}) mm, quaternion ({turn})",
        f"ball or tag in {found.arm.tip}: ({carried}) mm",
        # + 0.0: no negative zero
        f"images stamped late: {round(1e3 * found.delay_s, 1) + 0.0:.1f} +- "
        f"{1e3 * found.delay_deviation_s:.1f} ms; "
        f"lengths reported over true: {found.scale:.4f} +- {found.scale_deviation:.4f}",
        f"residual {1e3 * found.residual_m:.2f} mm"
        f"{'' if photo is None else f', {residual_px(found, photo.camera):.2f} px'} (median); "
        f"{len(found.stamps_s)} images, "
        f"{found.outliers} outliers",
        *(f"note: {one}" for one in found.notes()),
        *([] if word == "unusable" else ["", static_transform(found)]),
    ]
    return "\n".join(lines)


def static_transform(found: Calibration) -> str:
    """The command that publishes it."""
    names = ("x", "y", "z", "qx", "qy", "qz", "qw")
    numbers = [*found.translation_m, *quaternion_from_rotation(found.rotation)]
    words = " ".join(f"--{name} {one:.6f}" for name, one in zip(names, numbers, strict=True))
    frames = f"--frame-id {quote(found.arm.root)} --child-frame-id {quote(found.camera)}"
    return f"ros2 run tf2_ros static_transform_publisher {words} {frames}"


def urdf_joint(found: Calibration) -> str:
    """A joint that puts the camera's frame into a URDF."""
    place = " ".join(f"{one:.6f}" for one in found.translation_m)
    turn = " ".join(f"{one:.6f}" for one in Rotation.from_matrix(found.rotation).as_euler("xyz"))
    camera, parent = quoteattr(found.camera), quoteattr(found.arm.root)
    return (
        f"<link name={camera}/>\n"
        f'<joint name={quoteattr(found.camera + "_joint")} type="fixed">\n'
        f"  <parent link={parent}/>\n  <child link={camera}/>\n"
        f'  <origin xyz="{place}" rpy="{turn}"/>\n</joint>\n'
    )


def content(found: Calibration, photo: Photograph | None = None) -> dict[str, Any]:
    """What is written to the file."""
    word, reason = found.verdict

    def numbers(values: np.ndarray | Sequence[float]) -> list[Any]:
        return [float(f"{one:.9g}") for one in values]

    def known(values: np.ndarray) -> dict[str, float | None]:
        """By joint; None for a zero that the images do not tell."""
        told = np.isfinite(found.zeros_deviation_rad).tolist()
        by_joint = zip(found.arm.names, numbers(values), told, strict=True)
        return {name: one if is_told else None for name, one, is_told in by_joint}

    return {
        "parent_frame": found.arm.root,
        "camera_frame": found.camera,
        "translation_m": numbers(found.translation_m),
        "rotation_xyzw": numbers(quaternion_from_rotation(found.rotation)),
        "covariance": [numbers(row) for row in found.covariance],
        "verdict": word,
        "reason": reason,
        "notes": found.notes(),
        "carried_m": numbers(found.carried_m),
        "carried_rotation_xyzw": None
        if found.carried_rotation is None
        else numbers(quaternion_from_rotation(found.carried_rotation)),
        "image_delay_s": float(f"{found.delay_s:.6g}"),
        "image_delay_deviation_s": float(f"{found.delay_deviation_s:.3g}"),
        "length_scale": float(f"{found.scale:.6f}"),
        "length_scale_deviation": float(f"{found.scale_deviation:.3g}"),
        "focal_scale": float(f"{found.focal:.6f}"),
        "focal_scale_deviation": float(f"{found.focal_deviation:.3g}"),
        "distortion_k1": float(f"{found.radial:.4g}"),
        "distortion_k1_deviation": float(f"{found.radial_deviation:.3g}"),
        "encoder_scales": dict(zip(found.arm.names, numbers(1.0 + found.encoders), strict=True)),
        "joint_zeros_rad": known(found.zeros_rad),
        "joint_zeros_deviation_rad": known(found.zeros_deviation_rad),
        "displaced_joint": None if found.displaced is None else str(found.displaced),
        "outliers": found.outliers,
        "residual_m": float(f"{found.residual_m:.4g}"),
        "residual_px": None if photo is None else float(f"{residual_px(found, photo.camera):.3g}"),
        "static_transform": static_transform(found),
        "urdf": urdf_joint(found),
    }


def write(found: Calibration, path: Path, data: DataSet, photo: Photograph | None = None) -> None:
    """Write the file, and the picture beside it: over a photograph, if there is one."""
    path.write_text(yaml.safe_dump(content(found, photo), sort_keys=False), encoding="utf-8")
    draw(found, data, photo).savefig(path.with_suffix(".png"), dpi=110)


if __name__ == "__main__":
    sys.exit(main())
