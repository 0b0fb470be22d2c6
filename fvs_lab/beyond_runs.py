"""Runs beyond the paper: a minute of data, a camera that is moved far, a target that moves."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from fvs_estimator_node.chain_fit import fit_chain
from fvs_estimator_node.files import DataSet, data_set_of
from fvs_estimator_node.motion import MotionConfig, RandomMotion
from fvs_estimator_node.training import TrainingOptions, train
from fvs_lab import trials
from fvs_lab.contestants import variant
from fvs_lab.results import Results
from fvs_ros.timeline import Sample, Timeline
from fvs_tools.closed_loop import ClosedLoop

# ---- a minute of motion ---------------------------------------------------------------------

MINUTE_S = 60.0
#: Largest stamp delay of a recording's images, drawn uniformly by its seed, s.
MOST_LATE_S = 0.1

#: Plant errors and their conditions: the calibration error of an off-the-shelf depth camera, and
#: encoders and drives much worse than a UR's.
USUAL = "nothing"
ERRING: Mapping[str, Mapping[str, Any]] = {
    USUAL: {},
    "focal length stated 1 % too long": {"focal_error": 0.01},
    "focal length stated 1 % too short": {"focal_error": -0.01},
    "depths stated 0.5 % too large": {"depth_error": 0.005},
    "0.2 mrad of noise on the joints": {"encoder_noise_rad": 0.0002},
    "drives that lag by 100 ms": {"joint_lag_s": 0.1},
}


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


def record(seed: int, duration_s: float, conditions: trials.Conditions) -> tuple[DataSet, float]:
    """Record the simulated arm as the collector does; also returns the stamp delay, s.

    The seed determines the motion, the noise and the delay.
    """
    rng = np.random.default_rng([seed, 1])
    late_s = float(rng.uniform(0.0, MOST_LATE_S))
    simulation = trials.simulation_of(conditions)
    simulation.reset(trials.HOME_RAD, seed)
    config = MotionConfig(duration_s=duration_s, joint_range_rad=tuple(trials.BOX_RAD))
    motion = RandomMotion(trials.HOME_RAD, config, rng)
    matcher = Timeline()
    samples: list[Sample] = []
    joints = simulation.joints_rad
    while simulation.time_s < duration_s:
        simulation.command(motion.command(simulation.time_s, joints))
        out = simulation.advance()
        joints = out.joints_rad
        samples += matcher.add_joints(out.time_s, joints)
        for seen in out.observations:
            if seen.z is not None:
                samples += matcher.add_image(seen.stamp_s + late_s, seen.z)
    return data_set_of(samples), late_s


def learn(
    task: tuple[str, int, float, trials.Conditions], places: Mapping[str, np.ndarray]
) -> dict[str, Any]:
    """Record a plant (its name, seed, duration, s, and conditions), fit, distil and compare.

    Returns a row: relative errors of the Jacobians of the chain and of the distilled networks,
    medians over the places of :func:`draw_places`; ``fit_s`` on one core; true and estimated stamp
    delay. For box M also the error ``stated`` by the fit, and the error against the Jacobian of
    the position that the camera reports (``seen``); ``chain_box`` is against the true one.
    """
    plant, seed, duration_s, conditions = task
    data, late_s = record(seed, duration_s, conditions)
    began_s = time.process_time()
    distilled = train(data, TrainingOptions("poe", seed=seed))
    fit_s = time.process_time() - began_s
    assert distilled.chain is not None
    simulation = trials.simulation_of(conditions)
    true = {
        where: np.array([simulation.true_jacobian(one) for one in joints])
        for where, joints in places.items()
    }
    # the camera's systematic error is linear
    errs = np.stack([simulation.as_seen(one) for one in np.eye(true["box"].shape[1])], axis=1)
    stated = float(np.median(fit_chain(data).jacobian_deviation(places["box"])))

    def off(model: Any, where: str, seen: np.ndarray) -> float:
        return float(np.median(trials.relative_errors(model.jacobian(places[where]), seen)))

    seen = off(distilled.chain, "box", errs @ true["box"])
    return {
        "part": "minute",
        "plant": plant,
        "seed": seed,
        "images": len(data),
        "fit_s": fit_s,
        "late_error_s": abs(distilled.errors["time_offset_s"] - late_s),
        "chain_box": off(distilled.chain, "box", true["box"]),
        "chain_workspace": off(distilled.chain, "workspace", true["workspace"]),
        "distilled_box": off(distilled.model, "box", true["box"]),
        "stated": stated,
        "seen": seen,
        "honesty": stated / seen,
    }


# ---- moved cameras --------------------------------------------------------------------------

#: Time from the target to the blow in motion, s.
STRUCK_AFTER_S = 0.3
#: How long the camera is carried, and how long the arm rests at the first target after a blow, s.
CARRIED_S, REST_S = 2.0, 1.0

UNDISTURBED, AT_REST, IN_MOTION = "undisturbed", "between two targets", "in mid-motion"
CARRIED = f"within {CARRIED_S:g} s while the arm is stopped"
#: When the camera moves; the first is never.
MOMENTS = (UNDISTURBED, AT_REST, CARRIED, IN_MOTION)


#: A run of an experiment: the columns that tell it from the others, and the trial.
Run = tuple[Mapping[str, Any], trials.Trial]


def journeys(count: int, seed: int, names: Sequence[str]) -> Iterator[Run]:
    """From the goal of a case to its start, a rest, and back, with a blow to the camera.

    Cases and blows are drawn so that the ball is still seen after the blow; each has all moments
    and all contestants. Settling times count from the second target on.
    """
    rng = np.random.default_rng(seed)
    drawn = 0
    while drawn < count:
        case = trials.make_cases(f"C{drawn + 1}-", 1, int(rng.integers(2**31)))[0]
        # About the optical axis, except for a tenth.
        axis = np.append(0.1 * rng.normal(size=2), rng.choice([-1.0, 1.0]))
        shift = rng.normal(size=3)
        bump = trials.Bump(STRUCK_AFTER_S, trials.along(axis, 45.0), trials.along(shift, 0.1))
        if not _seen_after(bump, case):
            continue
        drawn += 1
        simulation = trials.simulation_of(trials.Conditions())
        simulation.reset(case.start_rad)
        first_m = simulation.world.ball_position()
        for moment in MOMENTS:
            for name in names:
                labels = {"part": "camera", "scheme": name, "moment": moment, "case": case.name}
                trial = trials.Trial(
                    variant(name),
                    replace(case, start_rad=case.goal_rad),
                    duration_s=3.5,
                    bump=bump if moment == IN_MOTION else None,
                    before=partial(_visit, first_m, bump, moment),
                )
                yield labels, trial


def _seen_after(bump: trials.Bump, case: trials.Case) -> bool:
    """Whether the struck camera sees the ball at both ends and between them."""
    simulation = trials.simulation_of(trials.Conditions())
    bump.strike(simulation)
    ends = np.array([case.start_rad, case.goal_rad])
    return trials.sees_all(simulation, (*ends, ends.mean(axis=0)))


def _visit(first_m: np.ndarray, bump: trials.Bump, moment: str, one: ClosedLoop) -> None:
    """Go to a first target, world frame, m, and rest there; the camera moves at its moment."""
    trials.give_target(one, first_m)
    one.run(1.6)
    if moment == AT_REST:
        bump.strike(one.simulation)
    elif moment == CARRIED:
        _carry(bump, one)
    if moment in (AT_REST, CARRIED):
        trials.give_target(one, first_m)
    if moment == CARRIED:
        one.loop.supervisor.start(one.simulation.time_s)
    one.run(REST_S)


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

    Settling times count from the last target. After a blow in motion that is the second target
    given again, compared with the remaining time of the undisturbed run. Infinite if no time
    remained, or if the undisturbed run never settled. ``kept`` is whether it is at most 1.2.
    """
    calm = arrivals.where(moment=UNDISTURBED).groups("scheme", "case")

    def slowdown(row: Mapping[str, Any]) -> dict[str, Any]:
        before_s = STRUCK_AFTER_S if row["moment"] == IN_MOTION else 0.0
        left_s = calm[row["scheme"], row["case"]].rows[0]["to_5mm_s"] - before_s
        comparable = 0.0 < left_s < math.inf
        ratio = (row["to_5mm_s"] - before_s) / left_s if comparable else math.inf
        return {"slowdown": ratio, "kept": ratio <= 1.2}

    return arrivals.adding(slowdown)


