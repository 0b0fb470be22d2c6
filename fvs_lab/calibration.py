"""The camera's pose from a minute of motion, beside the classic hand-eye solvers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from fvs_detector_node.tag_pose import TagPose
from fvs_detector_node.tags import Tag
from fvs_estimator_node.calibration import Calibration
from fvs_estimator_node.collecting import CollectorConfig
from fvs_estimator_node.files import DataSet
from fvs_estimator_node.hand_eye import calibrate
from fvs_estimator_node.hand_eye_start import registered
from fvs_lab import experiment as lab
from fvs_lab import figures as draw
from fvs_lab.arms import collect, collected
from fvs_lab.results import Results
from fvs_lab.trials import BOX_RAD, HOME_RAD, Conditions, simulation_of
from fvs_ros.chain import SerialChain
from fvs_ros.kinds.ball import Ball
from fvs_ros.kinds.pose import Pose
from fvs_ros.rotations import rotation_from_vector, vector_from_rotation_rad
from fvs_ros.urdf import Kinematics, kinematics, read_joints
from fvs_sim_node.robot import ROBOTS, robot_of
from fvs_sim_node.simulation import Simulation
from fvs_tools.overlay import arm_px

#: Duration of the motion, s, and others that are tried.
MOTION_S, OTHERS_S = 60.0, (15.0, 30.0)
#: Errors of the joints' zeros, degrees, of random sign.
ZEROS_DEG = (0.0, 1.0)
#: Poses that are taught for the classic solvers, and the board that they see.
TAUGHT, BOARD = 20, Tag(tag_size_m=0.075, tag_layout="plate")
LEAST_SQUARES = "least squares with zeros"
SOLVERS = {
    "Tsai": cv2.CALIB_HAND_EYE_TSAI,
    "Park": cv2.CALIB_HAND_EYE_PARK,
    "Horaud": cv2.CALIB_HAND_EYE_HORAUD,
    "Andreff": cv2.CALIB_HAND_EYE_ANDREFF,
    "Daniilidis": cv2.CALIB_HAND_EYE_DANIILIDIS,
}
#: Python lacks it in OpenCV 5.0.0, by a fault of the binding that is mended upstream (pull request
#: 29584); without it, the solvers have no rows.
_SOLVE: Any = getattr(cv2, "calibrateHandEye", None)
#: Other conditions, with a ball and an exact URDF, and other arms before an exact camera.
OTHERS = {
    "camera at 0.8 m": Conditions(position_noise_m=0.0, camera_distance_m=0.8),
    "camera at 1.8 m": Conditions(position_noise_m=0.0, camera_distance_m=1.8),
    "1 mm more noise": Conditions(position_noise_m=0.001),
    "joints: 0.2 mrad of noise": Conditions(position_noise_m=0.0, encoder_noise_rad=2e-4),
    "focal length 1 % too long": Conditions(position_noise_m=0.0, focal_error=0.01),
}
ARMS = ("iiwa", "xarm6", "panda")
#: Largest errors, m and degrees: of an exact URDF, and with errors of the zeros.
EXACT, WITH_ZEROS = (0.001, 0.1), (0.003, 0.3)
#: Quantile of chi squared with six degrees of freedom, for 95 %.
_ELLIPSOID = 12.592
_TURNS = -1.0, 1.0


@lru_cache(maxsize=1)
def arm() -> Kinematics:
    """Of the UR5's URDF."""
    return kinematics(read_joints(robot_of("ur5").file().read_text("utf-8")))


def conditions(feature: str, tag: Tag | None = None) -> Conditions:
    """Rendered images, with the camera's noise."""
    return Conditions(feature, position_noise_m=0.0, tag=tag or Tag())


def zeros_rad(seed: int, size_deg: float) -> np.ndarray:
    """Errors of the joints' zeros: what has to be added to what is reported."""
    signs = np.random.default_rng([seed, 7]).choice(_TURNS, len(HOME_RAD))
    return np.asarray(np.radians(size_deg) * signs)


def errors(
    simulation: Simulation, zeros: np.ndarray, rotation: np.ndarray, place_m: np.ndarray
) -> np.ndarray:
    """Of a camera's pose in the arm's frame: place, m, and turn, rad, (6,).

    An error of the first joint's zero turns the arm's frame as such.
    """
    turn = rotation_from_vector(-zeros[0] * arm().axes[0])
    camera = simulation.camera
    off = vector_from_rotation_rad(rotation @ (turn @ camera.rotation).T)
    return np.append(place_m - turn @ camera.position_m, off)


def _row(off: np.ndarray, **columns: Any) -> dict[str, Any]:
    way_m, turn_rad = (float(np.linalg.norm(one)) for one in np.split(off, 2))
    return {**columns, "place_m": way_m, "turn_deg": float(np.degrees(turn_rad))}


def _inside(found: Calibration, off: np.ndarray) -> bool:
    """Whether the truth is within the 95 % ellipsoid."""
    return bool(off @ np.linalg.solve(found.covariance, off) < _ELLIPSOID)


