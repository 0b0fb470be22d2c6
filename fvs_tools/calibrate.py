"""``fvs_calibrate``: where the camera is, from an arm that moved before it and the arm's URDF."""

from __future__ import annotations

import argparse
import importlib.util
import sys
from collections.abc import Sequence
from pathlib import Path

from fvs_estimator_node.files import DataSet, load_data_set
from fvs_ros import console
from fvs_ros.arguments import Parser, how_to_install
from fvs_ros.paths import find_file, output_file
from fvs_ros.stop import EXIT_BAD_INPUT, EXIT_FAILURE, EXIT_OK
from fvs_ros.urdf import read_joints
from fvs_tools.calibration import calibrate, report, verdict, write
from fvs_tools.kinematics import Kinematics, kinematics
from fvs_tools.table import read_table


@console.reader_may_leave()
def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit code."""
    arguments, left_out = _parser().parse_args(argv), ""
    try:
        output = output_file(arguments.output, ".yaml", ".yml")  # the picture is beside it
        data, arm = _inputs(arguments)
        left_out = data.provenance.get("left_out", "")
        estimate = calibrate(data, arm, arguments.camera_on_arm)
        write(estimate, output)
    except (ValueError, OSError) as error:
        print(f"fvs_calibrate: {error}{left_out and f' ({left_out})'}", file=sys.stderr)
        return EXIT_BAD_INPUT
    print(report(estimate))
    if left_out:
        print(f"note: {left_out}")
    print(f"written to {output} and {output.with_suffix('.png').name}")
    return EXIT_FAILURE if verdict(estimate)[0] == "unusable" else EXIT_OK


def _inputs(arguments: argparse.Namespace) -> tuple[DataSet, Kinematics]:
    if arguments.data.suffix == ".csv":
        data, hand = read_table(arguments.data)
        if hand is not None:
            return data, hand
    if not arguments.urdf:
        raise ValueError("expected the arm's URDF behind --urdf")
    joints = read_joints(find_file(arguments.urdf).read_bytes())
    if arguments.data.suffix == ".npz":
        data = load_data_set(arguments.data)
    elif arguments.data.suffix != ".csv":
        if importlib.util.find_spec("rosbags") is None:
            raise ValueError(f"a bag needs rosbags: {how_to_install('record', ['rosbags'])}")
        from fvs_tools.recorded import read_data_set

        names = kinematics(joints, arguments.tip).names
        data = read_data_set(arguments.data, names, arguments.joint_states, arguments.seen)
    return data, kinematics(joints, arguments.tip, data.joint_names)


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
    return parser


if __name__ == "__main__":
    sys.exit(main())
