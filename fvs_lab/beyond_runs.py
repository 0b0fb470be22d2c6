"""Runs beyond the paper: a minute of data, a camera that is moved far, a target that moves."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np

from fvs_controller_node.reasons import State
from fvs_estimator_node.chain_fit import fit_chain
from fvs_estimator_node.dataset import DataSet, data_set_of
from fvs_estimator_node.distilling import train_structured
from fvs_estimator_node.motion import MotionConfig, RandomMotion
from fvs_estimator_node.training import TrainingOptions, train
from fvs_lab.contestants import variant
from fvs_lab.outcome import settling_columns
from fvs_lab.results import Results
from fvs_lab.trials import (
    BOX_RAD,
    HOME_RAD,
    PRELUDE_S,
    Bump,
    Case,
    Conditions,
    Vector,
    make_cases,
    relative_errors,
    sees,
    simulation_of,
)
from fvs_ros.timeline import Sample, Timeline
from fvs_tools.closed_loop import ClosedLoop

# ---- a minute of motion ---------------------------------------------------------------------

MINUTE_S = 60.0
#: The images of a seed are stamped late by as much as this, drawn evenly, s.
MOST_LATE_S = 0.1
#: How the paper trains, and what is left of it where torch is not installed.
PAPERS_METHOD = "varpro" if find_spec("torch") else "ridge"

#: What may err in a plant, and how its conditions differ: the calibration by as much as that of a
#: depth camera off the shelf, encoders and drives far worse than a UR's.
ERRING: Mapping[str, Mapping[str, Any]] = {
    "nothing": {},
    "focal length told 1 % too long": {"focal_error": 0.01},
    "focal length told 1 % too short": {"focal_error": -0.01},
    "depths told 0.5 % too large": {"depth_error": 0.005},
    "0.2 mrad of noise on the joints": {"encoder_noise_rad": 0.0002},
    "drives that lag by 100 ms": {"joint_lag_s": 0.1},
}


@dataclass(frozen=True)
class Minute:
    """A recording to learn from."""

    #: Of the motion, the noise and the lateness.
    seed: int
    #: Length of the motion, s.
    duration_s: float
    conditions: Conditions
    #: Joints at which Jacobians are judged, rad, as of :func:`draw_places`.
    places: Mapping[str, np.ndarray]
    #: How the paper's networks are trained.
    papers_method: str = PAPERS_METHOD


def draw_places(seed: int, count: int) -> dict[str, np.ndarray]:
    """Draw joints of ``box`` M, and of the whole ``workspace`` that the camera sees, rad."""
    rng = np.random.default_rng(seed)
    box = HOME_RAD + rng.uniform(-1.0, 1.0, (count, HOME_RAD.size)) * BOX_RAD
    simulation = simulation_of(Conditions())
    seen: list[np.ndarray] = []
    while len(seen) < count:
        joints = rng.uniform(-np.pi, np.pi, HOME_RAD.size)
        simulation.reset(joints)
        if sees(simulation):
            seen.append(joints)
    return {"box": box, "workspace": np.array(seen)}


def record(minute: Minute) -> tuple[DataSet, float]:
    """Let the simulated arm move as the collector does, and record as it does.

    Returns
    -------
    DataSet
        Ball positions and the joints at the stamps.
    float
        How late the images are stamped, s.
    """
    rng = np.random.default_rng([minute.seed, 1])
    late_s = float(rng.uniform(0.0, MOST_LATE_S))
    simulation = simulation_of(minute.conditions)
    simulation.reset(HOME_RAD, minute.seed)
    motion = RandomMotion(HOME_RAD, MotionConfig(minute.duration_s), rng)
    matcher = Timeline()
    samples: list[Sample] = []
    joints = simulation.joints_rad
    while simulation.time_s < minute.duration_s:
        simulation.command(motion.command(simulation.time_s, joints))
        out = simulation.advance()
        joints = out.joints_rad
        samples += matcher.add_joints(out.time_s, joints)
        for seen in out.observations:
            if seen.detection is not None:
                samples += matcher.add_ball(seen.stamp_s + late_s, seen.detection.position_m)
    return data_set_of(samples), late_s


def learn(minute: Minute) -> dict[str, Any]:
    """Record a minute, fit, distill and train, and compare with the true Jacobian.

    Returns
    -------
    dict
        A row: relative errors of the Jacobians (medians over the places) of the chain, of the
        networks distilled from it and of those that the paper's training makes of the same data, in
        box M and over the workspace; ``fit_s`` of one core for chain and distillation; how late the
        images were stamped, and what the fit says.
    """
    data, late_s = record(minute)
    began_s = time.process_time()
    distilled = train_structured(data, seed=minute.seed)
    fit_s = time.process_time() - began_s
    trained = train(data, TrainingOptions(method=minute.papers_method, seed=minute.seed))
    simulation = simulation_of(minute.conditions)
    row = {
        "part": "minute",
        "seed": minute.seed,
        "images": len(data),
        "fit_s": fit_s,
        "late_s": late_s,
        "found_late_s": distilled.errors["time_offset_s"],
        "late_error_s": abs(distilled.errors["time_offset_s"] - late_s),
    }
    assert distilled.chain is not None
    for where, joints in minute.places.items():
        true = np.array([simulation.true_jacobian(one) for one in joints])
        for who, model in (
            ("chain", distilled.chain),
            ("distilled", distilled.model),
            ("paper", trained.model),
        ):
            errors = relative_errors(model.jacobian(joints), true)
            row[f"{who}_{where}"] = float(np.median(errors))
    return row


def assess(task: tuple[str, Minute]) -> dict[str, Any]:
    """Record a minute of a plant, fit a chain, and compare its error with what the fit says.

    Returns
    -------
    dict
        A row: what errs, the error ``stated`` by the fit, and the errors against the Jacobian of
        where the camera sees the ball (``seen``) and of where it is (``metric``), medians in box M.
    """
    plant, minute = task
    fit = fit_chain(record(minute)[0])
    simulation = simulation_of(minute.conditions)
    joints = minute.places["box"]
    metric = np.array([simulation.true_jacobian(one) for one in joints])
    # how the camera errs is linear
    seen = np.stack([simulation.as_seen(one) for one in np.eye(metric.shape[1])], axis=1) @ metric
    found = fit.chain.jacobian(joints)
    errors = {
        "stated": float(np.median(fit.jacobian_deviation(joints))),
        "seen": float(np.median(relative_errors(found, seen))),
        "metric": float(np.median(relative_errors(found, metric))),
    }
    honesty = errors["stated"] / errors["seen"]
    return {"part": "assessment", "plant": plant, **errors, "honesty": honesty}


# ---- moved cameras --------------------------------------------------------------------------

TURN_DEG, SHIFT_M = 45.0, 0.1
#: How far the axis of the turn is off the optical axis, a standard deviation of each part.
_TILT = 0.1
#: In motion the blow comes this time after the target, s.
STRUCK_AFTER_S = 0.3
#: How long the camera is carried, and how long the arm stands before and after, s.
CARRIED_S, _STOPPED_S = 2.0, 0.5
#: To the first target; at rest there after a blow; from the second target on, s.
_FIRST_S, REST_S, SECOND_S = 1.6, 1.0, 3.5
#: A run after a blow to the camera keeps its pace if it takes no longer than this ratio.
KEPT = 1.2

UNDISTURBED, AT_REST, IN_MOTION = "undisturbed", "between two targets", "in mid-motion"
CARRIED = f"within {CARRIED_S:g} s while the arm is stopped"
#: When the camera moves; the first is never.
MOMENTS = (UNDISTURBED, AT_REST, CARRIED, IN_MOTION)


@dataclass(frozen=True)
class Journey:
    """From the goal of a case to its start, a rest, and back, with a blow to the camera."""

    #: The contestant, and the two ends.
    name: str
    case: Case
    #: How the camera moves (its time does not count), and when, one of ``MOMENTS``.
    bump: Bump
    moment: str
    conditions: Conditions


def draw_journeys(
    count: int, seed: int, names: Sequence[str], conditions: Conditions
) -> list[Journey]:
    """Draw cases and blows after which the ball is still seen; for each all moments and names."""
    rng = np.random.default_rng(seed)
    pairs: list[tuple[Case, Bump]] = []
    while len(pairs) < count:
        case = make_cases(f"C{len(pairs) + 1}-", 1, int(rng.integers(2**31)))[0]
        axis = np.append(_TILT * rng.normal(size=2), rng.choice([-1.0, 1.0]))
        shift = rng.normal(size=3)
        bump = Bump(STRUCK_AFTER_S, _vector(axis, TURN_DEG), _vector(shift, SHIFT_M))
        if _seen_after(bump, case):
            pairs.append((case, bump))
    return [
        Journey(name, case, bump, moment, conditions)
        for case, bump in pairs
        for moment in MOMENTS
        for name in names
    ]


def _vector(direction: np.ndarray, length: float) -> Vector:
    x, y, z = (length * direction / np.linalg.norm(direction)).tolist()
    return (x, y, z)


def _seen_after(bump: Bump, case: Case) -> bool:
    """Whether the struck camera sees the ball at both ends and between them."""
    simulation = simulation_of(Conditions())
    bump.strike(simulation)
    between = 0.5 * (np.array(case.start_rad) + np.array(case.goal_rad))
    for joints in (case.start_rad, case.goal_rad, between):
        simulation.reset(joints)
        if not sees(simulation):
            return False
    return True


def run_journey(journey: Journey) -> dict[str, Any]:
    """Run one journey; a row, whose ``to_5mm_s`` counts from the second target on."""
    settled_s = _journey_s(journey)
    return {
        "part": "camera",
        "scheme": journey.name,
        "moment": journey.moment,
        "case": journey.case.name,
        "to_5mm_s": settled_s,
    }


def _journey_s(journey: Journey) -> float:
    simulation = simulation_of(journey.conditions)
    simulation.reset(journey.case.start_rad)
    first_m = simulation.world.ball_position()
    simulation.reset(journey.case.goal_rad, journey.case.seed)
    second_m = simulation.world.ball_position()
    loop = variant(journey.name).trial(journey.case, journey.conditions).loop(simulation)
    loop.run(PRELUDE_S)
    loop.set_target(simulation.camera.to_camera(first_m))
    loop.run(_FIRST_S)
    if journey.moment == AT_REST:
        journey.bump.strike(simulation)
    elif journey.moment == CARRIED:
        _carry(journey.bump, loop)
    if journey.moment in (AT_REST, CARRIED):
        loop.set_target(simulation.camera.to_camera(first_m))
    if journey.moment == CARRIED and not loop.loop.supervisor.start(simulation.time_s)[0]:
        return math.inf  # the ball was lost on the way to the first target, as undisturbed
    loop.run(REST_S)
    loop.set_target(simulation.camera.to_camera(second_m))
    errors_m = []
    struck = round(STRUCK_AFTER_S / loop.period_s)
    for tick in range(round(SECOND_S / loop.period_s)):
        if tick == struck and journey.moment == IN_MOTION:
            journey.bump.strike(simulation)
            loop.set_target(simulation.camera.to_camera(second_m))
        loop.tick()
        errors_m.append(float(np.linalg.norm(simulation.world.ball_position() - second_m)))
    times_s = loop.period_s * np.arange(1, len(errors_m) + 1)
    return settling_columns(times_s, np.array(errors_m))["to_5mm_s"]


def _carry(bump: Bump, loop: ClosedLoop) -> None:
    """Stop the arm and carry the camera evenly to where a blow would throw it."""
    loop.loop.supervisor.stop()
    loop.run(_STOPPED_S)
    ticks = round(CARRIED_S / loop.period_s)
    for _ in range(ticks):
        bump.strike(loop.simulation, ticks)
        loop.tick()
    loop.run(_STOPPED_S)


def with_slowdown(arrivals: Results) -> Results:
    """Rows with ``slowdown``: settling time over that of the undisturbed run of the same case.

    From the last target on: in mid-motion that is the second one given anew, which is compared
    with what was left of the undisturbed run. Infinite where nothing was left, or the undisturbed
    run never settled. ``kept``: whether it is at most ``KEPT``.
    """
    calm = arrivals.where(moment=UNDISTURBED).groups("scheme", "case")
    rows = []
    for row in arrivals:
        before_s = STRUCK_AFTER_S if row["moment"] == IN_MOTION else 0.0
        left_s = calm[row["scheme"], row["case"]].rows[0]["to_5mm_s"] - before_s
        comparable = 0.0 < left_s < math.inf
        slowdown = (row["to_5mm_s"] - before_s) / left_s if comparable else math.inf
        rows.append({**row, "slowdown": slowdown, "kept": slowdown <= KEPT})
    return Results(rows)


# ---- moving targets -------------------------------------------------------------------------

LINE, CIRCLE = "line", "circle"
RADIUS_M = 0.08
SPEEDS_M_S = (0.02, 0.05, 0.1, 0.2, 0.3)
#: Least and largest distance of a line's ends, m.
_LINE_M = (0.45, 0.6)
#: Longest run, and its beginning, which does not count, by kind, s.
LONGEST_S = {LINE: 3.0, CIRCLE: 4.0}
START_S = {LINE: 0.8, CIRCLE: 1.5}
#: The target is given as often as a camera would, Hz.
RATE_HZ = 30.0


@dataclass(frozen=True)
class Path:
    """Where a target goes, camera frame."""

    #: ``line`` or ``circle``.
    kind: str
    #: Joints whose ball is where it begins, rad.
    start_rad: tuple[float, ...]
    #: The beginning, m; unit vectors: a line goes along the first, a circle is in the plane of both
    #: and begins along the second.
    origin_m: tuple[float, ...]
    first: tuple[float, ...]
    second: tuple[float, ...]
    #: After which a line ends, m.
    length_m: float
    #: Of the noise.
    seed: int

    def at(self, way_m: float) -> np.ndarray:
        """The target after a length of its way, m, shape (3,)."""
        origin, first = np.array(self.origin_m), np.array(self.first)
        if self.kind == LINE:
            return origin + way_m * first
        angle = way_m / RADIUS_M
        turned = (np.cos(angle) - 1.0) * first + np.sin(angle) * np.array(self.second)
        return origin + RADIUS_M * turned

    def duration_s(self, speed_m_s: float) -> float:
        """How long it is followed, s."""
        return min(LONGEST_S[self.kind], self.length_m / speed_m_s)


@dataclass(frozen=True)
class Pursuit:
    """A target to be followed by a contestant, with or without feed-forward of its motion."""

    name: str
    path: Path
    speed_m_s: float
    feed_forward: bool
    conditions: Conditions


def draw_paths(count: int, seed: int) -> list[Path]:
    """Draw lines between places in box M, and as many circles in any plane about home."""
    rng = np.random.default_rng(seed)
    simulation = simulation_of(Conditions())

    def ball_m(joints_rad: Sequence[float]) -> np.ndarray:
        simulation.reset(joints_rad)
        return simulation.true_ball_position()

    home = tuple(HOME_RAD.tolist())
    paths = []
    for case in make_cases("L", count, seed, *_LINE_M):
        start_m, goal_m = ball_m(case.start_rad), ball_m(case.goal_rad)
        length_m = float(np.linalg.norm(goal_m - start_m))
        along = tuple(((goal_m - start_m) / length_m).tolist())
        paths.append(
            Path(LINE, case.start_rad, tuple(start_m.tolist()), along, along, length_m, case.seed)
        )
    for line in paths[:count]:
        plane = np.linalg.qr(rng.normal(size=(3, 2)))[0]
        first, second = (tuple(vector.tolist()) for vector in plane.T)
        origin = tuple(ball_m(home).tolist())
        paths.append(Path(CIRCLE, home, origin, first, second, np.inf, line.seed))
    return paths


def run_pursuit(pursuit: Pursuit) -> dict[str, Any]:
    """Follow one target.

    Returns
    -------
    dict
        A row; ``rms_m`` is the distance of the true ball from the target after the start, m,
        infinite for an arm that the supervisor held.
    """
    path = pursuit.path
    simulation = simulation_of(pursuit.conditions)
    simulation.reset(path.start_rad, path.seed)
    one = variant(pursuit.name, target_feed_forward=pursuit.feed_forward)
    case = Case("", path.start_rad, path.start_rad, path.seed)
    loop = one.trial(case, pursuit.conditions).loop(simulation)
    loop.run(PRELUDE_S)
    squares_m2, next_s, held = [], 0.0, False
    for tick in range(round(path.duration_s(pursuit.speed_m_s) / loop.period_s)):
        now_s = tick * loop.period_s
        if now_s >= next_s:
            loop.set_target(path.at(pursuit.speed_m_s * now_s))
            next_s += 1.0 / RATE_HZ
        held = loop.tick().state is not State.SERVOING
        if now_s >= START_S[path.kind]:
            target_m = path.at(pursuit.speed_m_s * (now_s + loop.period_s))
            error_m = simulation.true_ball_position() - target_m
            squares_m2.append(float(error_m @ error_m))
    return {
        "part": "tracking",
        "scheme": pursuit.name,
        "path": path.kind,
        "seed": path.seed,
        "speed_m_s": pursuit.speed_m_s,
        "feed_forward": pursuit.feed_forward,
        "rms_m": float("inf") if held else float(np.sqrt(np.mean(squares_m2))),
    }