def _asked(feature: str, seed: int) -> CollectorConfig:
    return CollectorConfig(
        duration_s=MOTION_S,
        seed=seed,
        feature=feature,
        joint_range_rad=(0.5,) * len(HOME_RAD),
        max_joint_velocity_rad_s=0.65,
    )


def by_motion(task: tuple[int, str]) -> list[dict[str, Any]]:
    """Collect as the collector does, and calibrate: a row for each size of zeros and duration."""
    seed, feature = task
    simulation = simulation_of(conditions(feature))
    data = collect(simulation, _asked(feature, seed))
    rows = []
    for size_deg in ZEROS_DEG:
        zeros = zeros_rad(seed, size_deg)
        for duration_s in (*OTHERS_S, MOTION_S):
            some = _first(data, duration_s)
            found = calibrate(replace(some, joints_rad=some.joints_rad - zeros), arm())
            off = errors(simulation, zeros, found.rotation, found.translation_m)
            known = np.isfinite(found.zeros_deviation_rad)
            rows.append(
                _row(
                    off,
                    scheme=f"motion, {feature}",
                    motion_s=duration_s,
                    zeros_deg=size_deg,
                    seed=seed,
                    inside=_inside(found, off),
                    zero_deg=float(np.degrees(np.abs((found.zeros_rad - zeros)[known]).max())),
                )
            )
    return rows


def elsewhere(task: tuple[str, int]) -> dict[str, Any]:
    """Calibrate under other conditions, or another arm: a row."""
    name, seed = task
    if name in ARMS:
        robot = robot_of(name)
        kin = kinematics(read_joints(robot.file().read_text("utf-8")), robot.ball_link)
        simulation, data = collected(name, MOTION_S, seed)
    else:
        kin, simulation = arm(), simulation_of(OTHERS[name])
        data = collect(simulation, _asked(Ball.name, seed))
    found = calibrate(data, kin)
    off = errors(simulation, np.zeros(1), found.rotation, found.translation_m)
    return _row(off, scheme=name, part="elsewhere", seed=seed, inside=_inside(found, off))


def _first(data: DataSet, duration_s: float) -> DataSet:
    some = data.stamps_s < data.stamps_s[0] + duration_s
    columns = ("stamps_s", "joints_rad", "ball_m", "segment")
    return replace(data, **{name: getattr(data, name)[some] for name in columns})


def by_solvers(seed: int) -> list[dict[str, Any]]:
    """Teach poses before a rendered board, and give them to OpenCV's solvers."""
    simulation, rng = simulation_of(conditions(Pose.name, BOARD)), np.random.default_rng([seed, 8])
    joints: list[np.ndarray] = []
    boards: list[tuple[np.ndarray, np.ndarray]] = []
    while len(joints) < TAUGHT:
        one = HOME_RAD + rng.uniform(-1.0, 1.0, HOME_RAD.size) * BOX_RAD
        simulation.reset(one, seed)
        seen = simulation.look().detection
        if isinstance(seen, TagPose):
            joints.append(one)
            boards.append((seen.rotation, seen.position_m))
    rows = []
    for size_deg in ZEROS_DEG:
        zeros = zeros_rad(seed, size_deg)
        reported = np.array(joints) - zeros
        off = errors(simulation, zeros, *least_squares_pose(reported, boards))
        rows.append(_row(off, scheme=LEAST_SQUARES, zeros_deg=size_deg, seed=seed))
        turns, places = arm().tip_at(reported)  # rows: the tip's axes
        # The solvers are for a camera in the hand; for one beside it, the base moves as the tip
        # sees it.
        shifts = [-turn @ place for turn, place in zip(turns, places, strict=True)]
        for name, method in SOLVERS.items() if _SOLVE else ():
            rotation, place = _SOLVE(
                list(turns), shifts, *map(list, zip(*boards, strict=True)), method=method
            )
            off = errors(simulation, zeros, rotation, place.ravel())
            rows.append(_row(off, scheme=name, zeros_deg=size_deg, seed=seed))
    return rows


def least_squares_pose(
    reported_rad: np.ndarray, boards: list[tuple[np.ndarray, np.ndarray]]
) -> tuple[np.ndarray, np.ndarray]:
    """A camera's rotation and place, m, by least squares with the joints' zeros as unknowns.

    Of boards at reported joints, rad, (k, n), and the rotations and places, m, that images show.
    Turns count as shifts over 0.3 m. The zero of the first joint counts as the base's.
    """
    pose, kin = Pose(0.3), arm()
    seen = np.array([pose.of_body(place, rotation) for rotation, place in boards])
    start = registered(
        DataSet(np.arange(len(seen)), reported_rad, seen, np.arange(len(seen)), kin.names,
                feature=Pose.name), kin,
    )  # fmt: skip

    def chain(values: np.ndarray) -> SerialChain:
        turn, middle = rotation_from_vector(values[:3]), seen[:, :3].mean(axis=0)
        moved = start.moved(turn, middle - turn @ middle + values[3:6])
        return replace(moved, feature_m=pose.retract(moved.feature_m, values[6:12]))

    def off(values: np.ndarray) -> np.ndarray:
        zeros = np.append(0.0, values[12:])
        return np.ravel(pose.weights * (chain(values).position(reported_rad + zeros) - seen))

    found = chain(least_squares(off, np.zeros(11 + len(kin.names))).x)
    rotation = Rotation.align_vectors(kin.axes, found.axes)[0].as_matrix()
    return rotation, kin.points_m[0] - rotation @ found.points_m[0]