# ---- moving targets -------------------------------------------------------------------------

LINE, CIRCLE = "line", "circle"
RADIUS_M = 0.08
SPEEDS_M_S = (0.02, 0.05, 0.1, 0.2, 0.3)
#: Longest run, and its beginning, which does not count, by kind, s.
LONGEST_S = {LINE: 3.0, CIRCLE: 4.0}
START_S = {LINE: 0.8, CIRCLE: 1.5}


def on_line(start_m: np.ndarray, along: np.ndarray, way_m: float) -> np.ndarray:
    """The target after a length of its way along a unit vector, m."""
    return start_m + way_m * along


def on_circle(start_m: np.ndarray, plane: np.ndarray, way_m: float) -> np.ndarray:
    """The target after a length of its way round, m; it begins along the second unit vector."""
    angle = way_m / RADIUS_M
    return start_m + RADIUS_M * ((np.cos(angle) - 1.0) * plane[0] + np.sin(angle) * plane[1])


def pursuits(
    count: int, seed: int, speeds_m_s: Sequence[float], names: Sequence[str]
) -> Iterator[Run]:
    """Targets on lines between places in box M, and on as many circles in any plane about home.

    Each has all speeds, all contestants, and feed-forward of the target's motion or none.
    """
    rng = np.random.default_rng(seed)
    simulation = trials.simulation_of(trials.Conditions())

    def ball_m(joints_rad: Sequence[float]) -> np.ndarray:
        simulation.reset(joints_rad)
        return simulation.true_ball_position()

    home = tuple(trials.HOME_RAD.tolist())
    lines, circles = [], []
    for case in trials.make_cases("L", count, seed, low_m=0.45, high_m=0.6):
        start_m = ball_m(case.start_rad)
        way_m = ball_m(case.goal_rad) - start_m
        length_m = float(np.linalg.norm(way_m))
        line = partial(on_line, start_m, way_m / length_m)
        lines.append((LINE, case, line, length_m))
        plane = np.linalg.qr(rng.normal(size=(way_m.size, 2)))[0].T
        circle = partial(on_circle, ball_m(home), plane)
        circles.append((CIRCLE, replace(case, start_rad=home), circle, math.inf))
    for (kind, case, path, length_m), speed_m_s, feed_forward, name in product(
        (*lines, *circles), speeds_m_s, (True, False), names
    ):
        labels = {"part": "tracking", "scheme": name, "path": kind, "seed": case.seed}
        labels |= {"speed_m_s": speed_m_s, "feed_forward": feed_forward}
        trial = trials.Trial(
            variant(name, target_feed_forward=feed_forward),
            case,
            duration_s=min(LONGEST_S[kind], length_m / speed_m_s),
            record=True,
            path=(path, speed_m_s),
        )
        yield labels, trial


def tracking_error(row: Mapping[str, Any]) -> dict[str, float]:
    """Of a pursuit's row: ``rms_m``, the ball's distance from the target after the start, m.

    It is infinite for an arm that the supervisor held.
    """
    counted = row["series"]["time_s"] > START_S[row["path"]] + 1e-9
    rms_m = float(np.sqrt(np.mean(row["series"]["error_m"][counted] ** 2)))
    held = row["jitter_rad_s"] == math.inf
    return {"rms_m": math.inf if held else rms_m}
