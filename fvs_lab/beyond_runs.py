"""Runs beyond the paper: a minute of data, a camera that is moved far, a target that moves."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fvs_controller_node.reasons import State
from fvs_estimator_node.chain_fit import fit_chain
from fvs_estimator_node.dataset import DataSet, data_set_of
from fvs_estimator_node.distilling import train_structured
from fvs_estimator_node.motion import MotionConfig, RandomMotion
from fvs_lab import trials
from fvs_lab.contestants import variant
from fvs_lab.results import Results
from fvs_ros.timeline import Sample, Timeline
from fvs_tools.closed_loop import ClosedLoop

# ---- a minute of motion ---------------------------------------------------------------------

MINUTE_S = 60.0
#: The images of a seed are stamped late by as much as this, drawn evenly, s.
MOST_LATE_S = 0.1

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
    conditions: trials.Conditions
    #: Joints at which Jacobians are judged, rad, as of :func:`draw_places`.
    places: Mapping[str, np.ndarray]


def draw_places(seed: int, count: int) -> dict[str, np.ndarray]:
    """Draw joints of ``box`` M, and of the whole ``workspace`` that the camera sees, rad."""
    rng = np.random.default_rng(seed)
    box = trials.HOME_RAD + rng.uniform(-1.0, 1.0, (count, trials.HOME_RAD.size)) * trials.BOX_RAD
    simulation = trials.simulation_of(trials.Conditions())
    seen: list[np.ndarray] = []
    while len(seen) < count:
        joints = rng.uniform(-np.pi, np.pi, trials.HOME_RAD.size)
        simulation.reset(joints)
        if trials.sees(simulation):
            seen.append(joints)
    return {"box": box, "workspace": np.array(seen)}


def record(minute: Minute) -> tuple[DataSet, float]:
    """Let the simulated arm move and record as the collector does; how late the images are, s."""
    rng = np.random.default_rng([minute.seed, 1])
    late_s = float(rng.uniform(0.0, MOST_LATE_S))
    simulation = trials.simulation_of(minute.conditions)
    simulation.reset(trials.HOME_RAD, minute.seed)
    motion = RandomMotion(trials.HOME_RAD, MotionConfig(minute.duration_s), rng)
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
    """Record a minute, fit and distill, and compare with the true Jacobian.

    A row: relative errors of the Jacobians (medians over the places) of the chain and of the
    networks distilled from it; ``fit_s`` of one core; how late the images were stamped, and what
    the fit says.
    """
    data, late_s = record(minute)
    began_s = time.process_time()
    distilled = train_structured(data, seed=minute.seed)
    fit_s = time.process_time() - began_s
    simulation = trials.simulation_of(minute.conditions)
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
        for who, model in (("chain", distilled.chain), ("distilled", distilled.model)):
            errors = trials.relative_errors(model.jacobian(joints), true)
            row[f"{who}_{where}"] = float(np.median(errors))
    return row


def assess(task: tuple[str, Minute]) -> dict[str, Any]:
    """Record a minute of a plant, fit a chain, and compare its error with what the fit says.

    A row: what errs, the error ``stated`` by the fit, and the errors against the Jacobian of where
    the camera sees the ball (``seen``) and of where it is (``metric``), medians in box M.
    """
    plant, minute = task
    fit = fit_chain(record(minute)[0])
    simulation = trials.simulation_of(minute.conditions)
    joints = minute.places["box"]
    metric = np.array([simulation.true_jacobian(one) for one in joints])
    # how the camera errs is linear
    seen = np.stack([simulation.as_seen(one) for one in np.eye(metric.shape[1])], axis=1) @ metric
    found = fit.chain.jacobian(joints)
    errors = {
        "stated": float(np.median(fit.jacobian_deviation(joints))),
        "seen": float(np.median(trials.relative_errors(found, seen))),
        "metric": float(np.median(trials.relative_errors(found, metric))),
    }
    honesty = errors["stated"] / errors["seen"]
    return {"part": "assessment", "plant": plant, **errors, "honesty": honesty}


# ---- moved cameras --------------------------------------------------------------------------

#: In motion the blow comes this time after the target, s.
STRUCK_AFTER_S = 0.3
#: How long the camera is carried, and how long the arm rests at the first target after a blow, s.
CARRIED_S, REST_S = 2.0, 1.0

UNDISTURBED, AT_REST, IN_MOTION = "undisturbed", "between two targets", "in mid-motion"
CARRIED = f"within {CARRIED_S:g} s while the arm is stopped"
#: When the camera moves; the first is never.
MOMENTS = (UNDISTURBED, AT_REST, CARRIED, IN_MOTION)


@dataclass(frozen=True)
class Journey:
    """From the goal of a case to its start, a rest, and back, with a blow to the camera."""

    #: The contestant, and the two ends.
    name: str
    case: trials.Case
    #: How the camera moves (its time does not count), and when, one of ``MOMENTS``.
    bump: trials.Bump
    moment: str
    conditions: trials.Conditions


def draw_journeys(
    count: int, seed: int, names: Sequence[str], conditions: trials.Conditions
) -> list[Journey]:
    """Draw cases and blows after which the ball is still seen; for each all moments and names."""
    rng = np.random.default_rng(seed)
    pairs: list[tuple[trials.Case, trials.Bump]] = []
    while len(pairs) < count:
        case = trials.make_cases(f"C{len(pairs) + 1}-", 1, int(rng.integers(2**31)))[0]
        # About the optical axis, but for a tenth.
        axis = np.append(0.1 * rng.normal(size=2), rng.choice([-1.0, 1.0]))
        shift = rng.normal(size=3)
        bump = trials.Bump(STRUCK_AFTER_S, _vector(axis, 45.0), _vector(shift, 0.1))
        if _seen_after(bump, case):
            pairs.append((case, bump))
    return [
        Journey(name, case, bump, moment, conditions)
        for case, bump in pairs
        for moment in MOMENTS
        for name in names
    ]


def _vector(direction: np.ndarray, length: float) -> trials.Vector:
    x, y, z = (length * direction / np.linalg.norm(direction)).tolist()
    return (x, y, z)


def _seen_after(bump: trials.Bump, case: trials.Case) -> bool:
    """Whether the struck camera sees the ball at both ends and between them."""
    simulation = trials.simulation_of(trials.Conditions())
    bump.strike(simulation)
    between = 0.5 * (np.array(case.start_rad) + np.array(case.goal_rad))
    for joints in (case.start_rad, case.goal_rad, between):
        simulation.reset(joints)
        if not trials.sees(simulation):
            return False
    return True


def run_journey(journey: Journey) -> dict[str, Any]:
    """Run one journey; a row, whose ``to_5mm_s`` counts from the second target on."""
    bump, moment, case = journey.bump, journey.moment, journey.case
    row = {"part": "camera", "scheme": journey.name, "moment": moment, "case": case.name}
    simulation = trials.simulation_of(journey.conditions)
    simulation.reset(case.start_rad)
    first_m = simulation.world.ball_position()
    simulation.reset(case.goal_rad, case.seed)
    second_m = simulation.world.ball_position()
    trial = variant(journey.name).trial(case, journey.conditions, duration_s=3.5)
    loop = trial.loop(simulation)
    loop.run(trials.PRELUDE_S)
    loop.set_target(simulation.camera.to_camera(first_m))
    loop.run(1.6)
    if moment == AT_REST:
        bump.strike(simulation)
    elif moment == CARRIED:
        _carry(bump, loop)
    if moment in (AT_REST, CARRIED):
        loop.set_target(simulation.camera.to_camera(first_m))
    if moment == CARRIED and not loop.loop.supervisor.start(simulation.time_s)[0]:
        # The ball was lost on the way to the first target, as undisturbed.
        return {**row, "to_5mm_s": math.inf}
    loop.run(REST_S)
    struck = replace(trial, bump=bump if moment == IN_MOTION else None)
    return {**row, "to_5mm_s": trials.go(struck, loop, second_m).settled_s}


def _carry(bump: trials.Bump, loop: ClosedLoop) -> None:
    """Stop the arm and carry the camera evenly to where a blow would throw it."""
    loop.loop.supervisor.stop()
    loop.run(0.5)
    ticks = round(CARRIED_S / loop.period_s)
    for _ in range(ticks):
        bump.strike(loop.simulation, ticks)
        loop.tick()
    loop.run(0.5)


def with_slowdown(arrivals: Results) -> Results:
    """Rows with ``slowdown``: settling time over that of the undisturbed run of the same case.

    From the last target on: in mid-motion that is the second one given anew, which is compared
    with what was left of the undisturbed run. Infinite where nothing was left, or the undisturbed
    run never settled. ``kept``: whether it is at most 1.2.
    """
    calm = arrivals.where(moment=UNDISTURBED).groups("scheme", "case")
    rows = []
    for row in arrivals:
        before_s = STRUCK_AFTER_S if row["moment"] == IN_MOTION else 0.0
        left_s = calm[row["scheme"], row["case"]].rows[0]["to_5mm_s"] - before_s
        comparable = 0.0 < left_s < math.inf
        slowdown = (row["to_5mm_s"] - before_s) / left_s if comparable else math.inf
        rows.append({**row, "slowdown": slowdown, "kept": slowdown <= 1.2})
    return Results(rows)


# ---- moving targets -------------------------------------------------------------------------

LINE, CIRCLE = "line", "circle"
RADIUS_M = 0.08
SPEEDS_M_S = (0.02, 0.05, 0.1, 0.2, 0.3)
#: Longest run, and its beginning, which does not count, by kind, s.
LONGEST_S = {LINE: 3.0, CIRCLE: 4.0}
START_S = {LINE: 0.8, CIRCLE: 1.5}
#: The target is given as often as a camera would, Hz.
RATE_HZ = 30.0


@dataclass(frozen=True)
class Path:
    """Where a target goes, camera frame."""

    #: ``line`` or ``circle``, and joints whose ball is where it begins, rad.
    kind: str
    start_rad: tuple[float, ...]
    #: The beginning, m; unit vectors: a line goes along the first, a circle is in the plane of both
    #: and begins along the second.
    origin_m: np.ndarray
    first: np.ndarray
    second: np.ndarray
    #: After which a line ends, m; seed of the noise.
    length_m: float
    seed: int

    def at(self, way_m: float) -> np.ndarray:
        """The target after a length of its way, m."""
        if self.kind == LINE:
            return self.origin_m + way_m * self.first
        angle = way_m / RADIUS_M
        turned = (np.cos(angle) - 1.0) * self.first + np.sin(angle) * self.second
        return self.origin_m + RADIUS_M * turned


@dataclass(frozen=True)
class Pursuit:
    """A target to be followed by a contestant, with or without feed-forward of its motion."""

    name: str
    path: Path
    speed_m_s: float
    feed_forward: bool
    conditions: trials.Conditions


def draw_paths(count: int, seed: int) -> list[Path]:
    """Draw lines between places in box M, and as many circles in any plane about home."""
    rng = np.random.default_rng(seed)
    simulation = trials.simulation_of(trials.Conditions())

    def ball_m(joints_rad: Sequence[float]) -> np.ndarray:
        simulation.reset(joints_rad)
        return simulation.true_ball_position()

    paths = []
    for case in trials.make_cases("L", count, seed, low_m=0.45, high_m=0.6):
        start_m, goal_m = ball_m(case.start_rad), ball_m(case.goal_rad)
        length_m = float(np.linalg.norm(goal_m - start_m))
        along = (goal_m - start_m) / length_m
        paths.append(Path(LINE, case.start_rad, start_m, along, along, length_m, case.seed))
    home = tuple(trials.HOME_RAD.tolist())
    for line in paths[:count]:
        first, second = np.linalg.qr(rng.normal(size=(len(line.first), 2)))[0].T
        paths.append(Path(CIRCLE, home, ball_m(home), first, second, math.inf, line.seed))
    return paths


def run_pursuit(pursuit: Pursuit) -> dict[str, Any]:
    """Follow one target; ``rms_m`` of the row is the ball's distance from it after the start, m.

    It is infinite for an arm that the supervisor held.
    """
    path, speed_m_s = pursuit.path, pursuit.speed_m_s
    simulation = trials.simulation_of(pursuit.conditions)
    simulation.reset(path.start_rad, path.seed)
    one = variant(pursuit.name, target_feed_forward=pursuit.feed_forward)
    case = trials.Case("", path.start_rad, path.start_rad, path.seed)
    loop = one.trial(case, pursuit.conditions).loop(simulation)
    loop.run(trials.PRELUDE_S)
    errors_m, next_s, held = [], 0.0, False
    duration_s = min(LONGEST_S[path.kind], path.length_m / speed_m_s)
    for tick in range(round(duration_s / loop.period_s)):
        now_s = tick * loop.period_s
        if now_s >= next_s:
            loop.set_target(path.at(speed_m_s * now_s))
            next_s += 1.0 / RATE_HZ
        held = loop.tick().state is not State.SERVOING
        if now_s >= START_S[path.kind]:
            target_m = path.at(speed_m_s * (now_s + loop.period_s))
            errors_m.append(simulation.true_ball_position() - target_m)
    return {
        "part": "tracking",
        "scheme": pursuit.name,
        "path": path.kind,
        "seed": path.seed,
        "speed_m_s": speed_m_s,
        "feed_forward": pursuit.feed_forward,
        "rms_m": math.inf if held else float(np.sqrt(np.mean(np.sum(np.square(errors_m), axis=1)))),
    }