def measure(context: lab.Context) -> lab.Found:
    """Calibrate by motion and by taught poses, with many seeds."""
    seeds = range(1, 1 + context.count(20, 1))
    tasks = [(seed, feature) for feature in (Ball.name, Pose.name) for seed in seeds]
    motion = context.map(by_motion, tasks[:1] if context.quick else tasks, "motion")
    names = (*OTHERS, *(name for name in ARMS if ROBOTS[name].installed))
    other = [(name, seed) for name in names for seed in seeds[: max(1, len(seeds) // 4)]]
    others = context.map(elsewhere, other[:1] if context.quick else other, "elsewhere")
    taught = context.map(by_solvers, seeds, "taught poses")
    rows = [row for some in (*motion, *taught, others) for row in some]
    facts = {"count": len(seeds), "opencv": cv2.__version__, "solvers": bool(_SOLVE)}
    rgb, seen_px, off_px = overlay()
    drawn = {"rgb": rgb, "seen_px": seen_px, "off_px": float(off_px.max())}
    return lab.Found(Results(rows), {**facts, **drawn}, facts)


def claims(found: lab.Found) -> Iterator[lab.Claim]:
    """Accuracy, honesty, and the classic solvers."""
    for size_deg, limits in zip(ZEROS_DEG, (EXACT, WITH_ZEROS), strict=True):
        runs = found.runs.where(zeros_deg=size_deg, motion_s=MOTION_S)
        good = [row["place_m"] < limits[0] and row["turn_deg"] < limits[1] for row in runs]
        yield lab.ours(
            "exact" if size_deg == 0.0 else "zeros", lab.kept("runs", sum(good), len(good), 1.0)
        )
        best = found.runs.where(zeros_deg=size_deg).those(
            lambda row: row["scheme"] in (LEAST_SQUARES, *SOLVERS)
        )
        solvers, parts = best.groups("scheme").values(), []
        for column, label, factor in (("place_m", "place, mm", 1e3), ("turn_deg", "turn, °", 1.0)):
            if solvers:
                least = float(f"{min(one.median(column).value for one in solvers):.3g}")
                parts.append(lab.below(label, runs.median(column), least, factor))
        if parts:
            yield lab.ours("solvers", *parts, zeros=size_deg)
    runs = found.runs.where(motion_s=MOTION_S)
    inside = sum(row["inside"] for row in runs)
    yield lab.ours("honest", lab.kept("runs", inside, len(runs), 0.9))


_COLUMNS = ("place_m", "place_m:all", "turn_deg", "turn_deg:all", "zero_deg:all", "inside:of")


def _full(runs: Results) -> Results:
    """All that had the whole motion, and the solvers."""
    some = runs.those(lambda row: "zeros_deg" in row)
    return some.those(lambda row: row.get("motion_s", MOTION_S) == MOTION_S)


TABLES = (
    lab.TableOf(
        "motion",
        ("scheme", "motion_s", "zeros_deg"),
        _COLUMNS,
        rows=lambda runs: runs.those(lambda row: "motion_s" in row),
    ),
    lab.TableOf("solvers", ("scheme", "zeros_deg"), _COLUMNS[:4], rows=_full),
    lab.TableOf("elsewhere", ("scheme",), (*_COLUMNS[:4], "inside:of"), {"part": "elsewhere"}),
)


def overlay() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """An image, the arm of the URDF drawn through a calibration, px, and its errors, px."""
    simulation = simulation_of(conditions(Ball.name))
    asked = CollectorConfig(duration_s=MOTION_S, seed=1)
    found = calibrate(collect(simulation, asked), arm())
    simulation.reset(HOME_RAD)
    simulation.full_frames = True
    frame = simulation.look().frame
    simulation.full_frames = False
    assert frame is not None
    camera = simulation.camera
    exact = replace(
        found, rotation=camera.rotation, translation_m=camera.position_m, focal=1.0,
        zeros_rad=np.zeros(len(HOME_RAD)),
    )  # fmt: skip
    seen, true = (arm_px(one, HOME_RAD, simulation.intrinsics) for one in (found, exact))
    return frame.rgb, seen, np.linalg.norm(seen - true, axis=1)


def figures(found: lab.Found) -> Iterator[lab.Drawn]:
    """The arm of the URDF over the camera's image."""
    seen_px = found.facts["seen_px"]
    figure, ((axis,),) = draw.grid(1, 1, (8.0, 6.0))
    axis.imshow(found.facts["rgb"])
    axis.plot(seen_px[:, 0], seen_px[:, 1], "o-", color="#00c853", linewidth=2.0, markersize=5)
    axis.set(xticks=[], yticks=[])
    axis.grid(visible=False)
    yield "overlay", figure, {}


EXPERIMENT = lab.Experiment("calibration", measure, claims, TABLES, figures, globals())
